"""A client that nobody here wrote flies the simulated vehicle: MAVSDK judges frames, signs and modes."""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing
from typing import Any

import pytest

from tests.helpers.autopilot_peer import free_port
from tests.helpers.commands import VALLEY
from tests.helpers.measured import measured
from tests.helpers.sitl import Ground

mavsdk = pytest.importorskip("mavsdk.asyncio", exc_type=ImportError)
from mavsdk.asyncio.component_type import ComponentType  # noqa: E402
from mavsdk.asyncio.plugins.action import ActionAsync  # noqa: E402
from mavsdk.asyncio.plugins.offboard import (  # noqa: E402
    OffboardAsync,
    OffboardError,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync  # noqa: E402
from mavsdk.plugins.telemetry import FlightMode  # noqa: E402

pytestmark = measured


class Client:
    """What of MAVSDK flies the vehicle."""

    def __init__(self, system: Any) -> None:
        self.telemetry, self.offboard, self.action = (
            kind(system) for kind in (TelemetryAsync, OffboardAsync, ActionAsync)
        )

    async def place(self) -> tuple[float, float, float]:
        """North, east, down."""
        at = (await self.telemetry.position_velocity_ned()).position
        return at.north_m, at.east_m, at.down_m

    async def yaw(self) -> float:
        """From north to the right, degrees."""
        return float((await self.telemetry.attitude_euler()).yaw_deg)

    async def body(self, forward: float = 0.0, right: float = 0.0, down: float = 0.0, yaw_rate: float = 0.0) -> None:
        await self.offboard.set_velocity_body(VelocityBodyYawspeed(forward, right, down, yaw_rate))

    async def moved(self, seconds: float) -> tuple[float, float, float, float]:
        """How far forward, right and down of where it looked, and how many degrees to the right."""
        before, yaw = await self.place(), math.radians(await self.yaw())
        await asyncio.sleep(seconds)
        north, east, down = (now - then for now, then in zip(await self.place(), before, strict=True))
        turned = math.remainder(await self.yaw() - math.degrees(yaw), 360.0)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return cos * north + sin * east, cos * east - sin * north, down, turned


@asynccontextmanager
async def vehicle(*options: str) -> AsyncIterator[Client]:
    """A process of ``uavrl-sitl`` in a small valley without obstacles, with MAVSDK connected to it."""
    ground, port = Ground(), free_port()
    addresses = [f"lidar={ground.addresses[0]}", f"autopilot=udp://127.0.0.1:{port}"]
    command = ["-m", "uavrl.cli.sitl", *VALLEY, "env.world.obstacles=0", *addresses, *options]
    with closing(ground):
        process = await asyncio.create_subprocess_exec(sys.executable, *command)
        configuration = mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        try:
            async with mavsdk.Mavsdk(configuration) as client:
                await client.add_any_connection(f"udpin://127.0.0.1:{port}")
                system = await client.first_autopilot(timeout_s=30.0)
                assert system is not None
                yield Client(system)
        finally:
            if process.returncode is None:
                process.terminate()
            await process.wait()


async def until(told: Any, seconds: float = 5.0) -> bool:
    """Whether something comes true in time."""
    for _ in range(round(seconds / 0.1)):
        if await told():
            return True
        await asyncio.sleep(0.1)
    return False


async def fly() -> None:
    async with vehicle("armed=false") as client:

        async def is_well() -> bool:
            return bool(await client.telemetry.health_all_ok())

        assert await until(is_well)
        assert await client.telemetry.in_air() and not await client.telemetry.armed()
        await client.action.arm()
        await _refused_without_a_stream(client)
        await client.offboard.start()
        await _moves_as_told(client)
        await _hovers_at_a_point(client)
        await client.offboard.stop()

        async def holds() -> bool:
            return await client.telemetry.flight_mode() == FlightMode.HOLD.value

        assert await until(holds)


async def _refused_without_a_stream(client: Client) -> None:
    await client.body()
    with pytest.raises(OffboardError, match="COMMAND_DENIED"):
        await client.offboard.start()
    await asyncio.sleep(1.3)


async def _moves_as_told(client: Client) -> None:
    await client.body(forward=0.5)
    forward, right, down, turned = await client.moved(1.5)
    assert 0.3 < forward < 0.9 and abs(right) < 0.1 and abs(down) < 0.1 and abs(turned) < 3.0
    await client.body(right=0.5)
    await asyncio.sleep(0.6)
    forward, right, down, _ = await client.moved(1.5)
    assert 0.5 < right < 0.9 and abs(forward) < 0.15 and abs(down) < 0.1
    await client.body(down=-0.3, yaw_rate=40.0)
    await asyncio.sleep(0.6)
    forward, right, down, turned = await client.moved(1.5)
    assert -0.6 < down < -0.3 and 45.0 < turned < 75.0 and math.hypot(forward, right) < 0.2
    before = await client.place()
    await client.offboard.set_velocity_ned(VelocityNedYaw(0.4, 0.0, 0.0, 90.0))
    await asyncio.sleep(2.5)
    north, east, _ = (now - then for now, then in zip(await client.place(), before, strict=True))
    assert 0.6 < north < 1.2 and abs(east) < 0.15 and await client.yaw() == pytest.approx(90.0, abs=5.0)


async def _hovers_at_a_point(client: Client) -> None:
    """By velocities in the body's axes, from where it is to 1.5 m west of it and 0.5 m lower."""
    north, east, down = await client.place()
    goal = (north, east - 1.5, down + 0.5)
    for _ in range(60):
        yaw = math.radians(await client.yaw())
        way = [to - at for to, at in zip(goal, await client.place(), strict=True)]
        forward = math.cos(yaw) * way[0] + math.sin(yaw) * way[1]
        right = math.cos(yaw) * way[1] - math.sin(yaw) * way[0]
        await client.body(forward, right, way[2])
        await asyncio.sleep(0.1)
    await client.body()
    await asyncio.sleep(1.0)
    assert math.dist(goal, await client.place()) < 0.5
    speed = (await client.telemetry.position_velocity_ned()).velocity
    assert math.hypot(speed.north_m_s, speed.east_m_s, speed.down_m_s) < 0.05
    goal = (goal[0], goal[1], goal[2] - 0.5)
    await client.offboard.set_position_ned(PositionNedYaw(*goal, 0.0))
    await asyncio.sleep(4.0)
    assert math.dist(goal, await client.place()) < 0.1 and await client.yaw() == pytest.approx(0.0, abs=3.0)


async def fly_ardupilot() -> None:
    async with vehicle("firmware=ardupilot") as client:
        await asyncio.sleep(1.5)
        await client.body(forward=0.5)
        await client.offboard.start()  # which ArduPilot calls GUIDED, and grants without a stream
        forward, right, _, _ = await client.moved(2.0)
        assert 0.4 < forward < 1.1 and abs(right) < 0.1


@pytest.mark.parametrize("flight", [fly, fly_ardupilot])
def test_mavsdk_flies_it(flight: Any) -> None:
    asyncio.run(asyncio.wait_for(flight(), 90.0))
