"""The least that an environment on PyBullet and Embree computes: its physics steps and its ray casts."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from flights import Row
from scipy.spatial.transform import Rotation

from uavrl.envs.bullet import STATIC, add_fixed, add_vehicle, pybullet, silenced
from uavrl.envs.navigation import CONTROL_RATE, PHYSICS_RATE
from uavrl.envs.quadrotor import GRAVITY, Airframe
from uavrl.envs.world import World
from uavrl_onboard.lidar.vlp16 import NUM_RAYS, firing_directions
from uavrl_onboard.mesh import Mesh


@dataclass(frozen=True)
class FleetState:
    """The motion of all vehicles at one moment."""

    position: np.ndarray  # of the hulls, [N, 3] in m
    sensor: np.ndarray  # positions of the LiDARs, [N, 3] in m
    rotation: np.ndarray  # from body to world, [N, 3, 3]
    velocity: np.ndarray  # [N, 3] in m/s


def bare_physics(world: World, airframe: Airframe, states: list[FleetState]) -> Row:
    """Return a row that times only `stepSimulation`, from each of the given states in turn."""
    with silenced():
        client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=client)
    pybullet.setPhysicsEngineParameter(fixedTimeStep=1 / PHYSICS_RATE, physicsClientId=client)
    for mesh in world.meshes:
        for part in mesh.split():
            add_fixed(client, part, STATIC)
    vehicles = [add_vehicle(client, airframe) for _ in states[0].position]
    turn = 0

    def place(state: FleetState) -> None:
        centres = state.position + state.rotation @ np.array(airframe.centre_of_mass)
        attitudes = Rotation.from_matrix(state.rotation).as_quat()
        for body, centre, attitude, velocity in zip(vehicles, centres, attitudes, state.velocity, strict=True):
            pybullet.resetBasePositionAndOrientation(body, centre, attitude, physicsClientId=client)
            pybullet.resetBaseVelocity(body, velocity, (0, 0, 0), physicsClientId=client)

    def run() -> float:
        nonlocal turn
        place(states[turn % len(states)])
        turn += 1
        begin = time.perf_counter()
        for _ in range(PHYSICS_RATE // CONTROL_RATE):
            pybullet.stepSimulation(physicsClientId=client)
        return (time.perf_counter() - begin) / len(vehicles) * 1e3

    return run


def bare_rays(world: World, reach: float, states: list[FleetState]) -> Row:
    """Return a row that times one Embree call on prepared rays, from each of the given states in turn."""
    scene, mesh = EmbreeScene(), Mesh.merge(world.meshes)
    TriangleMesh(scene, mesh.vertices, mesh.faces)
    ahead, turn = firing_directions(), 0

    def run() -> float:
        nonlocal turn
        state = states[turn % len(states)]
        turn += 1
        directions = (ahead @ state.rotation.transpose(0, 2, 1)).astype(np.float32).reshape(-1, 3)
        origins = np.repeat(state.sensor.astype(np.float32), NUM_RAYS, axis=0)
        lengths = np.full(len(origins), reach, np.float32)
        begin = time.perf_counter()
        scene.run(origins, directions, lengths, query="DISTANCE")
        return (time.perf_counter() - begin) / len(state.sensor) * 1e3

    return run
