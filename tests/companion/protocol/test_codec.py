"""Frames: small enough, exact enough, never optimistic about a threat, and deaf to everything that makes no sense."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from fastcrc.crc16 import mcrf4xx
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.protocol.codec import (
    AGENTS_PER_FRAME,
    BANDS_PER_FRAME,
    DETECTIONS_PER_FRAME,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    ID_SPAN,
    TARGETS_PER_FRAME,
    THREATS_PER_FRAME,
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Detection,
    DetectionsFrame,
    Directive,
    Frame,
    FrameReader,
    FrameWriter,
    Kind,
    MotionFrame,
    PointMotion,
    ReportFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    WireError,
    frame_resolution_cm,
)
from companion.protocol.dialect import oneway
from companion.protocol.frame import ED25519_BYTES

STAMP = Stamp(epoch_s=1_790_000_000, time_ms=12_345, sequence=7, frame_index=1, frame_count=2)
SMALL_STATE = StateFrame(
    stamp=STAMP,
    origin_lat_deg=47.1234567,
    origin_lon_deg=-8.7654321,
    directive=Directive.HOLD,
    revision=0x34,
    picture_threats=0x0506,
    picture_targets=7,
    resolution_cm=13,
    agents=(AgentEntry(300, 1_000.0, -2_000.0, 42), AgentEntry(301, -0.5, 0.25, None)),
    targets=(TargetEntry(42, 3_000.0, 4_000.0),),
    threats=(ThreatEntry(9, -500.0, 600.0, 100.0, 50.0, 9.5),),
)
SMALL_MOTION = MotionFrame(
    stamp=STAMP,
    agents=(AgentMotion(300, math.pi / 2, 60.0, 0.31), AgentMotion(301, None, 0.0, 1e6)),
    targets=(PointMotion(42, -1.25, 2.5, 3.0),),
    threats=(PointMotion(9, 10.0, -10.0, 1e6),),
)
SMALL_DETECTIONS = DetectionsFrame(
    epoch_s=1_790_000_000,
    time_ms=12_345,
    origin_lat_deg=47.1234567,
    origin_lon_deg=-8.7654321,
    detections=(Detection(Kind.THREAT, 9, -12_345.67, 200_000.0, -1.5, 9.75),),
)
SMALL_REPORT = ReportFrame(
    epoch_s=1_790_000_000,
    time_ms=12_345,
    agent_id=300,
    lat_deg=47.1234567,
    lon_deg=-8.7654321,
    velocity_north_m_s=-1.5,
    velocity_east_m_s=60.0,
    flown_m=12_346.0,
)
SMALL_BANDS = BandsFrame(
    stamp=STAMP, threats=(BandEntry(9, 450.5, 1_200.25), BandEntry(10, None, 800.0), BandEntry(200, -3.5, None))
)
UNSEEN_STATE = StateFrame(
    stamp=STAMP,
    origin_lat_deg=47.0,
    origin_lon_deg=8.0,
    directive=Directive.NORMAL,
    revision=1,
    picture_threats=0,
    picture_targets=1,
    resolution_cm=1,
    agents=(AgentEntry(1, None, None, 1), AgentEntry(2, 3.0, -4.0, None)),
    targets=(TargetEntry(1, 100.0, 200.0),),
    threats=(),
)
GOLDEN = [
    (
        SMALL_STATE,
        "fd9a000000febe0001a0803bb16a39300000070000000778161c4f80c6fa0c1efcff00000000000000000000000000000000"
        "e7c3020000000000000000000000000000000000255a000000000000000031780000000000000000faf00000000000000712"
        "000000000000020300000000000082010000000000000d002c012a000900060534070101020201010a000000000000000000"
        "0000000001000000000000000001c326",
    ),
    (
        SMALL_MOTION,
        "fd8a000000febe0101a0803bb16a39300000070000002823ffff000000000000000000000000000000007017000000000000"
        "00000000000000000000000083ff0000000000000000fa000000000000000000e80300000000000018fc0000000000001e00"
        "0000000000000000ffff0000000000002c012a000900010202010104ff000000000000000000000000000000000000019dd5",
    ),
    (
        SMALL_DETECTIONS,
        "fdd6000000febe0201a0803bb16a393000000778161c4f80c6fa7929edff0000000000000000000000000000000000000000"
        "0000000000000000000000000000000000000000000000000000000000000000002d31010000000000000000000000000000"
        "00000000000000000000000000000000000000000000000000000000000000000000000000006aff00000000000000000000"
        "00000000000000000000000000000000cf030000000000000000000000000000000000000000000000000000090000000000"
        "000000000000000000000000000000000000000000000102bb39",
    ),
    (SMALL_REPORT, "fd1a000000febe0301a0803bb16a393000000778161c4f80c6fa3a3000006aff70172c013729"),
    (
        UNSEEN_STATE,
        "fd9a000000febe0001a0803bb16a393000000700000080a1031c00b4c40400802c0100000000000000000000000000000000"
        "008070fe0000000000000000000000000000000010270000000000000000204e000000000000000000000000000000000000"
        "0000000000000000000000000000000000000000000001000100010000000000010100010202010000000000000000000000"
        "0000000001000000000000000001e814",
    ),
    (
        SMALL_BANDS,
        "fd64000000febe0401a0803bb16a3930000007000000c2010080fcff00000000000000000000000000000000000000000000"
        "000000000000000000000000b1042003ff7f0000000000000000000000000000000000000000000000000000000000000000"
        "000009000102030001bfe38f",
    ),
]
GOLDEN_NAMES = ["state", "motion", "detections", "report", "state of agents unseen", "bands"]
FULL_SIGNATURE = bytes(range(1, ED25519_BYTES + 1))
SIDE_M = 200_000.0

coordinates_m = st.floats(-SIDE_M, SIDE_M)
identities = st.integers(0, 65_535)


def paper_state() -> StateFrame:
    """Return the paper's mission, every entry in use and no byte of the payload zero at its end."""
    return StateFrame(
        stamp=Stamp(0x6A616263, 0x01020304, 0x05060708, 1, 2),
        origin_lat_deg=47.1234567,
        origin_lon_deg=8.7654321,
        directive=Directive.RETURN,
        revision=0x12,
        picture_threats=0x0304,
        picture_targets=5,
        resolution_cm=611,
        agents=tuple(
            AgentEntry(1_000 + k, 150_000.0 + 997.0 * k, 120_000.0 + 991.0 * k, 2_000 + k % 5) for k in range(10)
        ),
        targets=tuple(TargetEntry(2_000 + k, 90_000.0 + 983.0 * k, 60_000.0 + 977.0 * k) for k in range(5)),
        threats=tuple(
            ThreatEntry(3_000 + k, 30_000.0 + 971.0 * k, 50_000.0 + 967.0 * k, 10_000.0, 5_000.0, 10.0)
            for k in range(4)
        ),
    )


