"""Certificate of a mission: the bounds that the convergence theorem promises, with its assumptions checked.

`companion certify` prints it. The arithmetic is in companion/surrogate/theorem.py, the proofs in docs/convergence.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.mission.extent import mission_extent
from companion.mission.model import AgentSpec, Mission, ThreatSpec
from companion.protocol.codec import frame_resolution_cm
from companion.surrogate.cost import Weights
from companion.surrogate.networks import SIGMOID_SLOPE_MAX, load_monolithic
from companion.surrogate.profiles import profile_by_name
from companion.surrogate.theorem import (
    CONDITIONS,
    SQRT2,
    Condition,
    Pace,
    Sigmoids,
    bend_rad,
    quiet_distance_m,
    sigmoids_of,
    turn_needed_rad,
)

DEFAULT_SHARE = 0.5
"""Share of a condition's largest b at which its bound is stated: at the largest b itself the bound is infinite; far
below it the distance from the threats grows and the bound hardly shrinks."""


@dataclass(frozen=True)
class ThreatDistance:
    """Distance beyond which a condition holds around the threats of one pair of radii."""

    detection_radius_m: float
    attack_radius_m: float
    threats: int
    """Number of threats with these radii."""
    from_centre_m: float
    """Distance from a threat's centre; 0: the condition holds everywhere."""
    from_edge_m: float
    """The same distance from the edge of R_d; negative if it is inside."""
    as_heard_m: float | None
    """Distance from the centre for a threat as heard: as late as the broadcast allows without losses, and rounded, and
    at the part of b that the targets' error leaves; None if it leaves nothing."""


@dataclass(frozen=True)
class Finding:
    """A condition applied at one speed: its figures, and where it holds."""

    condition: str
    title: str
    source: str
    largest_b_m: float
    b_m: float
    """The b at which the rest is stated; 0 if no b satisfies the condition and none was asked for."""
    holds: bool
    """Whether the condition is satisfied at `b_m`."""
    why_not: str | None
    left_b_m: float | None
    """Part of b that the error of the targets as heard leaves for F*; 0 if none: then the bound is void in flight."""
    decrease: float | None
    decrease_unit: str
    weights_suffice: bool
    """Whether the network's weights alone keep |dF*/dx| <= b everywhere (paper: corollary)."""
    somewhere: bool
    """Whether the condition holds and a part of the plane is known on which |dF*/dU| <= b."""
    threat_distances: tuple[ThreatDistance, ...]
    peer_distance_m: float | None
    turn_needed_deg: float | None
    bend_deg: float | None
    """Greatest angle by which F* could turn the path at any detection edge if |dF*/dU| were sqrt(2) b there."""


@dataclass(frozen=True)
class SpeedGroup:
    """The agents of one speed, and their findings: the theorem has one v for all agents."""

    speed_m_s: float
    agents: tuple[int, ...]
    step_m: float
    """v, the distance that these agents fly in one step."""
    target_step_m: float
    """delta, the greatest distance that a target moves in one step."""
    turn_limit_deg: float
    """psi_max, the greatest turn in one step, of the least agile of these agents."""
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Corollary:
    """The condition on the network's weights, for an agent among all threats and peers (paper: coro_condi)."""

    weight_sum: float | None
    """sum_j |lambda_j w_j| of the radial profile, dimensionless; None for the monolithic network."""
    component_bound_m: float
    """Bound on |dF*/dx| and |dF*/dy| at any position; the corollary asks for at most b."""


@dataclass(frozen=True)
class Assumption:
    """An assumption of the bounds, and whether the mission meets it."""

    name: str
    holds: bool | None
    """Whether the assumption holds; None if that cannot be known before the flight."""
    text: str
    voids: tuple[str, ...] = ()
    """Titles of the bounds that are void in flight because the assumption does not hold."""


@dataclass(frozen=True)
class AgentBound:
    """Bounds for one agent on its way to one target, from their positions at the start."""

    agent: int
    target: int
    which: str
    """Which target this is: nearest, farthest or only; the one assigned in flight is at a distance between these."""
    distance_m: float
    steps: dict[str, int | None]
    """Greatest number of steps by condition; None if the condition does not hold, or nowhere that is known."""
    line_clear: dict[str, bool | None]
    """Whether, by condition, the straight line keeps the condition's distance from every threat's start."""


