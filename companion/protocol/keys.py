"""Key files: made once on the ground, copied to the vehicles, and refused if others could read or replace them.

Vehicles get `broadcast.public` and, where MAVLink signing is used, `broadcast.mavlink`; `broadcast.private` never
leaves the ground station. No key byte appears in an error: a file that cannot be used is named, not quoted.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path

from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from companion.errors import InputError
from companion.files.regular import can_be_written, places_to, read_regular
from companion.protocol.mavlink_signing import KEY_BYTES

PRIVATE_NAME = "broadcast.private"
PUBLIC_NAME = "broadcast.public"
MAVLINK_NAME = "broadcast.mavlink"

_SECRET_MODE = 0o600
_PUBLIC_MODE = 0o644
_FOLDER_MODE = 0o700
_OTHERS = 0o077
"""Permission bits of the group and of all others."""
_OTHERS_WRITE = 0o022
"""Permission bits of the group and of all others to write."""
_ROOT = 0
"""Root's user id."""
_MAX_FILE_BYTES = 4096
"""Greatest number of bytes read: more than any key file has, so that a wrong path is not read whole."""


def keygen(folder: Path) -> list[Path]:
    """Make a new set of keys and return their paths: private, public, MAVLink.

    Raises InputError if one of them is there already, the folder is open to others, or it cannot be written.
    """
    private = Ed25519PrivateKey.generate()
    contents = {
        folder / PRIVATE_NAME: (
            private.private_bytes(
                serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
            ),
            _SECRET_MODE,
        ),
        folder / PUBLIC_NAME: (_public_pem(private.public_key()), _PUBLIC_MODE),
        folder / MAVLINK_NAME: (_hex_line(os.urandom(KEY_BYTES)), _SECRET_MODE),
    }
    written: list[Path] = []
    try:
        folder.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
        _refuse_open(folder, folder.stat().st_mode, "the folder", "700")
        for path in contents:
            if path.exists() or path.is_symlink():
                raise InputError(f"{path}: is there already; a key is never overwritten: name another folder")
        for path, (content, mode) in contents.items():
            _write_new(path, content, mode, written)
    except OSError as error:
        for path in written:
            path.unlink(missing_ok=True)
        raise InputError(f"{folder}: cannot write keys: {error.strerror}") from error
    return written


def add_public(folder: Path, key: Ed25519PublicKey) -> list[Path]:
    """Write a public key into a folder of keys unless one is there; return its path if it was not.

    Raises InputError if it cannot be written.
    """
    return _add(folder, {PUBLIC_NAME: _public_pem(key)}, _PUBLIC_MODE)


def add_mavlink_keys(folder: Path, keys: Mapping[str, bytes]) -> list[Path]:
    """Write MAVLink keys under their names into a folder of keys, and return the paths of those that were not there.

    Raises InputError if the folder is open to others, or a key cannot be written.
    """
    return _add(folder, {name: _hex_line(key) for name, key in keys.items()}, _SECRET_MODE)


def load_private(path: Path) -> Ed25519PrivateKey:
    """Return the Ed25519 private key in a PEM file; raises InputError if it cannot be used or others can get at it."""
    content = _read(path, secret=True)
    try:
        key = serialization.load_pem_private_key(content, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        # The library's own message may quote what it read.
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError(f"{path}: not an Ed25519 private key; allowed: the {PRIVATE_NAME} that keygen wrote")
    return key


def load_public(path: Path) -> Ed25519PublicKey:
    """Return the Ed25519 public key in a PEM file; raises InputError if it cannot be used or others can replace it."""
    content = _read(path, secret=False)
    try:
        key = serialization.load_pem_public_key(content)
    except (ValueError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PublicKey):
        raise InputError(f"{path}: not an Ed25519 public key; allowed: the {PUBLIC_NAME} that keygen wrote")
    return key


def load_mavlink_key(path: Path) -> bytes:
    """Return the 32 bytes of a shared MAVLink key; raises InputError if it cannot be used or others can get at it."""
    content = _read(path, secret=True).strip()
    try:
        key = bytes.fromhex(content.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES:
        raise InputError(f"{path}: not a MAVLink key; allowed: {2 * KEY_BYTES} hexadecimal digits")
    return key


def _public_pem(key: Ed25519PublicKey) -> bytes:
    return key.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)


def _hex_line(key: bytes) -> bytes:
    return key.hex().encode() + b"\n"


def _add(folder: Path, contents: Mapping[str, bytes], mode: int) -> list[Path]:
    """Write the files of these names that are not there, and return their paths; a secret into no open folder."""
    written: list[Path] = []
    try:
        if mode == _SECRET_MODE:
            _refuse_open(folder, folder.stat().st_mode, "the folder", "700")
        for name, content in contents.items():
            path = folder / name
            if not (path.exists() or path.is_symlink()):
                _write_new(path, content, mode, written)
    except OSError as error:
        raise InputError(f"{folder}: cannot write keys: {error.strerror}") from error
    return written


def _write_new(path: Path, content: bytes, mode: int, written: list[Path]) -> None:
    # Made with its mode, so that at no moment anybody else can open it.
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    written.append(path)
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(descriptor, mode)
        file.write(content)
        file.flush()
        os.fsync(descriptor)


def _read(path: Path, *, secret: bool) -> bytes:
    """Return the content of a key file that nobody else can have written, or, if it is secret, read."""
    try:
        # A link is followed, but what it leads to must be as safe as a file in its place; a pipe is not waited for.
        real = path.resolve(strict=True)
        content, status = read_regular(real, _MAX_FILE_BYTES)
        places = list(places_to(path))
    except OSError as error:
        raise InputError(f"{path}: cannot read the key: {error.strerror}") from error
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{path}: cannot read the key: no path") from error
    if secret:
        _refuse_open(path, status.st_mode, "the key", "600")
    _refuse_writable(path, path, status)
    for place, status in places:
        _refuse_writable(path, place, status)
    return content


def _refuse_writable(key: Path, path: Path, status: os.stat_result) -> None:
    """Refuse a key that somebody else could replace: its file, or a folder or link on its way, is not ours alone."""
    what = "the folder" if stat.S_ISDIR(status.st_mode) else "the key"
    if status.st_uid not in (os.geteuid(), _ROOT):
        raise InputError(
            f"{key}: {what} {path} belongs to user {status.st_uid}, who could replace the key; "
            f"allowed: this program's user or root; chown {os.geteuid()} {path}"
        )
    if can_be_written(status.st_mode, _OTHERS_WRITE):
        raise InputError(
            f"{key}: {what} {path} can be written by others (mode {stat.S_IMODE(status.st_mode):03o}), who could "
            f"replace the key; allowed: its owner only; chmod go-w {path}"
        )


def _refuse_open(path: Path, mode: int, what: str, remedy: str) -> None:
    if stat.S_IMODE(mode) & _OTHERS:
        raise InputError(
            f"{path}: {what} is open to others (mode {stat.S_IMODE(mode):03o}); allowed: its owner only; "
            f"chmod {remedy} {path}"
        )
