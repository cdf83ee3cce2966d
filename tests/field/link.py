"""Situations of the autopilot's link: others speak on it, frames come twice, late or in pieces, or nobody answers."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.offboard import is_setpoint
from companion.onboard.companion import Companion
from companion.onboard.decision import Purpose
from companion.onboard.flight_log import FlightLog
from companion.onboard.inputs import AutopilotInput
from companion.onboard.recording import RecordedCompanion
from companion.runtime.clock import SteadyClock
from companion.transport.endpoints import open_duplex, parse_link
from tests.field.rig import Rig, config_of
from tests.field.situation import Situation
from tests.ports import free_port

OTHERS_S, END_S = 6.0, 12.0
"""When something happens, and when the flight ends: by then the vehicle was handed over for some seconds."""
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
HOLD = 4 << 16 | 3 << 24
"""PX4's mode HOLD."""
NAMED = "autopilot: {kind: arducopter, link: 'udpin:127.0.0.1:14550', system_id: 1}"


class LinkRig(Rig):
    """A rig on whose link others speak, too; it counts the setpoints."""

    deaf = False
    """Whether nothing of what the companion sends reaches the autopilot."""

    def __init__(self, kind: str = "arducopter") -> None:
        super().__init__(kind)
        self.setpoints_s: list[float] = []
        self.lost = self._seen
        self.frames: list[tuple[float, bytes]] = []
        """Every frame of the autopilot, with its time."""

    def hear(self, message: mavlink.MAVLink_message, system: int, component: int = 1, number: int = 0) -> None:
        """Let the companion hear somebody on the link."""
        link = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        link.seq = number
        self.companion.receive(bytes(message.pack(link)), self.now_s)

    def take_over(self) -> None:
        """Let the person put the vehicle into PX4's HOLD, and never hand it over again."""
        self.pilot = _Nobody()  # type: ignore[assignment]
        self.say(mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 4, 3, 0, 0, 0, 0))

    @property
    def steered_share(self) -> float:
        """Share of the decisions since OTHERS_S that steered."""
        steers = [one.purpose is not Purpose.IDLE for one in self.decisions if one.t_s - self.began_s >= OTHERS_S]
        return sum(steers) / len(steers)

    @property
    def began_s(self) -> float:
        """The time at which the flight began."""
        return self.now_s - self.t_s

    def _seen(self, frame: bytes) -> bool:
        self.frames.append((self.t_s, frame))
        return False

    def _to_autopilot(self, frames: list[bytes]) -> None:
        self.setpoints_s += [self.t_s for frame in frames if is_setpoint(frame)]
        super()._to_autopilot([] if self.deaf else frames)


class _Nobody:
    def orders(self, t_s: float, mode: int) -> list[bytes]:
        return []


def flown_on(rig: LinkRig) -> str:
    """Assert that the vehicle was steered all the time; return so in words."""
    assert rig.steered_share == 1.0, f"steered {rig.steered_share:.0%}: {rig.words()}"
    return "steered on"


def router_first() -> str:
    rig = LinkRig("px4-copter")
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3)
    rig.run(END_S, lambda: rig.hear(beat, 125))
    return flown_on(rig)


def script_undoes_the_lock() -> str:
    rig = LinkRig("px4-copter")
    rig.run(OTHERS_S)
    rig.take_over()
    rig.run(OTHERS_S + 2.0)
    rig.hear(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 12, 0, HOLD, 4, 3), 1)
    rig.run(END_S)
    after = [one for one in rig.setpoints_s if one > OTHERS_S + 2.0]
    assert not after, f"{len(after)} setpoints"
    return "locked, 0 setpoints"


def late_disarmed_heartbeat() -> str:
    rig = LinkRig("px4-copter")
    rig.run(OTHERS_S)
    rig.take_over()
    rig.run(OTHERS_S + 2.0)
    beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 1, HOLD, 4, 3)
    sent_s, first = rig.frames[0]
    rig.hear(beat, 1, number=first[4])
    rig.run(END_S)
    after = [one for one in rig.setpoints_s if one > OTHERS_S + 2.0]
    assert not after, f"{len(after)} setpoints"
    return "locked, 0 setpoints"


def copies(late_s: float, kind: str) -> Callable[[], str]:
    def play() -> str:
        rig, passed = LinkRig(kind), [0]

        def again() -> None:
            while passed[0] < len(rig.frames) and rig.frames[passed[0]][0] + late_s <= rig.t_s:
                rig.companion.receive(rig.frames[passed[0]][1], rig.now_s)
                passed[0] += 1

        rig.run(END_S + late_s, again)
        return flown_on(rig)

    return play


def one_position(ahead_ms: int) -> Callable[[], str]:
    """Return a play in which one position has a clock that is ahead, or behind."""

    def play() -> str:
        rig = LinkRig("px4-copter")
        rig.run(OTHERS_S)
        told = rig.companion.adapter.telemetry
        place = round(told.lat_deg * 1e7), round(told.lon_deg * 1e7), 560_000, 60_000
        boot_ms = max(0, (told.boot_ms or 0) + ahead_ms)
        rig.hear(mavlink.MAVLink_global_position_int_message(boot_ms, *place, 0, 0, 0, 0), 1)
        rig.run(END_S)
        return flown_on(rig)

    return play


def clock_begins_again() -> str:
    rig = LinkRig("px4-copter")
    rig.vehicle._telemetry.encoder.boot_s -= (2**32 - 8_000) / 1e3
    rig.run(END_S)
    return flown_on(rig)


