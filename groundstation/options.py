"""Arguments of `groundstation run`: which may be given together, and the options that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypedDict

from companion.autopilot.kinds import KINDS
from companion.autopilot.missions import load_mission_to_fly
from companion.errors import InputError
from companion.mission.model import Mission
from companion.mission.resolve import resolve
from companion.mission.sources import SourceSpec
from companion.transport.endpoints import Link, parse_link
from companion.transport.link import RECEIVING
from groundstation.choices import SIGNED, STATE_NAME, Authentication, one_of, without_null
from groundstation.ground_station import check_runnable
from groundstation.plausibility import SENSOR_ERROR_M
from groundstation.radio import Radio, parse_radio
from groundstation.sources.choices import source_specs
from groundstation.web.address import parse_address
from groundstation.web.site import LogFormat, Site, check_site

_MOST_ERROR_M = 10_000.0
"""Greatest error of a detection that may be given."""
_LOCAL_FORM = "udpin:127.0.0.1:PORT"


class RunArguments(TypedDict):
    """Arguments of the command line as they were typed; None for one that was left out."""

    mission: str
    link: str
    keys: str | None
    unsigned: bool
    auth: str | None
    radio: str | None
    share: float | None
    state: str | None
    log: str | None
    log_mb: float
    store_mb: float
    new_flight: bool
    mirror: str | None
    sensor: str | None
    uplink: str | None
    listen: str | None
    sensor_error: float
    unsigned_inputs: bool
    autopilot: str
    seed: int
    ui: str | None
    ui_tokens: str | None
    ui_cert: str | None
    ui_key: str | None
    ui_client_ca: str | None
    ui_tiles: str | None
    log_format: str
    source: tuple[str, ...]


@dataclass(frozen=True)
class Options:
    """Options of a run, checked and parsed."""

    link: Link
    authentication: Authentication
    keys: Path | None = None
    radio: Radio | None = None
    sensor: Link | None = None
    uplink: Link | None = None
    mirror: Link | None = None
    log: Path | None = None
    log_mb: float = 1_000.0
    """Greatest size of the logs of that name together, in millions of bytes."""
    state: Path | None = None
    store_mb: float = 1_000.0
    """Greatest size of the pictures and frames in the store, in millions of bytes."""
    new_flight: bool = False
    """Whether nothing of the last run is carried over but what vehicles need to believe this one."""
    can_stop: bool = False
    """Case II: whether the dead-reckoned agents can stand still."""
    listen: Link | None = None
    """Link on which the broadcast itself is heard, to notice another ground station; None: where it goes, if it can be
    heard there."""
    unsigned_inputs: bool = False
    """Whether sensors and vehicles on other computers are believed though they sign nothing."""
    sensor_error_m: float = SENSOR_ERROR_M
    """Greatest error of a detection."""
    sources: tuple[SourceSpec, ...] = ()
    """Live sources, of the mission and the command line."""
    site: Site | None = None
    """Where and how the page is served; None without one."""
    log_format: LogFormat = "text"
    """Form of the messages on the terminal."""

    @property
    def listened(self) -> Link | None:
        """Link on which the broadcast is heard; None where it goes one way only."""
        if self.listen is not None:
            return self.listen
        return self.link if self.link.scheme in ("mcast", "udpbcast") else None

    def believes_unsigned(self, link: Link | None) -> bool:
        """Return whether unsigned frames on an input are believed: by its word, or if only this computer is heard."""
        return self.unsigned_inputs or link is None or _is_local(link)


def run_of(given: RunArguments) -> tuple[Mission, Options]:
    """Return the resolved mission and the options of a run.

    Raises:
        InputError: an argument or the mission cannot be used, or arguments contradict each other.

    """
    one_of("--autopilot", given["autopilot"], tuple(KINDS))
    without_null({"MISSION": given["mission"], "--link": given["link"], "--keys": given["keys"]})
    without_null({"--state": given["state"], "--log": given["log"], "--mirror": given["mirror"]})
    without_null({"--sensor": given["sensor"], "--uplink": given["uplink"], "--listen": given["listen"]})
    mission = _mission_to_broadcast(given["mission"], given["seed"], given["uplink"])
    specs = source_specs(mission, given["source"], given["mission"], given["unsigned_inputs"])
    return mission, _options(given, specs)


def _mission_to_broadcast(name: str, seed: int, uplink: str | None) -> Mission:
    resolved = resolve(load_mission_to_fly(name), seed, name)
    check_runnable(resolved, name)
    if resolved.case == "I" and uplink is not None:
        raise InputError(f"{name}: case: 'I' with --uplink; allowed: II, Case I has no use for reports")
    if resolved.case == "II" and resolved.report_period_s > 0.0 and uplink is None:
        raise InputError(
            f"{name}: report_period_s: {resolved.report_period_s:g} without --uplink, so that everybody would count "
            "as lost; allowed: --uplink URL, or report_period_s 0"
        )
    refuse_monolithic(resolved, name)
    return resolved


def refuse_monolithic(mission: Mission, source: str) -> None:
    """Raise InputError if a mission has the surrogate that no vehicle flies by; `source` names it."""
    if mission.surrogate == "monolithic":
        raise InputError(f"{source}: surrogate: 'monolithic' flies only in the simulator; allowed: pairwise, analytic")


def _sensor(given: RunArguments, specs: Sequence[SourceSpec]) -> Link | None:
    """Return the sensors' link, of the command line or a source of that kind."""
    urls = [spec.url for spec in specs if spec.kind == "sensor"]
    if urls and given["sensor"] is not None:
        raise InputError(f"--sensor: '{given['sensor']}' beside a source of the kind sensor; allowed: one of them")
    return _link(urls[0] if urls else given["sensor"])


