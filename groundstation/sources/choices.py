"""The sources of a run: the mission's section and `--source` on the command line, checked together."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from companion.errors import InputError, nearest_hint
from companion.files.yaml import is_there, parse_yaml, validated
from companion.mission.model import Mission
from companion.mission.sources import FILED, MAX_SOURCES, SourceKind, SourceSpec
from companion.transport.link import SCHEMES, Link, parse_link
from groundstation.sources.playback import MOST_LINE_BYTES, open_recording
from groundstation.sources.recording import header_fault

FORM = "KIND=URL-OR-FILE[,KEY=VALUE...]"
KINDS = get_args(SourceKind)


def source_specs(mission: Mission, typed: Sequence[str], source: str, unsigned: bool) -> tuple[SourceSpec, ...]:
    """Return the sources of a run; `source` names the mission, and `unsigned` is whether anybody is believed.

    Raises:
        InputError: a source cannot be used, or two contradict each other.

    """
    specs = list(mission.sources)
    for index, spec in enumerate(specs):
        _check(spec, mission, f"{source}: sources[{index}]", unsigned)
    for text in typed:
        spec = _typed(text, {one.name for one in specs})
        _check(spec, mission, f"--source: '{text}'", unsigned)
        specs.append(spec)
    if len(specs) > MAX_SOURCES:
        raise InputError(f"--source: {len(specs)} sources; allowed: at most {MAX_SOURCES}")
    sensors = [spec.name for spec in specs if spec.kind == "sensor"]
    if len(sensors) > 1:
        raise InputError(
            f"sources: {' and '.join(sensors)} are of the kind sensor; allowed: one, which any sensors share"
        )
    return tuple(specs)


def _typed(text: str, taken: set[str]) -> SourceSpec:
    """Return the source in a text such as `basestation=tcp:127.0.0.1:30003,radius_m=800`."""
    first, *rest = text.split(",")
    kind, equals, place = first.partition("=")
    if not equals or kind not in KINDS:
        hint = "" if kind in KINDS else nearest_hint(kind, KINDS)
        raise InputError(f"--source: '{text}'{hint}; allowed: {FORM} with the kind {', '.join(KINDS)}")
    is_file = kind in FILED and not _is_url(place)
    given: dict[str, object] = {"name": _free_name(kind, taken), "kind": kind, "file" if is_file else "url": place}
    typed: set[str] = set()
    for part in rest:
        key, equals, value = part.partition("=")
        if not equals:
            raise InputError(f"--source: '{text}': '{part}' is no KEY=VALUE; allowed: {FORM}")
        if key in typed:
            raise InputError(f"--source: '{text}': {key} is given twice; allowed: each key once")
        typed.add(key)
        parsed = parse_yaml(f"value: {value}", f"--source: '{text}'")
        assert isinstance(parsed, dict)
        given[key] = parsed["value"]
    return validated(SourceSpec, given, f"--source: '{text}'")


def _is_url(place: str) -> bool:
    return place.partition(":")[0] in SCHEMES and not place.startswith("/")


def _free_name(kind: str, taken: set[str]) -> str:
    number = 1
    while (name := kind if number == 1 else f"{kind}-{number}") in taken:
        number += 1
    return name


def _check(spec: SourceSpec, mission: Mission, where: str, unsigned: bool) -> None:
    """Raise InputError, whose words begin with `where`, if a source cannot be heard or should not be believed."""
    if spec.file is not None:
        if not is_there(Path(spec.file)):
            raise InputError(f"{where}: file: '{spec.file}' is not there; allowed: a recording")
        if Path(spec.file).is_dir():
            raise InputError(f"{where}: file: '{spec.file}' is a folder; allowed: a recording")
        if spec.kind == "csv":
            _check_columns(spec.file, where)
    elif spec.url is not None:
        link = parse_link(spec.url)
        if link.scheme == "file" and spec.kind in FILED:
            raise InputError(
                f"{where}: url: '{link}' is a telemetry log; allowed: file: for a recording of {spec.kind}"
            )
        if spec.kind != "sensor" and hears_others(link) and not (spec.unsigned or unsigned):
            raise InputError(
                f"{where}: url: '{link}' hears others than this computer, and nothing is signed there; allowed: "
                "udpin:127.0.0.1:PORT, or unsigned: true to believe anybody"
            )
    if spec.things == "agents":
        known = {agent.id for agent in mission.agents}
        for key, identity in spec.ids.items():
            if identity not in known:
                raise InputError(f"{where}: ids: '{key}': {identity}; allowed: the id of an agent of the mission")


def _check_columns(name: str, where: str) -> None:
    """Raise InputError if a CSV has a header in which what every sighting needs is missing; an empty one may grow."""
    if not Path(name).is_file():
        return  # A pipe must not be waited for.
    try:
        with open_recording(name) as file:
            line = file.readline(MOST_LINE_BYTES)
        fault = header_fault(line) if line.strip() else None
    except (OSError, EOFError, InputError, zlib.error):
        return  # What cannot be read becomes the source's health, as it may be there later.
    if fault is not None:
        raise InputError(f"{where}: file: '{name}': {fault}")


def hears_others(link: Link) -> bool:
    """Return whether programs of other computers can send on a link that is listened on."""
    return link.scheme in ("udpin", "udpbcast", "mcast") and not link.is_loopback
