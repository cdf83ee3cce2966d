"""Packed frames: as small as promised, within half a unit, never optimistic about a threat, and deaf to nonsense."""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import companion
from companion.protocol.codec import (
    AgentEntry,
    DecisionFlag,
    DecisionFrame,
    Directive,
    FleetFrame,
    Frame,
    FrameReader,
    FrameWriter,
    Grid,
    MissionFrame,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    TargetEntry,
    ThreatPlace,
    WireError,
    decode_frame,
)
from companion.protocol.dialect import oneway
from companion.protocol.fleet_codec import (
    AGE_RATIO,
    FINE_AGES,
    FLEET_HEAD_BYTES,
    GREATEST_AGE_S,
    MISSION_HEAD_BYTES,
    RADII_HEAD_BYTES,
    Layout,
    Section,
    age_code,
    age_of,
    data_bytes,
    finest_grid,
    finest_radii_cm,
    read_fleet,
    read_radii,
)
from companion.protocol.frame import raw_frame

STAMP = Stamp(epoch_s=1_790_000_000, time_ms=12_345, sequence=7, frame_index=1, frame_count=2)
SMALL_FLEET = FleetFrame(
    stamp=STAMP,
    directive=Directive.HOLD,
    revision=0x34,
    grid=Grid(300, -1, -3),
    agents=(
        AgentEntry(300, 1_000.0, -2_000.0, 42),
        AgentEntry(302, 150_000.0, 120_000.0, None),
        AgentEntry(7, None, None, 43),
    ),
    targets=(TargetEntry(42, 3_000.0, 4_000.0), TargetEntry(43, -3.0, 3.0)),
    threats=(ThreatPlace(9, -500.0, 600.0, 3.0),),
)
SMALL_RADII = RadiiFrame(
    stamp=STAMP,
    revision=0x34,
    resolution_cm=16,
    threats=(RadiiEntry(9, 10_000.0, 5_000.0, 9.5), RadiiEntry(10, 800.0, 800.0, 0.0, -3.5, None)),
)
SMALL_MISSION = MissionFrame(
    stamp=replace(STAMP, frame_index=0, frame_count=1),
    revision=0x34,
    origin_lat_deg=47.1234567,
    origin_lon_deg=-8.7654321,
    origin_alt_m=-12.3,
    separation_m=100.0,
    arrival_radius_m=300.5,
    surrogate_digest=bytes(range(8)),
    agents=500,
    targets=50,
    threats=51,
    name="Übung",
    mission_digest=bytes(range(8, 16)),
)
SMALL_DECISION = DecisionFrame(
    time_us=1_790_000_012_345_678,
    purpose=1,
    stage=2,
    target_id=42,
    flags=DecisionFlag.TURN_LIMITED | DecisionFlag.OPPOSED,
    picture_age_s=0.5,
    wanted_heading_rad=math.nan,
    heading_rad=-1.25,
    speed_m_s=60.0,
    altitude_m=100.0,
    certified_s=2.5,
    words_crc=0x89ABCDEF,
)
GOLDEN: list[tuple[Frame, str]] = [
    (
        SMALL_FLEET,
        "fd48000000febe0501a0803bb16a3930000007000000fffffdff2c01340101023101032c012a004d02650001ffffffff0050"
        "c4409f00020107002b000103022a00e8043508ff000103040109005900c8031c2f9d",
    ),
    (
        SMALL_RADII,
        "fd28000000febe0601a0803bb16a39300000070000001000340102160501090024f4127a0a06010a008813881300fcffff7f8172",
    ),
    (
        SMALL_MISSION,
        "fd3a000000febe0701a0803bb16a39300000070000000778161c4f80c6fa85ffffffe803bd0bf40132003300340001020304"
        "05060708090a0b0c0d0e0f06c39c62756e6787d8",
    ),
    (
        SMALL_DECISION,
        "fd29000000febe0801a04e41e2dafe5b06000000003f0000c07f0000a0bf000070420000c84200002040efcdab892a000102414c0a",
    ),
]
GOLDEN_NAMES = ["fleet", "radii", "mission", "decision"]
SIDE_M = 200_000.0
FAR_M = 1.0e6

near_m = st.floats(-SIDE_M, SIDE_M)
ids_16 = st.integers(0, 65_535)
ages_s = st.floats(0.0, 1.0e6)


def through(frame: Frame) -> Frame:
    raw = FrameWriter().encode(frame)
    reader = FrameReader()
    (read,) = reader.read(raw)
    decoded = decode_frame(raw_frame(raw))
    assert repr(read) == repr(decoded)  # nan is not itself
    assert reader.rejected.total() == 0
    return decoded


