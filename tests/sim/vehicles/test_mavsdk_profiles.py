"""MAVSDK meets every profile as a user's program would: it connects, sees its health, arms, takes off and flies it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.mavlink_direct import MavlinkMessage
from mavsdk.plugins.offboard import OffboardError, VelocityNedYaw
from mavsdk.plugins.telemetry import FlightMode

from companion.transport.endpoints import parse_link
from sim.vehicle_service import VehicleOptions, run_vehicle
from tests.ports import free_port

pytestmark = pytest.mark.slow

LOCALHOST = "127.0.0.1"
ARDUPLANE_TAKEOFF = 13
COPTER_STAGES = ["healthy", "armed", "up", "flying east", "holding"]
PLANE_STAGES = ["healthy", "armed", "up", "holding"]
WANTED_STAGES = {
    "arducopter": COPTER_STAGES,
    "arduplane": PLANE_STAGES,
    "px4-copter": COPTER_STAGES,
    "px4-plane": PLANE_STAGES,
}
# A plane's way up is longer; 10 m is enough to see that it climbs.
UP_M = {"arducopter": 1.5, "px4-copter": 1.5, "arduplane": 10.0, "px4-plane": 10.0}
WITHIN_S = 20.0


class Client:
    """What a test needs of MAVSDK."""

    def __init__(self, system: Any) -> None:  # noqa: ANN401 (MAVSDK's types are not checked here)
        self.action = ActionAsync(system)
        self.direct = MavlinkDirectAsync(system)
        self.offboard = OffboardAsync(system)
        self.telemetry = TelemetryAsync(system)

    async def ask_for_mode(self, custom_mode: int) -> None:
        """Send DO_SET_MODE as it is: MAVSDK takes off by NAV_TAKEOFF in GUIDED, which ArduPlane refuses."""
        numbers = {f"param{index}": 0.0 for index in range(3, 8)}
        fields = {"target_system": 1, "target_component": 1, "command": 176, "confirmation": 0, **numbers}
        fields |= {"param1": 1.0, "param2": float(custom_mode)}
        await self.direct.send_message(
            MavlinkMessage(
                message_name="COMMAND_LONG",
                system_id=255,
                component_id=190,
                target_system_id=1,
                target_component_id=1,
                fields_json=json.dumps(fields),
            )
        )

    async def healthy(self) -> bool:
        # An ArduPilot that has just been powered is healthy before it would arm.
        return bool(await self.telemetry.health_all_ok()) and bool((await self.telemetry.health()).is_armable)

    async def armed(self) -> bool:
        return bool(await self.telemetry.armed())

    async def flies_east(self) -> bool:
        velocity = await self.telemetry.velocity_ned()
        return bool(velocity.east_m_s > 3.6 and abs(velocity.north_m_s) < 0.3)

    async def holds(self) -> bool:
        return bool(await self.telemetry.flight_mode() == FlightMode.HOLD)

    async def still(self) -> bool:
        return bool((await self.telemetry.velocity_ned()).east_m_s < 0.5)

    async def higher_than(self, height_m: float) -> bool:
        return bool((await self.telemetry.position()).relative_altitude_m > height_m)


async def until(condition: Callable[[], Awaitable[bool]]) -> None:
    while not await condition():
        await asyncio.sleep(0.1)


async def fly(kind: str, client: Client, done: list[str]) -> None:
    """Fly one profile and note the stages that it reaches."""
    await until(client.healthy)
    done.append("healthy")
    await client.action.arm()
    await until(client.armed)
    done.append("armed")
    if kind == "arduplane":
        await client.ask_for_mode(ARDUPLANE_TAKEOFF)
    else:
        await client.action.takeoff()
    await until(lambda: client.higher_than(UP_M[kind]))
    done.append("up")
    if kind.endswith("copter"):
        await client.offboard.set_velocity_ned(VelocityNedYaw(0.0, 4.0, 0.0, 90.0))
        await client.offboard.start()
        await until(client.flies_east)
        done.append("flying east")
        await client.offboard.stop()
        await until(client.still)
    else:
        await client.action.hold()
    await until(client.holds)
    done.append("holding")


async def meet(kind: str) -> list[str]:
    """Start a vehicle and a client for it; return the stages reached, and the error that ended them if one did."""
    port, stop = free_port(), asyncio.Event()
    done: list[str] = []
    options = VehicleOptions(kind, (parse_link(f"udpout:{LOCALHOST}:{port}"),))
    vehicle = asyncio.create_task(run_vehicle(options, stop=stop))
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    try:
        async with Mavsdk(configuration) as mavsdk:
            await mavsdk.add_any_connection(f"udpin://{LOCALHOST}:{port}")
            system = await mavsdk.first_autopilot(10.0)
            client = Client(system)
            try:
                await asyncio.wait_for(fly(kind, client, done), WITHIN_S)
            except (TimeoutError, ActionError, OffboardError) as error:
                done.append(f"{type(error).__name__} {error}")
            for plugin in (client.action, client.direct, client.offboard, client.telemetry):
                plugin.destroy()
    finally:
        stop.set()
        await vehicle
    return done


@pytest.fixture(scope="module")
def stages() -> dict[str, list[str]]:
    """Fly all profiles at once: most of the time is spent waiting for vehicles to climb."""

    async def meet_all() -> dict[str, list[str]]:
        done = await asyncio.gather(*(meet(kind) for kind in WANTED_STAGES))
        return dict(zip(WANTED_STAGES, done, strict=True))

    return asyncio.run(meet_all())


@pytest.mark.parametrize("kind", WANTED_STAGES)
def test_mavsdk_flies_the_profile(kind: str, stages: dict[str, list[str]]) -> None:
    assert stages[kind] == WANTED_STAGES[kind]
