"""docs/paper.md maps the paper to the code: nothing of the paper is missing there, and what it names exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "paper.md").read_text()
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if re.match(r"\| (?!label )", line)
]
REFERENCES = sorted(set(re.findall(r"`([a-z_]+/[a-z_/]+\.py)::([A-Za-z_.]+)`", PAGE)))
EQUATIONS = (
    "fun1 fun2 fun3 constraint fun4 newobjfun opt_pro fun5 Hmatrixform aprfun appro_fuc obfun1 direct1 unitdirect "
    "update update2 newdecre1 newdirect thm_condition thm_2_1 decrease direct_p newdecre newdecre2 newdecre3 newdecre4 "
    "newdecre_new newdecre_nn coro_condi"
).split()
THEOREMS = ["thm_2", "corollary", "KM thm", "Hungarian", "Hungarian method"]
FIGURES = [f"Fig:{name}" for name in "fighter submarine step flowchart performance compare paths time".split()]
REMARKS = ["remark 1", "remark 2", "remark 3"]


def names_in(path: Path) -> set[str]:
    """Return the functions and classes of a module, and the methods of its classes as Class.method."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return names


@pytest.mark.parametrize("label", [*EQUATIONS, *THEOREMS, *FIGURES])
def test_every_label_of_the_paper_has_a_row(label: str) -> None:
    assert [row for row in ROWS if f"`{label}`" in row[0]]


@pytest.mark.parametrize("remark", REMARKS)
def test_every_remark_of_the_paper_has_a_row(remark: str) -> None:
    assert [row for row in ROWS if row[0] == remark]


@pytest.mark.slow
@pytest.mark.parametrize(("path", "name"), REFERENCES)
def test_every_function_that_the_page_names_exists(path: str, name: str) -> None:
    assert name in names_in(ROOT / path)


def test_every_row_names_a_function_a_document_or_a_reason() -> None:
    assert len(ROWS) > len(EQUATIONS)
    for row in ROWS:
        assert len(row) == 3
        assert "::" in row[2] or "docs/" in row[2] or len(row[2].split()) >= 4, row