def fleet_through(frame: FleetFrame) -> FleetFrame:
    decoded = through(frame)
    assert isinstance(decoded, FleetFrame)
    return decoded


def radii_through(frame: RadiiFrame) -> RadiiFrame:
    decoded = through(frame)
    assert isinstance(decoded, RadiiFrame)
    return decoded


def fleet_of(**parts: object) -> FleetFrame:
    bare: dict[str, object] = {"agents": (), "targets": (), "threats": (), "grid": Grid(1, 0, 0)}
    return replace(SMALL_FLEET, **{**bare, **parts})  # type: ignore[arg-type]


def fitted(frame: FleetFrame) -> FleetFrame:
    """Return the frame with the finest grid that holds its places."""
    entries: list[AgentEntry | TargetEntry | ThreatPlace] = [*frame.agents, *frame.targets, *frame.threats]
    points = [(e.north_m, e.east_m) for e in entries if e.north_m is not None and e.east_m is not None]
    return replace(frame, grid=finest_grid(points or [(0.0, 0.0)]))


@st.composite
def fleets(draw: st.DrawFn, reach_m: float = SIDE_M) -> FleetFrame:
    """Return a frame with ids anywhere, of all kinds, about a point anywhere."""
    coordinate = st.floats(-reach_m, reach_m)

    def ids(most: int) -> list[int]:
        return draw(st.lists(ids_16, max_size=most, unique=True))

    targets = [TargetEntry(k, draw(coordinate), draw(coordinate)) for k in ids(5)]
    placed = st.tuples(coordinate, coordinate) | st.just((None, None))
    goes_to = st.none() | ids_16
    return fitted(
        fleet_of(
            agents=tuple(
                AgentEntry(k, place[0], place[1], draw(goes_to), draw(st.sampled_from(Directive)))
                for k in ids(8)
                for place in [draw(placed)]
            ),
            targets=tuple(targets),
            threats=tuple(ThreatPlace(k, draw(coordinate), draw(coordinate), draw(ages_s)) for k in ids(5)),
        )
    )


# Bytes


@pytest.mark.parametrize(("frame", "expected"), GOLDEN, ids=GOLDEN_NAMES)
def test_the_bytes_of_a_frame_are_pinned(frame: Frame, expected: str) -> None:
    assert FrameWriter().encode(frame).hex() == expected


def test_the_pinned_fleet_frame_decodes_to_what_was_sent() -> None:
    decoded = decode_frame(raw_frame(bytes.fromhex(GOLDEN[0][1])))
    assert isinstance(decoded, FleetFrame)
    assert [(a.id, a.north_m, a.east_m, a.target_id) for a in decoded.agents] == [
        (300, 999.0, -2_001.0, 42),
        (302, 150_000.0, 120_000.0, None),
        (7, None, None, 43),
    ]
    assert decoded.targets == (TargetEntry(42, 3_000.0, 3_999.0), TargetEntry(43, -3.0, 3.0))
    (threat,) = decoded.threats
    assert (threat.id, threat.north_m, threat.east_m) == (9, -501.0, 600.0)
    assert 3.0 <= threat.age_s <= 3.0 * AGE_RATIO


def test_the_pinned_radii_frame_decodes_to_what_was_sent() -> None:
    assert decode_frame(raw_frame(bytes.fromhex(GOLDEN[1][1]))) == replace(
        SMALL_RADII,
        threats=(RadiiEntry(9, 10_000.0, 5_000.0, 10.0), RadiiEntry(10, 800.0, 800.0, 0.0, -4.0, None)),
    )


def test_the_fleet_frame_that_the_wire_page_works_through_is_what_it_says() -> None:
    text = (Path(companion.__file__).parents[1] / "docs" / "wire.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```\n((?:[0-9a-f]{2}[ \n])+)```", text)
    frame = FleetFrame(
        stamp=Stamp(1_767_225_600, 5_000, 2),
        directive=Directive.NORMAL,
        revision=1,
        grid=Grid(305, 1, 0),
        agents=(
            AgentEntry(1, 61_283.46, 40_000.0, 1),
            AgentEntry(2, 1_500.0, 190_000.0, 1),
            AgentEntry(4, 100_000.0, 3.0, None),
        ),
        targets=(TargetEntry(1, 150_000.0, 120_000.0),),
        threats=(ThreatPlace(1, 80_000.0, 75_000.0, 2.0),),
    )
    assert bytes.fromhex(blocks[1]) == FrameWriter().encode(frame)
    decoded = fleet_through(frame)
    assert decoded.agents[0].north_m == pytest.approx(61_283.65)
    assert decoded.threats[0].age_s == age_of(22) == pytest.approx(2.13, abs=0.005)


# Places


