"""The functions of the three programs with their lengths and numbers of parameters, for the limits of docs/design.md.

`python -m tests.pages.sizes [COUNT]` prints the largest classes and functions.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from tests.pages.modules import ROOT, module_paths

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef


@dataclass(frozen=True)
class Size:
    """The size of a class or a function of the three programs."""

    name: str
    """Path and qualified name, as `path::Class.method`."""
    is_class: bool
    lines: int
    parameters: int
    attributes: int


def definitions(node: ast.AST, prefix: str = "") -> Iterator[tuple[str, Definition]]:
    """Yield every class and function within a node, with its qualified name."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Definition):
            yield prefix + child.name, child
            yield from definitions(child, f"{prefix}{child.name}.")
        else:
            yield from definitions(child, prefix)


def parameters(function: Function) -> int:
    """Return how many parameters a function takes, self and cls not counted."""
    every = function.args
    named = [each.arg for each in (*every.posonlyargs, *every.args, *every.kwonlyargs)]
    return len([name for name in named if name not in ("self", "cls")]) + len(
        [each for each in (every.vararg, every.kwarg) if each]
    )


def attributes(cls: ast.ClassDef) -> int:
    """Return how many attributes the methods of a class set on self."""
    return len(
        {
            node.attr
            for node in ast.walk(cls)
            if isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and isinstance(node.value, ast.Name)
            and node.value.id == "self"
        }
    )


def sizes() -> list[Size]:
    """Return every class and function of the three programs."""
    found = []
    for path in module_paths():
        for name, node in definitions(ast.parse(path.read_text())):
            is_class = isinstance(node, ast.ClassDef)
            found.append(
                Size(
                    name=f"{path.relative_to(ROOT)}::{name}",
                    is_class=is_class,
                    lines=(node.end_lineno or node.lineno) - node.lineno + 1,
                    parameters=0 if isinstance(node, ast.ClassDef) else parameters(node),
                    attributes=attributes(node) if isinstance(node, ast.ClassDef) else 0,
                )
            )
    return found


def main() -> None:
    """Print the largest classes and functions."""
    count = int(sys.argv[1]) if sys.argv[1:] else 15
    for is_class in (True, False):
        largest = sorted((each for each in sizes() if each.is_class is is_class), key=lambda each: -each.lines)
        for each in largest[:count]:
            print(f"{each.lines:5} lines {each.parameters:3} parameters {each.attributes:3} attributes  {each.name}")


if __name__ == "__main__":
    main()
