"""The `sim` command line: what it loads and when, and what it says where a library is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click
import pytest

from companion.errors import run_program
from sim.cli import COMMANDS, cli

HEAVY = ("matplotlib", "scipy", "pyproj", "numpy", "pydantic", "rich", "jinja2")


def sim(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[object, str, str]:
    """Return exit status, standard output and standard error of a call."""
    monkeypatch.setattr(sys, "argv", ["sim", *arguments])
    with pytest.raises(SystemExit) as ended:
        run_program(cli, "sim")
    printed = capsys.readouterr()
    return ended.value.code, printed.out, printed.err


def test_the_help_loads_none_of_the_libraries_that_the_commands_need() -> None:
    code = (
        "import sys\nfrom sim.cli import cli\ncli.main(['--help'], standalone_mode=False)\n"
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.rstrip().endswith("[]")


@pytest.mark.parametrize(("wrong", "right"), [("flyy", "fly"), ("arean", "arena"), ("vehicel", "vehicle")])
def test_a_command_that_is_none_is_refused_with_the_nearest_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], wrong: str, right: str
) -> None:
    status, _, told = sim(monkeypatch, capsys, wrong)
    assert (status, told) == (2, f"sim: No such command '{wrong}'. Did you mean '{right}'?\n")


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_of_commands_gives_the_first_sentence_of_each_commands_own_help(name: str) -> None:
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert command.name == name
    assert command.get_short_help_str(1_000) == COMMANDS[name].summary


def test_a_library_that_is_missing_is_named_on_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "jinja2", None)
    for module in ("sim.fly_folder", "sim.report"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    status, out, err = sim(monkeypatch, capsys, "fly", "paper-static", "--out", str(tmp_path / "out"))
    assert (status, out) == (2, "")
    assert err == "sim: needs jinja2, which is not installed: pip install '.[sim]'\n"
    assert list((tmp_path / "out").iterdir()) == [], "it is told before the flight"


def test_the_arena_without_its_planning_library_says_so_before_it_flies(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "ompl.base", None)
    status, out, err = sim(monkeypatch, capsys, "arena", "--runs", "1", "--out", str(tmp_path / "out"))
    assert (status, out) == (2, "")
    assert err == "sim: horizon: needs the library OMPL; install '.[arena]'\n"
    assert not (tmp_path / "out").exists()
