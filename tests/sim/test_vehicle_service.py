"""The real process on real sockets, met by MAVSDK as a user's program would."""

from __future__ import annotations

import asyncio
import math
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from click.testing import CliRunner
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.offboard import VelocityNedYaw
from mavsdk.plugins.telemetry import FlightMode
from pymavlink.dialects.v20 import common

from companion.errors import InputError
from companion.geo.air_density import true_per_indicated
from companion.protocol.v2_extension import wrap
from companion.transport.endpoints import Link
from sim.vehicle_service import VehicleOptions, run_vehicle, vehicle
from sim.vehicles import Truth
from tests.ports import free_port

pytestmark = pytest.mark.slow

LOCALHOST = "127.0.0.1"
RUN_VEHICLE = (
    "from companion.errors import run_program; from sim.vehicle_service import vehicle; run_program(vehicle, 's')"
)


@contextmanager
def vehicle_process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", RUN_VEHICLE, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


async def until(condition: Callable[[], Awaitable[bool]], within_s: float) -> None:
    async def poll() -> None:
        while not await condition():
            await asyncio.sleep(0.1)

    await asyncio.wait_for(poll(), within_s)


async def fly_with_mavsdk(port: int) -> list[str]:
    """Fly as a user's program would, and return the stages that were reached."""
    done: list[str] = []
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(configuration) as client:
        await client.add_any_connection(f"udpin://{LOCALHOST}:{port}")
        system = await client.first_autopilot(10.0)
        assert system is not None
        action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)

        async def is_healthy() -> bool:
            return bool(await telemetry.health_all_ok())

        async def is_up() -> bool:
            return bool((await telemetry.position()).relative_altitude_m > 1.5)

        async def flies_east() -> bool:
            velocity = await telemetry.velocity_ned()
            return bool(velocity.east_m_s > 3.6 and abs(velocity.north_m_s) < 0.3)

        async def holds() -> bool:
            return bool((await telemetry.flight_mode()) == FlightMode.HOLD)

        async def is_still() -> bool:
            return bool((await telemetry.velocity_ned()).east_m_s < 0.5)

        await until(is_healthy, 10.0)
        done.append("healthy")
        await action.set_takeoff_altitude(2.0)
        await action.arm()
        await until(telemetry.armed, 3.0)
        done.append("armed")
        await action.takeoff()
        await until(is_up, 10.0)
        done.append("up")
        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 4.0, 0.0, 90.0))
        await offboard.start()
        await until(flies_east, 8.0)
        done.append("flying east")
        await offboard.stop()
        await until(holds, 3.0)
        await until(is_still, 8.0)
        done.append("holding")
        for plugin in (action, offboard, telemetry):
            plugin.destroy()
    return done


def test_mavsdk_arms_takes_off_flies_a_velocity_and_holds() -> None:
    port = free_port()
    with vehicle_process("--autopilot", "arducopter", "--connect", f"udpout:{LOCALHOST}:{port}"):
        stages = asyncio.run(asyncio.wait_for(fly_with_mavsdk(port), 45.0))
    assert stages == ["healthy", "armed", "up", "flying east", "holding"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly_after_one_line(number: signal.Signals) -> None:
    with vehicle_process("--autopilot", "kinematic", "--connect", f"udpout:{LOCALHOST}:{free_port()}") as process:
        assert process.stdout is not None
        first_line = process.stdout.readline()
        process.send_signal(number)
        rest, complaints = process.communicate(timeout=10.0)
    assert first_line.startswith("sim vehicle: kinematic, system 1, on udpout:127.0.0.1:")
    assert (process.returncode, rest, complaints) == (0, "", "")


@pytest.mark.parametrize(
    ("given", "complaint"),
    [
        ("GUID_TIMEOUT=9", "--param: GUID_TIMEOUT=9; allowed: 0.1 to 5"),
        ("GUID_TIMEOUT=nan", "--param: GUID_TIMEOUT=nan; allowed: 0.1 to 5"),
        ("GUIDTIMEOUT=1", "--param: unknown 'GUIDTIMEOUT'"),
        ("GUID_TIMEOUT", "'GUID_TIMEOUT' is not NAME=VALUE"),
    ],
)
def test_a_parameter_that_the_autopilot_would_not_take_ends_with_one_line(given: str, complaint: str) -> None:
    arguments = ["--autopilot", "arducopter", "--connect", f"udpout:{LOCALHOST}:{free_port()}", "--param", given]
    with vehicle_process(*arguments) as process:
        _, said = process.communicate(timeout=20)
    assert process.returncode == 2
    assert complaint in said
    assert len(said.strip().splitlines()) == 1


def test_an_unknown_autopilot_ends_with_one_line_and_status_two() -> None:
    with vehicle_process("--autopilot", "ardukopter", "--connect", "udpout:127.0.0.1:9") as process:
        output, complaints = process.communicate(timeout=20.0)
    assert (process.returncode, output) == (2, "")
    assert complaints == (
        "s: --autopilot: unknown 'ardukopter'; allowed: arducopter, arduplane, px4-copter, px4-plane, kinematic; "
        "did you mean 'arducopter'?\n"
    )


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--connect", "udpp:127.0.0.1:1"], "did you mean 'udpin'"),
        (["--connect", "udpin:127.0.0.1:1", "--lat", "nan"], "nan is not a finite number"),
        (["--connect", "udpin:127.0.0.1:1", "--heading", "inf"], "inf is not a finite number"),
        (["--connect", "udpin:127.0.0.1:1", "--in-air", "nan"], "nan is not a finite number"),
        (["--connect", "udpin:127.0.0.1:1", "--battery", "101"], "101.0 is not in the range"),
        (["--connect", "udpin:127.0.0.1:1", "--lat", "91"], "91.0 is not in the range"),
        (["--connect", "udpin:127.0.0.1:1", "--system-id", "256"], "256 is not in the range"),
        ([], "Missing option '--connect'"),
    ],
)
def test_unusable_options_are_refused(arguments: list[str], complaint: str) -> None:
    outcome = CliRunner().invoke(vehicle, ["--autopilot", "arducopter", *arguments])
    assert outcome.exit_code != 0
    assert complaint in outcome.output + str(outcome.exception)


