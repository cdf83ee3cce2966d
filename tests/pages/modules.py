"""The list of modules in docs/architecture.md, made from the first line of each module's docstring.

`python -m tests.pages.modules` prints it, `--write` puts it into the page.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
MARK = "<!-- modules: written by `python -m tests.pages.modules --write` -->"
FOLDERS = (
    "companion",
    *(f"companion/{room}" for room in "onboard autopilot guidance surrogate mission protocol transport".split()),
    *(f"companion/{room}" for room in "files runtime geo guard".split()),
    "groundstation",
    "sim",
)
"""The folders in the order of their imports, the highest first; a folder that is not among them follows its parent."""
GENERATED = ROOT / "companion" / "protocol" / "dialect" / "oneway.py"


def module_paths() -> list[Path]:
    """Return every module of the three programs; the module that mavgen wrote is left out."""
    found = [path for program in ("companion", "groundstation", "sim") for path in (ROOT / program).rglob("*.py")]
    return sorted(path for path in found if path != GENERATED)


def first_line(path: Path) -> str:
    """Return the first line of a module's docstring, safe inside a Markdown table."""
    docstring = ast.get_docstring(ast.parse(path.read_text())) or ""
    line = docstring.partition("\n")[0]
    parts = line.split("`")
    parts[::2] = [part.replace("*", r"\*").replace("<", "&lt;") for part in parts[::2]]
    return "`".join(parts).replace("|", r"\|")


def folder_order(folder: str) -> tuple[int, str]:
    """Return the sort key of a folder: the position in FOLDERS of itself or its nearest parent, then its name."""
    room = max((known for known in FOLDERS if f"{folder}/".startswith(f"{known}/")), key=len)
    return FOLDERS.index(room), folder


def module_list() -> str:
    """Return the list: for each folder a heading, its package's first line and a table of its modules."""
    folders: dict[str, list[Path]] = {}
    for path in module_paths():
        folders.setdefault(str(path.parent.relative_to(ROOT)), []).append(path)
    lines: list[str] = []
    for folder in sorted(folders, key=folder_order):
        lines += [f"### {folder}", ""]
        package = [path for path in folders[folder] if path.name == "__init__.py"]
        lines += [text for path in package for text in (first_line(path), "")]
        modules = [path for path in folders[folder] if path.name != "__init__.py"]
        if modules:
            lines += ["| module | what it does |", "|---|---|"]
            lines += [f"| `{path.relative_to(ROOT)}` | {first_line(path)} |" for path in modules] + [""]
    return "\n".join(lines)


def page_with_list(page: str) -> str:
    """Return the page with the list of the modules as they are now.

    Args:
        page: The page as it is; everything behind the mark is replaced.

    """
    head, mark, _ = page.partition(MARK)
    if not mark:
        raise ValueError(f"{PAGE.relative_to(ROOT)} has no line {MARK}")
    return f"{head}{MARK}\n\n{module_list()}"


def main() -> None:
    """Print the list, or write it into the page."""
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(page_with_list(PAGE.read_text()))
    else:
        print(module_list())


if __name__ == "__main__":
    main()
