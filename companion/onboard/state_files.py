"""State files that a restarted companion reads: the last accepted frames, and who controls the vehicle.

Neither keeps a companion from being started again in flight: a disk that takes nothing, or gives nothing, is told, and
what is not known counts as the worst.
"""

from __future__ import annotations

import json
import os
import zlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from companion.errors import InputError
from companion.files.kept_file import KeptFile
from companion.files.state import (
    check_state_file,
    overwrite_state_file,
    read_state_file,
    warnings_of,
    write_state_file,
)
from companion.onboard.authority import State
from companion.onboard.config import AutopilotSection, BroadcastSection
from companion.protocol.authenticator import Authenticator, AuthenticatorState
from companion.runtime.console import program_logger
from companion.runtime.io_thread import IoThread

LOGGER = program_logger("companion")
STATE_PERIOD_S = 1.0
"""Shortest time between two writes of the authenticator's state."""
_WORSE = (State.WAITING, State.ENGAGED, State.LOCKED)
"""The states in the order in which they keep a companion that is started from steering."""
AUTHORITY_CHARACTERS = 64
"""Length of every text that tells who has the vehicle, so that one can be written over another on a full disk."""
OLD_BROADCAST = "believe what is broadcast now once more"
WHO_HAD_IT = "not know who had the vehicle: a PX4 would count as locked"


class Saved(NamedTuple):
    """What the companion before this one saved, with warnings about it."""

    state: AuthenticatorState | None
    """None: no file is configured."""
    warnings: tuple[str, ...] = ()


class SavedAuthority(NamedTuple):
    """Who controlled the vehicle when the companion before this one ended, with warnings about that."""

    state: State
    warnings: tuple[str, ...] = ()


def saved_authenticator_state(section: BroadcastSection) -> Saved:
    """Return the authenticator's state that the companion before this one saved; None if no file is configured.

    Where there is none, or none that can be read, one may have run all the same, and believed anything: where the clock
    is checked, nothing is then believed that was sent before the start.

    Raises:
        InputError: the state cannot be read, and the clock is not checked: anything old could then be believed.

    """
    if section.state_file is None:
        return Saved(None)
    path = Path(section.state_file)
    warnings = warnings_of(path)
    try:
        check_state_file(path)
    except InputError as error:
        warnings.append(f"{error}; a restart now would {OLD_BROADCAST}")
    try:
        text = read_state_file(path)
        state = AuthenticatorState(is_open=True) if text is None else AuthenticatorState.from_json(text)
        return Saved(state, tuple(warnings))
    except InputError as error:
        words = str(error) if str(error).startswith(str(path)) else f"{path}: {error}"
        if section.clock == "unchecked":
            raise InputError(f"{words}; remove it only if no old broadcast can be replayed") from error
        warnings.append(f"{words}; so nothing is believed that was sent before now")
        return Saved(AuthenticatorState(is_open=True), tuple(warnings))


def saved_authority(section: AutopilotSection) -> SavedAuthority:
    """Return who controlled the vehicle when the companion before this one ended, by its state file.

    A file that is damaged or cannot be read counts as LOCKED and does not keep the companion from starting in flight:
    the safety pilot then decides. So does a disk that takes no state, unless the one on it is the worse one already.
    """
    if section.state_file is None:
        return SavedAuthority(State.WAITING)
    path = Path(section.state_file)
    warnings = warnings_of(path)
    in_memory = _in_memory(path)
    kept: list[State] = []
    for place in (path, *in_memory):
        try:
            text = read_state_file(place)
            kept += [] if text is None else [State(json.loads(text)["engagement"])]
        except (InputError, ValueError, TypeError, KeyError, RecursionError) as error:
            why = str(error) if isinstance(error, InputError) else f"{place}: not a state of the engagement"
            warnings.append(f"{why}: a PX4 counts as locked, ArduPilot's mode decides")
            kept.append(State.LOCKED)
    state = max(kept, key=_WORSE.index, default=State.WAITING)
    if kept.count(State.LOCKED) == 0:
        try:
            _check_authority_file(path, state)
        except InputError as error:
            warnings.append(f"{error}; a PX4 that flies counts as locked, and so it would after a restart")
            # A copy in memory can be written over whatever becomes of the disk.
            state = State.LOCKED if state is State.WAITING and not in_memory else state
    return SavedAuthority(state, tuple(warnings))


