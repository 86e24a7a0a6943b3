"""The navigation task as a Gymnasium environment with pictures, for users of other RL libraries."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs import Compose, TransformedEnv

from uavrl.envs.camera import Camera
from uavrl.envs.guarding import far_seeing, guarded
from uavrl.envs.lidar import LidarConfig
from uavrl.envs.limits import OrMapping, require_speed, settings, whole
from uavrl.envs.navigation import CONTROL_RATE, NavigationEnv
from uavrl.envs.world import WorldLike, world_rules
from uavrl.errors import UavrlError, extras
from uavrl.transforms import NavigationReward, NavigationState, TraditionalReward
from uavrl.transforms.guarded import GOAL_HEADING
from uavrl_onboard.guards.settings import guard_settings
from uavrl_onboard.perception.reductions import Reduction
from uavrl_onboard.vehicle import VEHICLE, sight_for

with extras():
    import gymnasium
    from gymnasium.spaces import Box

METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": CONTROL_RATE}
_REWARDS = {"navigation": NavigationReward, "traditional": TraditionalReward}


class ValleyFlights:
    """N vehicles with the reduction, the frames and the reward inside: the part that one and many environments share.

    Args:
        num_envs: number of vehicles N.
        reward, radius, frames, reduction, last_action, lidar, world, guards, render_mode, kwargs: as in
            :class:`ValleyEnv`.
    """

    def __init__(
        self,
        num_envs: int,
        reward: Literal["navigation", "traditional"] = "navigation",
        *,
        radius: float | None = None,
        frames: int = 3,
        reduction: Reduction = "truncated_icosahedron",
        last_action: bool = False,
        lidar: OrMapping[LidarConfig] | None = None,
        world: WorldLike | None = None,
        guards: Any = "none",
        render_mode: str | None = None,
        **kwargs: Any,
    ) -> None:
        chosen = guard_settings(guards)
        if reward not in _REWARDS:
            raise ValueError(f"reward must be one of {', '.join(_REWARDS)}, got {reward!r}.")
        if render_mode not in (None, *METADATA["render_modes"]):
            raise UavrlError(
                f"render_mode must be rgb_array or None, got {render_mode!r}: to watch a policy, use uavrl-replay, "
                "which shows its episodes in a page."
            )
        self.render_mode = render_mode
        valley = world_rules(world)
        max_speed = require_speed(kwargs.get("max_speed", VEHICLE.velocity_limit))
        radius = sight_for(max_speed) if radius is None else radius
        state = NavigationState(
            radius,
            flight_level=valley.flight_level,
            frames=frames,
            reduction=reduction,
            last_action=last_action,
            max_speed=max_speed,
        )
        asked = {"max_range": radius, **lidar} if isinstance(lidar, Mapping) else lidar
        lidar = settings("lidar", LidarConfig, LidarConfig(max_range=radius) if asked is None else asked)
        lidar = far_seeing(lidar, chosen.sight)
        self.base = NavigationEnv(num_envs, world=valley, lidar=lidar, **kwargs)
        self.env = TransformedEnv(self.base, Compose())
        heading = {}
        if chosen.names:
            self.env.append_transform(guards_around := guarded(self.base, chosen))
            heading = {"heading": GOAL_HEADING} if guards_around.leads and reward == "navigation" else {}
        self.env.append_transform(state)
        self.env.append_transform(_REWARDS[reward](**heading))
        width = self.env.observation_spec["observation"].shape[-1]
        self.observation_space = Box(-np.inf, np.inf, (width,), np.float32)
        self.action_space = Box(-self.base.max_speed, self.base.max_speed, (4,), np.float32)
        self._state: TensorDictBase | None = None
        self._camera: Camera | None = None

    def reset(
        self,
        generator: np.random.Generator,
        seed: int | None,
        options: dict[str, Any],
        mask: np.ndarray | None = None,
    ) -> None:
        """Start the next tasks of the vehicles in ``mask [N]``, or of all.

        Args:
            generator: source of the seed of the first reset, if none is given.
            seed: of physics and tasks from now on.
            options: ``{"task": k}`` goes on with task k.
            mask: which vehicles; None for all.
        """
        options = dict(options)
        task = {"task": whole("options['task']", options.pop("task"))} if "task" in options else {}
        if options:
            raise UavrlError(f"options takes task, the number of a task, got {', '.join(map(repr, options))}.")
        if seed is not None or self._state is None:
            self.env.set_seed(int(generator.integers(2**31)) if seed is None else seed)
        if mask is None or mask.all():
            self._state = self.env.reset(**task)
        else:
            chosen = self.state.set("_reset", torch.from_numpy(mask.copy())[:, None])
            self._state = self.env.reset(chosen, **task)

    def step(self, actions: np.ndarray) -> None:
        """Advance by 0.1 s with ``actions [N, 4]``."""
        self.state["action"] = torch.as_tensor(actions, dtype=torch.float32)
        self._state = self.env.step(self.state)["next"]

    @property
    def state(self) -> TensorDictBase:
        """The newest tensordict of the environment."""
        if self._state is None:
            raise UavrlError("Reset the environment before the first step.")
        return self._state

    def values(self, key: str) -> np.ndarray:
        """A copy of the newest values of a key: ``[N]`` for single numbers, else ``[N, D]``."""
        values = self.state[key].numpy().copy()
        return values[:, 0] if values.shape[1:] == (1,) else values

    def infos(self) -> dict[str, np.ndarray]:
        """The info of all vehicles: an array for each key."""
        found = {"is_success": self.values("arrived"), "collided": self.values("collided")}
        found |= {key: self.values(key) for key in ("position", "goal")}
        return found | {"distance": self.values("distance").astype(np.float64)}

    def picture(self, vehicle: int = 0) -> np.ndarray | None:
        """The picture ``uint8 [360, 480, 3]`` of a camera behind a vehicle; None without a render mode."""
        if self.render_mode is None:
            return None
        if self._state is None:
            raise UavrlError("Reset the environment before the first picture.")
        if self._camera is None:
            self._camera = Camera(self.base)
        return self._camera.picture(self._state["goal"][vehicle].numpy(), vehicle)

    def close(self) -> None:
        """Free the simulation and the camera; a second call does nothing."""
        if self._camera is not None:
            self._camera.close()
        self._camera = None
        if not self.env.is_closed:
            self.env.close()


class ValleyEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One quadrotor in the valley; the LiDAR's reduction and the frames are inside.

    Observations are the thesis's state (Chansuparp (2022), §3.2): ``frames`` times 35 numbers, oldest first; with
    ``reduction="range_image"`` and ``last_action=True``, as ``policy=best`` has them, 79 each. ``info`` holds
    ``is_success``, ``collided``, ``position``, ``goal`` and ``distance``.

    Args:
        reward: ``"navigation"`` (Eq. 3.6) or ``"traditional"`` (Eq. 2.15).
        radius: how far the cells reach, m; None: 4 m, or farther where ``max_speed`` is above 4.4 m/s.
        frames: observations in a state.
        reduction, last_action: as in :class:`uavrl.transforms.NavigationState`.
        lidar: the sensor; by default its range is cut at the ball, which leaves the faces identical.
        world: the valley; ``WorldConfig(planes=3)`` or ``{"planes": 3}`` gives the dynamic environment.
        guards: filters around the action: ``"all"``, ``"none"`` or a list of names, as
            :func:`~uavrl_onboard.guards.settings.guard_settings` reads it. The map also turns the heading in the
            observation; the reward reads the heading to the goal itself. A ``lidar`` of your own must reach as far as
            the guards look, 12 m.
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

    metadata = METADATA

    def __init__(
        self,
        reward: Literal["navigation", "traditional"] = "navigation",
        *,
        render_mode: str | None = None,
        **kwargs: Any,
    ) -> None:
        self._flights = ValleyFlights(1, reward, render_mode=render_mode, **kwargs)
        self._base, self._env = self._flights.base, self._flights.env
        self.render_mode = render_mode
        self.observation_space, self.action_space = self._flights.observation_space, self._flights.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Starts the next task, or task k of ``options={"task": k}``; a seed rebuilds the physics and starts at 0."""
        seed = None if seed is None else whole("seed", seed)
        super().reset(seed=seed)
        self._flights.reset(self.np_random, seed, options or {})
        return self._observation(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advances by 0.1 s."""
        flights = self._flights
        if np.shape(action) != (4,):
            raise UavrlError(f"An action is 4 numbers, (l_x, l_y, l_z, a_z), got the shape {np.shape(action)}.")
        flights.step(np.asarray(action)[None])
        reward, terminated, truncated = (flights.values(key).item() for key in ("reward", "terminated", "truncated"))
        return self._observation(), reward, terminated, truncated, self._info()

    def render(self) -> np.ndarray | None:
        """The picture ``uint8 [360, 480, 3]`` of a camera behind the UAV; None without ``render_mode="rgb_array"``."""
        return self._flights.picture()

    def _observation(self) -> np.ndarray:
        return self._flights.values("observation")[0]

    def _info(self) -> dict[str, Any]:
        return {key: value[0] if value.ndim > 1 else value[0].item() for key, value in self._flights.infos().items()}

    def close(self) -> None:
        """Frees the simulation and what draws; no step or reset is taken any more."""
        self._flights.close()


def make_valley(**kwargs: Any) -> ValleyEnv:
    """What ``gymnasium.make`` calls: a function, since for a class Gymnasium itself opens a window for ``"human"``."""
    return ValleyEnv(**kwargs)
