"""State that a run of the ground station saves on disk for the next one.

It holds the last epoch and signing time, so that vehicles, which accept only newer frames, accept those of the next
run; the time at which the threats were at the mission's positions, so that they are not broadcast as if they had not
moved since; and the directive. It is one kept value of the store; a file of the releases before it, which held this
alone, is taken over.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path

from companion.errors import InputError
from companion.files.regular import refuse_other
from companion.files.state import read_state_file, warnings_of
from companion.mission.model import Mission
from companion.protocol.mavlink_signing import UNITS_PER_S, MavlinkSigner, timestamp_of
from companion.protocol.messages import REVISIONS, Directive
from groundstation.clock import MOST_AHEAD_S
from groundstation.directives import directive_from
from groundstation.ground_station import GroundStation, Resumed
from groundstation.options import Options
from groundstation.store.database import Database, is_store
from groundstation.store.event_store import EventStore

KEPT_AS = "run"
"""Name of the kept value."""
STATE_PERIOD_S = 1.0
"""Period at which the last signing time is written to disk: a crash loses less of it than the difference of clocks that
receivers allow."""
MOST_HOLD_S = 1.0
"""Longest time for which the broadcast waits for a state to be on disk: a disk that hangs must not silence it."""


@dataclass(frozen=True)
class SavedState:
    """State of a run that the next run must know."""

    epoch_s: int
    signing_timestamp: int
    """MAVLink signing time of a frame sent at most STATE_PERIOD_S before the last one; 0 without MAVLink signing."""
    threats: str
    """Digest of the threats as the mission places them (`threats_digest`)."""
    began_s: float
    """Start of the first run with these threats, when they were at the mission's positions."""
    directive: Directive
    revision: int
    """Number of the last revision of the picture, which the next run's exceeds."""


def saved_state_from(text: str, source: Path) -> SavedState:
    """Return the state in the text of a state file.

    Raises:
        InputError: the text is no saved state; `source` names the file.

    """
    try:
        values = json.loads(text)
        state = SavedState(
            int(values["epoch_s"]),
            int(values["signing_timestamp"]),
            str(values["threats"]),
            float(values["began_s"]),
            directive_from(str(values["directive"])),
            int(values["revision"]) % REVISIONS,
        )
        if not math.isfinite(state.began_s):
            raise ValueError("no time")
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, InputError) as error:
        raise InputError(
            f"{source}: no state of a ground station; allowed: the file that the last run wrote, or one that is not "
            "there yet"
        ) from error
    return state


def text_of(state: SavedState) -> str:
    """Return the text of a state file."""
    return json.dumps(
        {
            "epoch_s": state.epoch_s,
            "signing_timestamp": state.signing_timestamp,
            "threats": state.threats,
            "began_s": state.began_s,
            "directive": state.directive.name.lower(),
            "revision": state.revision,
        }
    )


def epoch_after(last: SavedState | None, now_s: float, source: Path | None) -> int:
    """Return the epoch of a run that begins now: the present second, but later than the last run's epoch.

    Raises:
        InputError: the epoch is farther ahead of the clock than receivers accept; `source` names the file.

    """
    epoch_s = int(now_s) if last is None else max(int(now_s), last.epoch_s + 1)
    if epoch_s - now_s > MOST_AHEAD_S:
        raise _behind(source, epoch_s - now_s)
    return epoch_s


def signing_after(last: SavedState | None, now_s: float, only_mavlink: bool, source: Path | None) -> int:
    """Return the MAVLink signing time that all signing times of a run that begins now must exceed.

    Raises:
        InputError: the time is farther ahead of the clock than receivers accept, and frames are signed by MAVLink alone
            (`only_mavlink`); with Ed25519 receivers ignore it. `source` names the file.

    """
    if last is None:
        return 0
    ahead_s = (last.signing_timestamp - timestamp_of(now_s)) / UNITS_PER_S
    if only_mavlink and ahead_s > MOST_AHEAD_S:
        raise _behind(source, ahead_s)
    return last.signing_timestamp


def _behind(source: Path | None, by_s: float) -> InputError:
    return InputError(
        f"{source}: the clock is {by_s:.1f} s behind the last run, so that vehicles would refuse every frame; allowed: "
        f"at most {MOST_AHEAD_S:g} s: wait, set the clock or, if the last run's clock was wrong, remove this file and "
        "the vehicles' state files and make new keys"
    )


def began_at_s(last: SavedState | None, threats: str, now_s: float) -> float:
    """Return the time at which a new run's threats were at the mission's positions; `threats` is their digest."""
    return now_s if last is None or last.threats != threats else min(last.began_s, now_s)


def threats_digest(mission: Mission) -> str:
    """Return a digest that is the same for two resolved missions with the same origin and threats.

    It covers nothing else: a restart with another target or period must not broadcast the threats as if they had just
    been placed.
    """
    text = mission.model_dump_json(include={"origin", "threats"})
    return hashlib.sha256(text.encode()).hexdigest()