@pytest.mark.slow
@given(fleets())
def test_a_fleet_frame_returns_every_id_target_and_place_within_half_a_unit(frame: FleetFrame) -> None:
    decoded = fleet_through(frame)
    assert (decoded.stamp, decoded.directive, decoded.grid) == (STAMP, Directive.HOLD, frame.grid)
    half_m = frame.grid.resolution_cm / 200.0 + 1e-6
    for name in ("agents", "targets", "threats"):
        sent, got = getattr(frame, name), getattr(decoded, name)
        assert [entry.id for entry in got] == [entry.id for entry in sent]
        for before, after in zip(sent, got, strict=True):
            assert (before.north_m is None) == (after.north_m is None)
            if before.north_m is not None:
                assert abs(after.north_m - before.north_m) <= half_m
                assert abs(after.east_m - before.east_m) <= half_m
    assert [(a.target_id, a.directive) for a in decoded.agents] == [(a.target_id, a.directive) for a in frame.agents]


@pytest.mark.slow
@given(fleets(FAR_M))
def test_what_was_decoded_encodes_to_what_was_heard(frame: FleetFrame) -> None:
    once = fleet_through(frame)
    assert fleet_through(once) == once


@pytest.mark.slow
@given(st.tuples(*[st.floats(-FAR_M, FAR_M)] * 2), st.lists(st.tuples(*[st.floats(0.0, 2_000.0)] * 2), min_size=1))
def test_places_near_each_other_are_fine_however_far_the_origin_is(
    corner: tuple[float, float], points: list[tuple[float, float]]
) -> None:
    frame = fitted(
        fleet_of(targets=tuple(TargetEntry(k, corner[0] + n, corner[1] + e) for k, (n, e) in enumerate(points[:30])))
    )
    assert frame.grid.resolution_cm <= 13  # 1000 km in steps of 256 units; 2 km alone would take 4 cm
    for sent, got in zip(frame.targets, fleet_through(frame).targets, strict=True):
        assert math.dist((sent.north_m, sent.east_m), (got.north_m, got.east_m)) <= frame.rounding_m + 1e-6


def test_all_in_one_place_takes_the_finest_unit() -> None:
    frame = fitted(fleet_of(agents=tuple(AgentEntry(k, 12_345.678, -0.004, None) for k in range(40))))
    assert frame.grid.resolution_cm == 1
    assert {(a.north_m, a.east_m) for a in fleet_through(frame).agents} == {(12_345.68, 0.0)}


def test_two_hundred_kilometres_take_units_of_about_three_metres() -> None:
    assert finest_grid([(0.0, 0.0), (SIDE_M, SIDE_M)]) == Grid(307, 0, 0)


@given(st.lists(st.tuples(*[st.floats(-2.0e7, 2.0e7)] * 2), min_size=1, max_size=8))
def test_the_finest_unit_always_fits(points: list[tuple[float, float]]) -> None:
    fleet_through(fitted(fleet_of(targets=tuple(TargetEntry(k, *point) for k, point in enumerate(points)))))


@pytest.mark.parametrize("points", [[(0.0, 0.0), (700.0, 0.0)], [(100_000.0, 0.0)], [(0.0, -100_000.0)]])
def test_places_that_do_not_fit_the_unit_given_are_refused(points: list[tuple[float, float]]) -> None:
    with pytest.raises(WireError, match="off the grid"):
        FrameWriter().encode(fleet_of(targets=tuple(TargetEntry(k, *point) for k, point in enumerate(points))))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1.0e300])
def test_a_place_that_is_nowhere_is_refused(bad: float) -> None:
    with pytest.raises(WireError):
        finest_grid([(0.0, 0.0), (0.0, bad)])
    with pytest.raises(WireError):
        FrameWriter().encode(fleet_of(targets=(TargetEntry(1, bad, 0.0),)))


@pytest.mark.parametrize("resolution_cm", [0, -1, 65_536])
def test_a_unit_that_fits_no_field_is_refused(resolution_cm: int) -> None:
    with pytest.raises(WireError, match="resolution"):
        FrameWriter().encode(fleet_of(grid=Grid(resolution_cm, 0, 0)))


# Discs


