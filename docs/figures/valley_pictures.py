"""Draws a valley from outside and from where a UAV starts, with PyBullet's own renderer.

python docs/figures/valley_pictures.py --output docs/img
python docs/figures/valley_pictures.py --seed 100 --obstacles 90
python docs/figures/valley_pictures.py --seed 200 --obstacles 20 --traps 3 --output docs/img   # from above
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.image import imsave

from uavrl.envs.bullet import pybullet, silenced
from uavrl.envs.traps import KINDS, wall
from uavrl.envs.world import World, WorldConfig
from uavrl_onboard.mesh import Mesh

GROUND, ROCK, WOOD, FIR = (0.62, 0.57, 0.42), (0.58, 0.54, 0.5), (0.45, 0.32, 0.2), (0.2, 0.42, 0.22)
BRICK, START, GOAL, LINE = (0.62, 0.32, 0.22), (0.1, 0.3, 0.9), (0.1, 0.8, 0.2), (0.95, 0.85, 0.2)
COLOURS = {"tree": FIR, "pole": WOOD, "bridge": WOOD, **dict.fromkeys((kind.__name__ for kind in KINDS), BRICK)}
WIDTH, HEIGHT = 1200, 700
TOP = 8.0  # m, over all walls: there lines are seen from above
BRIGHTER = 1.5  # the renderer's picture is dark


def add(client: int, mesh: Mesh, colour: tuple[float, float, float]) -> None:
    """Adds a mesh that is seen and does nothing."""
    faces = mesh.faces.ravel().tolist()
    shape = pybullet.createVisualShape(
        pybullet.GEOM_MESH,
        vertices=mesh.vertices.tolist(),
        indices=faces,
        rgbaColor=(*colour, 1.0),
        physicsClientId=client,
    )
    pybullet.createMultiBody(0, -1, shape, physicsClientId=client)


def picture(client: int, eye: tuple[float, ...], towards: tuple[float, ...], angle: float) -> np.ndarray:
    """What a camera sees: ``uint8 [HEIGHT, WIDTH, 3]``."""
    view = pybullet.computeViewMatrix(eye, towards, (0, 0, 1))
    lens = pybullet.computeProjectionMatrixFOV(angle, WIDTH / HEIGHT, 0.1, 200.0)
    pixels = pybullet.getCameraImage(
        WIDTH,
        HEIGHT,
        view,
        lens,
        shadow=1,
        lightDirection=(2, -3, 6),
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )[2]
    colours = np.reshape(pixels, (HEIGHT, WIDTH, 4))[..., :3].astype(float)
    return np.clip(np.where(colours.min(-1, keepdims=True) < 250, BRIGHTER * colours, colours), 0, 255).astype(np.uint8)


def main() -> None:
    """Writes both pictures, or the one from above."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--obstacles", type=int, default=WorldConfig.obstacles)
    parser.add_argument("--traps", type=int, default=0)
    parser.add_argument("--output", type=Path, default=Path())
    arguments = parser.parse_args()
    world = World(WorldConfig(seeds=(arguments.seed,), obstacles=arguments.obstacles, traps=arguments.traps))
    with silenced():
        client = pybullet.connect(pybullet.DIRECT)
    for tile in world.places[0].ground.tiles():
        add(client, tile, GROUND)
    for obstacle in world.places[0].obstacles:
        add(client, obstacle.mesh, COLOURS.get(obstacle.kind, ROCK))
    rng = np.random.default_rng(0)
    tasks = [world.sample_task(rng) for _ in range(5 if arguments.traps else 1)]
    task = tasks[0]
    for each in tasks if arguments.traps else ():
        ends = np.stack([each.start[:2], each.goal[:2]])
        for line, thick, colour in ((ends, 0.15, LINE), (ends[[0, 0]], 0.8, START), (ends[[1, 1]], 0.8, GOAL)):
            add(client, wall(line + np.array([[0.0, 0.0], [1e-3, 0.0]]), thick, TOP, TOP + thick), colour)
    arguments.output.mkdir(parents=True, exist_ok=True)
    views = {"outside": ((-6, -20, 34), (0, 1, 0), 62.0), "inside": (tuple(task.start), tuple(task.goal), 75.0)}
    if arguments.traps:
        views = {"traps": ((0.0, -0.01, 40.0), (0.0, 0.0, 0.0), 44.0)}
    for name, (eye, towards, angle) in views.items():
        imsave(arguments.output / f"valley_{name}.png", picture(client, eye, towards, angle))
    pybullet.disconnect(client)


if __name__ == "__main__":
    main()