def several_autopilots() -> str:
    rig = LinkRig()
    beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, ARMED, 4, 4, 3)

    def another() -> None:
        if round(10 * rig.t_s) % 10 == 5:
            rig.hear(beat, 2, number=round(rig.t_s))

    rig.run(END_S, another)
    assert "systems 1, 2" in rig.last.reason, rig.words()
    return rig.last.reason


def nobody_answers() -> str:
    rig = LinkRig()
    rig.deaf = True
    rig.run(END_S + 4.0)
    assert "answers nothing" in rig.last.reason, rig.words()
    return rig.last.reason


def receiver() -> tuple[RecordedCompanion, AutopilotInput]:
    config = config_of("arducopter")
    assert config.autopilot is not None
    config = config.model_copy(update={"autopilot": config.autopilot.model_copy(update={"system_id": 1})})
    flight = RecordedCompanion(Companion(config), SteadyClock(), FlightLog(None))
    return flight, AutopilotInput(flight, None, None)


def heartbeat(number: int = 0) -> bytes:
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    link.seq = number
    return bytes(mavlink.MAVLink_heartbeat_message(2, 3, ARMED, 4, 4, 3).pack(link))


def cut_by_a_bridge() -> str:
    flight, link = receiver()
    stream = b"".join(heartbeat(number) for number in range(10))
    for at in range(0, len(stream), 16):
        link.receive(stream[at : at + 16])
    telemetry = flight.companion.adapter.telemetry
    assert telemetry.heartbeat_at_s is not None, "nothing heard"
    return "heard"


def stranger_sends_a_byte() -> str:
    return asyncio.run(_stranger_sends_a_byte())


async def _stranger_sends_a_byte() -> str:
    _, heard = receiver()
    port = free_port()
    link = await open_duplex(parse_link(f"udpin:127.0.0.1:{port}"), heard.receive)
    peer = getattr(heard, "peer", None)
    if peer is not None:
        peer.bind = link.bind
    with socket.socket(type=socket.SOCK_DGRAM) as autopilot, socket.socket(type=socket.SOCK_DGRAM) as stranger:
        autopilot.setblocking(False)
        got = 0
        for number in range(20):
            if number % 5 == 0:
                autopilot.sendto(heartbeat(number), ("127.0.0.1", port))
            stranger.sendto(b"a", ("127.0.0.1", port))
            await asyncio.sleep(0.01)
            link.send(b"setpoint")
            await asyncio.sleep(0.005)
            got += _received(autopilot)
    link.close()
    assert got == 20, f"{got} of 20 setpoints reach the autopilot"
    return "20 of 20 setpoints reach the autopilot"


def _received(sock: socket.socket) -> int:
    try:
        return bool(sock.recv(100))
    except BlockingIOError:
        return 0


SITUATIONS: tuple[Situation, ...] = (
    Situation(
        "a router's heartbeat (125/1, generic) is heard first and on",
        "the configured kind is taken, the router is nobody",
        'deaf: "set autopilot.kind to kinematic"',
        router_first,
    ),
    Situation(
        "after a take-over of a PX4 a script sends one heartbeat as 1/1, as an onboard controller",
        "the take-over holds",
        "39 setpoints in 4 s",
        script_undoes_the_lock,
    ),
    Situation(
        "after a take-over of a PX4 a disarmed heartbeat comes 8 s late",
        "the take-over holds",
        "39 setpoints in 4 s",
        late_disarmed_heartbeat,
    ),
    Situation(
        "every frame comes twice, the copy 0.1 s late",
        "steers on",
        'silent: "two autopilots say they are system 1"',
        copies(0.1, "arducopter"),
    ),
    Situation(
        "every frame comes twice, the copy 1.5 s late, to a PX4",
        "steers on",
        'silent and locked: "two autopilots say they are system 1"',
        copies(1.5, "px4-copter"),
    ),
    Situation(
        "every frame comes twice, the copy 10 s late",
        "steers on",
        'silent for 74 % of the time: "two autopilots say they are system 1"',
        copies(10.0, "arducopter"),
    ),
    Situation(
        "one position of a PX4 comes 2 s late",
        "steers on",
        'locked: "autopilot restarted in flight"',
        one_position(-2_000),
    ),
    Situation(
        "one position in a PX4's name has a clock an hour ahead",
        "steers on",
        'locked: "autopilot restarted in flight"',
        one_position(3_600_000),
    ),
    Situation(
        "a PX4's clock begins again after 49.7 days",
        "steers on",
        'locked: "autopilot restarted in flight"',
        clock_begins_again,
    ),
    Situation(
        "two autopilots are on the link and no system id is configured",
        "refused, both named",
        "steers the one that is heard first",
        several_autopilots,
    ),
    Situation(
        "the autopilot is heard and takes nothing (a cut wire, or it takes only signed frames)",
        "not steered, and the cause said",
        'steers, and wonders: "does not gain speed"',
        nobody_answers,
    ),
    Situation(
        "a bridge from a serial line to UDP cuts frames anywhere",
        "heard by `run` as by `check`",
        "`run` hears nothing",
        cut_by_a_bridge,
    ),
    Situation(
        "a stranger sends one byte before each setpoint to the port of the link",
        "every setpoint reaches the autopilot",
        "0 of 20",
        stranger_sends_a_byte,
    ),
)
