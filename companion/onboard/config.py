"""The vehicle's configuration file: which agent it is, what it may do, and where its links are."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from companion.autopilot.kinds import KINDS
from companion.errors import InputError, nearest_hint
from companion.files.yaml import ListOf, Section, dump_yaml, is_there, parse_yaml, read_text_file, validated
from companion.guard.types import PIVOT_SPEED_M_S
from companion.guidance.settings import DEFAULT_LAW, LawName, SurrogateName
from companion.mission.model import CostWeights, Mission, agent_height_m
from companion.mission.values import MAX_ITEMS, DetectorName, Identity, NotNegative, Polygon, Positive, Speed, Step
from companion.transport.endpoints import FORMS, RECEIVING, SENDING, Link, parse_link

TrustWord = Literal["unsigned", "mavlink", "ed25519", "both"]
"""Signatures that frames must carry: none, MAVLink's own by a shared key, the ground station's Ed25519, or both."""
Height = Annotated[float, Field(ge=0, le=20_000)]
ONE_RADIO = "autopilot"
"""Value of `broadcast.link` when the broadcast comes through the autopilot, wrapped in V2_EXTENSION messages."""


class AutopilotSection(Section):
    """The autopilot that this companion steers."""

    kind: str
    link: str
    system_id: Annotated[int, Field(ge=1, le=255)] | None = None
    """MAVLink system id of the autopilot; None: the only one that is heard."""
    offboard: Literal["mavsdk", "direct"] = "mavsdk"
    """Sender of a PX4 copter's setpoints: MAVSDK in a process of its own, or the companion itself."""
    state_file: Annotated[str, Field(min_length=1)] | None = None
    """File that tells a restarted companion who controlled the vehicle."""
    clear: Literal["disarm", "signal"] = "disarm"
    """What clears a take-over of a PX4: disarming only, or also the signal SIGUSR1 to the program."""
    below_height: Literal["say", "climb"] = "say"
    """What is done when a vehicle is handed over below `limits.height_min_m`: say what the person must do, or climb
    straight up to it where it stands (vehicles that can stop)."""

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.kind not in KINDS:
            hint = nearest_hint(self.kind, KINDS)
            raise ValueError(f"kind: '{self.kind}'{hint}; allowed: {', '.join(KINDS)}")
        if self.offboard == "direct" and self.kind != "px4-copter":
            raise ValueError(f"offboard: 'direct' with kind '{self.kind}'; allowed: only with px4-copter")
        if self.below_height == "climb" and not KINDS[self.kind].can_stop:
            raise ValueError(f"below_height: 'climb' with kind '{self.kind}'; allowed: say, for it cannot stop")
        _checked_link(self.link)
        return self

    @property
    def needs_state_file(self) -> bool:
        """Whether the autopilot obeys a new stream by itself, so that a restart must know who had control before."""
        return KINDS[self.kind].resumes_on_stream


class BroadcastSection(Section):
    """Where the broadcast is heard, and which of its frames are accepted (docs/authenticity.md)."""

    link: str
    trust: TrustWord
    """Signatures that every frame must carry; `unsigned` accepts frames of any sender."""
    mavlink_key: Annotated[str, Field(min_length=1)] | None = None
    """File with the key that the whole fleet shares."""
    public_key: Annotated[str, Field(min_length=1)] | None = None
    """File with the ground station's public key."""
    state_file: Annotated[str, Field(min_length=1)] | None = None
    """File that tells a restarted companion which frame was accepted last."""
    clock: Literal["checked", "unchecked"] = "checked"
    """Whether a frame's time is compared with this computer's clock; `unchecked`: that clock may be wrong."""
    max_age_s: Positive = 30.0
    """Greatest age of an accepted frame; counts only with a checked clock."""
    ahead_s: Positive = 2.0
    """How far a frame's time may be ahead of this computer's clock; counts only with a checked clock."""
    checks_per_s: Annotated[float, Field(ge=1, le=100_000)] = 1_000.0
    """Most Ed25519 signatures checked per second, so that a flood of frames cannot use up the computer."""

    @model_validator(mode="after")
    def _listens(self) -> Self:
        if self.link != ONE_RADIO and _checked_link(self.link).scheme not in RECEIVING:
            forms = ", ".join(FORMS[scheme] for scheme in RECEIVING)
            raise ValueError(f"link: '{self.link}'; allowed: {forms} (the companion never writes to it), {ONE_RADIO}")
        return self

    @model_validator(mode="after")
    def _has_its_keys(self) -> Self:
        for key, words in (("mavlink_key", ("mavlink", "both")), ("public_key", ("ed25519", "both"))):
            given, wanted = getattr(self, key) is not None, self.trust in words
            if given != wanted:
                allowed = "the file of `groundstation keygen`" if wanted else f"only with {' or '.join(words)}"
                raise ValueError(f"{key}: {_is(given)} with trust '{self.trust}'; allowed: {allowed}")
        kept = self.state_file is not None
        if kept == (self.trust == "unsigned"):
            raise ValueError(
                f"state_file: {_is(kept)} with trust '{self.trust}'; allowed: a file where keys are used, so that what "
                "was sent before a restart is not believed again, and none with unsigned"
            )
        return self


