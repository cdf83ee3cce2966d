"""The broadcast of a flight with faults: the ground station's, none, or an impostor's in its place."""

from __future__ import annotations

from collections.abc import Iterator

from companion.mission.model import Mission
from groundstation.agents import VehicleModel
from groundstation.ground_station import GroundStation
from groundstation.schedule import Broadcaster
from sim.faults.scene import FLEET_KEY, LOOP_PERIOD_S, OTHER_KEY, Setting, frame_signer
from sim.loop import START_S


class ContestedBroadcast:
    """The frames on the broadcast link: the ground station's, and those of an impostor."""

    def __init__(self, setting: Setting, ground: GroundStation) -> None:
        """Begin with the ground station as the only transmitter."""
        self._mission = setting.mission
        self._broadcaster = Broadcaster(ground, None, frame_signer(FLEET_KEY if setting.signed else None))
        self._is_silent = False
        self._impostor: Broadcaster | None = None
        self._recorded: list[bytes] = []
        self._replayed: list[bytes] = []

    def silence(self, silent: bool) -> None:
        """Stop the ground station's broadcast, or let it go on."""
        self._is_silent = silent

    def replace(self, how: str | None, t_s: float) -> None:
        """Let an impostor transmit in the ground station's place from now on; None for `how` ends that.

        `unsigned` and `of another key` are broadcasts of a mission without discs and with its target elsewhere, which
        are not signed or signed with OTHER_KEY; `replayed` repeats the frames that were broadcast until now.
        """
        self._is_silent = how is not None
        self._impostor, self._replayed = None, []
        if how == "replayed":
            self._replayed = list(self._recorded)
        elif how is not None:
            station = GroundStation(_lure(self._mission), START_S + t_s, model=VehicleModel("routed", True))
            self._impostor = Broadcaster(station, None, frame_signer(OTHER_KEY if how == "of another key" else None))

    def transmit(self, t_s: float) -> Iterator[tuple[float, bytes]]:
        """Yield the frames that are transmitted at a time of the flight, each with that time."""
        true_s = START_S + t_s
        frames = self._broadcaster.tick(true_s)
        if self._is_silent:
            frames = []
        self._recorded += frames
        if self._impostor is not None:
            frames += self._impostor.tick(true_s)
        if self._replayed:
            # One recorded frame per turn of the loop, over and over.
            frames.append(self._replayed[round(t_s / LOOP_PERIOD_S) % len(self._replayed)])
        for frame in frames:
            yield t_s, frame


def _lure(mission: Mission) -> Mission:
    """Return the impostor's mission: without discs, and with its target elsewhere."""
    (target,) = mission.targets
    north_m, east_m = target.position_ned_m
    elsewhere = target.model_copy(update={"north_m": 0.3 * north_m, "east_m": east_m - 0.3 * north_m})
    return mission.model_copy(update={"threats": (), "targets": (elsewhere,)})