def through(frame: Frame) -> Frame:
    reader = FrameReader()
    frames = reader.read(FrameWriter().encode(frame))
    assert reader.rejected.total() == 0
    (decoded,) = frames
    return decoded


def state_through(frame: StateFrame) -> StateFrame:
    decoded = through(frame)
    assert isinstance(decoded, StateFrame)
    return decoded


def motion_through(frame: MotionFrame) -> MotionFrame:
    decoded = through(frame)
    assert isinstance(decoded, MotionFrame)
    return decoded


def report_through(frame: ReportFrame) -> ReportFrame:
    decoded = through(frame)
    assert isinstance(decoded, ReportFrame)
    return decoded


def resolution_m(datagram: bytes) -> float:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(datagram))
    return float(message.resolution) / 100.0


def state_of(**parts: object) -> StateFrame:
    return replace(SMALL_STATE, **{"agents": (), "targets": (), "threats": (), **parts})  # type: ignore[arg-type]


def with_signature(datagram: bytes) -> bytes:
    """Return a frame with its signature field full."""
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(datagram))
    message.ed25519_signature = list(FULL_SIGNATURE)
    return bytes(message.pack(oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)))


def with_good_crc(datagram: bytes) -> bytes:
    """Return a frame of ours whose checksum was made right again, as a forger would."""
    body, payload_bytes = datagram[1:-2], datagram[1]
    assert len(datagram) == payload_bytes + 12
    kind = oneway.mavlink_map.get(int.from_bytes(datagram[7:10], "little"))
    crc = mcrf4xx(body + bytes([kind.crc_extra if kind else 0]))
    return datagram[:-2] + crc.to_bytes(2, "little")


# Size


def test_the_papers_mission_signed_by_ed25519_takes_at_most_239_bytes() -> None:
    datagram = with_signature(FrameWriter().encode(paper_state()))
    assert len(datagram) <= 239
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(datagram))
    assert (message.agent_count, message.target_count, message.threat_count) == (10, 5, 4)
    assert bytes(message.ed25519_signature) == FULL_SIGNATURE


def test_mavlinks_own_signature_as_well_leaves_it_within_252_bytes() -> None:
    datagram = with_signature(FrameWriter().encode(paper_state()))
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(datagram))
    signing = oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)
    signing.signing.secret_key = bytes(range(32))
    signing.signing.sign_outgoing = True
    signed = message.pack(signing)
    assert len(signed) == len(datagram) + 13 <= 252


def test_an_unsigned_frame_does_not_pay_for_the_signature_field() -> None:
    signed = with_signature(FrameWriter().encode(paper_state()))
    unsigned = FrameWriter().encode(paper_state())
    assert len(signed) - len(unsigned) >= ED25519_BYTES


def test_the_motion_of_the_papers_mission_fits_with_both_signatures() -> None:
    motion = MotionFrame(
        stamp=paper_state().stamp,
        agents=tuple(AgentMotion(1_000 + k, 6.2, 655.0, 25.5) for k in range(10)),
        targets=tuple(PointMotion(2_000 + k, -300.0, 300.0, 6_000.0) for k in range(5)),
        threats=tuple(PointMotion(3_000 + k, -300.0, 300.0, 6_000.0) for k in range(4)),
    )
    assert len(with_signature(FrameWriter().encode(motion))) + 13 <= 252


# Bytes


@pytest.mark.parametrize(("frame", "expected"), GOLDEN, ids=GOLDEN_NAMES)
def test_the_bytes_of_a_frame_are_pinned(frame: Frame, expected: str) -> None:
    assert FrameWriter().encode(frame).hex() == expected


@pytest.mark.parametrize(("frame", "datagram"), GOLDEN, ids=GOLDEN_NAMES)
def test_the_pinned_bytes_decode_to_what_was_sent(frame: Frame, datagram: str) -> None:
    (decoded,) = FrameReader().read(bytes.fromhex(datagram))
    if frame is SMALL_STATE:
        assert isinstance(decoded, StateFrame)
        assert (decoded.stamp, decoded.directive) == (STAMP, Directive.HOLD)
        assert (decoded.origin_lat_deg, decoded.origin_lon_deg) == (47.1234567, -8.7654321)
        assert [(a.id, a.target_id) for a in decoded.agents] == [(300, 42), (301, None)]
        assert decoded.agents[0].north_m == pytest.approx(1_000.0, abs=0.065)
    elif isinstance(frame, MotionFrame):
        assert isinstance(decoded, MotionFrame)
        assert decoded.agents[0] == AgentMotion(300, math.radians(90.0), 60.0, 0.4)
        assert decoded.agents[1] == AgentMotion(301, None, 0.0, 25.5)
        assert decoded.targets == (PointMotion(42, -1.25, 2.5, 3.0),)
        assert decoded.threats == (PointMotion(9, 10.0, -10.0, 6_553.5),)
    elif isinstance(frame, BandsFrame):
        assert isinstance(decoded, BandsFrame)
        assert decoded.stamp == STAMP
        assert decoded.threats == (
            BandEntry(9, 450.0, 1_201.0),
            BandEntry(10, None, 800.0),
            BandEntry(200, -4.0, None),
        )
    else:
        assert decoded == frame


