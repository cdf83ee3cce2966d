"""Exit statuses and one-line errors, shared by all three programs."""

from __future__ import annotations

import subprocess
import sys

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import (
    EXIT_INTERRUPTED,
    InputError,
    nearest_hint,
    one_line,
    printable,
    run_program,
    some_of,
    tell,
)


def outcome(
    command: click.Command, capsys: pytest.CaptureFixture[str], *arguments: str, program: str = "program"
) -> tuple[int, str]:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr("sys.argv", [program, *arguments])
        run_program(command, program)
    assert isinstance(ended.value.code, int)
    return ended.value.code, capsys.readouterr().err


def ending_in(error: BaseException) -> click.Command:
    @click.command()
    def command() -> None:
        raise error

    return command


def test_the_status_a_command_returns_is_the_exit_status(capsys: pytest.CaptureFixture[str]) -> None:
    assert outcome(click.Command("c", callback=lambda: 1), capsys) == (1, "")


def test_a_command_that_returns_nothing_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    assert outcome(click.Command("c", callback=lambda: None), capsys) == (0, "")


def test_unusable_input_is_one_line_and_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    assert outcome(ending_in(InputError("file: key: 3;\n allowed: 4")), capsys) == (
        2,
        "program: file: key: 3; allowed: 4\n",
    )


def test_a_usage_error_is_one_line_and_status_two(capsys: pytest.CaptureFixture[str]) -> None:
    status, text = outcome(click.Command("c", callback=lambda: None), capsys, "--no-such-option")
    assert status == 2
    assert text.count("\n") == 1
    assert "--no-such-option" in text


def test_a_program_called_without_a_command_says_where_help_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert outcome(click.Group("g"), capsys) == (2, "program: Missing command; see 'program --help'\n")


def test_an_interrupt_ends_quietly_with_its_own_status(capsys: pytest.CaptureFixture[str]) -> None:
    status, text = outcome(ending_in(KeyboardInterrupt()), capsys)
    assert status == EXIT_INTERRUPTED
    assert "Traceback" not in text


def test_a_fault_of_the_program_itself_is_not_hidden() -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(ZeroDivisionError):
        patch.setattr("sys.argv", ["program"])
        run_program(ending_in(ZeroDivisionError()), "program")


@pytest.mark.parametrize(("program", "extra"), [("companion", "ground"), ("groundstation", "ground"), ("sim", "sim")])
def test_a_library_of_an_extra_that_is_not_installed_is_one_line_that_says_how_to_install_it(
    program: str, extra: str, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = ModuleNotFoundError("No module named 'scipy.optimize'", name="scipy.optimize")
    assert outcome(ending_in(missing), capsys, program=program) == (
        2,
        f"{program}: needs scipy, which is not installed: pip install '.[{extra}]'\n",
    )


def test_a_module_of_our_own_that_is_missing_is_not_hidden() -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(ModuleNotFoundError):
        patch.setattr("sys.argv", ["sim"])
        run_program(ending_in(ModuleNotFoundError("No module named 'sim.absent'", name="sim.absent")), "sim")


def test_the_nearest_word_is_suggested_only_if_it_is_near() -> None:
    assert nearest_hint("sed", ["seed", "ramp"]) == "; did you mean 'seed'?"
    assert nearest_hint("zzz", ["seed", "ramp"]) == ""


def test_any_white_space_is_folded_into_one_line() -> None:
    assert one_line(" a\n\tb  c ") == "a b c"


def test_a_full_disk_is_one_line_and_not_a_failed_mission(capsys: pytest.CaptureFixture[str]) -> None:
    error = OSError(28, "No space left on device", "out/trajectory.csv")
    assert outcome(ending_in(error), capsys) == (2, "program: out/trajectory.csv: No space left on device\n")


def test_a_reader_that_went_away_is_no_failure() -> None:
    script = "from companion.errors import tell; tell('x' * 100_000); tell('y' * 100_000)"
    writer = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert writer.stdout is not None and writer.stderr is not None
    writer.stdout.close()
    assert writer.stderr.read() == b""
    assert writer.wait(timeout=60) == 0


@given(st.text(max_size=60))
def test_no_text_steers_a_terminal_or_begins_a_line_of_its_own(text: str) -> None:
    assert printable(text).isprintable()
    assert len(printable(text)) == len(text)
    assert printable(text) == text or not text.isprintable()


def test_an_error_and_what_is_told_show_the_escapes_in_a_name_as_question_marks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, text = outcome(ending_in(InputError("name: \x1b[31mX\u202e")), capsys)
    assert (status, text) == (2, "program: name: ?[31mX?\n")
    tell("a \x1b[2J\nb")
    assert capsys.readouterr().out == "a ?[2J\nb\n"


@pytest.mark.parametrize(
    ("ids", "words"), [([], ""), ([7], "7"), ([1, 2, 3], "1, 2, 3"), ([1, 2, 3, 4, 5], "1, 2, 3 and 2 more")]
)
def test_of_many_things_the_first_ones_are_said_and_how_many_more_there_are(ids: list[int], words: str) -> None:
    assert some_of(ids, 3) == words
