"""What may be in the place of a YAML file: a file or a link to one; nothing that is waited for."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.files.yaml import read_text_file


@pytest.mark.parametrize(("kind", "words"), [("pipe", "it is a pipe"), ("folder", "it is a folder")])
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path, kind: str, words: str) -> None:
    path = tmp_path / "mission.yaml"
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.mkdir()
    with pytest.raises(InputError, match=rf"mission\.yaml: cannot be read: {words}$"):
        read_text_file(path)


def test_a_device_is_refused() -> None:
    with pytest.raises(InputError, match=r"/dev/zero: cannot be read: it is a device$"):
        read_text_file(Path("/dev/zero"))


def test_a_link_to_a_file_is_followed_and_one_to_itself_named(tmp_path: Path) -> None:
    (tmp_path / "mission.yaml").write_text("name: one\n")
    (tmp_path / "link.yaml").symlink_to("mission.yaml")
    assert read_text_file(tmp_path / "link.yaml") == "name: one\n"
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    with pytest.raises(InputError, match=r"loop\.yaml: cannot be read: "):
        read_text_file(tmp_path / "loop.yaml")