def test_frames_are_numbered_as_mavlink_does_and_wrap_at_256() -> None:
    writer = FrameWriter(17, 18)
    numbers = [writer.encode(SMALL_STATE)[4:7] for _ in range(257)]
    assert numbers[0] == bytes([0, 17, 18])
    assert [number[0] for number in numbers] == [*range(256), 0]


# Positions


@given(st.lists(st.tuples(coordinates_m, coordinates_m), min_size=1, max_size=AGENTS_PER_FRAME))
def test_positions_return_within_half_a_unit_and_a_unit_is_at_most_ten_metres(
    points: list[tuple[float, float]],
) -> None:
    agents = tuple(AgentEntry(k, *point, None) for k, point in enumerate(points))
    frame = state_of(resolution_cm=frame_resolution_cm(points, []), agents=agents)
    datagram = FrameWriter().encode(frame)
    unit_m = resolution_m(datagram)
    assert unit_m <= 10.0
    (decoded,) = FrameReader().read(datagram)
    assert isinstance(decoded, StateFrame)
    for sent, got in zip(frame.agents, decoded.agents, strict=True):
        assert got.north_m == pytest.approx(sent.north_m, rel=0.0, abs=unit_m / 2 + 1e-6)
        assert got.east_m == pytest.approx(sent.east_m, rel=0.0, abs=unit_m / 2 + 1e-6)


def test_a_small_mission_is_sent_by_the_centimetre() -> None:
    assert frame_resolution_cm([(300.0, -300.0)], []) == 1


@pytest.mark.parametrize("resolution_cm", [0, -1, 65_536])
def test_a_unit_that_fits_no_field_is_refused(resolution_cm: int) -> None:
    with pytest.raises(WireError, match="resolution"):
        FrameWriter().encode(state_of(resolution_cm=resolution_cm))


@pytest.mark.parametrize("north_m", [-4_260.0, 4_260.0, math.nan, math.inf])
def test_a_place_off_the_grid_is_refused(north_m: float) -> None:
    with pytest.raises(WireError, match="fit"):
        FrameWriter().encode(state_of(targets=(TargetEntry(1, north_m, 0.0),)))


@given(
    st.lists(st.tuples(coordinates_m, coordinates_m), max_size=TARGETS_PER_FRAME - 1),
    st.lists(st.tuples(coordinates_m, coordinates_m, st.floats(1.0, 4e4)), max_size=THREATS_PER_FRAME - 1),
    st.tuples(coordinates_m, coordinates_m, st.floats(1.0, 4e4)),
)
def test_what_is_told_of_a_thing_does_not_depend_on_what_else_is_in_the_frame(
    targets: list[tuple[float, float]],
    threats: list[tuple[float, float, float]],
    thing: tuple[float, float, float],
) -> None:
    north_m, east_m, radius_m = thing
    target, threat = TargetEntry(9, north_m, east_m), ThreatEntry(9, north_m, east_m, radius_m, radius_m / 2.0, 0.0)
    alone = state_through(state_of(resolution_cm=611, targets=(target,), threats=(threat,)))
    among = state_through(
        state_of(
            resolution_cm=611,
            agents=tuple(AgentEntry(k, *point, None) for k, point in enumerate(targets)),
            targets=(*(TargetEntry(k, *point) for k, point in enumerate(targets)), target),
            threats=(*(ThreatEntry(k, *point, 1.0, 9.0) for k, point in enumerate(threats)), threat),
        )
    )
    assert (among.targets[-1], among.threats[-1]) == (alone.targets[0], alone.threats[0])


@given(coordinates_m, coordinates_m, st.integers(0, 2))
def test_detections_return_within_half_a_centimetre(north_m: float, east_m: float, kind: int) -> None:
    sent = replace(SMALL_DETECTIONS, detections=(Detection(Kind(kind), 1, north_m, east_m, 0.0, 0.0),))
    decoded = through(sent)
    assert isinstance(decoded, DetectionsFrame)
    (detection,) = decoded.detections
    assert detection.kind is Kind(kind)
    assert abs(detection.north_m - north_m) <= 0.005 + 1e-6
    assert abs(detection.east_m - east_m) <= 0.005 + 1e-6


# Threats


@given(
    st.tuples(coordinates_m, coordinates_m),
    st.tuples(coordinates_m, coordinates_m),
    st.floats(0.1, 50_000.0),
    st.floats(0.001, 1.0),
)
def test_a_decoded_disc_holds_the_true_one_and_is_hardly_larger(
    centre: tuple[float, float], elsewhere: tuple[float, float], detection_m: float, share: float
) -> None:
    attack_m = detection_m * share
    frame = state_of(
        resolution_cm=frame_resolution_cm([centre, elsewhere], [detection_m]),
        agents=(AgentEntry(1, *elsewhere, None),),
        threats=(ThreatEntry(5, *centre, detection_m, attack_m, 3.2),),
    )
    datagram = FrameWriter().encode(frame)
    (decoded,) = FrameReader().read(datagram)
    assert isinstance(decoded, StateFrame)
    (threat,) = decoded.threats
    shift_m = math.dist(centre, (threat.north_m, threat.east_m))
    slack_m = 2.0 * resolution_m(datagram)
    for true_m, got_m in ((detection_m, threat.detection_radius_m), (attack_m, threat.attack_radius_m)):
        assert true_m + shift_m <= got_m + 1e-6
        assert got_m <= true_m + shift_m + slack_m / 2.0 + 1e-6


@given(st.floats(0.0, 855.0))
def test_the_speed_bound_of_a_threat_is_rounded_up(bound_m_s: float) -> None:
    frame = state_of(threats=(ThreatEntry(5, 0.0, 0.0, 2.0, 1.0, bound_m_s),))
    (threat,) = state_through(frame).threats
    step_m_s = 1.0 if bound_m_s <= 230.0 else 25.0
    assert bound_m_s <= threat.speed_bound_m_s <= bound_m_s + step_m_s