@given(
    st.tuples(near_m, near_m),
    st.tuples(near_m, near_m),
    st.floats(0.0, 1.0e6),
    st.floats(1.0, 60_000.0),
    st.floats(1e-3, 1.0),
    st.floats(0.0, 255.0),
)
def test_a_receivers_disc_holds_the_true_one(
    seen: tuple[float, float],
    elsewhere: tuple[float, float],
    age_s: float,
    detection_m: float,
    share: float,
    bound_m_s: float,
) -> None:
    fleet = fitted(fleet_of(threats=(ThreatPlace(1, *seen, age_s), ThreatPlace(2, *elsewhere, 0.0))))
    place = fleet_through(fleet).threats[0]
    sent = RadiiEntry(1, detection_m, share * detection_m, bound_m_s)
    unit_cm = finest_radii_cm(detection_m)
    (radii,) = radii_through(replace(SMALL_RADII, resolution_cm=unit_cm, threats=(sent,))).threats
    shift_m = math.dist(seen, (place.north_m, place.east_m))
    grown_m = fleet.rounding_m + radii.speed_bound_m_s * place.age_s
    for true_m, told_m in (
        (sent.detection_radius_m, radii.detection_radius_m),
        (sent.attack_radius_m, radii.attack_radius_m),
    ):
        assert true_m + bound_m_s * age_s + shift_m <= (told_m + grown_m) * (1 + 1e-12) + 1e-4
        assert told_m <= true_m + detection_m / 65_535.0 + 0.021


@given(st.floats(0.0, GREATEST_AGE_S))
def test_an_age_is_rounded_up_to_the_next_code_and_no_further(age_s: float) -> None:
    code = age_code(age_s)
    assert age_of(code) >= age_s
    assert code == 0 or age_of(code - 1) < age_s


def test_age_codes_rise_from_tenths_of_a_second_to_more_than_an_hour() -> None:
    ages = [age_of(code) for code in range(256)]
    assert ages == sorted(set(ages))
    assert ages[: FINE_AGES + 1] == [pytest.approx(0.1 * code) for code in range(FINE_AGES + 1)]
    assert all(later / earlier <= AGE_RATIO + 1e-9 for earlier, later in zip(ages[10:], ages[11:], strict=False))
    assert ages[-1] == GREATEST_AGE_S >= 46 * 86_400.0
    assert [age_code(age) for age in ages] == list(range(256))


@pytest.mark.parametrize("age_s", [-1e-9, math.nan, math.inf, GREATEST_AGE_S * 1.001])
def test_an_age_that_no_code_holds_is_refused_not_cut(age_s: float) -> None:
    with pytest.raises(WireError, match="age"):
        FrameWriter().encode(fleet_of(threats=(ThreatPlace(1, 0.0, 0.0, age_s),)))


@given(st.lists(st.tuples(st.floats(1e-3, 4.0e7), st.floats(1e-3, 1.0)), min_size=1, max_size=20))
def test_radii_are_rounded_up_by_less_than_a_unit_and_return_the_same_when_sent_on(
    radii: list[tuple[float, float]],
) -> None:
    sent = tuple(RadiiEntry(k, big, big * share, 1.0) for k, (big, share) in enumerate(radii))
    unit_cm = finest_radii_cm(max(big for big, _ in radii))
    frame = replace(SMALL_RADII, resolution_cm=unit_cm, threats=sent)
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(FrameWriter().encode(frame)))
    unit_m = message.resolution / 100.0
    decoded = radii_through(frame)
    for before, after in zip(sent, decoded.threats, strict=True):
        for true_m, told_m in (
            (before.detection_radius_m, after.detection_radius_m),
            (before.attack_radius_m, after.attack_radius_m),
        ):
            assert true_m - 1e-6 * unit_m <= told_m <= true_m + unit_m
    assert radii_through(decoded) == decoded


def test_heights_are_rounded_outwards() -> None:
    sent = (RadiiEntry(1, 5.0, 5.0, 0.0, -3.5, 12.25), RadiiEntry(2, 5.0, 5.0, 0.0, None, 0.0))
    first, second = radii_through(replace(SMALL_RADII, threats=sent)).threats
    assert (first.floor_m, first.ceiling_m) == (-4.0, 13.0)
    assert (second.floor_m, second.ceiling_m) == (None, 0.0)


@pytest.mark.parametrize(
    "entry",
    [
        RadiiEntry(1, 5.0, 6.0, 0.0),
        RadiiEntry(1, 5.0, 0.0, 0.0),
        RadiiEntry(1, math.nan, 1.0, 0.0),
        RadiiEntry(1, 5.0, math.nan, 0.0),
        RadiiEntry(1, math.inf, 1.0, 0.0),
        RadiiEntry(1, 1.0e9, 1.0, 0.0),
        RadiiEntry(1, 5.0, 1.0, 855.5),
        RadiiEntry(1, 5.0, 1.0, -1.0),
        RadiiEntry(1, 5.0, 1.0, math.nan),
        RadiiEntry(1, 5.0, 1.0, 0.0, 40_000.0, None),
        RadiiEntry(1, 5.0, 1.0, 0.0, math.nan, None),
        RadiiEntry(1, 5.0, 1.0, 0.0, 10.0, 10.0),
        RadiiEntry(65_536, 5.0, 1.0, 0.0),
        RadiiEntry(-1, 5.0, 1.0, 0.0),
    ],
)
def test_radii_that_make_no_sense_are_refused(entry: RadiiEntry) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(replace(SMALL_RADII, threats=(entry,)))


