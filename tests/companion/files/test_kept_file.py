"""A state is on disk in the end, and what stands in its way is said once."""

from __future__ import annotations

import logging
import threading
from pathlib import Path

import pytest

from companion.files import kept_file
from companion.files.kept_file import KeptFile
from companion.runtime.io_thread import IoThread

LOGGER = logging.getLogger("test of kept files")


def test_the_newest_text_is_written_and_those_that_it_overtakes_are_not(tmp_path: Path) -> None:
    files, written = IoThread("files"), []
    hung, began = threading.Event(), threading.Event()

    def write(path: Path, text: str) -> None:
        written.append(text)
        began.set()
        hung.wait(10.0)

    kept = KeptFile(tmp_path / "x.state", files, LOGGER, "forget", write)
    kept.write("first")
    assert began.wait(10.0)
    for text in ("second", "third"):
        kept.write(text)
    assert not kept.is_written
    hung.set()
    files.close()
    assert (written, kept.is_written) == (["first", "third"], True)


def test_a_disk_that_hangs_is_told_and_nobody_waits_for_it_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(kept_file, "SLOW_S", 0.0)
    files, hung = IoThread("files"), threading.Event()

    def hang() -> None:
        hung.wait(10.0)

    files.do(hang)
    kept = KeptFile(tmp_path / "x.state", files, LOGGER, "forget")
    kept.write("text")
    assert kept.is_awaited
    for _ in range(3):
        kept.write("text")
    assert not kept.is_awaited
    (said,) = caplog.messages
    assert said.endswith("the disk is too slow; it is tried again; a restart now would forget")
    hung.set()
    files.close()
    assert (tmp_path / "x.state").read_text() == "text"


def test_the_same_text_is_written_once(tmp_path: Path) -> None:
    files, written = IoThread("files"), []
    kept = KeptFile(tmp_path / "x.state", files, LOGGER, "forget", lambda path, text: written.append(text))
    for _ in range(3):
        kept.write("text")
        done = threading.Event()
        files.do(done.set)
        assert done.wait(10.0)
    files.close()
    assert written == ["text"]