@dataclass(frozen=True)
class Certificate:
    """The certificate of a mission, as `companion certify` prints it."""

    mission: str
    seed: int
    surrogate: str
    guidance_step_s: float
    arrival_radius_m: float
    sources: int
    """Number of threats and peers around an agent; each may contribute an equal share of b."""
    groups: tuple[SpeedGroup, ...]
    corollary: Corollary
    assumptions: tuple[Assumption, ...]
    agents: tuple[AgentBound, ...]
    exclusion: str

    @property
    def certified(self) -> bool:
        """Whether at every speed some condition holds on a part of the plane that is known."""
        return all(any(finding.somewhere for finding in group.findings) for group in self.groups)

    def to_dict(self) -> dict[str, Any]:
        """Return the certificate as plain values that JSON can hold."""
        return {**asdict(self), "certified": self.certified}


def certify(mission: Mission, seed: int, b_m: float | None = None) -> Certificate:
    """Return the certificate of a resolved mission; `seed` is the one it was resolved with, for the record.

    `b_m`, positive and finite, is the b at which every bound is stated; by default it is DEFAULT_SHARE of each
    condition's largest b.

    Raises:
        InputError: the weights file of the surrogate is missing or damaged, or a radius is too large for any broadcast.

    """
    field = _Field.of(mission)
    speeds_m_s = sorted({agent.speed_m_s for agent in mission.agents})
    groups = tuple(_group(mission, field, speed_m_s, b_m) for speed_m_s in speeds_m_s)
    return Certificate(
        mission=mission.name,
        seed=seed,
        surrogate=mission.surrogate,
        guidance_step_s=mission.guidance_step_s,
        arrival_radius_m=mission.arrival_radius_m,
        sources=field.sources,
        groups=groups,
        corollary=Corollary(field.sigmoids.weight_sum if field.sigmoids else None, field.component_bound_m),
        assumptions=_assumptions(mission, field.heard, groups),
        agents=_agent_bounds(mission, groups),
        exclusion=_exclusion(mission, field, groups),
    )


@dataclass(frozen=True)
class _Heard:
    """Errors of positions as heard, if no frame is lost and nothing is farther from the origin than at the start."""

    age_s: float
    """Greatest age of a position."""
    resolution_m: float
    """Unit of length of the broadcast."""
    target_error_m: float
    """Greatest distance between a target and its position as heard, from age and rounding together."""

    @classmethod
    def of(cls, mission: Mission) -> _Heard:
        extent = mission_extent(mission)
        corners_ned_m = (extent.low_ned_m, extent.high_ned_m)
        resolution_m = frame_resolution_cm(corners_ned_m, (extent.radius_m,)) / 100.0
        age_s = mission.broadcast_period_s + mission.link.delay_s + mission.link.jitter_s
        late_m = age_s * max(target.speed_bound_m_s for target in mission.targets)
        return cls(age_s, resolution_m, late_m + resolution_m / SQRT2)

    @property
    def rounding_m(self) -> float:
        """Greatest rounding error of a position: half a unit on each axis."""
        return self.resolution_m / SQRT2

    def left_b_m(self, b_m: float) -> float:
        """Return the part of b that the targets' error leaves, m: that error adds to a gradient of length sqrt(2) b."""
        return max(0.0, b_m - self.target_error_m / SQRT2)