# Sections


def agents_with(ids: list[int], target_id: int | None = 1, placed: bool = True) -> list[AgentEntry]:
    north_m, east_m = (1.0, 2.0) if placed else (None, None)
    return [AgentEntry(k, north_m, east_m, target_id) for k in ids]


def layout_of(entries: list[AgentEntry]) -> Layout[AgentEntry]:
    layout = Layout[AgentEntry]()
    for entry in entries:
        layout.add(entry)
    return layout


def test_an_agent_among_many_takes_five_bytes() -> None:
    assert layout_of(agents_with(list(range(1, 41)))).size == 6 + 40 * 5


@pytest.mark.parametrize(
    ("ids", "placed", "size", "sections"),
    [
        ([1, 3], True, 6 + 3 * 5, 1),  # nobody is 2: five bytes, a section head would be six
        ([1, 4], True, 2 * (6 + 5), 2),
        ([1, 8], False, 6 + 8, 1),
        ([1, 9], False, 2 * (6 + 1), 2),
        ([2, 1], True, 2 * (6 + 5), 2),
    ],
)
def test_a_gap_in_the_ids_is_bridged_where_that_is_no_longer(
    ids: list[int], placed: bool, size: int, sections: int
) -> None:
    layout = layout_of(agents_with(ids, placed=placed))
    assert (layout.size, len(layout.sections)) == (size, sections)
    data = {"agents": tuple(agents_with(ids, placed=placed))}
    assert fleet_through(fleet_of(**data)).agents == fleet_of(**data).agents


@pytest.mark.parametrize(("furthest", "sections"), [(254, 1), (255, 2)])
def test_agents_share_a_section_while_their_targets_are_in_reach(furthest: int, sections: int) -> None:
    agents = (AgentEntry(1, None, None, furthest), AgentEntry(2, None, None, None), AgentEntry(3, None, None, 1))
    assert len(layout_of(list(agents)).sections) == sections
    assert fleet_through(fleet_of(agents=agents)).agents == agents


def test_two_hundred_agents_without_a_place_fit_one_frame() -> None:
    agents = tuple(AgentEntry(1 + k, None, None, 1 + k % 50) for k in range(200))
    assert fleet_through(fleet_of(agents=agents)).agents == agents


def test_more_than_a_frame_holds_is_refused() -> None:
    with pytest.raises(WireError, match="a frame holds 232"):
        FrameWriter().encode(fleet_of(agents=tuple(agents_with(list(range(1, 47))))))


@pytest.mark.parametrize(
    "frame",
    [
        fleet_of(agents=tuple(agents_with([5, 5]))),
        fleet_of(agents=(AgentEntry(5, 0.0, 0.0, None), AgentEntry(5, None, None, None))),
        fleet_of(targets=(TargetEntry(5, 0.0, 0.0), TargetEntry(5, 1.0, 1.0))),
        replace(SMALL_RADII, threats=(RadiiEntry(5, 2.0, 1.0, 0.0), RadiiEntry(5, 2.0, 1.0, 0.0, 1.0, 2.0))),
    ],
    ids=["agents", "agents with and without a place", "targets", "radii with and without a band"],
)
def test_an_id_given_twice_is_refused(frame: Frame) -> None:
    with pytest.raises(WireError, match="twice"):
        FrameWriter().encode(frame)


def test_the_same_id_of_a_target_and_a_threat_is_none_given_twice() -> None:
    frame = fleet_of(targets=(TargetEntry(5, 0.0, 0.0),), threats=(ThreatPlace(5, 0.0, 0.0, 0.0),))
    assert fleet_through(frame) == frame


# Sizes


def test_the_data_of_a_message_begin_after_its_head() -> None:
    heads = {"fleet": FLEET_HEAD_BYTES, "radii": RADII_HEAD_BYTES, "mission": MISSION_HEAD_BYTES}
    for name, head_bytes in heads.items():
        kind = next(k for k in oneway.mavlink_map.values() if k.msgname == f"ONEWAY_{name.upper()}")
        assert kind.ordered_fieldnames[-2:] == ["size", "data"]
        assert kind.unpacker.size == 255
        assert head_bytes + kind.lengths[-1] == 255


def test_only_the_bytes_in_use_travel() -> None:
    frame = fleet_of(agents=(AgentEntry(1, 0.0, 0.0, 1),))
    assert len(FrameWriter().encode(frame)) == 12 + FLEET_HEAD_BYTES + 6 + 5


