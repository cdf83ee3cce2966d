"""What the guard may depend on."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from companion.guard import guard


def test_the_guard_imports_nothing_but_numpy_and_the_standard_library() -> None:
    for module in Path(guard.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or "companion"]
            for name in names:
                own = name.startswith("companion.guard.")
                assert own or name.split(".")[0] in {"numpy", *sys.stdlib_module_names}, (module.name, name)
