"""The vehicle's configuration file: which agent it is, what it may do, and where its links are."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from companion.autopilot.kinds import KINDS
from companion.errors import InputError, nearest_hint
from companion.files.yaml import ListOf, Section, dump_yaml, is_there, parse_yaml, read_text_file, validated
from companion.guidance.settings import DEFAULT_LAW, LawName, SurrogateName
from companion.mission.model import (
    CostWeights,
    Identity,
    Mission,
    NotNegative,
    Positive,
    Speed,
    Vertex,
    agent_height_m,
)
from companion.transport.endpoints import FORMS, RECEIVING, SENDING, Link, parse_link

TrustWord = Literal["unsigned", "mavlink", "ed25519", "both"]
"""MAVLink's own signature by a shared key, an Ed25519 signature of the ground station's, or both."""
Height = Annotated[float, Field(ge=0, le=20_000)]
ONE_RADIO = "autopilot"
"""The broadcast link of a vehicle that hears the broadcast through its autopilot, inside V2_EXTENSION."""


class AutopilotSection(Section):
    """The one autopilot this companion steers."""

    kind: str
    link: str
    system_id: Annotated[int, Field(ge=1, le=255)] | None = None
    """The autopilot's; none: whichever is heard first."""
    offboard: Literal["mavsdk", "direct"] = "mavsdk"
    """Who sends the setpoints of a PX4 copter: MAVSDK in a process of its own, or the companion itself."""
    state_file: Annotated[str, Field(min_length=1)] | None = None
    """Where it is kept over restarts whether the companion steers."""
    clear: Literal["disarm", "signal"] = "disarm"
    """What ends a take-over of a PX4: only disarming, or a signal to the program as well."""

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.kind not in KINDS:
            hint = nearest_hint(self.kind, KINDS)
            raise ValueError(f"kind: '{self.kind}'{hint}; allowed: {', '.join(KINDS)}")
        if self.offboard == "direct" and self.kind != "px4-copter":
            raise ValueError(f"offboard: 'direct' with kind '{self.kind}'; allowed: only with px4-copter")
        _checked_link(self.link)
        return self

    @property
    def needs_state_file(self) -> bool:
        """Whether the autopilot resumes by itself, so that a restart must know what was before."""
        return KINDS[self.kind].resumes_on_stream


class BroadcastSection(Section):
    """Where the broadcast is heard, and what of it is believed (docs/authenticity.md)."""

    link: str
    trust: TrustWord
    """What every frame must carry; `unsigned` believes anybody."""
    mavlink_key: Annotated[str, Field(min_length=1)] | None = None
    """File with the key that the whole fleet shares."""
    public_key: Annotated[str, Field(min_length=1)] | None = None
    """File with the ground station's public key."""
    state_file: Annotated[str, Field(min_length=1)] | None = None
    """Where the last accepted frame is kept over restarts."""
    clock: Literal["checked", "unchecked"] = "checked"
    """`unchecked`: this computer's clock may be wrong, so that a frame's time is not compared with it."""
    max_age_s: Positive = 30.0
    ahead_s: Positive = 2.0
    checks_per_s: Annotated[float, Field(ge=1, le=100_000)] = 1_000.0
    """Ed25519 signatures checked at most: a flood by a holder of the shared key must not use up the computer."""

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
    """Where reports go, on a link of their own."""

    link: str

    @model_validator(mode="after")
    def _sends(self) -> Self:
        if _checked_link(self.link).scheme not in SENDING:
            forms = ", ".join(FORMS[scheme] for scheme in SENDING)
            raise ValueError(f"link: '{self.link}'; allowed: {forms}: nothing is heard on it")
        return self


