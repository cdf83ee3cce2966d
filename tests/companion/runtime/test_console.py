"""A program's messages are one line each, on the stream that they belong to."""

from __future__ import annotations

import logging

import pytest

from companion.runtime.console import Job, messages_as_json, messages_written_by, program_logger

LOGGER = program_logger("ferry")


def test_information_goes_to_standard_output_after_the_name_of_the_program(capsys: pytest.CaptureFixture[str]) -> None:
    LOGGER.info("%s of %d", "agent", 3)
    said = capsys.readouterr()
    assert (said.out, said.err) == ("ferry: agent of 3\n", "")


def test_warnings_go_to_standard_error_and_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    LOGGER.warning("the disk is full")
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "ferry: warning: the disk is full\n")


def test_errors_go_to_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    LOGGER.error("directive: 'x'")
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "ferry: directive: 'x'\n")


def test_a_program_has_one_logger_that_says_each_message_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert program_logger("ferry") is LOGGER
    root = logging.StreamHandler()
    logging.getLogger().addHandler(root)
    try:
        program_logger("ferry").info("once")
    finally:
        logging.getLogger().removeHandler(root)
    said = capsys.readouterr()
    assert said.out + said.err == "ferry: once\n"


def test_messages_can_be_written_by_another_thread_for_a_while(capsys: pytest.CaptureFixture[str]) -> None:
    jobs: list[Job] = []
    with messages_written_by("ferry", jobs.append):
        LOGGER.info("later")
        assert capsys.readouterr().out == ""
    jobs[0]()
    LOGGER.info("at once")
    assert capsys.readouterr().out == "ferry: later\nferry: at once\n"


def test_a_reader_that_has_gone_away_is_no_secret(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("click.echo", gone)
    with pytest.raises(BrokenPipeError):
        LOGGER.info("anybody there?")


@pytest.mark.parametrize("form", ["text", "json"])
def test_a_name_in_a_message_begins_no_line_and_steers_no_terminal(
    form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    logger = program_logger(f"ferry-{form}")
    if form == "json":
        messages_as_json(f"ferry-{form}")
    logger.info("name X\n\x1b[2Jferry: paused\u202e")
    said = capsys.readouterr().out
    assert said.count("\n") == 1
    assert said[:-1].isprintable()