def _options(given: RunArguments, specs: tuple[SourceSpec, ...]) -> Options:
    link = parse_link(given["link"])
    sensor, uplink, mirror = (_sensor(given, specs), _link(given["uplink"]), _link(given["mirror"]))
    if mirror is not None and mirror == link:
        raise InputError(f"--mirror: '{given['mirror']}' is the broadcast's own link; allowed: another port")
    log, keys, state = given["log"], given["keys"], given["state"]
    error_m = given["sensor_error"]
    if not 0.0 < error_m <= _MOST_ERROR_M:
        raise InputError(f"--sensor-error: {error_m:g}; allowed: above 0, at most {_MOST_ERROR_M:g} m")
    if log is not None and not log.endswith(".tlog"):
        raise InputError(f"--log: '{log}'; allowed: a name that ends in .tlog")
    if state is None and keys is not None:
        state = str(Path(keys) / STATE_NAME)
    options = Options(
        link=link,
        authentication=authentication_of(keys, given["unsigned"], given["auth"]),
        keys=_path(keys),
        radio=_radio(link, given["radio"], given["share"]),
        sensor=sensor,
        uplink=uplink,
        mirror=mirror,
        log=_path(log),
        log_mb=given["log_mb"],
        state=_path(state),
        store_mb=given["store_mb"],
        new_flight=given["new_flight"],
        can_stop=KINDS[given["autopilot"]].can_stop,
        listen=_link(given["listen"]),
        unsigned_inputs=given["unsigned_inputs"],
        sensor_error_m=error_m,
        sources=specs,
        site=_site(given),
        log_format="json" if given["log_format"] == "json" else "text",
    )
    for option, heard in (("--sensor", sensor), ("--uplink", uplink)):
        if heard is None or heard.scheme not in RECEIVING:
            continue  # One that cannot be listened on is refused where it is opened.
        if keys is None and not options.believes_unsigned(heard):
            raise InputError(
                f"{option}: '{heard}' hears others than this computer, and no key tells whom to believe; allowed: "
                f"--keys DIR, {_LOCAL_FORM}, or --unsigned-inputs to believe anybody"
            )
    return options


def _site(given: RunArguments) -> Site | None:
    """Return where and how the page is served; raises InputError unless it is guarded as its address demands."""
    guards = {
        "--ui-tokens": given["ui_tokens"],
        "--ui-cert": given["ui_cert"],
        "--ui-key": given["ui_key"],
        "--ui-client-ca": given["ui_client_ca"],
        "--ui-tiles": given["ui_tiles"],
    }
    if given["ui"] is None:
        for option, value in guards.items():
            if value is not None:
                raise InputError(f"{option}: '{value}' without --ui; allowed: with --ui")
        return None
    without_null(guards)
    tokens, certificate, key, client_ca, tiles = map(_path, guards.values())
    site = Site(
        parse_address(given["ui"]),
        tokens=tokens,
        certificate=certificate,
        key=key,
        client_ca=client_ca,
        tiles=tiles,
        log_format="json" if given["log_format"] == "json" else "text",
    )
    check_site(site)
    return site


def _is_local(link: Link) -> bool:
    """Return whether only programs of this computer can send on a link that is listened on."""
    return link.scheme == "file" or link.is_loopback


def _link(url: str | None) -> Link | None:
    return None if url is None else parse_link(url)


def _path(name: str | None) -> Path | None:
    return None if name is None else Path(name)


def authentication_of(keys: str | None, unsigned: bool, auth: str | None) -> Authentication:
    """Return how frames are signed, by the options --keys, --unsigned and --auth.

    Raises:
        InputError: they contradict each other, or neither of the first two is given.

    """
    if keys is not None and unsigned:
        raise InputError("--unsigned: given together with --keys; allowed: one of them")
    if keys is None and not unsigned:
        raise InputError(
            "neither --keys nor --unsigned given; allowed: --keys DIR to sign, or --unsigned to sign nothing"
        )
    if unsigned:
        if auth is not None:
            raise InputError(f"--auth: '{auth}' with --unsigned; allowed: only with --keys")
        return "unsigned"
    return one_of("--auth", auth or "both", SIGNED)


def _radio(link: Link, name: str | None, share: float | None) -> Radio | None:
    if name is None:
        if share is not None:
            raise InputError(f"--share: {share:g} without --radio; allowed: --radio NAME with it")
        if link.scheme == "serial":
            raise InputError(f"--link: '{link}' without --radio, so that nothing would pace it; allowed: --radio NAME")
        return None
    if link.others:
        raise InputError(
            f"--link: '{link}' sends every frame {1 + len(link.others)} times, which --radio {name} does not count; "
            "allowed: one address behind a radio"
        )
    radio = parse_radio(name, 1.0 if share is None else share)
    # Any radio on a serial line may wait for a heartbeat before it reports its buffer.
    return replace(radio, heartbeats=True) if link.scheme == "serial" and not radio.wrapped else radio