@dataclass(frozen=True)
class _Field:
    """F* around one agent of the mission, from all threats and all other agents."""

    mission: Mission
    weights: Weights
    sigmoids: Sigmoids | None
    """The profile's sigmoids; None for the monolithic network, whose gradient need not be small at any distance."""
    component_bound_m: float
    heard: _Heard

    @classmethod
    def of(cls, mission: Mission) -> _Field:
        weights, heard = Weights(**mission.weights.model_dump()), _Heard.of(mission)
        if mission.surrogate == "monolithic":
            return cls(mission, weights, None, load_monolithic().component_bound_m(), heard)
        sigmoids = sigmoids_of(profile_by_name(mission.surrogate))
        discs = [disc for threat in mission.threats for disc in _discs(threat, weights)]
        discs += (len(mission.agents) - 1) * [_peer_disc(mission, weights)]
        slope = SIGMOID_SLOPE_MAX * sigmoids.weight_sum
        return cls(mission, weights, sigmoids, slope * sum(weight / radius for weight, radius in discs), heard)

    @property
    def sources(self) -> int:
        return len(self.mission.threats) + len(self.mission.agents) - 1

    def threat_distances(self, b_m: float) -> tuple[ThreatDistance, ...]:
        if self.sigmoids is None:
            return ()
        found = []
        kinds = {(t.detection_radius_m, t.attack_radius_m) for t in self.mission.threats}
        for detection_m, attack_m in sorted(kinds):
            like = [
                t for t in self.mission.threats if (t.detection_radius_m, t.attack_radius_m) == (detection_m, attack_m)
            ]
            exact_m = quiet_distance_m(self.sigmoids, _discs(like[0], self.weights), self._share_m(b_m))
            found.append(
                ThreatDistance(
                    detection_m, attack_m, len(like), exact_m, exact_m - detection_m, self._as_heard_m(like, b_m)
                )
            )
        return tuple(found)

    def _as_heard_m(self, like: Sequence[ThreatSpec], b_m: float) -> float | None:
        left_m = self.heard.left_b_m(b_m)
        if self.sigmoids is None or left_m <= 0.0:
            return None
        # A threat heard late is off by this distance, and its radii are enlarged by as much and by both roundings.
        late_m = self.heard.age_s * max(threat.speed_bound_m_s for threat in like)
        growth_m = late_m + self.heard.rounding_m + self.heard.resolution_m
        quiet_m = quiet_distance_m(self.sigmoids, _discs(like[0], self.weights, growth_m), self._share_m(left_m))
        return quiet_m + late_m + self.heard.rounding_m if quiet_m > 0.0 else 0.0

    def peer_distance_m(self, b_m: float) -> float | None:
        if self.sigmoids is None or len(self.mission.agents) == 1:
            return None
        return quiet_distance_m(self.sigmoids, [_peer_disc(self.mission, self.weights)], self._share_m(b_m))

    def _share_m(self, b_m: float) -> float:
        """Return the part of b that each threat and peer may contribute, m; infinite if their sum never exceeds b."""
        return math.inf if self.component_bound_m <= b_m else b_m / self.sources


def _discs(threat: ThreatSpec, weights: Weights, growth_m: float = 0.0) -> list[tuple[float, float]]:
    return [
        (weights.k_d, threat.detection_radius_m + growth_m),
        (weights.k_a, threat.attack_radius_m + growth_m),
    ]


def _peer_disc(mission: Mission, weights: Weights) -> tuple[float, float]:
    # Both ordered pairs of two agents depend on each one's position, hence the factor 2 (surrogate_gradient).
    return 2.0 * weights.k_c, mission.separation_m


def _group(mission: Mission, field: _Field, speed_m_s: float, b_m: float | None) -> SpeedGroup:
    agents = [agent for agent in mission.agents if agent.speed_m_s == speed_m_s]
    target_m_s = max(target.speed_bound_m_s for target in mission.targets)
    pace = Pace(speed_m_s * mission.guidance_step_s, target_m_s * mission.guidance_step_s, mission.arrival_radius_m)
    return SpeedGroup(
        speed_m_s=speed_m_s,
        agents=tuple(agent.id for agent in agents),
        step_m=pace.speed_m,
        target_step_m=pace.target_m,
        turn_limit_deg=math.degrees(min(_turn_limit_rad(agent, mission) for agent in agents)),
        findings=tuple(_finding(mission, field, pace, condition, b_m) for condition in CONDITIONS),
    )


def _turn_limit_rad(agent: AgentSpec, mission: Mission) -> float:
    return turn_rate_rad_s(agent.speed_m_s, agent.n_max) * mission.guidance_step_s


