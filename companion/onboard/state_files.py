"""What a companion leaves on disk for the one that is started after it: what it heard last, and who has the vehicle."""

from __future__ import annotations

import json
from pathlib import Path

from companion.errors import InputError
from companion.files.state import check_state_file, read_state_file, write_state_file
from companion.onboard.authority import State
from companion.onboard.config import AutopilotSection, BroadcastSection
from companion.protocol.authenticator import Authenticator, AuthenticatorState
from companion.runtime.console import program_logger
from companion.runtime.io_thread import IoThread

LOGGER = program_logger("companion")
STATE_PERIOD_S = 1.0
"""How often at most what was accepted last is written to disk."""


def saved_authenticator_state(section: BroadcastSection) -> AuthenticatorState | None:
    """Return what the companion before this one accepted last; None if there was none, or it keeps no state.

    Raises:
        InputError: the state file cannot be read or could not be written.

    """
    if section.state_file is None:
        return None
    text = read_state_file(Path(section.state_file))
    check_state_file(Path(section.state_file))
    try:
        return None if text is None else AuthenticatorState.from_json(text)
    except InputError as error:
        raise InputError(
            f"{section.state_file}: {error}; remove it only if no old broadcast can be replayed"
        ) from error


def saved_authority(section: AutopilotSection) -> tuple[State, str | None]:
    """Return who had the vehicle when the companion before this one ended, by its state file, and a warning, if any.

    A file that does not tell is no reason not to start in flight: it counts as locked, which lets a person decide.

    Raises:
        InputError: the state file could not be written.

    """
    if section.state_file is None:
        return State.WAITING, None
    path = Path(section.state_file)
    check_state_file(path)
    try:
        text = read_state_file(path)
        return (State.WAITING if text is None else State(json.loads(text)["engagement"])), None
    except (InputError, ValueError, TypeError, KeyError, RecursionError):
        return State.LOCKED, f"{path}: not a state of the engagement: a PX4 counts as locked, ArduPilot's mode decides"


class AuthenticatorStateFile:
    """Keeps what was accepted last on disk; a full disk is no reason to stop steering."""

    def __init__(self, path: str | None, authenticator: Authenticator, files: IoThread) -> None:
        self._path = None if path is None else Path(path)
        self._authenticator = authenticator
        self._files = files
        self._written = authenticator.state
        self._next_s = 0.0

    def write_if_due(self, now_s: float) -> None:
        """Write what is new, unless it was written a moment ago."""
        if now_s >= self._next_s:
            self._next_s = now_s + STATE_PERIOD_S
            self.write()

    def write(self) -> None:
        """Write what is new."""
        state = self._authenticator.state
        if self._path is not None and state != self._written:
            _write_in_background(self._path, state.to_json(), self._files)
            self._written = state


class AuthorityStateFile:
    """Keeps on disk who has the vehicle."""

    def __init__(self, path: str | None, before: State, files: IoThread) -> None:
        """Keep it at a path, or nowhere; `before` is what the file says already."""
        self._path = None if path is None else Path(path)
        self._written = before
        self._files = files

    def write(self, state: State) -> None:
        """Write it if it changed."""
        if state is not self._written and self._path is not None:
            _write_in_background(self._path, json.dumps({"engagement": state.value}), self._files)
        self._written = state


def _write_in_background(path: Path, text: str, files: IoThread) -> None:
    def write() -> None:
        try:
            write_state_file(path, text)
        except InputError as error:
            LOGGER.warning("%s", error)

    files.do(write)