@pytest.mark.parametrize("bound_m_s", [855.1, -1.0, math.nan, math.inf])
def test_a_speed_bound_that_does_not_fit_is_refused_not_clipped(bound_m_s: float) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(state_of(threats=(ThreatEntry(5, 0.0, 0.0, 2.0, 1.0, bound_m_s),)))


@pytest.mark.parametrize(("detection_m", "attack_m"), [(5.0, 6.0), (5.0, 0.0), (5.0, -1.0), (math.nan, 1.0)])
def test_radii_out_of_order_are_refused(detection_m: float, attack_m: float) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(state_of(threats=(ThreatEntry(5, 0.0, 0.0, detection_m, attack_m, 0.0),)))


# Ids and counts


@given(identities, st.sets(st.integers(0, ID_SPAN - 1), min_size=1, max_size=AGENTS_PER_FRAME))
def test_ids_anywhere_in_16_bits_return(base: int, offsets: set[int]) -> None:
    ids = sorted(base + offset for offset in offsets if base + offset <= 65_535)
    assume(ids)
    frame = state_of(
        agents=tuple(AgentEntry(identity, 0.0, 0.0, None) for identity in ids),
        targets=tuple(TargetEntry(identity, 0.0, 0.0) for identity in ids[:TARGETS_PER_FRAME]),
        threats=tuple(ThreatEntry(identity, 0.0, 0.0, 2.0, 1.0, 0.0) for identity in ids[:THREATS_PER_FRAME]),
    )
    decoded = state_through(frame)
    assert [agent.id for agent in decoded.agents] == ids
    assert [target.id for target in decoded.targets] == ids[:TARGETS_PER_FRAME]
    assert [threat.id for threat in decoded.threats] == ids[:THREATS_PER_FRAME]


@pytest.mark.parametrize("kind", ["agents", "targets", "threats"])
def test_ids_at_the_ends_of_the_span_fit_and_beyond_it_are_refused(kind: str) -> None:
    def frame(distance: int) -> StateFrame:
        ids = (100, 100 + distance)
        entries: dict[str, object] = {
            "agents": tuple(AgentEntry(i, 0.0, 0.0, None) for i in ids),
            "targets": tuple(TargetEntry(i, 0.0, 0.0) for i in ids),
            "threats": tuple(ThreatEntry(i, 0.0, 0.0, 2.0, 1.0, 0.0) for i in ids),
        }
        return state_of(**{kind: entries[kind]})

    state_through(frame(ID_SPAN - 1))
    with pytest.raises(WireError, match="too far apart"):
        FrameWriter().encode(frame(ID_SPAN))


@pytest.mark.parametrize("identity", [-1, 65_536])
def test_an_id_beyond_16_bits_is_refused(identity: int) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(state_of(agents=(AgentEntry(identity, 0.0, 0.0, None),)))


def test_an_id_given_twice_is_refused() -> None:
    with pytest.raises(WireError, match="twice"):
        FrameWriter().encode(state_of(agents=(AgentEntry(1, 0.0, 0.0, None), AgentEntry(1, 5.0, 0.0, None))))


@pytest.mark.parametrize(
    "frame",
    [
        state_of(agents=tuple(AgentEntry(k, 0.0, 0.0, None) for k in range(AGENTS_PER_FRAME + 1))),
        state_of(targets=tuple(TargetEntry(k, 0.0, 0.0) for k in range(TARGETS_PER_FRAME + 1))),
        state_of(threats=tuple(ThreatEntry(k, 0.0, 0.0, 2.0, 1.0, 0.0) for k in range(THREATS_PER_FRAME + 1))),
        replace(SMALL_MOTION, agents=tuple(AgentMotion(k, 0.0, 0.0, 0.0) for k in range(AGENTS_PER_FRAME + 1))),
        replace(SMALL_MOTION, targets=tuple(PointMotion(k, 0.0, 0.0, 0.0) for k in range(TARGETS_PER_FRAME + 1))),
        replace(SMALL_MOTION, threats=tuple(PointMotion(k, 0.0, 0.0, 0.0) for k in range(THREATS_PER_FRAME + 1))),
        replace(SMALL_DETECTIONS, detections=SMALL_DETECTIONS.detections * (DETECTIONS_PER_FRAME + 1)),
        replace(SMALL_BANDS, threats=tuple(BandEntry(k, 0.0, 1.0) for k in range(BANDS_PER_FRAME + 1))),
    ],
    ids=["agents", "targets", "threats", "agent motions", "target motions", "threat motions", "detections", "bands"],
)
def test_more_entries_than_a_frame_holds_are_refused(frame: Frame) -> None:
    with pytest.raises(WireError, match="a frame holds"):
        FrameWriter().encode(frame)


def test_an_agent_sent_to_a_target_the_frame_lacks_is_refused() -> None:
    with pytest.raises(WireError, match="which the frame lacks"):
        FrameWriter().encode(state_of(agents=(AgentEntry(1, 0.0, 0.0, 2),)))


