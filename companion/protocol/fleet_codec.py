"""Codec of the packed data in ONEWAY_FLEET and ONEWAY_RADII: sections of records with consecutive ids.

MAVLink sends an array in full, so that few entries would cost as much as many. Here only the bytes in use are sent:
five for an agent with its position and target, about one more for a directive of its own. Ages, radii and speeds are
rounded up, so that a receiver's disc of a threat always contains the true one; bytes that make no sense raise WireError
and nothing else.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Generic, TypeVar

from companion.files.mavlink_layout import OVERHEAD_BYTES
from companion.protocol.dialect import oneway
from companion.protocol.fields import (
    INT16_MAX,
    UINT8_MAX,
    UINT16_MAX,
    band_limits,
    band_of,
    bound_code,
    bound_of,
    ceiling_units,
    rounded,
    whole,
)
from companion.protocol.messages import AgentEntry, Directive, Grid, RadiiEntry, TargetEntry, ThreatPlace, WireError

PAYLOAD_BYTES = 255
"""Greatest length of a MAVLink 2 payload."""
FLEET_HEAD_BYTES = 23
"""Bytes of ONEWAY_FLEET's payload before its data."""
RADII_HEAD_BYTES = 18
"""Bytes of ONEWAY_RADII's payload before its data."""
MISSION_HEAD_BYTES = 52
"""Bytes of ONEWAY_MISSION's payload before its data."""
BASE_STEP_UNITS = 256
"""Unit of the base from which positions count: a 16-bit multiple of this number of position units."""
FINE_AGES = 10
"""Greatest age code that counts tenths of a second."""
AGE_RATIO = 1.065
"""Ratio of the ages of two successive codes above FINE_AGES; the last code means 58 days."""
GREATEST_AGE_S = AGE_RATIO ** (UINT8_MAX - FINE_AGES)

_SECTION_HEAD = struct.Struct("<BBH")
"""Head of a section: its kind, the number of its records and its first id."""
_TARGET_BASE = struct.Struct("<H")
"""Least target id in a section of agents, which ends the section's head."""
_GREATEST_OFFSET = UINT16_MAX - 1
"""Greatest offset of a position from the grid's base; 65535 on both axes marks an id that no agent has."""
_SPAN_UNITS = _GREATEST_OFFSET - (BASE_STEP_UNITS - 1)
"""Greatest span of a grid's positions: its base may lie up to one BASE_STEP_UNITS below its least position."""
_NOBODY = (UINT16_MAX, UINT16_MAX, 0)
"""Record of an id that no agent has, among agents with a position."""
_NOBODY_UNPLACED = (UINT8_MAX,)
"""Record of an id that no agent has, among agents without a position."""
_NO_DIRECTIVE = (0,)
"""Record of an id that no agent has, or whose agent has no directive of its own."""
_GREATEST_TARGET_CODE = UINT8_MAX - 1
"""Greatest code of an agent's target: 1 + the target's id - the section's least target id; 0 means no target."""


class Section(IntEnum):
    """The kind of records in a section (ONEWAY_SECTION)."""

    AGENTS = oneway.ONEWAY_SECTION_AGENTS
    AGENTS_UNPLACED = oneway.ONEWAY_SECTION_AGENTS_UNPLACED
    TARGETS = oneway.ONEWAY_SECTION_TARGETS
    THREATS = oneway.ONEWAY_SECTION_THREATS
    RADII = oneway.ONEWAY_SECTION_RADII
    RADII_BANDS = oneway.ONEWAY_SECTION_RADII_BANDS
    DIRECTIVES = oneway.ONEWAY_SECTION_DIRECTIVES


FleetEntry = AgentEntry | TargetEntry | ThreatPlace
Entry = FleetEntry | RadiiEntry
EntryT = TypeVar("EntryT", bound=Entry)
Record = tuple[int, ...]

_RECORDS = {
    Section.AGENTS: struct.Struct("<HHB"),
    Section.AGENTS_UNPLACED: struct.Struct("<B"),
    Section.TARGETS: struct.Struct("<HH"),
    Section.THREATS: struct.Struct("<HHB"),
    Section.RADII: struct.Struct("<HHB"),
    Section.RADII_BANDS: struct.Struct("<HHBhh"),
    Section.DIRECTIVES: struct.Struct("<B"),
}
_ABSENT: dict[Section, Record] = {
    Section.AGENTS: _NOBODY,
    Section.AGENTS_UNPLACED: _NOBODY_UNPLACED,
    Section.DIRECTIVES: _NO_DIRECTIVE,
}
"""Record of an id that is left out, by the kinds of sections in which one may be."""
_WITH_TARGETS = (Section.AGENTS, Section.AGENTS_UNPLACED)
"""The kinds of sections that have a least target id in their head."""


