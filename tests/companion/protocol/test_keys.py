"""Key files: safe from the first moment, refused when open to others, and never quoted."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from companion.errors import InputError
from companion.protocol.authenticator import Trust
from companion.protocol.keys import (
    MAVLINK_NAME,
    PRIVATE_NAME,
    PUBLIC_NAME,
    keygen,
    load_mavlink_key,
    load_private,
    load_public,
)

LOADERS: dict[str, Callable[[Path], object]] = {
    PRIVATE_NAME: load_private,
    PUBLIC_NAME: load_public,
    MAVLINK_NAME: load_mavlink_key,
}
SECRET_NAMES = (PRIVATE_NAME, MAVLINK_NAME)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    keygen(tmp_path / "keys")
    return tmp_path / "keys"


def test_the_keys_written_fit_each_other(folder: Path) -> None:
    signature = load_private(folder / PRIVATE_NAME).sign(b"words")
    load_public(folder / PUBLIC_NAME).verify(signature, b"words")
    assert len(load_mavlink_key(folder / MAVLINK_NAME)) == 32


def test_two_sets_of_keys_differ(tmp_path: Path) -> None:
    first, second = keygen(tmp_path / "a"), keygen(tmp_path / "b")
    assert [path.name for path in first] == [PRIVATE_NAME, PUBLIC_NAME, MAVLINK_NAME]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() != other.read_bytes()


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_file_modes_are_safe_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        keygen(tmp_path / "keys")
    finally:
        os.umask(before)
    assert mode_of(tmp_path / "keys") == 0o700
    assert mode_of(tmp_path / "keys" / PRIVATE_NAME) == 0o600
    assert mode_of(tmp_path / "keys" / MAVLINK_NAME) == 0o600
    assert mode_of(tmp_path / "keys" / PUBLIC_NAME) == 0o644


@pytest.mark.parametrize("name", LOADERS)
def test_a_key_that_is_there_is_never_overwritten(folder: Path, name: str) -> None:
    for other in set(LOADERS) - {name}:
        (folder / other).unlink()
    before = (folder / name).read_bytes()
    with pytest.raises(InputError, match=f"{name}: is there already"):
        keygen(folder)
    assert [path.name for path in folder.iterdir()] == [name]
    assert (folder / name).read_bytes() == before


def test_a_folder_open_to_others_gets_no_keys(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    with pytest.raises(InputError, match=r"the folder is open to others \(mode 755\).*chmod 700"):
        keygen(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write keys"):
        keygen(tmp_path / "file" / "keys")


@pytest.mark.parametrize("name", SECRET_NAMES)
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o601])
def test_a_secret_that_others_can_reach_is_refused_with_the_remedy(folder: Path, name: str, mode: int) -> None:
    (folder / name).chmod(mode)
    with pytest.raises(InputError, match=rf"the key is open to others \(mode {mode:o}\).*chmod 600 .*{name}"):
        LOADERS[name](folder / name)


def test_the_public_key_may_be_read_by_anybody(folder: Path) -> None:
    (folder / PUBLIC_NAME).chmod(0o644)
    load_public(folder / PUBLIC_NAME)


@pytest.mark.parametrize("name", LOADERS)
def test_a_missing_key_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: cannot read the key: No such file"):
        LOADERS[name](tmp_path / name)


@pytest.mark.parametrize("name", LOADERS)
@pytest.mark.parametrize(
    "content", [b"", b"zz" * 32, b"ab" * 31, b"\xff\xfe", b"-----BEGIN PRIVATE KEY-----\nSECRET\n"]
)
def test_a_malformed_key_is_refused_in_one_line_that_does_not_quote_it(
    tmp_path: Path, name: str, content: bytes
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    path.chmod(0o600)
    with pytest.raises(InputError, match=f"{name}: not a.*allowed: ") as caught:
        LOADERS[name](path)
    words = str(caught.value)
    assert "\n" not in words
    assert not content or content.decode("latin-1").strip() not in words
    assert "SECRET" not in words


def test_a_private_key_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / PRIVATE_NAME
    path.write_bytes(
        ec.generate_private_key(ec.SECP256R1()).private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    path.chmod(0o600)
    with pytest.raises(InputError, match="not an Ed25519 private key"):
        load_private(path)


def test_a_private_key_given_for_a_public_one_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="not an Ed25519 public key"):
        load_public(folder / PRIVATE_NAME)


def test_keys_are_in_no_words_of_what_holds_them(folder: Path) -> None:
    key = load_mavlink_key(folder / MAVLINK_NAME)
    trust = Trust(key, load_public(folder / PUBLIC_NAME))
    assert key.hex() not in repr(trust)
    assert repr(key) not in repr(trust)
    private = load_private(folder / PRIVATE_NAME)
    assert private.private_bytes_raw().hex() not in repr(private)


@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
@pytest.mark.parametrize("name", LOADERS)
def test_a_key_that_others_can_write_is_refused_with_the_remedy(folder: Path, name: str, mode: int) -> None:
    (folder / name).chmod(mode)
    with pytest.raises(InputError, match=r"others.*chmod"):
        LOADERS[name](folder / name)


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_folder_in_which_others_could_replace_the_key_is_refused(folder: Path, mode: int) -> None:
    folder.chmod(mode)
    with pytest.raises(InputError, match=r"the folder .* can be written by others .*; chmod go-w "):
        load_public(folder / PUBLIC_NAME)
    folder.chmod(0o1777)
    load_public(folder / PUBLIC_NAME)


def test_a_link_is_followed_only_to_a_key_as_safe_as_one_in_its_place(folder: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.public"
    link.symlink_to(folder / PUBLIC_NAME)
    load_public(link)
    folder.chmod(0o777)
    with pytest.raises(InputError, match="who could replace the key"):
        load_public(link)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("of_folder", [True, False])
def test_a_key_that_belongs_to_another_user_is_refused(folder: Path, of_folder: bool) -> None:
    os.chown(folder if of_folder else folder / PUBLIC_NAME, 12345, -1)
    with pytest.raises(InputError, match="belongs to user 12345, who could replace the key"):
        load_public(folder / PUBLIC_NAME)


@pytest.mark.parametrize("load", LOADERS.values())
def test_a_pipe_in_the_place_of_a_key_is_not_waited_for(tmp_path: Path, load: Callable[[Path], object]) -> None:
    os.mkfifo(tmp_path / "pipe", 0o600)
    with pytest.raises(InputError, match="cannot read the key: it is a pipe"):
        load(tmp_path / "pipe")


def test_a_link_that_leads_to_itself_is_named(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError, match="loop: cannot read the key"):
        load_public(tmp_path / "loop")


def test_keys_below_a_folder_that_others_could_replace_are_refused(tmp_path: Path) -> None:
    above = tmp_path / "above"
    keygen(above / "keys")
    load_public(above / "keys" / PUBLIC_NAME)
    above.chmod(0o777)
    with pytest.raises(InputError, match=r"the folder .*/above can be written by others .*; chmod go-w "):
        load_public(above / "keys" / PUBLIC_NAME)
    above.chmod(0o1777)
    load_public(above / "keys" / PUBLIC_NAME)


def test_keys_by_a_link_that_others_could_replace_are_refused(folder: Path, tmp_path: Path) -> None:
    below = tmp_path / "open"
    below.mkdir()
    (below / "link").symlink_to(folder)
    (tmp_path / "way").symlink_to(below / "link")
    load_public(tmp_path / "way" / PUBLIC_NAME)
    below.chmod(0o777)
    with pytest.raises(InputError, match=r"the folder .*/open can be written by others"):
        load_public(tmp_path / "way" / PUBLIC_NAME)
