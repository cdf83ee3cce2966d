"""Tokens that let somebody in: made by `groundstation token`, kept in a file as hashes, and read again when it changes.

A token is 256 random bits, so that its SHA-256 can stand in a file: nobody finds the token from it.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from companion.errors import InputError, nearest_hint
from companion.files.regular import read_regular
from companion.files.state import write_state_file
from groundstation.web.pipe import ROLES, Who

_TOKEN_BYTES = 32
_PREFIX = "gs_"
"""Beginning of every token, so that one that leaked into a file is found."""
_MOST_BYTES = 200_000
"""Greatest size of a file of tokens."""
MOST_NAME = 40
"""Greatest length of a name."""
_HASH_DIGITS = 64
_FORM = "the file that `groundstation token` writes"


class Token(NamedTuple):
    """A token as it is kept: whose it is, and its hash."""

    who: Who
    sha256: str


def hash_of(token: str) -> str:
    """Return the hash under which a token is kept."""
    return hashlib.sha256(token.encode(errors="surrogateescape")).hexdigest()


def read_tokens(path: Path) -> Sequence[Token]:
    """Return the tokens in a file; none if there is no such file.

    Raises:
        InputError: the file cannot be read, is open to others for writing, or is no file of tokens.

    """
    try:
        content, status = read_regular(path, _MOST_BYTES)
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; allowed: {_FORM}") from error
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise InputError(f"{path}: others can write to it; allowed: its owner only: chmod 600 {path}")
    try:
        return [_token(entry) for entry in json.loads(content)["tokens"]]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(f"{path}: no file of tokens; allowed: {_FORM}") from error


def _token(entry: Mapping[str, str]) -> Token:
    name, role, digest = entry["name"], entry["role"], entry["sha256"]
    if role not in ROLES or not _is_name(name) or not isinstance(digest, str) or len(digest) != _HASH_DIGITS:
        raise ValueError("no token")
    return Token(Who(name, role), digest)


def add_token(path: Path, who: Who) -> str:
    """Add a new token to a file, making it if there is none, and return the token, which is kept nowhere.

    Raises:
        InputError: the name is taken or too long, the role is unknown, or the file cannot be read or written.

    """
    if not _is_name(who.name):
        raise InputError(f"NAME: '{who.name[:60]}'; allowed: 1 to {MOST_NAME} letters that can be printed")
    if who.role not in ROLES:
        raise InputError(f"--role: '{who.role}'{nearest_hint(who.role, ROLES)}; allowed: {', '.join(ROLES)}")
    tokens = read_tokens(path)
    if any(token.who.name == who.name for token in tokens):
        raise InputError(f"{path}: '{who.name}' has a token; allowed: another name, or --revoke first")
    secret = _PREFIX + secrets.token_urlsafe(_TOKEN_BYTES)
    _write(path, [*tokens, Token(who, hash_of(secret))])
    return secret


def revoke_token(path: Path, name: str) -> None:
    """Remove a name's token from a file; raises InputError if there is none."""
    tokens = read_tokens(path)
    names = [token.who.name for token in tokens]
    if name not in names:
        raise InputError(f"{path}: nobody is '{name[:60]}'{nearest_hint(name, names)}; allowed: {', '.join(names)}")
    _write(path, [token for token in tokens if token.who.name != name])


def _write(path: Path, tokens: Sequence[Token]) -> None:
    entries = [{"name": token.who.name, "role": token.who.role, "sha256": token.sha256} for token in tokens]
    if not path.exists():
        # Made with its mode, which a replacement keeps: the hashes are nobody else's business.
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(mode=stat.S_IRUSR | stat.S_IWUSR)
    write_state_file(path, json.dumps({"tokens": entries}, indent=1) + "\n")


def _is_name(name: object) -> bool:
    return isinstance(name, str) and 1 <= len(name) <= MOST_NAME and name.isprintable() and name.strip() == name


class TokenFile:
    """The tokens of a file as they are now: it is read again whenever it was changed."""

    def __init__(self, path: Path) -> None:
        """Read the file; raises InputError if it cannot be used or lets nobody in."""
        self._path = path
        self._read_at = self._stamp()
        self._tokens = read_tokens(path)
        if not self._tokens:
            raise InputError(f"{path}: no token in it; allowed: one at least: groundstation token NAME --file {path}")

    def _stamp(self) -> tuple[int, int, int]:
        try:
            status = self._path.stat()
        except OSError:
            return 0, 0, 0
        return status.st_mtime_ns, status.st_ino, status.st_size

    def tokens(self) -> Sequence[Token]:
        """Return the tokens; those of before if the file cannot be used any more, none if it was removed."""
        stamp = self._stamp()
        if stamp != self._read_at:
            self._read_at = stamp
            try:
                self._tokens = read_tokens(self._path)
            except InputError:
                # Half a file must neither let in nor shut out; a file that is gone shuts everybody out.
                return self._tokens
        return self._tokens

    def find(self, digest: str) -> Token | None:
        """Return the token with a hash; every token is compared in the same time."""
        found = None
        for token in self.tokens():
            if hmac.compare_digest(token.sha256, digest):
                found = token
        return found