def data_bytes(head_bytes: int, max_frame_bytes: int, overhead_bytes: int) -> int:
    """Return the number of bytes of data that a message may hold on a link with frames of at most `max_frame_bytes`.

    `head_bytes` is the number of payload bytes before the data, `overhead_bytes` of those that signatures add.
    """
    return min(PAYLOAD_BYTES, max_frame_bytes - OVERHEAD_BYTES - overhead_bytes) - head_bytes


def age_code(age_s: float) -> int:
    """Return the least code that means at least a given age.

    Raises:
        WireError: the age is negative, not a number or beyond GREATEST_AGE_S.

    """
    if not 0.0 <= age_s <= GREATEST_AGE_S:
        raise WireError(f"an age of {age_s} s does not fit its field; allowed: 0 to {GREATEST_AGE_S:.0f}")
    if age_s <= FINE_AGES / 10.0:
        code = math.ceil(age_s * 10.0)
    else:
        code = FINE_AGES + math.ceil(math.log(age_s) / math.log(AGE_RATIO))
    # Floating-point error may have made the code one too high or too low.
    if age_of(code) < age_s:
        return code + 1
    return code - 1 if code > 0 and age_of(code - 1) >= age_s else code


def age_of(code: int) -> float:
    """Return the age in seconds that a code means."""
    return code / 10.0 if code <= FINE_AGES else AGE_RATIO ** (code - FINE_AGES)


def finest_grid(points: Sequence[tuple[float, float]]) -> Grid:
    """Return the finest grid that holds some positions (north, east, in m), at least one.

    Raises:
        WireError: the positions are too far apart, too far from the origin, or not finite.

    """
    needed_cm = 1.0
    for along_m in zip(*points, strict=True):
        low_m, high_m = min(along_m), max(along_m)
        if not (math.isfinite(low_m) and math.isfinite(high_m) and math.isfinite(sum(along_m))):
            raise WireError("a position is not finite")
        # Rounding may lengthen a span, and move a position beyond a base, by one unit.
        span_cm = 100.0 * (high_m - low_m) / (_SPAN_UNITS - 1)
        reach_cm = 100.0 * max(abs(low_m), abs(high_m)) / (BASE_STEP_UNITS * (INT16_MAX - 1))
        needed_cm = max(needed_cm, span_cm, reach_cm)
    if needed_cm > UINT16_MAX:
        raise WireError("positions so far apart, or so far from the origin, do not fit a grid")
    resolution_cm = math.ceil(needed_cm)
    north_base, east_base = (
        rounded(100.0 * min(along_m) / resolution_cm) // BASE_STEP_UNITS for along_m in zip(*points, strict=True)
    )
    return Grid(resolution_cm, north_base, east_base)


@dataclass
class _Group(Generic[EntryT]):
    """Entries of one section by rising id, and the least and greatest id of the targets assigned to them."""

    kind: Section
    entries: list[EntryT] = field(default_factory=list)
    target_base: int | None = None
    target_top: int = 0

    def target_code(self, target_id: int | None) -> int:
        return 0 if target_id is None or self.target_base is None else 1 + target_id - self.target_base


