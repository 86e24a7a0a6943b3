"""Many vehicles in one world as a vectorised environment of Stable-Baselines3."""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from uavrl.envs.gym_vector import ValleyVectorEnv
from uavrl.errors import UavrlError, extras

with extras():
    from gymnasium.vector import AutoresetMode

try:
    from stable_baselines3.common.vec_env import VecEnv
except ModuleNotFoundError as error:
    raise UavrlError(
        "uavrl.envs.sb3 needs Stable-Baselines3, which is not installed: pip install stable-baselines3."
    ) from error

Indices = int | Iterable[int] | None
_SINGLE = {"observation_space": "single_observation_space", "action_space": "single_action_space"}
_OF_ALL = ("reset", "step", "close")


class ValleyVecEnv(VecEnv):
    """N quadrotors in one PyBullet world for the algorithms of Stable-Baselines3.

    It is a :class:`~uavrl.envs.gym_vector.ValleyVectorEnv` with the interface of Stable-Baselines3: an episode that has
    ended is followed by the next one in the same step, its last observation is ``info["terminal_observation"]``, and
    ``info["TimeLimit.truncated"]`` says that it ran out of time. Wrap it in ``VecMonitor`` to log returns.

    The vehicles share one world, so they share its attributes as well: ``get_attr`` repeats one value, ``set_attr``
    takes no ``indices``, and ``env_method`` calls a method once. Only ``env_method("render")`` differs by vehicle.

    Args:
        num_envs: number of vehicles N.
        **kwargs: as in :class:`~uavrl.envs.gym.ValleyEnv`.

    Attributes:
        envs: the Gymnasium environment underneath.

    Examples:
        >>> env = ValleyVecEnv(2, reward="traditional")
        >>> env.reset().shape
        (2, 105)
        >>> observations, rewards, dones, infos = env.step(np.zeros((2, 4)))
        >>> rewards.shape, infos[0]["TimeLimit.truncated"]
        ((2,), False)
        >>> env.close()
    """

    def __init__(self, num_envs: int = 8, **kwargs: Any) -> None:
        self.envs = ValleyVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs)
        super().__init__(self.envs.num_envs, self.envs.single_observation_space, self.envs.single_action_space)
        self.metadata = self.envs.metadata
        self._next: dict[str, Any] = {}  # seed and options of the next reset

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed of the next reset, one for all vehicles: their tasks are the first N of that seed."""
        self._next["seed"] = next(iter(super().seed(seed)))
        return [self._next["seed"]] * self.num_envs

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Set the options of the next reset, the same for all vehicles: ``{"task": k}`` starts with task k."""
        each = options if isinstance(options, list) else [options]
        if any(other != each[0] for other in each):
            raise UavrlError("The vehicles share one world: set_options takes the same options for all of them.")
        self._next["options"] = each[0]

    def reset(self) -> np.ndarray:
        """Start new episodes; returns ``float32 [N, W]``."""
        observations, infos = self.envs.reset(**self._next)
        self._next = {}
        self.reset_infos = [_row(infos, vehicle) for vehicle in range(self.num_envs)]
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keep ``actions [N, 4]`` for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Advance by 0.1 s; returns observations ``[N, W]``, rewards ``float32 [N]``, dones ``[N]`` and infos."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones, told = terminated | truncated, []
        for vehicle, done in enumerate(dones):
            info = _row(infos, vehicle)
            if done:
                self.reset_infos[vehicle] = info
                final_obs = infos["final_obs"][vehicle]
                info = {**_row(infos["final_info"], vehicle), "terminal_observation": final_obs}
            told.append(info | {"TimeLimit.truncated": bool(truncated[vehicle] and not terminated[vehicle])})
        return observations, rewards.astype(np.float32), dones, told

    def close(self) -> None:
        """Free the simulation."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return a picture from behind each vehicle; None for each without ``render_mode="rgb_array"``."""
        pictures = self.envs.render()
        if pictures is None:
            warnings.warn("There are no pictures without render_mode='rgb_array'.", stacklevel=2)
            return [None] * self.num_envs
        return pictures

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of the environment for each vehicle; the spaces are those of one vehicle."""
        return [getattr(self.envs, _SINGLE.get(attr_name, attr_name)) for _ in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environment, for all vehicles."""
        if set(self._chosen(indices)) != set(range(self.num_envs)):
            raise UavrlError(f"The vehicles share one world: set {attr_name} for all of them, without indices.")
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environment, once, and return its result for each vehicle."""
        chosen = self._chosen(indices)
        if method_name in _OF_ALL:
            raise UavrlError(f"The vehicles share one world: call {method_name}() of the whole environment.")
        if method_name == "render":
            pictures = self.get_images()
            return [pictures[vehicle] for vehicle in chosen]
        return [getattr(self.envs, method_name)(*method_args, **method_kwargs)] * len(chosen)

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Return False for each vehicle: wrappers of single environments cannot be in here."""
        return [False for _ in self._chosen(indices)]

    def _chosen(self, indices: Indices) -> list[int]:
        """Return the vehicles that ``indices`` mean."""
        if indices is None:
            return list(range(self.num_envs))
        return [indices] if isinstance(indices, int) else list(indices)


def _row(infos: dict[str, Any], vehicle: int) -> dict[str, Any]:
    """Return the info of one vehicle, as a single environment gives it."""
    found: dict[str, Any] = {}
    for key, values in infos.items():
        if isinstance(values, np.ndarray) and not key.startswith(("_", "final_")):
            found[key] = values[vehicle].copy() if values.ndim > 1 else values[vehicle].item()
    return found
