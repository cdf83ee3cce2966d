"""The real process on real sockets, met by MAVSDK as a user's program would."""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager

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
from companion.transport import Link
from sim.vehicle import Truth
from sim.vehicle_service import VehicleOptions, run_vehicle, vehicle

LOCALHOST = "127.0.0.1"
RUN_VEHICLE = (
    "from companion.errors import run_program; from sim.vehicle_service import vehicle; run_program(vehicle, 's')"
)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOCALHOST, 0))
        return int(probe.getsockname()[1])


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


def test_an_unknown_autopilot_ends_with_one_line_and_status_two() -> None:
    with vehicle_process("--autopilot", "ardukopter", "--connect", "udpout:127.0.0.1:9") as process:
        output, complaints = process.communicate(timeout=20.0)
    assert (process.returncode, output) == (2, "")
    assert complaints == (
        "s: --autopilot: unknown 'ardukopter'; allowed: arducopter, kinematic; did you mean 'arducopter'?\n"
    )


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--connect", "udpp:127.0.0.1:1"], "did you mean 'udpin'"),
        (["--connect", "udpin:127.0.0.1:1", "--lat", "nan"], "nan is not a finite number"),
        (["--connect", "udpin:127.0.0.1:1", "--heading", "inf"], "inf is not a finite number"),
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