def open_state(path: Path | None) -> tuple[Database | None, SavedState | None]:
    """Return the store at a path, None if there is none yet, and the state that the last run left.

    A state file of an earlier release is read, too; the first write replaces it by a store.

    Raises:
        InputError: what is there is neither, or cannot be read.

    """
    if path is None:
        return None, None
    try:
        refuse_other(path)
        is_new = is_store(path)
    except FileNotFoundError:
        return None, None
    except OSError:
        is_new = False
    if is_new:
        database = Database.opened(path)
        return database, last_state(database)
    before = read_state_file(path)
    return None, None if before is None else saved_state_from(before, path)


def last_state(database: Database) -> SavedState | None:
    """Return the state that the last run left in a store; None before the first run.

    Raises:
        InputError: the store holds something else in its place, or cannot be read.

    """
    source = database.path or Path("state")
    try:
        text = database.kept(KEPT_AS)
    except OSError as error:
        raise InputError(f"{source}: cannot read the store: {error.strerror}; allowed: one that is whole") from error
    return None if text is None else saved_state_from(text, source)


def state_in(path: Path) -> SavedState | None:
    """Return the state that the last run left at a path, without touching it; None before the first run.

    Raises:
        InputError: there is no store, or it cannot be read.

    """
    database = Database.read_only(path)
    try:
        return last_state(database)
    finally:
        database.close()


class RunState:
    """The saved state of the last run, and the store in which this run saves its own."""

    def __init__(
        self,
        options: Options,
        mission: Mission,
        signer: MavlinkSigner | None,
        now_s: float,
        store: EventStore,
        last: SavedState | None,
    ) -> None:
        """Go on from the last run; raises InputError if this run cannot.

        `signer` is this run's MAVLink signer, whose times are set to exceed the last run's; None without MAVLink
        signing.
        """
        self._path = options.state
        self._store = store
        self._signer = signer
        self._threats = threats_digest(mission)
        self._can_move = any(threat.speed_bound_m_s > 0.0 for threat in mission.threats)
        self.epoch_s = epoch_after(last, now_s, self._path)
        self.began_s = began_at_s(last, self._threats, now_s)
        self._revision = 1 if last is None else (last.revision + 1) % REVISIONS
        self._written = last
        """The state handed over for writing, at first the last run's."""
        self._written_at_s = -math.inf
        self._hold_until_s = -math.inf
        if signer is not None:
            signer.last_timestamp = signing_after(last, now_s, options.authentication == "mavlink", self._path)

    @property
    def resumed(self) -> Resumed:
        """What this run takes over from the last one."""
        return Resumed(self.epoch_s, self.began_s, self._revision)

    def news(self, now_s: float, directive: Directive) -> list[str]:
        """Return the messages about what this run has taken over from the last one, with the directive in force."""
        lines = []
        if directive is not Directive.NORMAL:
            lines.append(f"directive: {directive.name.lower()}, kept from the last run")
        if self._can_move and self.began_s < now_s:
            lines.append(
                f"threats: where the mission says {now_s - self.began_s:.0f} s ago, when its first run began; a new "
                "flight of it begins with --new-flight"
            )
        return lines

    def warnings(self) -> list[str]:
        """Return the warnings about what a restart will not know."""
        if self._path is not None:
            return warnings_of(self._path)
        if not self._can_move:
            return []
        return ["without --state a restart would tell the threats smaller than they may be by then, and no directive"]

    def write(self, station: GroundStation, now_s: float) -> None:
        """Have the state written for the next run; while the disk does not take it, that is told and tried again."""
        # A run that does not sign with MAVLink forgets no time of one that did.
        kept_timestamp = 0 if self._written is None else self._written.signing_timestamp
        state = SavedState(
            station.epoch_s,
            kept_timestamp if self._signer is None else self._signer.last_timestamp,
            self._threats,
            self.began_s + station.tracks.clock_ahead_s,
            station.directive,
            station.revision,
        )
        self._store.keep(KEPT_AS, text_of(state))
        if _kept(state) != _kept(self._written):
            self.hold(now_s)
        self._written, self._written_at_s = state, now_s

    def write_if_due(self, station: GroundStation, now_s: float) -> None:
        """Write the state if directive, epoch or revision has changed, or the signing time is STATE_PERIOD_S old."""
        changed = _kept(self._written) != (station.directive, station.epoch_s, station.revision)
        is_old = self._signer is not None and now_s - self._written_at_s >= STATE_PERIOD_S
        if changed or is_old:
            self.write(station, now_s)
        self._store.retry_if_due()

    def hold(self, now_s: float) -> None:
        """Have the broadcast wait for what was just handed to the store, as far as MOST_HOLD_S."""
        self._hold_until_s = now_s + MOST_HOLD_S

    def holds(self, now_s: float) -> bool:
        """Return whether the broadcast is to wait until directive, epoch, revision and new events are on disk."""
        return self._path is not None and now_s < self._hold_until_s and self._store.is_awaited


def _kept(state: SavedState | None) -> tuple[Directive, int, int] | None:
    """Return what must be on disk before it is on the air."""
    return None if state is None else (state.directive, state.epoch_s, state.revision)
