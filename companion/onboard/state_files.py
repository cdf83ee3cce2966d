"""State files that a restarted companion reads: the last accepted frames, and who controls the vehicle."""

from __future__ import annotations

import json
from dataclasses import replace
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
"""Shortest time between two writes of the authenticator's state."""


def saved_authenticator_state(section: BroadcastSection) -> AuthenticatorState | None:
    """Return the authenticator's state that the companion before this one saved; None if the configuration has no file.

    Without a saved state a companion may have run before all the same, and believed anything.

    Raises:
        InputError: the state file cannot be read or could not be written.

    """
    if section.state_file is None:
        return None
    text = read_state_file(Path(section.state_file))
    check_state_file(Path(section.state_file))
    try:
        return AuthenticatorState(is_open=True) if text is None else AuthenticatorState.from_json(text)
    except InputError as error:
        raise InputError(
            f"{section.state_file}: {error}; remove it only if no old broadcast can be replayed"
        ) from error


def saved_authority(section: AutopilotSection) -> tuple[State, str | None]:
    """Return who controlled the vehicle when the companion before this one ended, by its state file, and a warning.

    The warning is None unless the file is damaged. A damaged file counts as LOCKED and does not keep the companion from
    starting in flight: the safety pilot then decides.

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
    """Saves the authenticator's state; an error of the disk is a warning, and the steering goes on."""

    def __init__(self, path: str | None, authenticator: Authenticator, files: IoThread) -> None:
        self._path = None if path is None else Path(path)
        self._authenticator = authenticator
        self._files = files
        self._written = authenticator.state
        self._next_s = 0.0

    def begin(self) -> None:
        """Save, before anything is accepted, that a program runs which may accept more than it saves."""
        self._write(replace(self._authenticator.state, is_open=True))

    def write_if_due(self, now_s: float) -> None:
        """Save the state if it changed, unless it was saved less than STATE_PERIOD_S ago and no broadcast leapt."""
        state = replace(self._authenticator.state, is_open=True)
        leapt = len(state.spans) != len(self._written.spans)
        if state != self._written and (now_s >= self._next_s or leapt):
            self._next_s = now_s + STATE_PERIOD_S
            self._write(state)

    def write(self) -> None:
        """Save the state if it changed; nothing is accepted after it."""
        self._write(self._authenticator.state)

    def _write(self, state: AuthenticatorState) -> None:
        if self._path is not None and state != self._written:
            _write_in_background(self._path, state.to_json(), self._files)
            self._written = state


class AuthorityStateFile:
    """Saves who controls the vehicle; an error of the disk is a warning, and the steering goes on."""

    def __init__(self, path: str | None, before: State, files: IoThread) -> None:
        """Save the state at a path, or nowhere if that is None; `before` is the state in the file already."""
        self._path = None if path is None else Path(path)
        self._written = before
        self._files = files

    def write(self, state: State) -> None:
        """Save the state if it changed."""
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