NOT_FITTING: list[Frame] = [
    replace(SMALL_STATE, origin_lat_deg=90.1),
    replace(SMALL_STATE, origin_lon_deg=-180.1),
    replace(SMALL_STATE, origin_lat_deg=math.nan),
    replace(SMALL_STATE, stamp=replace(STAMP, epoch_s=2**32)),
    replace(SMALL_STATE, stamp=replace(STAMP, time_ms=-1)),
    replace(SMALL_STATE, stamp=replace(STAMP, frame_index=2)),
    replace(SMALL_STATE, stamp=replace(STAMP, frame_count=256)),
    state_of(agents=(AgentEntry(1, math.nan, 0.0, None),)),
    state_of(agents=(AgentEntry(1, 0.0, math.inf, None),)),
    state_of(agents=(AgentEntry(1, 1e9, 0.0, None),)),
    replace(SMALL_MOTION, agents=(AgentMotion(1, math.nan, 0.0, 0.0),)),
    replace(SMALL_MOTION, agents=(AgentMotion(1, 0.0, 656.0, 0.0),)),
    replace(SMALL_MOTION, agents=(AgentMotion(1, 0.0, math.nan, 0.0),)),
    replace(SMALL_MOTION, agents=(AgentMotion(1, 0.0, 1.0, -1.0),)),
    replace(SMALL_MOTION, targets=(PointMotion(1, 0.0, math.nan, 0.0),)),
    replace(SMALL_MOTION, threats=(PointMotion(1, 0.0, 0.0, math.nan),)),
    replace(SMALL_MOTION, stamp=replace(STAMP, frame_count=0)),
    replace(SMALL_BANDS, threats=(BandEntry(1, 5.0, 5.0),)),
    replace(SMALL_BANDS, threats=(BandEntry(1, 10.9, 10.1),)),
    replace(SMALL_BANDS, threats=(BandEntry(1, math.nan, None),)),
    replace(SMALL_BANDS, threats=(BandEntry(1, None, math.nan),)),
    replace(SMALL_BANDS, threats=(BandEntry(1, -32_767.5, None),)),
    replace(SMALL_BANDS, threats=(BandEntry(1, None, 32_766.5),)),
    replace(SMALL_BANDS, threats=(BandEntry(65_536, 0.0, None),)),
    replace(SMALL_BANDS, stamp=replace(STAMP, frame_index=2)),
    replace(SMALL_DETECTIONS, detections=(Detection(Kind.AGENT, 1, 3e7, 0.0, 0.0, 0.0),)),
    replace(SMALL_DETECTIONS, detections=(Detection(Kind.AGENT, 1, math.nan, 0.0, 0.0, 0.0),)),
    replace(SMALL_DETECTIONS, detections=(Detection(Kind.AGENT, 65_536, 0.0, 0.0, 0.0, 0.0),)),
    replace(SMALL_DETECTIONS, origin_lon_deg=math.inf),
    replace(SMALL_REPORT, lat_deg=90.000001),
    replace(SMALL_REPORT, lat_deg=math.nan),
    replace(SMALL_REPORT, lon_deg=-180.000001),
    replace(SMALL_REPORT, lon_deg=math.inf),
    replace(SMALL_REPORT, flown_m=-1.5),
    replace(SMALL_REPORT, flown_m=2.0**32),
    replace(SMALL_REPORT, flown_m=math.nan),
    replace(SMALL_REPORT, velocity_north_m_s=math.nan),
    replace(SMALL_REPORT, velocity_east_m_s=math.inf),
    replace(SMALL_REPORT, agent_id=65_536),
    replace(SMALL_REPORT, agent_id=-1),
    replace(SMALL_REPORT, epoch_s=2**32),
    replace(SMALL_REPORT, time_ms=-1),
]


@pytest.mark.parametrize("frame", NOT_FITTING)
def test_a_value_that_fits_no_field_is_a_wire_error(frame: Frame) -> None:
    with pytest.raises(WireError):
        FrameWriter().encode(frame)


numbers = st.one_of(st.floats(), st.floats(-1e3, 1e3))


@pytest.mark.slow
@given(
    st.builds(
        StateFrame,
        stamp=st.builds(Stamp, *[st.integers(-1, 2**33)] * 3, st.integers(-1, 4), st.integers(-1, 300)),
        origin_lat_deg=numbers,
        origin_lon_deg=numbers,
        directive=st.sampled_from(Directive),
        agents=st.lists(
            st.builds(
                AgentEntry, st.integers(-1, 9), st.none() | numbers, st.none() | numbers, st.none() | st.integers(0, 3)
            ),
            max_size=11,
        ).map(tuple),
        targets=st.lists(st.builds(TargetEntry, st.integers(0, 9), numbers, numbers), max_size=6).map(tuple),
        threats=st.lists(st.builds(ThreatEntry, st.integers(0, 9), *[numbers] * 5), max_size=5).map(tuple),
    )
    | st.builds(
        MotionFrame,
        stamp=st.builds(Stamp, st.just(1), st.just(2), st.just(3), st.integers(-1, 4), st.integers(-1, 5)),
        agents=st.lists(
            st.builds(AgentMotion, st.integers(0, 9), st.none() | numbers, numbers, numbers), max_size=11
        ).map(tuple),
        targets=st.lists(st.builds(PointMotion, st.integers(0, 9), *[numbers] * 3), max_size=6).map(tuple),
        threats=st.lists(st.builds(PointMotion, st.integers(0, 9), *[numbers] * 3), max_size=5).map(tuple),
    )
    | st.builds(
        BandsFrame,
        stamp=st.builds(Stamp, st.just(1), st.just(2), st.just(3), st.integers(-1, 4), st.integers(-1, 5)),
        threats=st.lists(
            st.builds(BandEntry, st.integers(-1, 9), *[st.none() | numbers | st.floats(-4e4, 4e4)] * 2),
            max_size=BANDS_PER_FRAME + 1,
        ).map(tuple),
    )
    | st.builds(ReportFrame, *[st.integers(-1, 2**33)] * 2, st.integers(-1, 70_000), *[numbers] * 5)
)
def test_what_can_be_encoded_is_accepted_and_the_rest_is_a_wire_error(frame: Frame) -> None:
    try:
        datagram = FrameWriter().encode(frame)
    except WireError:
        return
    reader = FrameReader()
    assert len(reader.read(datagram)) == 1
    assert reader.rejected.total() == 0


# Motions


@given(st.floats(-10.0, 10.0))
def test_a_heading_returns_within_half_a_hundredth_of_a_degree_in_zero_to_a_full_turn(heading_rad: float) -> None:
    (agent,) = motion_through(replace(SMALL_MOTION, agents=(AgentMotion(1, heading_rad, 1.0, 0.0),))).agents
    assert agent.heading_rad is not None
    assert 0.0 <= agent.heading_rad < math.tau
    assert abs(math.remainder(agent.heading_rad - heading_rad, math.tau)) <= math.radians(0.005) + 1e-9