class UplinkSection(Section):
    """The link on which the vehicle's position reports go to the ground station."""

    link: str
    key: Annotated[str, Field(min_length=1)] | None = None
    """File with the key that signs the reports, which `groundstation keygen --agents` wrote for this agent alone."""

    @model_validator(mode="after")
    def _sends(self) -> Self:
        if _checked_link(self.link).scheme not in SENDING:
            forms = ", ".join(FORMS[scheme] for scheme in SENDING)
            raise ValueError(f"link: '{self.link}'; allowed: {forms}: nothing is heard on it")
        return self


class LimitsSection(Section):
    """What the vehicle may do, and how well it flies; heights are above home."""

    speed_m_s: Speed = 5.0
    n_max: Annotated[float, Field(gt=0, le=100)] = 0.25
    range_m: Positive = 5_000.0
    height_min_m: Height = 5.0
    height_max_m: Height = 120.0
    braking_m_s2: Positive = 2.0
    reaction_s: NotNegative = 0.0
    """Time from sending a setpoint until the vehicle begins to obey it."""
    rate_share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Turn rate that the vehicle achieves, as a share of n_max g/v."""
    wind_m_s: NotNegative = 0.0
    """The strongest wind, gusts included, in which the guard must still keep the vehicle out of the discs."""
    airspeed_max_m_s: Positive | None = None
    """Greatest airspeed that the vehicle was measured to reach; None: what its parameters tell."""
    position_error_m: NotNegative = 0.0
    """Greatest distance between the vehicle's true and reported position."""
    fence: Polygon | None = None
    """Polygon, of corners (north, east) about the broadcast's origin, that the guard keeps the vehicle inside."""
    exclusions: Annotated[ListOf[Polygon], Field(max_length=MAX_ITEMS)] = ()
    """Polygons that the guard keeps the vehicle outside of."""

    @property
    def fastest_m_s(self) -> float:
        """Greatest speed over ground."""
        return self.speed_m_s + self.wind_m_s

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.height_min_m > self.height_max_m:
            raise ValueError(
                f"height_min_m: {self.height_min_m:g}; allowed: at most height_max_m {self.height_max_m:g}"
            )
        if self.wind_m_s >= self.speed_m_s:
            raise ValueError(f"wind_m_s: {self.wind_m_s:g}; allowed: less than speed_m_s {self.speed_m_s:g}")
        return self


class StalenessSection(Section):
    """Ages of the picture at which the failsafe's stages begin."""

    coasting_after_s: Positive = 15.0
    loitering_after_s: Positive = 60.0
    blind_after_s: Positive = 300.0
    recover_after_s: NotNegative = 1.0
    """Time for which the reason of a stage must have been gone before the stage becomes milder."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.coasting_after_s <= self.loitering_after_s <= self.blind_after_s:
            raise ValueError("allowed: coasting_after_s <= loitering_after_s <= blind_after_s")
        return self


class HealthSection(Section):
    """Limits on the vehicle's own state at which the failsafe acts."""

    battery_return_percent: Annotated[float, Field(ge=0, le=90)] = 25.0
    """Remaining charge at or below which the vehicle returns; 0: it never returns for its battery."""
    position_accuracy_m: Positive = 10.0
    """Worst accuracy of the position with which the vehicle still flies to a target; with a worse one it loiters."""
    gps_fix_min: Annotated[int, Field(ge=0, le=6)] = 3
    """Least GPS_FIX_TYPE with which the vehicle is steered: 3 is a 3D fix; 0 where it navigates without GPS."""
    infeasible_after_s: Positive = 5.0
    """Time without a certified back-up of the guard after which the vehicle loiters."""
    clock_step_s: Positive = 1.0
    """Offset between system clock and steady clock from which the companion reports that the clock stepped."""


