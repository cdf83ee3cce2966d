"""The broadcast of a flight with faults: the ground station's, none, or somebody else's in its place."""

from __future__ import annotations

from collections.abc import Iterator

from companion.mission.model import Mission
from groundstation.agents import VehicleModel
from groundstation.ground_station import GroundStation
from groundstation.schedule import Broadcaster
from sim.faults.scene import FLEET_KEY, LOOP_PERIOD_S, OTHER_KEY, Setting, frame_signer
from sim.loop import START_S


class ContestedBroadcast:
    """What is on the air."""

    def __init__(self, setting: Setting, ground: GroundStation) -> None:
        """Let the ground station alone transmit."""
        self._mission = setting.mission
        self._broadcaster = Broadcaster(ground, None, frame_signer(FLEET_KEY if setting.signed else None))
        self._is_silent = False
        self._impostor: Broadcaster | None = None
        self._recorded: list[bytes] = []
        self._replayed: list[bytes] = []

    def silence(self, silent: bool) -> None:
        """Let the broadcast end, or begin again."""
        self._is_silent = silent

    def replace(self, how: str | None, t_s: float) -> None:
        """Let another transmit in the ground station's place from now on, by how he does it; None ends it.

        `unsigned` and `of another key` say that there are no discs and that the target is elsewhere, `replayed` repeats
        what was broadcast until now.
        """
        self._is_silent = how is not None
        self._impostor, self._replayed = None, []
        if how == "replayed":
            self._replayed = list(self._recorded)
        elif how is not None:
            station = GroundStation(_lure(self._mission), START_S + t_s, model=VehicleModel("routed", True))
            self._impostor = Broadcaster(station, None, frame_signer(OTHER_KEY if how == "of another key" else None))

    def transmit(self, t_s: float) -> Iterator[tuple[float, bytes]]:
        """Yield what is on the air at a time of the flight."""
        true_s = START_S + t_s
        frames = self._broadcaster.tick(true_s)
        if self._is_silent:
            frames = []
        self._recorded += frames
        if self._impostor is not None:
            frames += self._impostor.tick(true_s)
        if self._replayed:
            # In their own rhythm and over and over, as a recorder would.
            frames.append(self._replayed[round(t_s / LOOP_PERIOD_S) % len(self._replayed)])
        for frame in frames:
            yield t_s, frame


def _lure(mission: Mission) -> Mission:
    """Return a mission without discs and with its target elsewhere."""
    (target,) = mission.targets
    north_m, east_m = target.position_ned_m
    elsewhere = target.model_copy(update={"north_m": 0.3 * north_m, "east_m": east_m - 0.3 * north_m})
    return mission.model_copy(update={"threats": (), "targets": (elsewhere,)})