@pytest.mark.slow
@given(st.floats(0.0, 655.0), st.floats(-327.0, 327.0))
def test_speeds_return_within_half_a_centimetre_per_second(speed_m_s: float, velocity_m_s: float) -> None:
    decoded = motion_through(
        replace(
            SMALL_MOTION,
            agents=(AgentMotion(1, 0.0, speed_m_s, 0.0),),
            targets=(PointMotion(2, velocity_m_s, -velocity_m_s, 0.0),),
        )
    )
    assert abs(decoded.agents[0].speed_m_s - speed_m_s) <= 0.005 + 1e-9
    assert abs(decoded.targets[0].velocity_north_m_s - velocity_m_s) <= 0.005 + 1e-9
    assert abs(decoded.targets[0].velocity_east_m_s + velocity_m_s) <= 0.005 + 1e-9


def test_a_velocity_beyond_the_field_is_clipped_to_it() -> None:
    (target,) = motion_through(replace(SMALL_MOTION, targets=(PointMotion(2, 900.0, -900.0, 0.0),))).targets
    assert (target.velocity_north_m_s, target.velocity_east_m_s) == (327.67, -327.67)


@given(st.floats(0.0, 25.5), st.floats(0.0, 6_553.5))
def test_ages_are_rounded_up(agent_s: float, point_s: float) -> None:
    decoded = motion_through(
        replace(
            SMALL_MOTION,
            agents=(AgentMotion(1, 0.0, 0.0, agent_s),),
            targets=(PointMotion(2, 0.0, 0.0, point_s),),
            threats=(PointMotion(3, 0.0, 0.0, point_s),),
        )
    )
    for sent_s, got_s in (
        (agent_s, decoded.agents[0].age_s),
        (point_s, decoded.targets[0].age_s),
        (point_s, decoded.threats[0].age_s),
    ):
        assert sent_s - 1e-6 <= got_s <= sent_s + 0.1 + 1e-6


@pytest.mark.parametrize("age_s", [25.6, 1e6, math.inf])
def test_a_great_age_stays_the_greatest_the_field_holds(age_s: float) -> None:
    decoded = motion_through(
        replace(
            SMALL_MOTION,
            agents=(AgentMotion(1, 0.0, 0.0, age_s),),
            threats=(PointMotion(3, 0.0, 0.0, age_s * 1e6),),
        )
    )
    assert (decoded.agents[0].age_s, decoded.threats[0].age_s) == (25.5, 6_553.5)


# Reports


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    identities,
    st.tuples(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0)),
    st.tuples(st.floats(-327.0, 327.0), st.floats(-327.0, 327.0)),
    st.floats(0.0, 4e9),
)
def test_a_report_returns(
    epoch_s: int,
    time_ms: int,
    agent_id: int,
    place_deg: tuple[float, float],
    velocity_m_s: tuple[float, float],
    flown_m: float,
) -> None:
    got = report_through(ReportFrame(epoch_s, time_ms, agent_id, *place_deg, *velocity_m_s, flown_m))
    assert (got.epoch_s, got.time_ms, got.agent_id) == (epoch_s, time_ms, agent_id)
    assert got.unix_s == epoch_s + time_ms / 1000.0
    assert (got.lat_deg, got.lon_deg) == pytest.approx(place_deg, abs=0.6e-7)
    assert (got.velocity_north_m_s, got.velocity_east_m_s) == pytest.approx(velocity_m_s, abs=0.005 + 1e-9)
    assert flown_m <= got.flown_m <= flown_m + 1.0


def test_a_report_is_small() -> None:
    assert len(FrameWriter().encode(SMALL_REPORT)) == 38


def test_a_reported_velocity_beyond_the_field_is_clipped_to_it() -> None:
    got = report_through(replace(SMALL_REPORT, velocity_north_m_s=900.0, velocity_east_m_s=-900.0))
    assert (got.velocity_north_m_s, got.velocity_east_m_s) == (327.67, -327.67)


@pytest.mark.parametrize(("lat_e7", "lon_e7"), [(900_000_001, 0), (-900_000_001, 0), (0, 1_800_000_001), (0, -(2**31))])
def test_a_forged_report_that_is_not_on_earth_is_dropped_and_counted(lat_e7: int, lon_e7: int) -> None:
    message = oneway.MAVLink_oneway_report_message(1, 2, lat_e7, lon_e7, 3, 4, 5, 6)
    reader = FrameReader()
    assert reader.read(bytes(message.pack(oneway.MAVLink(None)))) == []
    assert reader.rejected == {"position out of range": 1}


# Heights that threats reach

levels_m = st.floats(-32_767.0, 32_766.0)


def bands_through(frame: BandsFrame) -> BandsFrame:
    decoded = through(frame)
    assert isinstance(decoded, BandsFrame)
    return decoded


@given(st.none() | levels_m, st.none() | levels_m)
def test_a_decoded_band_holds_the_true_one_and_is_at_most_a_metre_wider_on_each_side(
    floor_m: float | None, ceiling_m: float | None
) -> None:
    assume(floor_m is None or ceiling_m is None or floor_m < ceiling_m)
    (threat,) = bands_through(replace(SMALL_BANDS, threats=(BandEntry(1, floor_m, ceiling_m),))).threats
    assert (threat.floor_m is None, threat.ceiling_m is None) == (floor_m is None, ceiling_m is None)
    if floor_m is not None and threat.floor_m is not None:
        assert floor_m - 1.0 <= threat.floor_m <= floor_m
    if ceiling_m is not None and threat.ceiling_m is not None:
        assert ceiling_m <= threat.ceiling_m <= ceiling_m + 1.0