class LimitsSection(Section):
    """What the vehicle may do; heights are above home."""

    speed_m_s: Speed = 5.0
    n_max: Annotated[float, Field(gt=0, le=100)] = 0.25
    range_m: Positive = 5_000.0
    height_min_m: Height = 5.0
    height_max_m: Height = 120.0
    braking_m_s2: Positive = 2.0
    reaction_s: NotNegative = 0.0
    """From sending a setpoint to the vehicle beginning to obey it."""
    rate_share: Annotated[float, Field(gt=0, le=1)] = 1.0
    """How much of the turn rate n_max g/v the vehicle achieves."""
    wind_m_s: NotNegative = 0.0
    """The strongest wind, gusts included, that keep-out shall still hold in."""
    position_error_m: NotNegative = 0.0
    fence: Annotated[ListOf[Vertex], Field(min_length=3)] | None = None

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
    """Ages of the picture at which each stage begins."""

    coasting_after_s: Positive = 15.0
    loitering_after_s: Positive = 60.0
    blind_after_s: Positive = 300.0
    recover_after_s: NotNegative = 1.0
    """A stage is left for a milder one only after its reason has been gone for this time."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.coasting_after_s <= self.loitering_after_s <= self.blind_after_s:
            raise ValueError("allowed: coasting_after_s <= loitering_after_s <= blind_after_s")
        return self


class HealthSection(Section):
    """From where on the vehicle's own state of health matters."""

    battery_return_percent: Annotated[float, Field(ge=0, le=90)] = 25.0
    """Not above this it returns; 0: never for that."""
    position_accuracy_m: Positive = 10.0
    """A position known less well than this is good enough to loiter only."""
    gps_fix_min: Annotated[int, Field(ge=0, le=6)] = 3
    """GPS_FIX_TYPE: 3 is 3D; 0 for a vehicle that finds its way without."""
    infeasible_after_s: Positive = 5.0
    """It loiters after this time without a certified back-up."""
    clock_step_s: Positive = 1.0
    """A step of the computer's clock against the steady one is told from here on."""


class StatusSection(Section):
    """What the companion says of itself on the autopilot link."""

    quiet: bool | None = None
    """Say nothing; none: as the case wants, in Case II nothing."""
    period_s: Annotated[float, Field(ge=1, le=3600)] = 5.0


class Config(Section):
    """A companion's whole configuration. Angles in degrees, lengths in metres, times in seconds, as the names say."""

    agent_id: Identity
    autopilot: AutopilotSection | None = None
    broadcast: BroadcastSection | None = None
    limits: LimitsSection = LimitsSection()
    height_m: Height = 30.0
    case: Literal["I", "II"] = "I"
    """In Case II nothing but the broadcast shall be heard of the fleet: the companion keeps silent (status.quiet)."""
    law: LawName = DEFAULT_LAW
    surrogate: SurrogateName = "pairwise"
    keep_out: Literal["attack", "detection"] = "detection"
    """Which discs the guard holds; what the law holds is its own affair."""
    weights: CostWeights = CostWeights()
    separation_m: Positive = 100.0
    arrival_radius_m: Positive = 300.0
    guidance_step_s: Annotated[float, Field(gt=0, le=10)] = 0.5
    setpoint_rate_hz: Annotated[float, Field(ge=2, le=50)] = 10.0
    telemetry_timeout_s: Positive = 2.0
    range_policy: Literal["return", "arrive"] = "return"
    staleness: StalenessSection = StalenessSection()
    health: HealthSection = HealthSection()
    status: StatusSection = StatusSection()
    peer_memory_s: NotNegative = 30.0
    vertical_separation_m: NotNegative = 0.0
    """Neighbours higher or lower by at least this need not give way, nor be given way; 0: everybody does."""
    detector_range_m: NotNegative = 2_000.0
    """Neighbours that the autopilot passes on are minded within this distance."""
    report_period_s: NotNegative = 0.0
    """0: never."""
    uplink: UplinkSection | None = None
    log_dir: Annotated[str, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _within_band(self) -> Self:
        if not self.limits.height_min_m <= self.height_m <= self.limits.height_max_m:
            raise ValueError(
                f"height_m: {self.height_m:g}; allowed: limits.height_min_m {self.limits.height_min_m:g} "
                f"to limits.height_max_m {self.limits.height_max_m:g}"
            )
        return self


def packaged_configs() -> tuple[str, ...]:
    """Return the names of the configurations that ship with the project."""
    folder = resources.files("companion.onboard") / "configs"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def load_config(name_or_path: str) -> Config:
    """Load a configuration for flying: one whose links are given.

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
    config = parse_config(text, name_or_path)
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
            wind_m_s=mission.wind.speed_m_s + mission.wind.gust_m_s,
            height_min_m=min(LimitsSection().height_min_m, height_m),
            height_max_m=max(LimitsSection().height_max_m, height_m),
        ),
        height_m=height_m,
        case=mission.case,
        # Half-way between two layers: whoever is on his own is not mistaken for a neighbour's.
        vertical_separation_m=0.5 * mission.layer_spacing_m,
        law=law,
        # The paper's laws are flown to see what they do: the guard shall not make up for them outside R_a.
        keep_out="detection" if law == "routed" else "attack",
        surrogate=mission.surrogate,
        weights=mission.weights,
        separation_m=mission.separation_m,
        arrival_radius_m=mission.arrival_radius_m,
        guidance_step_s=mission.guidance_step_s,
        range_policy=mission.range_policy,
        peer_memory_s=mission.lost_after_s,
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