def _in_memory(path: Path) -> list[Path]:
    """Return where the copy of a state file is that outlives the program but not the computer; nothing without one.

    systemd gives the folder (RuntimeDirectory=), which is in memory: a disk that fails in flight does not lose it.
    """
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return [Path(folder) / f"{zlib.crc32(str(path.absolute()).encode()):08x}-{path.name}"] if folder else []


def authority_text(state: State) -> str:
    """Return the text of a state file for who controls the vehicle."""
    return json.dumps({"engagement": state.value}).ljust(AUTHORITY_CHARACTERS - 1) + "\n"


def write_authority(path: Path, text: str) -> None:
    """Replace the text of a state file or, on a full disk, write over it; raises InputError.

    A mixture of two texts, which a crash could then leave, counts as LOCKED.
    """
    try:
        write_state_file(path, text)
    except InputError as error:
        try:
            overwrite_state_file(path, text)
        except InputError:
            # The first error is the one of interest: that there was nothing to write over is none.
            raise error from None


def _check_authority_file(path: Path, state: State) -> None:
    """Raise InputError if a state file could neither be replaced nor written over."""
    try:
        check_state_file(path)
    except InputError as error:
        try:
            overwrite_state_file(path, authority_text(state))
        except InputError:
            raise error from None


class AuthenticatorStateFile:
    """Saves the authenticator's state; while the disk does not take it, that is told and tried again."""

    def __init__(self, path: str | None, authenticator: Authenticator, files: IoThread) -> None:
        self._file = None if path is None else KeptFile(Path(path), files, LOGGER, OLD_BROADCAST)
        self._authenticator = authenticator
        self._saved = authenticator.state
        self._next_s = 0.0

    def begin(self) -> None:
        """Save, before anything is accepted, that a program runs which may accept more than it saves."""
        self._write(replace(self._authenticator.state, is_open=True))

    def write_if_due(self, now_s: float) -> None:
        """Save the state if it changed, unless it was saved less than STATE_PERIOD_S ago and no broadcast leapt."""
        state = replace(self._authenticator.state, is_open=True)
        leapt = len(state.spans) != len(self._saved.spans)
        if (now_s >= self._next_s or leapt) and self._write(state):
            self._next_s = now_s + STATE_PERIOD_S

    def write(self) -> None:
        """Save the state if it changed; nothing is accepted after it."""
        self._write(self._authenticator.state)

    def _write(self, state: AuthenticatorState) -> bool:
        """Save a state if it is another than the one saved, or that was not written; return whether it was."""
        if self._file is None or (state == self._saved and self._file.is_written):
            return False
        self._file.write(state.to_json())
        self._saved = state
        return True


class AuthorityStateFile:
    """Saves who controls the vehicle; while the disk does not take it, that is told and tried again."""

    def __init__(self, path: str | None, files: IoThread) -> None:
        """Save the state at a path, or nowhere if that is None."""
        self._file = None if path is None else KeptFile(Path(path), files, LOGGER, WHO_HAD_IT, write_authority)
        self._copies = [] if path is None else _in_memory(Path(path))
        self._saved: State | None = None

    def write(self, state: State) -> None:
        """Save the state if it changed, or was not written yet."""
        if self._file is not None and (state is not self._saved or not self._file.is_written):
            self._file.write(authority_text(state))
        if state is not self._saved:
            for copy in self._copies:
                # In memory, so that nothing waits; if it fails, the file on disk has to do.
                with suppress(InputError):
                    write_state_file(copy, authority_text(state))
        self._saved = state
