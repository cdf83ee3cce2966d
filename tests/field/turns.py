"""The autopilot first, what anybody may have sent after it, and a computer that stands still: the shell's own loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.onboard.flight_log import FlightLog
from companion.onboard.output import AutopilotOutput
from companion.protocol.frame import ED25519_BYTES
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.v2_extension import wrap
from companion.transport.udp import UdpDuplex
from tests.companion.protocol.hostile import forged_seal
from tests.field.real_loop import PLAYED_S, UNIX_S, RealLoop
from tests.field.rig import Rig
from tests.field.situation import Situation

TAKE_OVER_S = 0.25
"""Longest time from the HEARTBEAT that tells a take-over to the last setpoint."""
GAP_S = 0.3
"""Longest gap between two setpoints."""
SLOW = {"datagram": 0.0003, "telemetry": 0.0003, "decision": 0.005}
"""What the work takes on a small computer, in seconds."""


def _flooded(kind: str = "arducopter", **options: bool) -> RealLoop:
    """Return a flight on a slow computer, taken over 0.8 s after a flood of the broadcast has begun."""
    flight = RealLoop(kind, **options)
    flight.costs_s.update(SLOW)
    flight.take_over(5.8)
    return flight


def _ended(flight: RealLoop) -> str:
    """Assert that setpoints left on their grid until the take-over and ended with it; return the figures."""
    assert flight.taken_s is not None
    from_s, taken_s = 5.0, flight.taken_s
    steered_s = [time_s for time_s in flight.setpoints_s if from_s <= time_s <= taken_s]
    longest_s = float(np.diff([from_s, *steered_s, taken_s]).max())
    after_s = max(0.0, flight.setpoints_s[-1] - taken_s)
    assert longest_s <= GAP_S, f"no setpoint for {longest_s:.1f} s"
    assert after_s <= TAKE_OVER_S, f"a setpoint {after_s:.1f} s after the take-over"
    return f"gaps of at most {1e3 * longest_s:.0f} ms; the last setpoint {1e3 * after_s:.0f} ms after the take-over"


def _junk(kind: str) -> Callable[[], str]:
    def play() -> str:
        flight = _flooded(kind)
        flight.flood(b"x" * 20, 5.0, 6.6)
        flight.run(7.2)
        return _ended(flight)

    return play


def _with_the_key() -> str:
    flight = _flooded()
    signer = MavlinkSigner(flight.ground.mavlink_key, 0)
    raw = flight.ground.unsealed(UNIX_S + 6.0, 1 << 31)
    flight.flood(signer.sign(forged_seal(raw, bytes(ED25519_BYTES)), UNIX_S + 6.0), 5.0, 6.6, 10_000.0)
    flight.costs_s["check"] = 0.001
    flight.run(7.2)
    return _ended(flight)


def _one_radio() -> str:
    flight = _flooded(one_radio=True)
    raw = flight.ground.unsealed(UNIX_S + 6.0, 1 << 31)
    # What a router passes on comes from the autopilot's own address.
    flight.flood_from_autopilot(wrap(raw, 0), 5.0, 6.6, 10_000.0)
    flight.run(7.2)
    return _ended(flight)


def _strangers() -> str:
    flight = _flooded()
    stranger = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
    level = mavlink.MAVLink_attitude_message(1_000_000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    flight.flood(bytes(level.pack(stranger)), 5.0, 6.6, port=flight.autopilot_port)
    flight.run(7.2)
    return _ended(flight)


def _late_slot() -> str:
    flight = RealLoop()
    flight.costs_s.update(SLOW)
    flight.flood(b"x" * 20, 5.0, 6.0, 10_000.0)
    flight.stand_still(5.0, 1.0)
    flight.run(6.6)
    first_s = next(time_s for time_s in flight.setpoints_s if time_s > 5.0 + PLAYED_S)
    after_s = first_s - 6.0
    assert after_s <= 0.1, f"first setpoint {after_s:.1f} s after it went on"
    return f"the first setpoint {1e3 * after_s:.0f} ms after it went on"


def _held_up_while_deciding() -> str:
    flight = RealLoop()
    flight.at(5.0, lambda: flight.costs_s.update(decision=2.0))
    flight.take_over(5.5)
    flight.at(5.6, lambda: flight.costs_s.update(decision=0.0))
    flight.run(8.5)
    assert flight.taken_s is not None
    late_s = max(0.0, flight.setpoints_s[-1] - flight.taken_s)
    assert not late_s, f"a setpoint {late_s:.1f} s after the take-over"
    return "no setpoint after the take-over"


class _Link(UdpDuplex):
    """A link that keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def send(self, datagram: bytes) -> None:
        self.sent.append(datagram)


