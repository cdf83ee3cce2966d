"""Who is believed on the sensor's link and on the uplink: by key, by stream and by the clock."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.protocol.codec import Detection, DetectionsFrame, FrameWriter, Kind, ReportFrame
from companion.protocol.mavlink_signing import MavlinkSigner
from groundstation.input_keys import vehicle_key
from groundstation.inputs import Inputs, InputTrust, sensor_trust, uplink_trust
from groundstation.refusals import MOST_CAUSES, Refusals

NOW_S = 1_790_000_000.0
KEY, OTHER_KEY, MASTER = bytes(range(32)), bytes(32), bytes(range(100, 132))
KEYS = {agent: vehicle_key(MASTER, agent) for agent in (1, 2)}


def detections() -> bytes:
    seen = (Detection(Kind.THREAT, 1, 10.0, 20.0, 0.0, 0.0),)
    return FrameWriter(254, 191).encode(DetectionsFrame(int(NOW_S), 0, 47.0, 8.0, seen))


def report(agent_id: int) -> bytes:
    return FrameWriter(agent_id, 191).encode(ReportFrame(int(NOW_S), 0, agent_id, 47.0, 8.0, 1.0, 0.0, 5.0))


def inputs(sensor: InputTrust | None = None, uplink: InputTrust | None = None) -> tuple[Inputs, Refusals]:
    refusals = Refusals()
    made = Inputs(refusals)
    made.sensor, made.uplink = sensor or made.sensor, uplink or made.uplink
    return made, refusals


def test_signed_detections_are_believed_once() -> None:
    made, refusals = inputs(sensor_trust(KEY, unsigned=False))
    signed = MavlinkSigner(KEY, 3).sign(detections(), NOW_S)
    assert [len(made.detections(signed, NOW_S)) for _ in range(2)] == [1, 0]
    assert refusals.news(NOW_S) == ["sensor: 1 frames refused: MAVLink time not newer"]


@pytest.mark.parametrize("key", [None, OTHER_KEY])
def test_who_has_not_the_key_is_not_believed(key: bytes | None) -> None:
    made, refusals = inputs(sensor_trust(KEY, unsigned=False))
    raw = detections()
    assert made.detections(raw if key is None else MavlinkSigner(key, 0).sign(raw, NOW_S), NOW_S) == []
    (line,) = refusals.news(NOW_S)
    assert line.startswith(f"sensor: 1 frames refused: {'unsigned' if key is None else 'wrong MAVLink signature'}")


def test_on_this_computers_own_link_unsigned_frames_count_but_no_wrong_signature() -> None:
    made, _ = inputs(sensor_trust(KEY, unsigned=True))
    assert len(made.detections(detections(), NOW_S)) == 1
    assert made.detections(MavlinkSigner(OTHER_KEY, 0).sign(detections(), NOW_S), NOW_S) == []


@pytest.mark.parametrize(("signed_s", "cause"), [(16.0, "+16.0 s"), (-40.0, "-40.0 s")])
def test_a_signature_by_a_wrong_clock_is_refused_with_the_difference(signed_s: float, cause: str) -> None:
    made, refusals = inputs(sensor_trust(KEY, unsigned=False))
    assert made.detections(MavlinkSigner(KEY, 0).sign(detections(), NOW_S + signed_s), NOW_S) == []
    assert f"it is {cause} from this computer's clock" in refusals.news(NOW_S)[0]


def test_a_vehicle_reports_for_itself_and_for_nobody_else() -> None:
    made, _ = inputs(uplink=uplink_trust(KEYS, unsigned=False))
    signer = MavlinkSigner(KEYS[1], 0)
    assert [len(made.reports(signer.sign(report(agent), NOW_S), NOW_S)) for agent in (1, 2, 3)] == [1, 0, 0]


def test_reports_of_one_stream_do_not_shut_out_those_of_another() -> None:
    made, _ = inputs(uplink=uplink_trust(KEYS, unsigned=False))
    ahead = MavlinkSigner(KEYS[1], 0).sign(report(1), NOW_S + 1.9)
    late = MavlinkSigner(KEYS[2], 0).sign(report(2), NOW_S - 5.0)
    assert [len(made.reports(raw, NOW_S)) for raw in (ahead, late)] == [1, 1]


def test_what_is_meant_for_the_other_link_is_refused() -> None:
    made, refusals = inputs()
    assert (made.detections(report(1), NOW_S), made.reports(detections(), NOW_S)) == ([], [])
    assert refusals.total == 2


@settings(max_examples=100)
@given(st.lists(st.binary(max_size=300) | st.binary(max_size=80).map(lambda data: b"\xfd" + data), max_size=5))
def test_whatever_comes_in_nothing_raises_and_nothing_unsigned_is_believed(junk: list[bytes]) -> None:
    made, _ = inputs(sensor_trust(KEY, unsigned=False), uplink_trust(KEYS, unsigned=False))
    for datagram in [*junk, *(detections()[:10] + piece + detections()[10:] for piece in junk)]:
        assert made.detections(datagram, NOW_S) == [] == made.reports(datagram, NOW_S)


def test_any_number_of_causes_takes_a_bounded_table_and_a_line_a_minute_each() -> None:
    refusals = Refusals()
    for cause in range(10 * MOST_CAUSES):
        refusals.add(cause, "{} refused")
    assert len(refusals.news(NOW_S)) == MOST_CAUSES + 1
    refusals.add(1, "{} refused")
    assert refusals.news(NOW_S + 59.0) == []
    assert refusals.news(NOW_S + 60.0) == ["2 refused"]