def _finding(mission: Mission, field: _Field, pace: Pace, condition: Condition, asked_b_m: float | None) -> Finding:
    largest_m = condition.largest_b_m(pace)
    b_m = DEFAULT_SHARE * largest_m if asked_b_m is None else asked_b_m
    why_not = _why_not(pace, condition, largest_m, b_m)
    holds = why_not is None
    edge_m = _edge_attraction_m(mission)
    return Finding(
        condition=condition.name,
        title=condition.title,
        source=condition.source,
        largest_b_m=largest_m,
        b_m=b_m,
        holds=holds,
        why_not=why_not,
        left_b_m=field.heard.left_b_m(b_m) if holds else None,
        decrease=condition.decrease(pace, b_m) if holds else None,
        decrease_unit=condition.unit,
        weights_suffice=holds and field.component_bound_m <= b_m,
        somewhere=holds and (field.sigmoids is not None or field.component_bound_m <= b_m),
        threat_distances=field.threat_distances(b_m) if holds else (),
        peer_distance_m=field.peer_distance_m(b_m) if holds else None,
        turn_needed_deg=math.degrees(turn_needed_rad(pace, b_m)) if holds else None,
        bend_deg=None if edge_m is None or not holds else math.degrees(bend_rad(b_m, edge_m)),
    )


def _why_not(pace: Pace, condition: Condition, largest_m: float, b_m: float) -> str | None:
    if largest_m <= 0.0:
        return f"no b satisfies it at delta/v = {pace.target_m / pace.speed_m:.4g}"
    if condition.ends_at_v and pace.speed_m > pace.arrival_m:
        return f"it ends within v = {pace.speed_m:.6g} m of the target, beyond the arrival radius"
    # At the limit itself rounding decides: a decrease of zero must not be divided by.
    if b_m >= largest_m or condition.decrease(pace, b_m) <= 0.0:
        return f"b = {b_m:.6g} m is not below {largest_m:.6g} m"
    return None


def _edge_attraction_m(mission: Mission) -> float | None:
    """Return the least attraction at any detection edge towards any target, m; None without threats, or if it is 0."""
    least_m = min(
        (
            math.dist(threat.position_ned_m, target.position_ned_m) - threat.detection_radius_m
            for threat in mission.threats
            for target in mission.targets
        ),
        default=0.0,
    )
    return least_m if least_m > 0.0 else None


def _assumptions(mission: Mission, heard: _Heard, groups: Sequence[SpeedGroup]) -> tuple[Assumption, ...]:
    delta_m = groups[0].target_step_m
    slowest_m = groups[0].step_m
    fastest_m = groups[-1].step_m
    calm = mission.wind.speed_m_s == 0.0 and mission.wind.gust_m_s == 0.0
    threat_m_s = max((threat.speed_bound_m_s for threat in mission.threats), default=0.0)
    found = [
        Assumption(
            "v > sqrt(2) delta",
            slowest_m > SQRT2 * delta_m,
            f"v = {slowest_m:.6g} m, sqrt(2) delta = {SQRT2 * delta_m:.6g} m per step",
        ),
        Assumption(
            "v <= arrival radius",
            fastest_m <= mission.arrival_radius_m,
            f"v = {fastest_m:.6g} m, arrival radius {mission.arrival_radius_m:g} m; the theorem ends at v",
        ),
        _fixed_assignment(mission),
        *(_turn_limit(group) for group in groups),
        _targets_known(mission, heard, groups),
        Assumption(
            "threats known at every step",
            threat_m_s == 0.0 if mission.threats else True,
            "there are none"
            if not mission.threats
            else "they stand still; rounded by the broadcast, they count as in the row 'as heard'"
            if threat_m_s == 0.0
            else f"they move at up to {threat_m_s:g} m/s: the distances are to where they are at the moment, and from "
            "where they are heard of late, those in the row 'as heard'",
        ),
        Assumption(
            "nothing else moving the agents",
            None if calm else False,
            "no wind, but the guard may change a setpoint: a flight counts it"
            if calm
            else f"wind {mission.wind.speed_m_s:g} m/s, gusts {mission.wind.gust_m_s:g} m/s: voids every bound",
            () if calm else _titles(groups, [finding for group in groups for finding in group.findings]),
        ),
    ]
    if len(mission.agents) > 1:
        shared = len(mission.agents) > len(mission.targets)
        found.append(
            Assumption(
                "peers far enough",
                None,
                f"{len(mission.agents)} agents for {len(mission.targets)} targets: "
                + ("those that share one meet there" if shared else "their ways may cross"),
            )
        )
    return tuple(found)


