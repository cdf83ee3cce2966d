"""What a run finds in its store: where the run before it ended, and what it goes on with."""

from __future__ import annotations

import json
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from companion.errors import InputError
from companion.mission.model import Mission
from companion.protocol.messages import Directive
from groundstation.events import Command, Direct
from groundstation.operations import DIRECTIVE_NAMES
from groundstation.places import Places, kept_places
from groundstation.saved_state import SavedState, open_state
from groundstation.store.chapters import Beginning, beginning
from groundstation.store.database import Database
from groundstation.store.rows import EventRow

MOST_TOLD = 2_000
"""Greatest number of earlier events that a page is given."""
_LATEST_S = 1e12


@dataclass(frozen=True)
class Resumption:
    """What a run goes on with."""

    database: Database | None
    """The open store; None if there is none yet."""
    last: SavedState | None
    """State of the last run; None: this is the first."""
    begun: Beginning
    places: Places | None
    """Where everything was in the last picture; None: where the mission and commands have it."""
    told: tuple[EventRow, ...] = ()
    """The last MOST_TOLD events of the flight that goes on, which a page shows as its time line."""

    @property
    def orders(self) -> tuple[Command, ...]:
        """What gives the orders again that go on though no event of the chapter tells them."""
        if not self.begun.is_fresh or self.begun.orders is not None:
            return self.begun.orders or ()
        if self.last is None or self.last.directive is Directive.NORMAL:
            return ()
        return (Direct(do="direct", directive=DIRECTIVE_NAMES[self.last.directive]),)


def resumption(path: Path | None, mission: Mission, new_flight: bool = False) -> Resumption:
    """Return what a run of a resolved mission goes on with; `new_flight` asks for the mission's beginning.

    Raises:
        InputError: what is at the path is no store, is damaged, or was written by a later release.

    """
    database, last = open_state(path)
    if database is None:
        return Resumption(None, _anew(last) if new_flight else last, beginning(mission, {}, ()), None)
    try:
        begun = beginning(mission, database.all_kept(), database.events(), new_flight)
        places = None if begun.is_fresh else _last_places(database, begun.chapter.first)
        told = () if begun.is_fresh else tuple(deque(database.events(begun.chapter.first - 1), maxlen=MOST_TOLD))
    except (OSError, InputError) as error:
        database.close()
        why = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: {why}; allowed: a whole store, of this release or an earlier one") from error
    return Resumption(database, _anew(last) if new_flight else last, begun, places, told)


def _anew(last: SavedState | None) -> SavedState | None:
    """Return what a new flight takes over: epoch, signing time and revision, without which nobody would believe it."""
    return None if last is None else replace(last, threats="", directive=Directive.NORMAL)


def _last_places(database: Database, first: int) -> Places | None:
    """Return the places in the last picture, if that was made since the event with the number `first`."""
    began = next(database.events(first - 1), None)
    recorded = database.last_picture(_LATEST_S)
    if recorded is None or began is None or recorded.unix_s < began.unix_s:
        return None
    with suppress(ValueError, KeyError, TypeError):
        return kept_places(json.loads(recorded.body))
    return None