def test_the_help_shows_an_example() -> None:
    assert "Example: sim vehicle --autopilot arducopter" in CliRunner().invoke(vehicle, ["--help"]).output


class Client(asyncio.DatagramProtocol):
    """Keeps the messages that a vehicle sends."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.systems: set[int] = set()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        parser = common.MAVLink(None)
        parser.robust_parsing = True
        for message in parser.parse_buffer(data) or ():
            self.names.append(message.get_type())
            self.systems.add(message.get_srcSystem())


class Recorder(asyncio.DatagramProtocol):
    """Keeps the newest of some messages."""

    def __init__(self, *names: str) -> None:
        self.names = names
        self.newest: dict[str, Any] = {}

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        for message in common.MAVLink(None).parse_buffer(data) or ():
            if message.get_type() in self.names:
                self.newest[message.get_type()] = message


async def open_client() -> tuple[asyncio.DatagramTransport, Client]:
    return await asyncio.get_running_loop().create_datagram_endpoint(Client, local_addr=(LOCALHOST, 0))


def request_home() -> bytes:
    mav = common.MAVLink(None, srcSystem=255, srcComponent=190)
    command = mav.command_long_encode(7, 1, common.MAV_CMD_REQUEST_MESSAGE, 0, 242, 0, 0, 0, 0, 0, 0)
    return bytes(command.pack(mav))


def test_telemetry_goes_to_every_link_and_an_answer_only_to_who_asked() -> None:
    async def body() -> None:
        stop = asyncio.Event()
        caller_transport, caller = await open_client()
        listener_transport, listener = await open_client()
        called_port = free_port()
        links = (
            Link("udpin", LOCALHOST, called_port),
            Link("udpout", LOCALHOST, listener_transport.get_extra_info("sockname")[1]),
        )
        running = asyncio.create_task(run_vehicle(VehicleOptions("kinematic", links, system_id=7), stop=stop))

        async def both_hear() -> bool:
            caller_transport.sendto(request_home(), (LOCALHOST, called_port))
            return caller.names.count("GLOBAL_POSITION_INT") > 3 and listener.names.count("GLOBAL_POSITION_INT") > 3

        await until(both_hear, 5.0)
        stop.set()
        await running
        assert caller.systems == listener.systems == {7}
        assert "COMMAND_ACK" in caller.names
        assert "COMMAND_ACK" not in listener.names
        caller_transport.close()
        listener_transport.close()

    asyncio.run(body())


def test_a_wrapped_broadcast_passes_between_two_links_once_both_have_spoken() -> None:
    async def body() -> None:
        stop = asyncio.Event()
        radio_transport, _radio = await open_client()
        companion_transport, companion = await open_client()
        ports = free_port(), free_port()
        links = tuple(Link("udpin", LOCALHOST, port) for port in ports)
        running = asyncio.create_task(run_vehicle(VehicleOptions("kinematic", links, system_id=7), stop=stop))
        ground = common.MAVLink(None, srcSystem=255, srcComponent=190)
        heartbeat = common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)

        async def heard() -> bool:
            radio_transport.sendto(wrap(b"a frame of ours", 0), (LOCALHOST, ports[0]))
            companion_transport.sendto(bytes(heartbeat.pack(ground)), (LOCALHOST, ports[1]))
            return "V2_EXTENSION" in companion.names

        await until(heard, 5.0)
        stop.set()
        await running
        radio_transport.close()
        companion_transport.close()

    asyncio.run(body())


@pytest.mark.parametrize(
    ("kind", "mode", "speed_m_s"),
    [("arducopter", 17, 0.0), ("arduplane", 12, 22.0), ("px4-copter", 50593792, 0.0), ("px4-plane", 50593792, 15.0)],
)
def test_in_the_air_it_begins_armed_in_the_mode_that_holds_it_at_cruise_in_the_wind(
    kind: str, mode: int, speed_m_s: float
) -> None:
    async def body() -> None:
        stop = asyncio.Event()
        port = free_port()
        transport, protocol = await asyncio.get_running_loop().create_datagram_endpoint(
            lambda: Recorder("HEARTBEAT", "VFR_HUD", "SYS_STATUS"), local_addr=(LOCALHOST, port)
        )
        options = VehicleOptions(
            kind,
            (Link("udpout", LOCALHOST, port),),
            in_air_m=80.0,
            wind_from_deg=270.0,
            wind_speed_m_s=2.0,
            battery_percent=40.0,
        )
        running = asyncio.create_task(run_vehicle(options, stop=stop))

        async def told() -> bool:
            return len(protocol.newest) == 3

        await until(told, 5.0)
        stop.set()
        await running
        transport.close()
        heartbeat, hud = protocol.newest["HEARTBEAT"], protocol.newest["VFR_HUD"]
        assert (heartbeat.custom_mode, heartbeat.base_mode & 128) == (mode, 128)
        assert hud.alt == pytest.approx(580.0, abs=2.0)
        # A copter stands over the ground; a plane that heads north is carried east.
        true_m_s = speed_m_s * true_per_indicated(580.0)
        assert hud.groundspeed == pytest.approx(math.hypot(true_m_s, 2.0) if speed_m_s else 0.0, abs=0.1)
        assert protocol.newest["SYS_STATUS"].battery_remaining == 40

    asyncio.run(body())


def test_the_truth_is_told_once_a_second_in_real_time() -> None:
    async def body() -> None:
        told: list[tuple[float, Truth]] = []
        stop = asyncio.Event()

        def on_truth(t_unix_s: float, truth: Truth) -> None:
            told.append((t_unix_s, truth))
            if len(told) == 3:
                stop.set()

        options = VehicleOptions("kinematic", (Link("udpout", LOCALHOST, free_port()),), alt_m=300.0, speed_m_s=30.0)
        await asyncio.wait_for(run_vehicle(options, stop=stop, on_truth=on_truth), 15.0)
        assert told[2][0] - told[0][0] == pytest.approx(2.0, abs=0.5)
        assert told[0][1] == Truth(0.0, 0.0, 400.0, 0.0, 30.0)

    asyncio.run(body())


def test_a_port_in_use_is_an_input_error_that_frees_the_other_links() -> None:
    async def body() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as owner:
            owner.bind((LOCALHOST, 0))
            other = Link("udpin", LOCALHOST, free_port())
            taken = Link("udpin", LOCALHOST, owner.getsockname()[1])
            with pytest.raises(InputError, match="is in use"):
                await run_vehicle(VehicleOptions("arducopter", (other, taken)))
            await asyncio.sleep(0.0)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
                again.bind((LOCALHOST, other.port))

    asyncio.run(body())


def test_a_vehicle_hears_the_transponder_of_another_if_it_has_a_receiver() -> None:
    async def body() -> set[bytes]:
        receiver, port = free_port(), free_port()
        callsigns: set[bytes] = set()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as companion:
            companion.bind((LOCALHOST, port))
            companion.setblocking(False)
            seen = VehicleOptions(
                "px4-copter",
                (Link("udpout", LOCALHOST, free_port()),),
                system_id=9,
                adsb_to=(Link("udpout", LOCALHOST, receiver),),
            )
            seeing = VehicleOptions(
                "px4-copter", (Link("udpout", LOCALHOST, port),), adsb_from=Link("udpin", LOCALHOST, receiver)
            )
            stop = asyncio.Event()
            tasks = [asyncio.create_task(run_vehicle(options, stop=stop)) for options in (seeing, seen)]
            loop = asyncio.get_running_loop()

            async def listen() -> None:
                while not callsigns:
                    for message in common.MAVLink(None).parse_buffer(await loop.sock_recv(companion, 2048)) or ():
                        if message.get_type() == "ADSB_VEHICLE" and message.get_srcSystem() == 1:
                            callsigns.add(message.callsign.encode())

            await asyncio.wait_for(listen(), 20.0)
            stop.set()
            await asyncio.gather(*tasks)
        return callsigns

    assert asyncio.run(body()) == {b"OW00009"}