@pytest.mark.parametrize(
    ("max_frame_bytes", "overhead_bytes", "expected"), [(252, 0, 217), (252, 13, 204), (252, 64, 153), (280, 13, 232)]
)
def test_the_room_for_data_is_what_the_path_leaves(max_frame_bytes: int, overhead_bytes: int, expected: int) -> None:
    assert data_bytes(FLEET_HEAD_BYTES, max_frame_bytes, overhead_bytes) == expected


# The mission and the decision


def test_a_mission_returns() -> None:
    assert through(SMALL_MISSION) == SMALL_MISSION


@given(st.floats(0.0, 6_553.5), st.floats(0.0, 6_553.5), st.floats(-1_000.0, 20_000.0), st.text(max_size=40))
def test_a_missions_lengths_return_within_half_a_decimetre(
    separation_m: float, arrival_m: float, alt_m: float, name: str
) -> None:
    sent = replace(SMALL_MISSION, separation_m=separation_m, arrival_radius_m=arrival_m, origin_alt_m=alt_m, name=name)
    got = through(sent)
    assert isinstance(got, MissionFrame)
    assert got.name == name
    assert got.separation_m == pytest.approx(separation_m, abs=0.050001)
    assert got.arrival_radius_m == pytest.approx(arrival_m, abs=0.050001)
    assert got.origin_alt_m == pytest.approx(alt_m, abs=0.050001)


@pytest.mark.parametrize(
    "frame",
    [
        replace(SMALL_MISSION, separation_m=6_553.6),
        replace(SMALL_MISSION, arrival_radius_m=math.nan),
        replace(SMALL_MISSION, origin_alt_m=math.inf),
        replace(SMALL_MISSION, origin_alt_m=1.0e12),
        replace(SMALL_MISSION, origin_lat_deg=90.1),
        replace(SMALL_MISSION, surrogate_digest=bytes(7)),
        replace(SMALL_MISSION, mission_digest=bytes(9)),
        replace(SMALL_MISSION, agents=65_536),
        replace(SMALL_MISSION, name="x" * 205),
        replace(SMALL_DECISION, speed_m_s=1.0e39),
        replace(SMALL_DECISION, heading_rad=math.inf),
        replace(SMALL_DECISION, time_us=-1),
        replace(SMALL_DECISION, target_id=65_536),
        replace(SMALL_DECISION, purpose=256),
        replace(SMALL_FLEET, stamp=replace(STAMP, frame_index=2)),
        replace(SMALL_RADII, stamp=replace(STAMP, frame_count=256)),
        replace(SMALL_FLEET, agents=(AgentEntry(1, None, None, 65_536),)),
        replace(SMALL_FLEET, agents=(AgentEntry(1, None, None, -1),)),
    ],
)
def test_a_value_that_fits_no_field_is_a_wire_error(frame: Frame) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(frame)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_decisions_numbers_return_bit_for_bit_as_32_bit_floats(number: float) -> None:
    got = through(replace(SMALL_DECISION, heading_rad=number))
    assert isinstance(got, DecisionFrame)
    assert struct.pack("<f", got.heading_rad) == struct.pack("<f", number)


@given(st.floats(width=32, min_value=0.0, allow_nan=False))
def test_a_decisions_certificate_returns_as_it_was_for_ever_too(certified_s: float) -> None:
    got = through(replace(SMALL_DECISION, certified_s=certified_s))
    assert isinstance(got, DecisionFrame)
    assert got.certified_s == certified_s


@pytest.mark.parametrize("certified_s", [-1.0, math.nan])
def test_a_certificate_that_is_no_time_is_a_wire_error(certified_s: float) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(replace(SMALL_DECISION, certified_s=certified_s))


def test_a_decision_returns_with_nan_where_there_is_nothing() -> None:
    got = through(SMALL_DECISION)
    assert isinstance(got, DecisionFrame)
    assert math.isnan(got.wanted_heading_rad)
    assert replace(got, wanted_heading_rad=0.0) == replace(SMALL_DECISION, wanted_heading_rad=0.0)
    assert through(replace(SMALL_DECISION, target_id=None, wanted_heading_rad=0.0)) == replace(
        SMALL_DECISION, target_id=None, wanted_heading_rad=0.0
    )


# Hostile bytes


def message_of(frame: Frame, **fields: object) -> bytes:
    """Return the frame with some fields forged, its checksum right."""
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(FrameWriter().encode(frame)))
    values = {name: getattr(message, name) for name in message.fieldnames} | fields
    return bytes(type(message)(**values).pack(oneway.MAVLink(None)))


def padded(data: bytes, length: int) -> list[int]:
    return list(data.ljust(length, b"\0"))


