"""What the ground station believes of the sightings and reports that come in, and the words about the rest.

Each agent, target and threat of the mission has its bound: the speed that the mission gives it, and for agents the wind
and a margin. What is believed of it follows from plausibility.py and dispute.py; here are the ids, the clocks and the
words.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from companion.geo.kinematics import GRAVITY_M_S2
from companion.mission.extent import Point
from companion.mission.model import AgentSpec, Mission
from companion.protocol.codec import Kind
from groundstation.dispute import Watched, judge
from groundstation.filter import Noise
from groundstation.plausibility import Bound, Known, Reach, Sample, Verdict, Weighed, weigh
from groundstation.refusals import Refusals

Key = tuple[Kind, int]
"""Kind and id of a thing."""

FASTER = 1.5
"""Greatest ratio of an agent's ground speed to its speed in the mission, beside the mission's own wind: a real plane at
22 m/s indicated was measured at 23.4 m/s over ground in still air, and a mission need not know the wind."""
AHEAD_S = 2.0
"""Greatest time by which a sighting or report may be stamped ahead of this computer's clock, as on the vehicles."""
BEHIND_S = 30.0
"""Greatest age of a sighting or report, as on the vehicles."""
ASTRAY_SHARE = 0.25
"""Share of the way since its last report by which an agent may be off its dead reckoning, as a vehicle that hears few
broadcasts is."""
_TURN_S = 1.0
"""Time in which something may turn round or stop that has no turn limit in the mission."""
_REPORT_PERIOD_S = 10.0
"""Period of reports if the mission gives none."""