class Layout(Generic[EntryT]):
    """Distributes entries over sections one by one, in the order given, and counts the bytes of data.

    An agent with a directive of its own is in two: the second says which.
    """

    def __init__(self) -> None:
        self.size = 0
        self.groups: list[_Group[EntryT]] = []
        self.directives: list[_Group[EntryT]] = []

    @property
    def sections(self) -> list[list[EntryT]]:
        """The entries of each section."""
        return [group.entries for group in self.groups]

    def cost(self, entry: EntryT) -> int:
        """Return the number of bytes by which an entry would make the data longer."""
        return sum(_bytes_in(entry, kind, _joinable(groups, entry, kind)) for groups, kind in self._places(entry))

    def add(self, entry: EntryT) -> None:
        """Add an entry to the last section, or to a new one if it cannot join or a new one takes fewer bytes."""
        for groups, kind in self._places(entry):
            group = _joinable(groups, entry, kind)
            self.size += _bytes_in(entry, kind, group)
            if group is None:
                group = _Group[EntryT](kind)
                groups.append(group)
            group.entries.append(entry)
            target_id = _target_id(entry)
            if target_id is not None:
                group.target_base = target_id if group.target_base is None else min(group.target_base, target_id)
                group.target_top = max(group.target_top, target_id)

    def _places(self, entry: EntryT) -> Iterator[tuple[list[_Group[EntryT]], Section]]:
        """Yield the rows of sections that an entry belongs into, each with the kind that its section has."""
        yield self.groups, _kind_of(entry)
        if _own_directive(entry) is not Directive.NORMAL:
            yield self.directives, Section.DIRECTIVES


def _joinable(groups: Sequence[_Group[EntryT]], entry: EntryT, kind: Section) -> _Group[EntryT] | None:
    """Return the last section if the entry can join it and that takes no more bytes than a new section."""
    if not groups or groups[-1].kind is not kind:
        return None
    group = groups[-1]
    gap = entry.id - group.entries[-1].id - 1
    if gap < 0 or (gap > 0 and kind not in _ABSENT) or gap * _RECORDS[kind].size > _head_bytes(kind):
        return None
    target_id = _target_id(entry)
    if kind in _WITH_TARGETS and target_id is not None and group.target_base is not None:
        base, top = min(group.target_base, target_id), max(group.target_top, target_id)
        if top - base >= _GREATEST_TARGET_CODE:
            return None
    return group


def _bytes_in(entry: EntryT, kind: Section, group: _Group[EntryT] | None) -> int:
    """Return the number of bytes that an entry takes in the section that it joins, or in a new one (None)."""
    if group is None:
        return _head_bytes(kind) + _RECORDS[kind].size
    return (entry.id - group.entries[-1].id) * _RECORDS[kind].size


def write_fleet(entries: Sequence[FleetEntry], grid: Grid) -> bytes:
    """Return the data of a fleet frame.

    Raises:
        WireError: a position is off the grid, an id or age does not fit, an id is given twice, or one frame cannot hold
            all entries.

    """
    _refuse_bad_resolution(grid.resolution_cm)
    if not -INT16_MAX <= min(grid[1:]) <= max(grid[1:]) <= INT16_MAX:
        raise WireError(f"a base of {grid.north_base}, {grid.east_base} does not fit its fields")

    def record(entry: FleetEntry, group: _Group[FleetEntry]) -> Record:
        if group.kind is Section.DIRECTIVES:
            return (_own_directive(entry),)
        code = group.target_code(entry.target_id) if isinstance(entry, AgentEntry) else 0
        place = _units(entry, grid.resolution_cm)
        if place is None:
            return (code,)
        offsets = (place[0] - BASE_STEP_UNITS * grid.north_base, place[1] - BASE_STEP_UNITS * grid.east_base)
        if not 0 <= min(offsets) <= max(offsets) <= _GREATEST_OFFSET:
            raise WireError(f"a position is off the grid of {grid.resolution_cm} cm")
        if isinstance(entry, AgentEntry):
            return (*offsets, code)
        return (*offsets, age_code(entry.age_s)) if isinstance(entry, ThreatPlace) else offsets

    return _written(entries, record, PAYLOAD_BYTES - FLEET_HEAD_BYTES)


def write_radii(entries: Sequence[RadiiEntry], resolution_cm: int) -> bytes:
    """Return the data of a radii frame.

    Raises:
        WireError: a radius, speed, height or id does not fit, an id is given twice, or one frame cannot hold all
            entries.

    """
    for entry in entries:
        if not 0.0 < entry.attack_radius_m <= entry.detection_radius_m < math.inf:
            raise WireError("a threat's radii are not in order; allowed: 0 < attack radius <= detection radius")
    _refuse_bad_resolution(resolution_cm)

    def record(entry: RadiiEntry, group: _Group[RadiiEntry]) -> Record:
        radii = (
            ceiling_units(100.0 * radius_m, resolution_cm, UINT16_MAX, "radius")
            for radius_m in (entry.detection_radius_m, entry.attack_radius_m)
        )
        speed = bound_code(entry.speed_bound_m_s)
        band = band_limits(entry.floor_m, entry.ceiling_m, entry.id) if group.kind is Section.RADII_BANDS else ()
        return (*radii, speed, *band)

    return _written(entries, record, PAYLOAD_BYTES - RADII_HEAD_BYTES)