class StatusSection(Section):
    """Status messages of the companion on the autopilot link."""

    quiet: bool | None = None
    """Whether the companion sends none; None: it sends them in Case I and not in Case II."""
    period_s: Annotated[float, Field(ge=1, le=3600)] = 5.0


class LogsSection(Section):
    """How much of the disk the logs may take."""

    most_mb: Annotated[float, Field(ge=20, le=1_000_000)] = 2_000.0
    """Greatest size of all runs' logs in `log_dir` together, in millions of bytes; the oldest make room."""


class Config(Section):
    """The whole configuration of a companion; the names of the keys carry their units."""

    agent_id: Identity
    autopilot: AutopilotSection | None = None
    broadcast: BroadcastSection | None = None
    limits: LimitsSection = LimitsSection()
    height_m: Height = 30.0
    case: Literal["I", "II"] = "I"
    """Case II: the fleet keeps radio silence, so that the companion sends no status messages (status.quiet)."""
    law: LawName = DEFAULT_LAW
    surrogate: SurrogateName = "pairwise"
    keep_out: Literal["attack", "detection"] = "detection"
    """Which discs of the threats the guard keeps the vehicle out of; the guidance law is not affected."""
    weights: CostWeights = CostWeights()
    separation_m: Positive = 100.0
    arrival_radius_m: Positive = 300.0
    guidance_step_s: Step = 0.5
    setpoint_rate_hz: Annotated[float, Field(ge=2, le=50)] = 10.0
    telemetry_timeout_s: Positive = 2.0
    range_policy: Literal["return", "arrive"] = "return"
    staleness: StalenessSection = StalenessSection()
    health: HealthSection = HealthSection()
    status: StatusSection = StatusSection()
    peer_memory_s: NotNegative = 30.0
    """Age above which another agent's broadcast position is ignored."""
    vertical_separation_m: NotNegative = 0.0
    """Difference in height from which neighbours are ignored; 0: neighbours at any height count."""
    detector: DetectorName = "adsb"
    """By what the right of way knows the others: what the autopilot reports of them and, of those that it does not
    show, the broadcast; the broadcast alone; or nothing at all."""
    detector_range_m: NotNegative = 2_000.0
    """Distance within which the neighbours that the autopilot reports (ADSB_VEHICLE) count."""
    report_period_s: NotNegative = 0.0
    """Time between two position reports on the uplink; 0: none are sent."""
    uplink: UplinkSection | None = None
    log_dir: Annotated[str, Field(min_length=1)] | None = None
    logs: LogsSection = LogsSection()

    @model_validator(mode="after")
    def _within_band(self) -> Self:
        if not self.limits.height_min_m <= self.height_m <= self.limits.height_max_m:
            raise ValueError(
                f"height_m: {self.height_m:g}; allowed: limits.height_min_m {self.limits.height_min_m:g} "
                f"to limits.height_max_m {self.limits.height_max_m:g}"
            )
        return self

    @model_validator(mode="after")
    def _fast_enough(self) -> Self:
        speed_m_s, kind = self.limits.speed_m_s, None if self.autopilot is None else self.autopilot.kind
        allowed = None if kind is None else fast_enough(speed_m_s, KINDS[kind].can_stop)
        if allowed is not None:
            raise ValueError(f"limits.speed_m_s: {speed_m_s:g} with autopilot.kind '{kind}'; allowed: {allowed}")
        return self


def fast_enough(speed_m_s: float, can_stop: bool) -> str | None:
    """Return which speed is allowed instead of one that the guard can hold no vehicle at; None if it can."""
    if can_stop or speed_m_s >= PIVOT_SPEED_M_S:
        return None
    return f"at least {PIVOT_SPEED_M_S:g} m/s for a vehicle that cannot stop"