def fleet_data(data: bytes) -> dict[str, object]:
    return {"size": len(data), "data": padded(data, 232)}


def radii_data(data: bytes) -> dict[str, object]:
    return {"size": len(data), "data": padded(data, 237)}


def section(kind: int, count: int, first_id: int, body: bytes = b"") -> bytes:
    return struct.pack("<BBH", kind, count, first_id) + body


AGENT = section(1, 1, 5, struct.pack("<HHHB", 9, 0, 0, 1))


@pytest.mark.parametrize(
    ("frame", "fields", "reason"),
    [
        (SMALL_FLEET, {"directive": 3}, "unknown directive"),
        (SMALL_FLEET, {"resolution": 0}, "resolution is zero"),
        (SMALL_FLEET, {"frame_index": 2}, "frame index out of range"),
        (SMALL_FLEET, {"size": 233}, "size out of range"),
        (SMALL_FLEET, {"size": 255}, "size out of range"),
        (SMALL_FLEET, fleet_data(b"\x01"), "section cut short"),
        (SMALL_FLEET, fleet_data(AGENT[:-1]), "section cut short"),
        (SMALL_FLEET, fleet_data(AGENT + b"\x03\x01\x00"), "section cut short"),
        (SMALL_FLEET, fleet_data(section(1, 1, 5)), "section cut short"),
        (SMALL_FLEET, fleet_data(section(0, 1, 5, bytes(9))), "unknown section"),
        (SMALL_FLEET, fleet_data(section(8, 1, 5, bytes(9))), "unknown section"),
        (SMALL_FLEET, fleet_data(AGENT + section(7, 1, 5, b"\3")), "unknown directive"),
        (SMALL_FLEET, fleet_data(AGENT + section(7, 1, 6, b"\1")), "directive of an agent that is not there"),
        (SMALL_FLEET, fleet_data(AGENT + section(7, 1, 5, b"\1") * 2), "an id is given twice"),
        (SMALL_RADII, radii_data(section(7, 1, 5, b"\1")), "section out of place"),
        (SMALL_FLEET, fleet_data(section(5, 1, 5, bytes(5))), "section out of place"),
        (SMALL_FLEET, fleet_data(section(3, 0, 5)), "ids out of range"),
        (SMALL_FLEET, fleet_data(section(3, 2, 65_535, bytes(8))), "ids out of range"),
        (SMALL_FLEET, fleet_data(AGENT + AGENT), "an id is given twice"),
        (SMALL_FLEET, fleet_data(AGENT + section(2, 1, 5, b"\0\0\x01")), "an id is given twice"),
        (
            SMALL_FLEET,
            fleet_data(section(1, 1, 5, struct.pack("<HHHB", 9, 0, 0, 255))),
            "assigned to a target that cannot be",
        ),
        (
            SMALL_FLEET,
            fleet_data(section(1, 1, 5, struct.pack("<HHHB", 65_535, 0, 0, 2))),
            "assigned to a target that cannot be",
        ),
        (SMALL_RADII, {"resolution": 0}, "resolution is zero"),
        (SMALL_RADII, {"frame_count": 0}, "frame index out of range"),
        (SMALL_RADII, {"size": 238}, "size out of range"),
        (SMALL_RADII, radii_data(section(3, 1, 5, bytes(4))), "section out of place"),
        (SMALL_RADII, radii_data(section(5, 1, 5, struct.pack("<HHB", 5, 6, 0))), "radii out of range"),
        (SMALL_RADII, radii_data(section(5, 1, 5, struct.pack("<HHB", 5, 0, 0))), "radii out of range"),
        (SMALL_RADII, radii_data(section(6, 1, 5, struct.pack("<HHBhh", 5, 5, 0, 9, 9))), "band out of range"),
        (SMALL_RADII, radii_data(section(5, 1, 5, b"\5\0\5\0\0") * 2), "an id is given twice"),
        (SMALL_MISSION, {"origin_lat": 900_000_001}, "origin out of range"),
        (SMALL_MISSION, {"origin_lon": -1_800_000_001}, "origin out of range"),
        (SMALL_MISSION, {"size": 204}, "size out of range"),
        (SMALL_MISSION, {"size": 1, "data": padded(b"\xff", 203)}, "name is not UTF-8"),
        (SMALL_DECISION, {"flags": 128}, "unknown flag"),
        (SMALL_DECISION, {"speed": math.inf}, "number out of range"),
        (SMALL_DECISION, {"picture_age": -math.inf}, "number out of range"),
    ],
)
def test_a_frame_that_makes_no_sense_is_refused_with_its_reason(
    frame: Frame, fields: dict[str, object], reason: str
) -> None:
    with pytest.raises(WireError) as error:
        decode_frame(raw_frame(message_of(frame, **fields)))
    assert str(error.value) == reason