def finest_radii_cm(radius_m: float) -> int:
    """Return the finest unit, in whole cm, in which a radius can be sent in a radii frame.

    Raises:
        WireError: the radius is too great, or not finite.

    """
    return max(1, ceiling_units(100.0 * radius_m, UINT16_MAX, UINT16_MAX, "resolution"))


def read_fleet(
    data: bytes, grid: Grid
) -> tuple[tuple[AgentEntry, ...], tuple[TargetEntry, ...], tuple[ThreatPlace, ...]]:
    """Return the agents, targets and threats in the data of a fleet frame.

    Raises:
        WireError: the data make no sense.

    """
    if grid.resolution_cm < 1:
        raise WireError("resolution is zero")
    agents: list[AgentEntry] = []
    targets: list[TargetEntry] = []
    threats: list[ThreatPlace] = []
    directives: list[tuple[int, Directive]] = []

    def place_m(north: int, east: int) -> tuple[float, float]:
        north_m = (BASE_STEP_UNITS * grid.north_base + north) * grid.resolution_cm / 100.0
        return north_m, (BASE_STEP_UNITS * grid.east_base + east) * grid.resolution_cm / 100.0

    for kind, target_base, records in _sections(data):
        for identity, record in records:
            if kind is Section.AGENTS:
                agents.append(AgentEntry(identity, *place_m(*record[:2]), _target_of(record[2], target_base)))
            elif kind is Section.AGENTS_UNPLACED:
                agents.append(AgentEntry(identity, None, None, _target_of(record[0], target_base)))
            elif kind is Section.TARGETS:
                targets.append(TargetEntry(identity, *place_m(*record)))
            elif kind is Section.THREATS:
                threats.append(ThreatPlace(identity, *place_m(*record[:2]), age_of(record[2])))
            elif kind is Section.DIRECTIVES:
                directives.append((identity, directive_of(record[0])))
            else:
                raise WireError("section out of place")
    for entries in (agents, targets, threats):
        _refuse_twice(entries)
    return _directed(agents, directives), tuple(targets), tuple(threats)


def _directed(agents: Sequence[AgentEntry], directives: Sequence[tuple[int, Directive]]) -> tuple[AgentEntry, ...]:
    """Return the agents, each with its own directive if it has one."""
    by_id = dict(directives)
    if len(by_id) != len(directives):
        raise WireError("an id is given twice")
    if not by_id.keys() <= {agent.id for agent in agents}:
        raise WireError("directive of an agent that is not there")
    return tuple(replace(agent, directive=by_id[agent.id]) if agent.id in by_id else agent for agent in agents)


def directive_of(value: int) -> Directive:
    """Return the directive that a field's value means.

    Raises:
        WireError: there is none of that value.

    """
    if value not in _DIRECTIVES:
        raise WireError("unknown directive")
    return _DIRECTIVES[value]


def read_radii(data: bytes, resolution_cm: int) -> tuple[RadiiEntry, ...]:
    """Return the threats in the data of a radii frame.

    Raises:
        WireError: the data make no sense.

    """
    if resolution_cm < 1:
        raise WireError("resolution is zero")
    entries = []
    for kind, _, records in _sections(data):
        for identity, record in records:
            if kind not in (Section.RADII, Section.RADII_BANDS):
                raise WireError("section out of place")
            detection_m, attack_m = record[0] * resolution_cm / 100.0, record[1] * resolution_cm / 100.0
            if not 0 < attack_m <= detection_m:
                raise WireError("radii out of range")
            band = band_of(*record[3:]) if kind is Section.RADII_BANDS else None
            limits = (None, None) if band is None else (band.floor_m, band.ceiling_m)
            entries.append(RadiiEntry(identity, detection_m, attack_m, bound_of(record[2]), *limits))
    _refuse_twice(entries)
    return tuple(entries)