def _targets_known(mission: Mission, heard: _Heard, groups: Sequence[SpeedGroup]) -> Assumption:
    fastest_m_s = max(target.speed_bound_m_s for target in mission.targets)
    void = _titles(groups, [finding for group in groups for finding in group.findings if finding.left_b_m == 0.0])
    error = (
        f"off by up to {heard.target_error_m:.4g} m, which acts like a gradient of that length and leaves of each b "
        "what the row 'left of b' says"
    )
    rounded = f"rounded to {heard.resolution_m:g} m by the broadcast"
    when = (
        f"they stand still, but are {rounded}"
        if fastest_m_s == 0.0
        else f"heard every {mission.broadcast_period_s:g} s, up to {heard.age_s:g} s late without losses, and {rounded}"
    )
    return Assumption(
        "targets known at every step",
        fastest_m_s == 0.0 and not void,
        f"{when}: {error}" + (f"; voids {', '.join(void)}" if void else ""),
        void,
    )


def _titles(groups: Sequence[SpeedGroup], findings: Sequence[Finding]) -> tuple[str, ...]:
    """Return the titles of those findings that hold, each with its speed if there are several."""
    return tuple(
        finding.title if len(groups) == 1 else f"{finding.title} at {group.speed_m_s:g} m/s"
        for group in groups
        for finding in group.findings
        if finding.holds and any(finding is wanted for wanted in findings)
    )


def _fixed_assignment(mission: Mission) -> Assumption:
    if len(mission.targets) == 1:
        return Assumption("fixed assignment", True, "there is one target")
    steps = mission.assignment_period_s / mission.guidance_step_s
    return Assumption(
        "fixed assignment",
        None,
        f"assigned anew every {mission.assignment_period_s:g} s ({steps:g} steps) and at every arrival and loss: each "
        "change of an agent's target starts its count anew",
    )


def _turn_limit(group: SpeedGroup) -> Assumption:
    name = f"turn limit inactive at {group.speed_m_s:g} m/s"
    if group.turn_limit_deg >= 180.0:
        return Assumption(name, True, f"{group.turn_limit_deg:.4g} degrees per step: it never binds")
    held = [finding for finding in group.findings if finding.turn_needed_deg is not None]
    fits = [finding.title for finding in held if (finding.turn_needed_deg or 0.0) <= group.turn_limit_deg]
    exceeds = [finding.title for finding in held if finding.title not in fits]
    parts = [f"at most {group.turn_limit_deg:.4g} degrees per step"]
    if fits:
        first = math.ceil(180.0 / group.turn_limit_deg)
        parts.append(f"{', '.join(fits)}: inactive for good after the first turn (at most {first} steps, not counted)")
    if exceeds:
        parts.append(f"{', '.join(exceeds)}: may be exceeded at this b, to be checked along the run")
    return Assumption(name, bool(fits) and not exceeds or None, "; ".join(parts))


