"""Many vehicles in one world as a vectorised Gymnasium environment."""

from typing import Any

import numpy as np

from uavrl.envs.gym import METADATA, ValleyFlights
from uavrl.envs.limits import whole
from uavrl.errors import UavrlError, extras

with extras():
    from gymnasium.envs.registration import EnvSpec
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space


class ValleyVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N quadrotors that fly in one PyBullet world, each with its own task; they neither see nor touch each other.

    Spaces, observations, rewards and infos are those of :class:`~uavrl.envs.gym.ValleyEnv`, batched. A reset with a
    seed starts the vehicles with tasks 0 to N - 1 of that seed, and each new episode takes the next task. Vehicle i
    therefore starts as a single environment does after ``reset(seed=seed, options={"task": i})``.

    Args:
        num_envs: number of vehicles N.
        autoreset_mode: how an episode that has ended is followed by the next one, as in Gymnasium: ``"NextStep"``,
            ``"SameStep"`` or ``"Disabled"``, or an ``AutoresetMode``.
        **kwargs: as in :class:`~uavrl.envs.gym.ValleyEnv`.

    Raises:
        UavrlError: for settings out of range, actions of another shape, a step before the first reset, or, with
            ``"Disabled"``, a step of a vehicle whose episode has ended.

    Examples:
        >>> import gymnasium
        >>> envs = gymnasium.make_vec("uavrl:uavrl/Valley-v0", num_envs=2)
        >>> observations, infos = envs.reset(seed=0)
        >>> observations.shape, infos["distance"].shape
        ((2, 105), (2,))
        >>> envs.step(envs.action_space.sample())[1].shape
        (2,)
        >>> envs.close()
    """

    def __init__(
        self, num_envs: int = 8, *, autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, **kwargs: Any
    ) -> None:
        self.num_envs = whole("num_envs", num_envs, 1)
        self.autoreset_mode = _mode(autoreset_mode)
        self.metadata = {**METADATA, "autoreset_mode": self.autoreset_mode}
        self._flights = ValleyFlights(self.num_envs, **kwargs)
        self.render_mode = self._flights.render_mode
        self.single_observation_space = self._flights.observation_space
        self.single_action_space = self._flights.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended = np.zeros(self.num_envs, dtype=bool)  # these vehicles need a reset

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: one for all vehicles. The next reset of all vehicles also rebuilds the physics from it.
            options: ``{"task": k}`` starts with task k; ``{"reset_mask": mask}``, a ``bool [N]`` with at least one
                True, resets these vehicles only.

        Returns:
            Observations ``float32 [N, W]`` of all vehicles, and the infos of those that were reset.
        """
        options = dict(options or {})
        mask = self._checked_mask(options.pop("reset_mask")) if "reset_mask" in options else None
        seed = None if seed is None else whole("seed", seed)
        super().reset(seed=seed)
        self._flights.reset(self.np_random, seed, options, mask)
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else mask
        self._ended = self._ended & ~chosen
        return self._flights.values("observation"), self._infos(chosen)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Advance all vehicles by 0.1 s.

        With ``"NextStep"``, a vehicle whose episode ended in the last step is reset instead: its action is ignored and
        its reward is 0. With ``"SameStep"`` it is reset in the step that ends its episode, and the last observation and
        info of that episode are in ``infos["final_obs"]`` and ``infos["final_info"]``.

        Args:
            actions: ``[N, 4]``.

        Returns:
            Observations ``float32 [N, W]``, rewards ``float64 [N]``, terminations and truncations ``bool [N]``, infos.
        """
        flights, before, everyone = self._flights, self._ended, np.ones(self.num_envs, dtype=bool)
        actions = self._checked_actions(actions)
        if not before.all():  # otherwise nobody flies
            flights.step(np.where(before[:, None], 0.0, actions))
        rewards = flights.values("reward").astype(np.float64)
        terminated, truncated = flights.values("terminated"), flights.values("truncated")
        infos: dict[str, Any] = {}
        if before.any():
            flights.reset(self.np_random, None, {}, before)
            rewards[before], terminated[before], truncated[before] = 0.0, False, False
        ended = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            if ended.any():
                infos = self._final(ended)
                flights.reset(self.np_random, None, {}, ended)
        else:
            self._ended = ended
        return flights.values("observation"), rewards, terminated, truncated, infos | self._infos(everyone)

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture from behind each vehicle, as the single environment does; None without a render mode."""
        pictures = [self._flights.picture(vehicle) for vehicle in range(self.num_envs if self.render_mode else 0)]
        return tuple(picture for picture in pictures if picture is not None) or None

    def close_extras(self, **kwargs: Any) -> None:
        """Free the simulation and the camera."""
        self._flights.close()

    @property
    def spec(self) -> EnvSpec | None:
        """The specification by which ``make_vec`` made it; it can be written as JSON."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None and "autoreset_mode" in spec.kwargs:
            spec.kwargs["autoreset_mode"] = self.autoreset_mode.value
        self._spec = spec

    _spec: EnvSpec | None = None

    def _infos(self, chosen: np.ndarray) -> dict[str, Any]:
        """Return the infos of the chosen vehicles, with a mask of these beside each key."""
        infos: dict[str, Any] = {}
        for key, values in self._flights.infos().items():
            values[~chosen] = 0
            infos |= {key: values, f"_{key}": chosen.copy()}
        return infos

    def _final(self, ended: np.ndarray) -> dict[str, Any]:
        """Return the last observations and infos of episodes, before they are replaced by those of the next ones."""
        final_obs = np.full(self.num_envs, None, dtype=object)
        observations = self._flights.values("observation")
        for vehicle in np.flatnonzero(ended):
            final_obs[vehicle] = observations[vehicle].copy()
        final = {"final_obs": final_obs, "final_info": self._infos(ended)}
        return final | {f"_{key}": ended.copy() for key in final}

    def _checked_actions(self, actions: np.ndarray) -> np.ndarray:
        if np.shape(actions) != (self.num_envs, 4):
            raise UavrlError(
                f"Expected actions of shape ({self.num_envs}, 4), one row (l_x, l_y, l_z, a_z) for each vehicle, got "
                f"{np.shape(actions)}."
            )
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = np.flatnonzero(self._ended).tolist()
            raise UavrlError(
                f"The episodes of vehicles {ended} have ended, and autoreset is disabled: "
                'call reset(options={"reset_mask": terminations | truncations}) first.'
            )
        return np.asarray(actions, dtype=np.float32)

    def _checked_mask(self, mask: Any) -> np.ndarray:
        fits = isinstance(mask, np.ndarray) and mask.shape == (self.num_envs,) and mask.dtype == np.bool_
        if not fits or not mask.any():
            raise UavrlError(
                f"options['reset_mask'] must be a NumPy array of {self.num_envs} bools, at least one of them True, "
                f"got {mask!r}."
            )
        return mask


def _mode(given: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(given)
    except ValueError:
        known = ", ".join(mode.value for mode in AutoresetMode)
        raise UavrlError(f"autoreset_mode must be one of {known}, got {given!r}.") from None


def make_valleys(
    num_envs: int = 8, *, max_steps: int = 300, max_episode_steps: int | None = None, **kwargs: Any
) -> ValleyVectorEnv:
    """Make the environment for ``gymnasium.make_vec``, whose ``max_episode_steps`` is a limit beside ``max_steps``."""
    limit = max_steps if max_episode_steps is None else min(max_steps, whole("max_episode_steps", max_episode_steps, 1))
    return ValleyVectorEnv(num_envs, max_steps=limit, **kwargs)
