"""The navigation task as a Gymnasium environment, for users of other RL libraries."""

from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv

from uavrl.envs.camera import Camera
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.limits import whole
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.world import WorldConfig
from uavrl.errors import UavrlError
from uavrl.transforms import NavigationReward, NavigationState, TraditionalReward
from uavrl.transforms.reductions import Reduction
from uavrl.transforms.state import ACTION_LIMIT

_REWARDS = {"navigation": NavigationReward, "traditional": TraditionalReward}


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
                f"render_mode must be rgb_array or None, got {render_mode!r}: to watch a policy fly, use uavrl-replay, "
                "which shows its flights in a page."
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
        """Flies for 0.1 s."""
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