def directed(frame: FleetFrame, own: dict[int, Directive]) -> FleetFrame:
    agents = (replace(agent, directive=own.get(agent.id, Directive.NORMAL)) for agent in frame.agents)
    return replace(frame, agents=tuple(agents))


@given(st.sampled_from(Directive))
def test_the_last_broadcast_says_so_beside_its_directive(directive: Directive) -> None:
    told = fleet_through(replace(SMALL_FLEET, directive=directive, is_last=True))
    assert (told.directive, told.is_last) == (directive, True)
    assert not fleet_through(SMALL_FLEET).is_last


def test_directives_for_single_agents_stand_in_a_section_of_their_own_that_costs_nothing_without_them() -> None:
    told = directed(SMALL_FLEET, {300: Directive.HOLD, 302: Directive.RETURN})
    plain, longer = (FrameWriter().encode(frame) for frame in (SMALL_FLEET, told))
    assert longer[:-2].endswith(plain[33:-2] + bytes.fromhex("07032c01010002"))
    assert [agent.directive for agent in fleet_through(told).agents] == [Directive.HOLD, Directive.RETURN, 0]


@pytest.mark.parametrize(("step", "bytes_more"), [(40, 5), (2, 4 + 39), (1, 4 + 40), (8, 5 * 5)])
def test_a_directive_for_one_in_so_many_agents_of_a_frame_costs_that_many_bytes(step: int, bytes_more: int) -> None:
    frame = fleet_of(agents=tuple(AgentEntry(k, None, None, 1) for k in range(1, 41)))
    told = directed(frame, dict.fromkeys(range(1, 41, step), Directive.HOLD))
    assert len(FrameWriter().encode(told)) - len(FrameWriter().encode(frame)) == bytes_more


def test_a_record_for_nobody_is_nobody() -> None:
    data = section(1, 3, 5, struct.pack("<H", 9) + b"\1\0\1\0\1" + b"\xff\xff\xff\xff\0" + b"\2\0\2\0\0")
    decoded = decode_frame(raw_frame(message_of(SMALL_FLEET, **fleet_data(data))))
    assert isinstance(decoded, FleetFrame)
    assert [(agent.id, agent.target_id) for agent in decoded.agents] == [(5, 9), (7, None)]


def likely_data(kinds: tuple[int, ...]) -> st.SearchStrategy[bytes]:
    """Return bytes that begin like sections, so that more than the first check is reached."""
    part = st.builds(section, st.sampled_from(kinds), st.integers(0, 6), ids_16, st.binary(max_size=40))
    return (st.lists(part, max_size=5).map(b"".join) | st.binary(max_size=238)).map(lambda data: data[:238])


@pytest.mark.slow
@settings(max_examples=300)
@given(likely_data((1, 2, 3, 4, 5, 6)), st.integers(0, 65_535), *[st.integers(-32_768, 32_767)] * 2)
def test_any_data_decode_to_finite_numbers_or_a_wire_error(
    data: bytes, resolution_cm: int, north: int, east: int
) -> None:
    readers: list[Callable[[], object]] = [
        lambda: read_fleet(data, Grid(resolution_cm, north, east)),
        lambda: read_radii(data, resolution_cm),
    ]
    for read in readers:
        try:
            got = read()
        except WireError:
            continue
        assert "nan" not in repr(got)
        assert "inf" not in repr(got)


@given(st.binary(max_size=300), st.sampled_from([k.id for k in oneway.mavlink_map.values()]), st.booleans())
def test_any_bytes_decode_or_are_a_wire_error(body: bytes, number: int, v1: bool) -> None:
    marker = b"\xfe" if v1 else b"\xfd"
    raw = marker + bytes([min(255, len(body))]) + bytes(5) + number.to_bytes(3, "little") + body
    try:
        frame = decode_frame(raw_frame(raw + bytes(2)))
    except WireError:
        return
    if not isinstance(frame, DecisionFrame):
        assert "nan" not in repr(frame).replace(repr(getattr(frame, "name", "")), "")


def test_a_frame_of_mavlink_1_is_foreign_whatever_stands_where_the_id_would() -> None:
    with pytest.raises(WireError, match="foreign"):
        decode_frame(raw_frame(b"\xfe" + FrameWriter().encode(SMALL_FLEET)[1:]))


def test_a_section_of_each_kind_is_known_to_the_xml() -> None:
    assert {kind.name: int(kind) for kind in Section} == {
        entry.name.removeprefix("ONEWAY_SECTION_"): value
        for value, entry in oneway.enums["ONEWAY_SECTION"].items()
        if not entry.name.endswith("ENUM_END")
    }
