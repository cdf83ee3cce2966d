"""How far a place is from a mission: from the box that its agents, targets and fence span."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from companion.mission.model import Mission


@dataclass(frozen=True)
class Box:
    """A box on the mission's plane; corners are north + i east, in m."""

    low: complex
    high: complex

    @staticmethod
    def around(mission: Mission, but_targets: Collection[int] = ()) -> Box:
        """Return the box around the agents, targets and fence of a resolved mission, without some targets."""
        places = [complex(*agent.position_ned_m) for agent in mission.agents]
        places += [complex(*target.position_ned_m) for target in mission.targets if target.id not in but_targets]
        places += [complex(*corner) for corner in mission.fence or ()]
        norths, easts = [one.real for one in places], [one.imag for one in places]
        return Box(complex(min(norths), min(easts)), complex(max(norths), max(easts)))

    def distance_m(self, place: complex) -> float:
        """Return the distance of a place from the box, 0 inside."""
        north_m = max(self.low.real - place.real, 0.0, place.real - self.high.real)
        east_m = max(self.low.imag - place.imag, 0.0, place.imag - self.high.imag)
        return abs(complex(north_m, east_m))