def packaged_configs() -> tuple[str, ...]:
    """Return the names of the configurations that ship with the project."""
    folder = resources.files("companion.onboard") / "configs"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def load_config(name_or_path: str) -> Config:
    """Load a configuration for flying: one whose links are given.

    Raises:
        InputError: the file cannot be read, is not YAML, or breaks a rule.

    """
    config = read_config(name_or_path)
    for key in ("autopilot", "broadcast"):
        if getattr(config, key) is None:
            raise InputError(f"{name_or_path}: {key}: missing; `companion run` needs its link")
    if config.autopilot is not None and config.autopilot.needs_state_file and config.autopilot.state_file is None:
        raise InputError(
            f"{name_or_path}: autopilot.state_file: missing with kind '{config.autopilot.kind}', which obeys again by "
            "itself; allowed: a file, so that a companion started again in flight knows whether it had the vehicle"
        )
    if (config.uplink is None) != (config.report_period_s == 0.0):
        raise InputError(
            f"{name_or_path}: report_period_s: {config.report_period_s:g} with{'out' * (config.uplink is None)} an "
            "uplink; allowed: a period above 0 with an uplink, or neither"
        )
    if config.surrogate == "monolithic":
        raise InputError(
            f"{name_or_path}: surrogate: 'monolithic' flies only in the simulator; allowed: pairwise, analytic"
        )
    return config


def read_config(name_or_path: str) -> Config:
    """Read a configuration, a file or a packaged one, with or without links.

    Raises:
        InputError: the file cannot be read, is not YAML, or breaks a rule.

    """
    if name_or_path in packaged_configs():
        text = (resources.files("companion.onboard") / "configs" / f"{name_or_path}.yaml").read_text(encoding="utf-8")
    else:
        path = Path(name_or_path)
        if not is_there(path):
            hint = nearest_hint(name_or_path, packaged_configs())
            raise InputError(
                f"{name_or_path}: no such configuration file or packaged one{hint}; "
                f"packaged: {', '.join(packaged_configs())}"
            )
        text = read_text_file(path)
    return parse_config(text, name_or_path)


def dump_config(config: Config) -> str:
    """Return a configuration as YAML text that `parse_config` reads back to an equal one."""
    return dump_yaml(config.model_dump(mode="json", exclude_none=True))


def parse_config(text: str, source: str) -> Config:
    """Parse and validate the YAML text of a configuration, with or without links; `source` names it in errors.

    Raises:
        InputError: not YAML, or against a rule.

    """
    return validated(Config, parse_yaml(text, source), source)


def config_for_agent(mission: Mission, agent_id: int, law: LawName) -> Config:
    """Return the configuration a mission implies for one of its agents; links are left to the caller."""
    agent = next(agent for agent in mission.agents if agent.id == agent_id)
    height_m = agent_height_m(mission, agent_id)
    return Config(
        agent_id=agent.id,
        limits=LimitsSection(
            speed_m_s=agent.speed_m_s,
            n_max=agent.n_max,
            range_m=agent.range_m,
            fence=mission.fence,
            exclusions=mission.exclusions,
            wind_m_s=mission.wind.speed_m_s + mission.wind.gust_m_s,
            height_min_m=min(LimitsSection().height_min_m, height_m),
            height_max_m=max(LimitsSection().height_max_m, height_m),
        ),
        height_m=height_m,
        case=mission.case,
        # Half-way between two layers: a vehicle in its own layer does not count as a neighbour in the next one.
        vertical_separation_m=0.5 * mission.layer_spacing_m,
        law=law,
        # The paper's laws are flown to see what they do: the guard must not correct them outside R_a.
        keep_out="detection" if law == "routed" else "attack",
        surrogate=mission.surrogate,
        weights=mission.weights,
        separation_m=mission.separation_m,
        arrival_radius_m=mission.arrival_radius_m,
        guidance_step_s=mission.guidance_step_s,
        range_policy=mission.range_policy,
        peer_memory_s=mission.lost_after_s,
        detector=mission.detector,
        detector_range_m=mission.detector_range_m,
        report_period_s=mission.report_period_s if mission.case == "II" else 0.0,
        staleness=StalenessSection(
            coasting_after_s=3.0 * mission.broadcast_period_s,
            loitering_after_s=max(60.0, 12.0 * mission.broadcast_period_s),
            blind_after_s=max(300.0, 60.0 * mission.broadcast_period_s),
        ),
    )


def _checked_link(text: str) -> Link:
    try:
        return parse_link(text)
    except InputError as error:
        raise ValueError(str(error)) from error


def _is(given: bool) -> str:
    return "given" if given else "missing"