def _mavsdk_goes_on() -> str:
    rig = Rig("px4-copter")
    rig.run(12.0)
    assert rig.companion.steers
    link = _Link()
    output = AutopilotOutput(rig.companion, link, FlightLog(None), None)
    setpoint = rig.companion.repeat(rig.now_s)[-1]
    output.transmit(setpoint)
    hold = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4.0, 3.0, 0.0, 0.0, 0.0, 0.0)
    rig.say(mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *hold))
    # PX4 tells its mode once a second. The loop has no slot meanwhile, as on a computer that is held up.
    for step in range(1, 25):
        t_s = rig.now_s + step * 0.05
        rig.vehicle.step_to(t_s)
        for frame in rig.vehicle.telemetry(t_s):
            rig.companion.receive(frame, t_s)
    output.transmit(setpoint)
    assert len(link.sent) == 1, "MAVSDK's next setpoint was passed on"
    return "MAVSDK's next setpoint was not passed on"


def _stall_told() -> str:
    flight = RealLoop()
    flight.stand_still(5.02, 3.28)
    flight.run(9.0, logs=True)
    gap_ms = max(float(row["gap_max_ms"]) for row in flight.rows)
    said = next((line for line in flight.said if "stood still" in line), None)
    assert gap_ms >= 3200.0, f"longest gap in the table {gap_ms:.0f} ms"
    assert said is not None and "stood still for 3.2 s" in said, "the stall is not said"
    return f'gap_max_ms {gap_ms:.0f}; "{said}"'


def _stall_locks() -> str:
    flight = RealLoop("px4-copter")
    flight.stand_still(6.52, 7.0)
    flight.run(14.5)
    (summary,) = (line for line in flight.said if "setpoint gaps" in line)
    longest_ms = float(summary.split("longest ")[1].split(" ms")[0])
    assert longest_ms >= 7000.0, summary
    return f'"{summary}"'


def _suspended() -> str:
    flight = RealLoop()
    flight.stand_still(5.02, 60.0, suspended=True)
    flight.silence(5.02)
    flight.run(66.0)
    late_s = [time_s for time_s in flight.setpoints_s if time_s > 10.0]
    assert not late_s, f"{len(late_s)} setpoints on positions from before"
    return "no setpoint on positions from before"


def _flood_told() -> str:
    flight = _flooded()
    flight.flood(b"x" * 20, 5.0, 7.4, 10_000.0)
    flight.run(7.5)
    said = next((line for line in flight.said if "flooded" in line), None)
    assert said is not None, "nothing is said of the flood"
    return f'"{said}"'


_FLOOD = "setpoints every 0.1 s, none 0.25 s after the HEARTBEAT that tells it"

SITUATIONS = (
    *(
        Situation(
            f"20 000 datagrams of junk a second on the broadcast link of a small computer, {kind}: a person takes over",
            _FLOOD,
            "no setpoint for 0.7 s before it already",
            _junk(kind),
        )
        for kind in ("arducopter", "arduplane", "px4-copter", "px4-plane")
    ),
    Situation(
        "10 000 frames a second with the fleet's shared key, whose Ed25519 signatures take 1 ms each to check",
        _FLOOD,
        "no setpoint for 0.7 s before it already",
        _with_the_key,
    ),
    Situation(
        "one radio: 10 000 wrapped frames a second come over the autopilot's own link",
        _FLOOD,
        "setpoints for 1.3 s after it",
        _one_radio,
    ),
    Situation(
        "20 000 frames a second in the autopilot's name come to its link's port from another program",
        _FLOOD,
        "no setpoint for 0.8 s before it already",
        _strangers,
    ),
    Situation(
        "the companion is stopped for 1 s while 10 000 datagrams come on the broadcast link",
        "the next setpoint within 0.1 s after it goes on",
        "3.1 s after it goes on: the late slot worked on everything that waited",
        _late_slot,
    ),
    Situation(
        "a decision takes 2 s (swap, a busy core), and a person takes over meanwhile",
        "its setpoint is not sent",
        "its setpoint was sent 1.5 s after the take-over",
        _held_up_while_deciding,
    ),
    Situation(
        "MAVSDK sends its next setpoint when HEARTBEAT has told the take-over and the loop has not come to it yet",
        "it is not passed on",
        "it was passed on",
        _mavsdk_goes_on,
    ),
    Situation(
        "the companion is stopped for 3.2 s",
        "said with its length, in the table of decisions too",
        "not said; longest gap in the table 100 ms",
        _stall_told,
    ),
    Situation(
        "the companion is stopped for 7 s, after which a PX4 may not be steered",
        "the gap is counted though no setpoint follows it",
        '"55 setpoint gaps, longest 100 ms, none over 0.5 s"',
        _stall_locks,
    ),
    Situation(
        "the computer is suspended for a minute, and the autopilot is silent afterwards",
        "no setpoint on positions from before",
        "9 setpoints on positions that were a minute old",
        _suspended,
    ),
    Situation(
        "10 000 datagrams of junk a second on the broadcast link: what the operator is told",
        "how many came, and how many of them were dropped unread",
        "nothing",
        _flood_told,
    ),
)