def test_a_full_frame_of_bands_fits_with_both_signatures() -> None:
    full = replace(SMALL_BANDS, threats=tuple(BandEntry(1_000 + k, -5.0, 9.0) for k in range(BANDS_PER_FRAME)))
    assert bands_through(full) == full
    assert len(with_signature(FrameWriter().encode(full))) + 13 <= 252


def forged_bands(**fields: object) -> bytes:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(FrameWriter().encode(SMALL_BANDS)))
    values = {name: getattr(message, name) for name in message.fieldnames} | fields
    return bytes(oneway.MAVLink_oneway_bands_message(**values).pack(oneway.MAVLink(None)))


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"threat_floor": [2_000] * 20}, "band out of range"),
        ({"threat_floor": [800] * 20}, "band out of range"),
        ({"threat_floor": [32_767] * 20}, "band out of range"),
        ({"threat_ceiling": [-32_768] * 20}, "band out of range"),
        ({"threat_count": 21}, "count out of range"),
        ({"threat_id": [1] * 20}, "ids out of range"),
        ({"threat_id_base": 65_535}, "ids out of range"),
        ({"frame_count": 1}, "frame index out of range"),
    ],
)
def test_a_band_that_makes_no_sense_is_dropped_and_counted_by_its_reason(
    fields: dict[str, object], reason: str
) -> None:
    reader = FrameReader()
    assert reader.read(forged_bands(**fields)) == []
    assert reader.rejected == {reason: 1}


def test_what_follows_the_entries_in_use_may_be_anything() -> None:
    (frame,) = FrameReader().read(forged_bands(threat_floor=[450, -32_768, -4] + [32_767] * 17))
    assert isinstance(frame, BandsFrame)
    assert [threat.id for threat in frame.threats] == [9, 10, 200]


# Agents whose place nobody knows

maybe_places = st.none() | st.tuples(coordinates_m, coordinates_m)


@pytest.mark.slow
@given(st.lists(maybe_places, min_size=1, max_size=AGENTS_PER_FRAME))
def test_an_agent_without_a_place_returns_without_one_beside_those_that_have_one(
    places: list[tuple[float, float] | None],
) -> None:
    entries = [
        AgentEntry(k, None, None, None) if place is None else AgentEntry(k, place[0], place[1], None)
        for k, place in enumerate(places)
    ]
    decoded = state_through(state_of(resolution_cm=611, agents=tuple(entries)))
    for sent, got in zip(places, decoded.agents, strict=True):
        if sent is None:
            assert got.position_ned_m is None
        else:
            assert got.position_ned_m == pytest.approx(sent, abs=5.0)


@given(coordinates_m, coordinates_m)
def test_no_place_on_the_plane_is_mistaken_for_an_unknown_one(north_m: float, east_m: float) -> None:
    (agent,) = state_through(state_of(resolution_cm=611, agents=(AgentEntry(1, north_m, east_m, None),))).agents
    assert agent.position_ned_m is not None


@pytest.mark.parametrize("half", ["agent_north", "agent_east"])
def test_half_a_place_is_dropped_and_counted(half: str) -> None:
    reader = FrameReader()
    assert reader.read(forged_state(**{half: [-32_768] + [5] * 9})) == []
    assert reader.rejected == {"half a position": 1}


@pytest.mark.parametrize(("north_m", "east_m"), [(None, 5.0), (5.0, None), (None, None)])
def test_an_entry_with_less_than_a_place_has_none(north_m: float | None, east_m: float | None) -> None:
    entry = AgentEntry(1, north_m, east_m, None)
    assert entry.position_ned_m is None
    assert state_through(state_of(agents=(entry,))).agents == (AgentEntry(1, None, None, None),)


# Hostile bytes

GENUINE = [bytes.fromhex(datagram) for _, datagram in GOLDEN] + [with_signature(FrameWriter().encode(paper_state()))]


def read_and_count(datagram: bytes) -> tuple[list[Frame], int]:
    reader = FrameReader()
    return reader.read(datagram), reader.rejected.total()


@given(st.binary(max_size=600) | st.binary(max_size=280).map(lambda data: b"\xfd" + data))
def test_random_bytes_are_dropped_and_counted(datagram: bytes) -> None:
    frames, rejected = read_and_count(datagram)
    assert frames == []
    assert rejected >= 1


@given(st.sampled_from(GENUINE), st.data())
def test_a_frame_cut_short_is_dropped_and_counted(datagram: bytes, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(datagram) - 1))
    frames, rejected = read_and_count(datagram[:cut])
    assert frames == []
    assert rejected >= 1


@given(st.sampled_from(GENUINE), st.data())
def test_a_frame_with_one_damaged_byte_is_dropped_and_counted(datagram: bytes, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(datagram) - 1))
    mutated = bytearray(datagram)
    mutated[place] ^= data.draw(st.integers(1, 255))
    frames, rejected = read_and_count(bytes(mutated))
    assert frames == []
    assert rejected >= 1


def all_finite(frame: Frame) -> bool:
    def numbers_in(value: object) -> list[float]:
        if isinstance(value, tuple):
            return [number for item in value for number in numbers_in(item)]
        if hasattr(value, "__dataclass_fields__"):
            return [number for name in value.__dataclass_fields__ for number in numbers_in(getattr(value, name))]
        return [value] if isinstance(value, int | float) else []

    return all(map(math.isfinite, numbers_in(frame)))


