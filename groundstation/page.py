"""What a run shows on its page, and when: everything once a second, places more often, every frame and event."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from groundstation.desk import Desk
from groundstation.events import Who
from groundstation.ground_station import GroundStation
from groundstation.schedule import BroadcastFrame
from groundstation.view import Surroundings, moves, picture
from groundstation.web.pipe import Request

PICTURE_PERIOD_S = 1.0
MOVES_PERIOD_S = 0.2
PATIENCE_S = 0.3
"""Time for which a picture that is due waits for frames to be sent."""
_DUE_TOLERANCE_S = 1e-6


class Screen(Protocol):
    """The other side of the page: the bridge to the web process, or a test's."""

    def publish(self, message: Mapping[str, Any]) -> None:
        """Show a message."""

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        """Show unsigned frames that were broadcast."""

    def refuse(self, identity: int, why: str) -> None:
        """Answer a request that is not obeyed."""

    def pump(self) -> Sequence[Request]:
        """Send and receive without waiting, and return what was asked."""


class Overheard:
    """A ground station as the broadcaster uses it, whose unsigned frames are kept until they are shown."""

    def __init__(self, station: GroundStation) -> None:
        self.station = station
        self._frames: list[bytes] = []
        self._advanced_s: float | None = None

    @property
    def orders(self) -> object:
        """What vehicles are told to do."""
        return self.station.orders

    @property
    def is_outdated(self) -> bool:
        """Whether threats have changed since the last broadcast of the state was begun."""
        return self.station.is_outdated

    def advance(self, now_s: float) -> None:
        """Update all tracks and the assignment to `now_s`."""
        self._advanced_s = now_s
        self.station.advance(now_s)

    def refresh(self, now_s: float, payload_bytes: int) -> Sequence[BroadcastFrame]:
        """Return the frames of a new broadcast of the state."""
        return self.station.refresh(now_s, payload_bytes)

    def carousel(self, now_s: float, payload_bytes: int) -> Sequence[BroadcastFrame]:
        """Return the frames of one turn of the carousel."""
        return self.station.carousel(now_s, payload_bytes)

    def overhear(self, datagram: bytes, now_s: float) -> None:
        """Take note of an unsigned frame that is being broadcast."""
        self._frames.append(datagram)
        self.station.overhear(datagram, now_s)

    def tick(self, now_s: float) -> list[bytes]:
        """Return the unsigned frames that are due if no radio limits the broadcast."""
        datagrams = self.station.due(now_s) if now_s == self._advanced_s else self.station.tick(now_s)
        self._frames += datagrams
        return datagrams

    def taken(self) -> list[bytes]:
        """Return the frames that were broadcast since the last call."""
        frames, self._frames = self._frames, []
        return frames


class Page:
    """Shows one run on a screen, and has what is asked there obeyed."""

    def __init__(
        self,
        station: GroundStation,
        desk: Desk,
        screen: Screen,
        around: Callable[[float], Surroundings],
        *,
        can_stop: bool = False,
        is_seen: bool = True,
    ) -> None:
        """Begin to show; `around` returns what a page shows beside the ground station, at a time.

        `can_stop`: whether the vehicles can stand still, as the copies that say why are to believe. `is_seen`: whether
        somebody may look on, and not only a recorder of pictures and frames.
        """
        self._can_stop = can_stop
        self._station = station
        self._desk = desk
        self._screen = screen
        self._around = around
        self._picture_due_s = float("-inf")
        self._moves_due_s = float("-inf") if is_seen else float("inf")
        self._event = -1
        """Number of the last event that a picture has shown."""
        self._mission: object = None
        """The mission that was shown."""

    def tick(self, frames: Sequence[bytes], now_s: float) -> None:
        """Show what is due, and hand what was asked to the desk; `frames` were broadcast, unsigned, since the last."""
        station, screen = self._station, self._screen
        if station.mission is not self._mission:
            self._mission = station.mission
            mission = station.mission.model_dump(mode="json")
            screen.publish({"type": "mission", "mission": mission, "can_stop": self._can_stop})
        if frames:
            screen.frames(now_s + station.tracks.clock_ahead_s, frames)
        number = station.operations.next_number - 1
        # A picture of 500 agents takes some milliseconds: best right after frames were sent, when no other is due soon.
        due_s = self._picture_due_s + (0.0 if frames else PATIENCE_S) - _DUE_TOLERANCE_S
        if number != self._event or now_s >= due_s:
            self._event = number
            self._picture_due_s = now_s + PICTURE_PERIOD_S
            screen.publish(picture(station, now_s, self._around(now_s)))
        if now_s >= self._moves_due_s - _DUE_TOLERANCE_S:
            # On a grid, so that the ticks between which they are due do not make them fewer.
            following_s = self._moves_due_s + MOVES_PERIOD_S
            self._moves_due_s = following_s if following_s > now_s else now_s + MOVES_PERIOD_S
            screen.publish(moves(station, now_s))
        for request in screen.pump():
            if request.who.role != "operator":
                # The web process refuses it already; what it shows to everybody must not decide that alone.
                screen.refuse(request.id, f"{request.who.name} is {request.who.role}; allowed: for an operator only")
                continue
            self._desk.ask_data(request.command, Who(name=request.who.name, role="operator"), request.id)