def _sections(data: bytes) -> Iterator[tuple[Section, int, list[tuple[int, Record]]]]:
    """Yield kind, least target id and (id, record) pairs of each section, without records of ids that no agent has."""
    at = 0
    while at < len(data):
        if at + _SECTION_HEAD.size > len(data):
            raise WireError("section cut short")
        number, count, first_id = _SECTION_HEAD.unpack_from(data, at)
        if number not in _KINDS:
            raise WireError("unknown section")
        kind = _KINDS[number]
        start, layout = at + _head_bytes(kind), _RECORDS[kind]
        at = start + count * layout.size
        if at > len(data):
            raise WireError("section cut short")
        if count == 0 or first_id + count - 1 > UINT16_MAX:
            raise WireError("ids out of range")
        (target_base,) = _TARGET_BASE.unpack_from(data, start - _TARGET_BASE.size) if kind in _WITH_TARGETS else (0,)
        records = enumerate(layout.iter_unpack(data[start:at]), first_id)
        nobody = _ABSENT.get(kind)
        yield kind, target_base, [(identity, record) for identity, record in records if record != nobody]


def _written(
    entries: Sequence[EntryT], record: Callable[[EntryT, _Group[EntryT]], Record], greatest_bytes: int
) -> bytes:
    for kinds in ((AgentEntry,), (TargetEntry,), (ThreatPlace,), (RadiiEntry,)):
        _refuse_twice([entry for entry in entries if isinstance(entry, kinds)])
    layout = Layout[EntryT]()
    for entry in entries:
        whole(entry.id, UINT16_MAX, "id")
        whole(_target_id(entry) or 0, UINT16_MAX, "target id")
        layout.add(entry)
    if layout.size > greatest_bytes:
        raise WireError(f"{layout.size} bytes of entries; a frame holds {greatest_bytes}")
    data = bytearray()
    for group in (*layout.groups, *layout.directives):
        layout_of_one, absent = _RECORDS[group.kind], _ABSENT.get(group.kind)
        next_id = group.entries[0].id
        data += _SECTION_HEAD.pack(group.kind, group.entries[-1].id - next_id + 1, next_id)
        if group.kind in _WITH_TARGETS:
            data += _TARGET_BASE.pack(group.target_base or 0)
        for entry in group.entries:
            if absent is not None:
                data += layout_of_one.pack(*absent) * (entry.id - next_id)
            data += layout_of_one.pack(*record(entry, group))
            next_id = entry.id + 1
    return bytes(data)


_KINDS = {int(kind): kind for kind in Section}
_DIRECTIVES = {int(directive): directive for directive in Directive}


def _kind_of(entry: Entry) -> Section:
    if isinstance(entry, AgentEntry):
        return Section.AGENTS_UNPLACED if entry.position_ned_m is None else Section.AGENTS
    if isinstance(entry, TargetEntry):
        return Section.TARGETS
    if isinstance(entry, ThreatPlace):
        return Section.THREATS
    return Section.RADII if entry.floor_m is None and entry.ceiling_m is None else Section.RADII_BANDS


def _head_bytes(kind: Section) -> int:
    return _SECTION_HEAD.size + (_TARGET_BASE.size if kind in _WITH_TARGETS else 0)


def _own_directive(entry: Entry) -> Directive:
    return entry.directive if isinstance(entry, AgentEntry) else Directive.NORMAL


def _target_id(entry: Entry) -> int | None:
    return entry.target_id if isinstance(entry, AgentEntry) else None


def _target_of(code: int, target_base: int) -> int | None:
    if code == 0:
        return None
    target_id = target_base + code - 1
    if code > _GREATEST_TARGET_CODE or target_id > UINT16_MAX:
        raise WireError("assigned to a target that cannot be")
    return target_id


def _units(entry: FleetEntry, resolution_cm: int) -> tuple[int, int] | None:
    """Return north and east in units, None for an agent whose position is unknown."""
    if entry.north_m is None or entry.east_m is None:
        return None
    return rounded(100.0 * entry.north_m / resolution_cm), rounded(100.0 * entry.east_m / resolution_cm)


def _refuse_bad_resolution(resolution_cm: int) -> None:
    if not 1 <= resolution_cm <= UINT16_MAX:
        raise WireError(f"a resolution of {resolution_cm} cm does not fit its field; allowed: 1 to {UINT16_MAX}")


def _refuse_twice(entries: Sequence[Entry]) -> None:
    if len({entry.id for entry in entries}) != len(entries):
        raise WireError("an id is given twice")