@pytest.mark.slow
@settings(max_examples=300)
@given(st.sampled_from(GENUINE), st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=40))
def test_a_forged_frame_with_a_good_checksum_is_sensible_or_dropped(
    datagram: bytes, changes: list[tuple[int, int]]
) -> None:
    forged = bytearray(datagram)
    for place, value in changes:
        forged[10 + place % (len(forged) - 12)] = value
    frames, rejected = read_and_count(with_good_crc(bytes(forged)))
    assert len(frames) + rejected == 1
    assert all(map(all_finite, frames))
    for frame in frames:
        if isinstance(frame, StateFrame):
            known = {target.id for target in frame.targets}
            assert {agent.target_id for agent in frame.agents} <= known | {None}
            assert all(0 < t.attack_radius_m <= t.detection_radius_m for t in frame.threats)
            assert abs(frame.origin_lat_deg) <= 90.0
            assert abs(frame.origin_lon_deg) <= 180.0
            assert len({agent.id for agent in frame.agents}) == len(frame.agents)
            assert all((agent.north_m is None) == (agent.east_m is None) for agent in frame.agents)
        if isinstance(frame, BandsFrame):
            limits = [
                (-math.inf if t.floor_m is None else t.floor_m, math.inf if t.ceiling_m is None else t.ceiling_m)
                for t in frame.threats
            ]
            assert all(floor_m < ceiling_m for floor_m, ceiling_m in limits)
        if isinstance(frame, ReportFrame):
            assert abs(frame.lat_deg) <= 90.0
            assert abs(frame.lon_deg) <= 180.0
            assert frame.flown_m >= 0.0


def forged_state(**fields: object) -> bytes:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(GENUINE[-1]))
    values = {name: getattr(message, name) for name in message.fieldnames} | fields
    return bytes(oneway.MAVLink_oneway_state_message(**values).pack(oneway.MAVLink(None)))


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"directive": 3}, "unknown directive"),
        ({"resolution": 0}, "resolution is zero"),
        ({"agent_count": 11}, "count out of range"),
        ({"threat_count": 5}, "count out of range"),
        ({"target_count": 4}, "assigned to a target that is not there"),
        ({"agent_target": [0x80 | 6] * 10}, "assigned to a target that is not there"),
        ({"agent_target": [0xC1] * 10}, "unknown directive"),
        ({"frame_index": 2}, "frame index out of range"),
        ({"frame_count": 0}, "frame index out of range"),
        ({"origin_lat": 900_000_001}, "origin out of range"),
        ({"origin_lon": -1_800_000_001}, "origin out of range"),
        ({"agent_id_base": 65_535}, "ids out of range"),
        ({"agent_id": [1] * 10}, "ids out of range"),
        ({"threat_attack": [65_535] * 4}, "radii out of range"),
        ({"threat_attack": [0] * 4}, "radii out of range"),
    ],
)
def test_a_field_that_makes_no_sense_is_counted_by_its_reason(fields: dict[str, object], reason: str) -> None:
    reader = FrameReader()
    assert reader.read(forged_state(**fields)) == []
    assert reader.rejected == {reason: 1}


@given(st.lists(st.sampled_from(Directive), min_size=2, max_size=2))
def test_a_directive_for_one_agent_returns_beside_its_target_and_makes_the_frame_no_longer(
    own: list[Directive],
) -> None:
    agents = tuple(replace(agent, directive=word) for agent, word in zip(SMALL_STATE.agents, own, strict=True))
    directed = replace(SMALL_STATE, agents=agents)
    decoded = state_through(directed)
    assert [(agent.target_id, agent.directive) for agent in decoded.agents] == [(42, own[0]), (None, own[1])]
    assert len(FrameWriter().encode(directed)) <= len(FrameWriter().encode(SMALL_STATE)) + 1


@given(st.sampled_from(Directive), st.booleans())
def test_the_last_broadcast_says_so_beside_its_directive_and_is_no_longer(directive: Directive, is_last: bool) -> None:
    frame = replace(SMALL_STATE, directive=directive)
    told = replace(frame, is_last=is_last)
    assert state_through(told) == replace(state_through(frame), is_last=is_last)
    assert len(FrameWriter().encode(told)) == len(FrameWriter().encode(frame))


def test_the_bytes_of_directives_for_single_agents_are_pinned() -> None:
    agents = tuple(
        replace(agent, directive=own)
        for agent, own in zip(SMALL_STATE.agents, (Directive.RETURN, Directive.HOLD), strict=True)
    )
    plain, directed = (FrameWriter().encode(replace(SMALL_STATE, agents=told)) for told in (SMALL_STATE.agents, agents))
    assert plain[-3:-2].hex() == "01"
    assert directed[-4:-2].hex() == "8140"


def test_a_genuine_frame_under_the_same_forging_is_accepted() -> None:
    assert len(FrameReader().read(forged_state())) == 1


def test_two_frames_in_one_datagram_are_both_read_in_order() -> None:
    frames, rejected = read_and_count(GENUINE[0] + GENUINE[1])
    assert [type(frame) for frame in frames] == [StateFrame, MotionFrame]
    assert rejected == 0


@pytest.mark.parametrize("junk", [b"\xfd\xff\x01", b"\xfd" * 9, GENUINE[0][:20], b"\xfe\xff\x01", b""])
def test_a_datagram_of_junk_does_not_swallow_the_next(junk: bytes) -> None:
    reader = FrameReader()
    assert reader.read(junk) == []
    assert len(reader.read(GENUINE[0])) == 1
    assert reader.rejected.total() >= 1


def test_a_frame_after_junk_in_the_same_datagram_is_read() -> None:
    frames, rejected = read_and_count(b"junk" + GENUINE[0])
    assert len(frames) == 1
    assert rejected >= 1


def test_a_public_message_is_counted_as_foreign() -> None:
    reader = FrameReader()
    mav = oneway.MAVLink(None)
    assert reader.read(bytes(mav.heartbeat_encode(2, 3, 81, 0, 4).pack(mav))) == []
    assert reader.rejected == {"foreign": 1}


def test_a_frame_with_mavlinks_own_signature_is_read() -> None:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(GENUINE[0]))
    signing = oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)
    signing.signing.secret_key = bytes(range(32))
    signing.signing.sign_outgoing = True
    (frame,) = FrameReader().read(bytes(message.pack(signing)))
    assert frame == through(SMALL_STATE)


def test_the_time_of_a_frame_is_its_epoch_and_the_time_since() -> None:
    assert STAMP.unix_s == 1_790_000_012.345