class Sightings:
    """What is known of everything in a mission by sightings and reports, and what was refused."""

    def __init__(self, mission: Mission, placed_at_s: float, now_s: float, error_m: float) -> None:
        """Begin with the mission's positions, true at `placed_at_s`; `error_m` is the greatest error of a sighting."""
        self.refusals = Refusals()
        self.ahead_s = 0.0
        """Time by which the clock that stamps frames is ahead of the times given here (clock.py)."""
        wind_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
        self._error_m = error_m
        self._broadcast_s = mission.broadcast_period_s
        self._bounds: dict[Key, Bound] = {}
        self._watched: dict[Key, Watched] = {}
        self._flown: dict[int, Known] = {}
        self._reporting: dict[int, Bound] = {}
        """Bounds of what agents report, which comes too rarely to be expected."""
        for agent in mission.agents:
            bound = _agent_bound(agent, wind_m_s, error_m)
            reports = bound._replace(is_gated=False, period_s=mission.report_period_s or _REPORT_PERIOD_S)
            self._reporting[agent.id] = reports
            self._flown[agent.id] = Known.placed(0j, placed_at_s, reports, now_s)
            bound = reports if mission.case == "II" else bound
            self._bounds[Kind.AGENT, agent.id] = bound
        for kind, things in ((Kind.TARGET, mission.targets), (Kind.THREAT, mission.threats)):
            for thing in things:
                self.limit((kind, thing.id), thing.speed_bound_m_s)
        for key, place_ned_m in places_in(mission):
            self.begin(key, place_ned_m, placed_at_s, now_s)

    def limit(self, key: Key, speed_m_s: float) -> None:
        """Take a target or threat to be no faster than `speed_m_s` from now on."""
        self._bounds[key] = Bound(speed_m_s, Noise(self._error_m, 2.0 * speed_m_s / _TURN_S))

    def begin(self, key: Key, place_ned_m: Point, placed_at_s: float, now_s: float) -> None:
        """Forget what is known of a thing whose bound is known: it was at a place at `placed_at_s`."""
        bound = self._bounds[key]
        self._watched[key] = Watched.begun(Known.placed(complex(*place_ned_m), placed_at_s, bound, now_s), bound)

    def end(self, key: Key) -> None:
        """Forget a thing."""
        del self._bounds[key], self._watched[key]

    def bound(self, key: Key) -> Bound:
        """Return how fast a thing may be and how well it is seen."""
        return self._bounds[key]

    def held(self, key: Key) -> Reach | None:
        """Return where a thing was when that was not disputed; None if nothing is disputed."""
        watched = self._watched[key]
        return None if watched.candidate is None else watched.sure

    def sighted(self, key: Key, sample: Sample, now_s: float) -> Weighed | None:
        """Return what a sighting of a thing is taken for; None if the mission has no such thing."""
        name = words_of(key)
        if key not in self._watched:
            place = f"{sample.place.real:.0f} N {sample.place.imag:.0f} E"
            self.refusals.add(
                ("unknown", key), f"sensor: {name} at {place} is not in the mission: {{}} detections ignored"
            )
            return None
        self._watched[key], weighed = judge(self._watched[key], sample, self._bounds[key], now_s)
        self._tell(f"sensor: {name} seen", key, weighed)
        if weighed.verdict is Verdict.DISPUTED and weighed.off_m > 0.0:
            self.refusals.add(
                (key, Verdict.DISPUTED),
                f"sensor: sightings of {name} contradict each other by {_far(weighed.off_m)}: held at its last "
                "undisputed place, and its disc grows, {} times",
            )
        return weighed

    def reported(
        self, agent_id: int, sample: Sample, reckoned: complex, uncertainty_m: float, now_s: float
    ) -> Weighed | None:
        """Return what an agent's report of its place is taken for; None if the mission has no such agent.

        `reckoned` is where it is by dead reckoning at that time, within `uncertainty_m` if it heard every broadcast;
        infinite without dead reckoning.
        """
        key = Kind.AGENT, agent_id
        if key not in self._watched:
            self.refusals.add(
                ("no agent", agent_id), f"uplink: agent {agent_id} is not in the mission: {{}} reports ignored"
            )
            return None
        bound, watched = self._reporting[agent_id], self._watched[key]
        known = watched.known
        # It may have flown on for a broadcast or two, and since its last report have drifted by a share of its way.
        by_share_s = 2.0 * self._broadcast_s + ASTRAY_SHARE * max(0.0, sample.at_s - known.believed.motion.at_s)
        astray_m = abs(sample.place - reckoned) - uncertainty_m - self._error_m - bound.speed_m_s * by_share_s
        known, weighed = weigh(known, sample, bound, now_s, astray_m)
        self._watched[key] = replace(watched, known=known)
        self._tell(f"uplink: agent {agent_id} reports a place", key, weighed)
        return weighed

    def flown(self, agent_id: int, flown_m: float, at_s: float, now_s: float) -> float | None:
        """Return the distance that an agent reports to have flown; None if its bounds do not allow it."""
        bound = self._reporting[agent_id]
        self._flown[agent_id], weighed = weigh(self._flown[agent_id], Sample(complex(flown_m), at_s), bound, now_s)
        if weighed.verdict in (Verdict.BEYOND, Verdict.JUMP):
            self.refusals.add(
                ("flown", agent_id),
                f"uplink: agent {agent_id} reports {_far(flown_m)} flown, {_far(weighed.off_m)} from what its speed "
                "allows: not believed, {} times",
            )
        return flown_m if weighed.verdict is Verdict.BELIEVED else None

    def time_of(self, channel: str, stamped_s: float, now_s: float) -> float | None:
        """Return when a frame of `channel` was made that comes in now; None if its stamp cannot be true."""
        at_s = stamped_s - self.ahead_s
        if at_s - now_s > AHEAD_S:
            self.refusals.add(
                (channel, "ahead"),
                f"{channel}: {{}} frames refused, stamped in the future: its clock is {at_s - now_s:.1f} s ahead of "
                f"this computer's; allowed: {AHEAD_S:g} s",
            )
            return None
        if now_s - at_s > BEHIND_S:
            self.refusals.add(
                (channel, "behind"),
                f"{channel}: {{}} frames refused, stamped too long ago: they are old, or its clock is "
                f"{now_s - at_s:.1f} s behind this computer's; allowed: {BEHIND_S:g} s",
            )
            return None
        return min(now_s, at_s)

    def _tell(self, what: str, key: Key, weighed: Weighed) -> None:
        if weighed.verdict is Verdict.BEYOND:
            bound_m_s = self._bounds[key].speed_m_s
            self.refusals.add(
                (key, Verdict.BEYOND),
                f"{what} {_far(weighed.off_m)} from where its bound of {bound_m_s:g} m/s allows: not believed, "
                "{} times",
            )
        elif weighed.verdict is Verdict.JUMP:
            self.refusals.add(
                (key, Verdict.JUMP),
                f"{what} {_far(weighed.off_m)} from where it was expected: believed when confirmed, {{}} times",
            )


def words_of(key: Key) -> str:
    """Return what a thing is called in words, which are also the key of a sensor's track: `threat 7`."""
    return f"{key[0].name.lower()} {key[1]}"


def places_in(mission: Mission) -> Iterator[tuple[Key, Point]]:
    """Yield every agent, target and threat of a mission by kind and id, with its place (north, east) in m."""
    for agent in mission.agents:
        yield (Kind.AGENT, agent.id), agent.position_ned_m
    for target in mission.targets:
        yield (Kind.TARGET, target.id), target.position_ned_m
    for threat in mission.threats:
        yield (Kind.THREAT, threat.id), threat.position_ned_m


def _agent_bound(agent: AgentSpec, wind_m_s: float, error_m: float) -> Bound:
    speed_m_s = FASTER * agent.speed_m_s + wind_m_s
    return Bound(speed_m_s, Noise(error_m, agent.n_max * GRAVITY_M_S2 + agent.speed_m_s / _TURN_S))


def _far(distance_m: float) -> str:
    return f"{distance_m / 1000.0:.1f} km" if distance_m >= 1000.0 else f"{distance_m:.0f} m"