def _agent_bounds(mission: Mission, groups: Sequence[SpeedGroup]) -> tuple[AgentBound, ...]:
    targets_ned_m = np.array([target.position_ned_m for target in mission.targets])  # (K, 2)
    threats_ned_m = np.array([threat.position_ned_m for threat in mission.threats]).reshape(-1, 2)  # (M, 2)
    group_of = {identity: group for group in groups for identity in group.agents}
    # (M,) per group and condition
    quiet_m = {
        (group.speed_m_s, finding.condition): np.array([_quiet_m(finding, threat) for threat in mission.threats])
        for group in groups
        for finding in group.findings
    }
    found = []
    for agent in mission.agents:
        group = group_of[agent.id]
        pace = Pace(group.step_m, group.target_step_m, mission.arrival_radius_m)
        start_ned_m = np.array(agent.position_ned_m)
        distance_m = np.hypot(*(targets_ned_m - start_ned_m).T)  # (K,)
        ends = [("nearest", int(np.argmin(distance_m))), ("farthest", int(np.argmax(distance_m)))]
        for which, index in ends if len(distance_m) > 1 else [("only", 0)]:
            apart_m = _segment_distances_m(start_ned_m, targets_ned_m[index], threats_ned_m)
            found.append(
                AgentBound(
                    agent=agent.id,
                    target=mission.targets[index].id,
                    which=which,
                    distance_m=float(distance_m[index]),
                    steps={
                        finding.condition: _steps(condition, pace, finding, float(distance_m[index]))
                        for condition, finding in zip(CONDITIONS, group.findings, strict=True)
                    },
                    line_clear={
                        finding.condition: bool(np.all(apart_m >= quiet_m[group.speed_m_s, finding.condition]))
                        if finding.somewhere
                        else None
                        for finding in group.findings
                    },
                )
            )
    return tuple(found)


def _quiet_m(finding: Finding, threat: ThreatSpec) -> float:
    """Return the distance from a threat's centre beyond which a finding holds, m; 0 if the finding has none."""
    radii_m = (threat.detection_radius_m, threat.attack_radius_m)
    return next(
        (
            distance.from_centre_m
            for distance in finding.threat_distances
            if (distance.detection_radius_m, distance.attack_radius_m) == radii_m
        ),
        0.0,
    )


def _steps(condition: Condition, pace: Pace, finding: Finding, distance_m: float) -> int | None:
    if not finding.somewhere:
        return None
    return 0 if distance_m <= pace.arrival_m else condition.steps(pace, finding.b_m, distance_m)


def _segment_distances_m(start_ned_m: np.ndarray, end_ned_m: np.ndarray, points_ned_m: np.ndarray) -> np.ndarray:
    """Return the distance of each point (M, 2) from the segment between two points (2,), (M,), m."""
    along = end_ned_m - start_ned_m
    square = float(along @ along)
    offset = points_ned_m - start_ned_m
    share = np.clip(offset @ along / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points_ned_m))
    distance_m: np.ndarray = np.hypot(*(offset - share[:, np.newaxis] * along).T)
    return distance_m


def _exclusion(mission: Mission, field: _Field, groups: Sequence[SpeedGroup]) -> str:
    held = [finding for group in groups for finding in group.findings if finding.holds]
    if not held:
        return "No bound holds: nothing is promised."
    if not field.sources:
        return "There are no threats and no other agents: F* is zero, and a satisfied condition holds everywhere."
    if not any(finding.somewhere for finding in held):
        return (
            "Nothing is certified anywhere: this network has no distance from which on its gradient is known to be "
            "small, and its weights allow more than any b. Weights that did not would avoid no threat: the bound and "
            "the avoidance exclude each other."
        )
    if not mission.threats:
        return "There are no threats: the bound holds wherever the other agents are far enough."
    begin = (
        "Nearer to a threat than the distance above the bound promises nothing; farther off F* does next to nothing: "
    )
    edge_m = _edge_attraction_m(mission)
    if edge_m is None:
        return f"{begin}a target lies inside a detection disc, where the law cannot follow it."
    beta_m = _span([SQRT2 * finding.b_m for finding in held], ".3g")
    bend_deg = _span([finding.bend_deg or 0.0 for finding in held], ".2g")
    return (
        f"{begin}at the edge of a detection disc the attraction is at least {edge_m:.0f} m. A gradient within the "
        f"bound (sqrt(2) b, {beta_m} m) turns the path by at most {bend_deg} degrees there; to hold an agent off, it "
        "must equal the attraction. So the bound and the "
        "avoidance exclude each other: no bound covers what keeps an agent out of a disc."
    )


def _span(figures: Sequence[float], form: str) -> str:
    """Return the least and the greatest figure as text, or one of them if both read the same."""
    ends = (f"{min(figures):{form}}", f"{max(figures):{form}}")
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)
