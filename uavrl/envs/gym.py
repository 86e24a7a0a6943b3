"""The navigation task as a Gymnasium environment with pictures, for users of other RL libraries."""

import weakref
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from scipy.spatial.transform import Rotation
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv

from uavrl.envs.bullet import connect, mesh_shape, pybullet
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.limits import whole
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.transforms import NavigationReward, NavigationState, TraditionalReward
from uavrl.transforms.state import ACTION_LIMIT, Reduction
from uavrl_onboard.geometry import heading_vector
from uavrl_onboard.mesh import Mesh

WIDTH, HEIGHT = 480, 360  # pixels
BEHIND, ABOVE, AHEAD = 3.0, 1.2, 2.0  # m from the UAV: the camera's place, and the point that it looks at
TERRAIN, OBSTACLE, PLANE, GOAL, UAV = (0.45, 0.5, 0.35), (0.6, 0.5, 0.42), (0.8, 0.2, 0.15), (1, 1, 1), (0.1, 0.3, 0.8)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
_REWARDS = {"navigation": NavigationReward, "traditional": TraditionalReward}


class Camera:
    """A camera that follows the first vehicle of an environment, which has been reset, from behind.

    It draws in a PyBullet world of its own, in which nothing moves by itself: the physics does not notice it.
    """

    def __init__(self, env: NavigationEnv) -> None:
        client = connect()
        self.close = weakref.finalize(self, pybullet.disconnect, physicsClientId=client)
        self._env = env
        self._at: dict[str, Any] = {"physicsClientId": client}
        config, airframe = env.world.config, env.airframe
        for valley in env.world.valleys:
            obstacles = Mesh.merge(obstacle.mesh for obstacle in valley.obstacles).split()
            for parts, colour in ((valley.ground.tiles(), TERRAIN), (obstacles, OBSTACLE)):
                for part in parts:
                    self._mesh(part.translated((*valley.origin, 0.0)), colour)
        self._planes = [self._mesh(env.plane_mesh, PLANE) for _ in env.plane_poses()]
        self._goal = self._cylinder(config.goal_radius, config.ceiling, GOAL)
        self._uav = self._cylinder(airframe.collision_radius, airframe.collision_height, UAV)

    def _mesh(self, mesh: Mesh, colour: tuple[float, ...]) -> int:
        shape = mesh_shape(pybullet.createVisualShape, mesh, rgbaColor=(*colour, 1.0), **self._at)
        return pybullet.createMultiBody(0, -1, shape, **self._at)

    def _cylinder(self, radius: float, length: float, colour: tuple[float, ...]) -> int:
        size = {"radius": radius, "length": length, "rgbaColor": (*colour, 1.0)}
        shape = pybullet.createVisualShape(pybullet.GEOM_CYLINDER, **size, **self._at)
        return pybullet.createMultiBody(0, -1, shape, **self._at)

    def picture(self, goal: np.ndarray) -> np.ndarray:
        """Returns what is to be seen now, with the goal at ``goal [3]`` in m: ``uint8 [360, 480, 3]``."""
        simulation = self._env.simulation
        position, yaw = simulation.position[0], float(simulation.yaw[0])
        self._put(self._goal, goal)
        self._put(self._uav, position, Rotation.from_matrix(simulation.rotation[0]).as_quat())
        for body, pose in zip(self._planes, self._env.plane_poses(), strict=True):
            self._put(body, pose[:3], Rotation.from_euler("z", pose[3]).as_quat())
        ahead = np.append(heading_vector(yaw), 0.0)
        eye = position - BEHIND * ahead + [0.0, 0.0, ABOVE]
        view = pybullet.computeViewMatrix(eye.tolist(), (position + AHEAD * ahead).tolist(), (0, 0, 1))
        lens = pybullet.computeProjectionMatrixFOV(60.0, WIDTH / HEIGHT, 0.1, 100.0)
        drawer = {"shadow": 0, "renderer": pybullet.ER_TINY_RENDERER}
        drawn = pybullet.getCameraImage(WIDTH, HEIGHT, view, lens, **drawer, **self._at)
        return np.reshape(drawn[2], (HEIGHT, WIDTH, 4))[..., :3].astype(np.uint8)

    def _put(self, body: int, position: np.ndarray, attitude: np.ndarray = LEVEL) -> None:
        pybullet.resetBasePositionAndOrientation(body, position.tolist(), attitude.tolist(), **self._at)


class ValleyEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One quadrotor in the valley; the LiDAR's reduction and the frames are inside.

    Observations are the thesis's state (Chansuparp (2022), §3.2): ``frames`` times 35 numbers, oldest first; with
    ``reduction="range_image"`` and ``last_action=True``, as ``policy=best`` has them, 79 each. ``info`` holds
    ``is_success``, ``collided``, ``position``, ``goal`` and ``distance``.

    Args:
        reward: ``"navigation"`` (Eq. 3.6) or ``"traditional"`` (Eq. 2.15).
        radius: the ball's radius, m.
        frames: observations in a state.
        reduction, last_action: as in :class:`uavrl.transforms.NavigationState`.
        lidar: the sensor; by default its range is cut at the ball, which leaves the faces identical.
        world: the valley; ``WorldConfig(planes=3)`` gives the dynamic environment.
        render_mode: ``"rgb_array"``: :meth:`render` gives a picture from behind the UAV.
        **kwargs: as in :class:`uavrl.envs.NavigationEnv`.

    Raises:
        ValueError: for an unknown reward, reduction or render mode, or settings out of range.

    Examples:
        >>> import gymnasium
        >>> env = gymnasium.make("uavrl:uavrl/Valley-v0")  # imports uavrl first
        >>> state, info = env.reset(seed=0)
        >>> state.shape
        (105,)
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_RATE}  # noqa: RUF012

    def __init__(
        self,
        reward: Literal["navigation", "traditional"] = "navigation",
        *,
        radius: float = 4.0,
        frames: int = 3,
        reduction: Reduction = "truncated_icosahedron",
        last_action: bool = False,
        lidar: LidarConfig | None = None,
        world: WorldConfig | None = None,
        render_mode: str | None = None,
        **kwargs: Any,
    ) -> None:
        if reward not in _REWARDS:
            raise ValueError(f"reward must be one of {', '.join(_REWARDS)}, got {reward!r}.")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UavrlError(
                f"render_mode must be rgb_array or None, got {render_mode!r}: to watch a policy, use uavrl-replay, "
                "which shows its episodes in a page."
            )
        self.render_mode = render_mode
        world = world or WorldConfig()
        state = NavigationState(
            radius, flight_level=world.flight_level, frames=frames, reduction=reduction, last_action=last_action
        )
        self._base = NavigationEnv(1, world=world, lidar=lidar or LidarConfig(max_range=radius), **kwargs)
        self._env = TransformedEnv(self._base, Compose(state, _REWARDS[reward]()))
        width = self._env.observation_spec["observation"].shape[-1]
        self.observation_space = Box(-np.inf, np.inf, (width,), np.float32)
        self.action_space = Box(-ACTION_LIMIT, ACTION_LIMIT, (4,), np.float32)
        self._state: TensorDictBase | None = None
        self._camera: Camera | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts the next task, or task k of ``options={"task": k}``; a seed rebuilds the physics and starts at 0."""
        options = dict(options or {})
        task = {"task": whole("options['task']", options.pop("task"))} if "task" in options else {}
        if options:
            raise UavrlError(f"options takes task, the number of a task, got {', '.join(map(repr, options))}.")
        if seed is not None:
            seed = whole("seed", seed)
        first = self._state is None
        super().reset(seed=seed)
        if seed is not None or first:
            self._env.set_seed(int(self.np_random.integers(2**31)) if seed is None else seed)
        self._state = self._env.reset(**task)
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advances by 0.1 s."""
        if self._state is None:
            raise UavrlError("Reset the environment before the first step.")
        if np.shape(action) != (4,):
            raise UavrlError(f"An action is 4 numbers, (l_x, l_y, l_z, a_z), got the shape {np.shape(action)}.")
        self._state["action"] = torch.as_tensor(action, dtype=torch.float32)[None]
        self._state = self._env.step(self._state)["next"]
        reward, terminated, truncated = (self._state[key].item() for key in ("reward", "terminated", "truncated"))
        return self._observation(), float(reward), bool(terminated), bool(truncated), self._info()

    def render(self) -> np.ndarray | None:
        """The picture ``uint8 [360, 480, 3]`` of a camera behind the UAV; None without ``render_mode="rgb_array"``."""
        if self.render_mode is None:
            return None
        if self._state is None:
            raise UavrlError("Reset the environment before the first picture.")
        if self._camera is None:
            self._camera = Camera(self._base)
        return self._camera.picture(self._state["goal"][0].numpy())

    def _observation(self) -> np.ndarray:
        assert self._state is not None
        return self._state["observation"][0].numpy().copy()

    def _info(self) -> dict[str, Any]:
        assert self._state is not None
        return {
            "is_success": bool(self._state["arrived"].item()),
            "collided": bool(self._state["collided"].item()),
            "position": self._state["position"][0].numpy().copy(),
            "goal": self._state["goal"][0].numpy().copy(),
            "distance": float(self._state["distance"].item()),
        }

    def close(self) -> None:
        """Frees the simulation and what draws; no step or reset is taken any more."""
        if self._camera is not None:
            self._camera.close()
        self._camera = None
        if not self._env.is_closed:
            self._env.close()


def make_valley(**kwargs: Any) -> ValleyEnv:
    """What ``gymnasium.make`` calls: a function, since for a class Gymnasium itself opens a window for ``"human"``."""
    return ValleyEnv(**kwargs)
