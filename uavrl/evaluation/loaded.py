"""A trained policy that knows its environment."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

from uavrl.config import compose, validate
from uavrl.entries import MissingEntry, entry
from uavrl.errors import UavrlError
from uavrl.evaluation.environment import make_env, with_sight
from uavrl.evaluation.field_of_view import check_field_of_view, trained_sensor, with_trained_view
from uavrl.evaluation.overrides import OF_SENSOR, keys_of, require_valley, with_overrides
from uavrl.evaluation.worlds import FIRST_UNSEEN
from uavrl.exploration import deterministic
from uavrl.models.memory import IS_INIT, RECURRENT_STATE, RecurrentPolicy
from uavrl.policy_protocol import PolicyModule
from uavrl_onboard.guards.settings import guard_settings

_TAKEN = ("env", "randomize")


class LoadedPolicy(PolicyModule):
    """Reads ``observation`` and writes ``action``, without exploration noise and without gradients.

    One with a memory also reads ``is_init`` and ``recurrent_state``, and writes the next ``recurrent_state``; an
    environment of :meth:`make_env` carries it from step to step.

    :func:`uavrl.load_policy` makes it. It acts wherever its network is, and answers where the observation is.

    Args:
        actor: the network with what turns its numbers into an action; to be trained further, for example.
        config: the configuration of the run that trained it.
        source: what is known of it: its run, checkpoint, training steps and episodes, commit.
        inputs: numbers in an observation; None if that is not known.

    Raises:
        UavrlError: at a call, for an observation of another width.
    """

    def __init__(
        self,
        actor: TensorDictModuleBase,
        config: DictConfig,
        source: Mapping[str, Any],
        inputs: int | None = None,
    ) -> None:
        super().__init__()
        self.inputs = inputs
        self.in_keys: list[NestedKey] = list(actor.in_keys)
        self.out_keys: list[NestedKey] = ["action"]
        self.recurrent_state = actor.recurrent_state if isinstance(actor, RecurrentPolicy) else None
        if self.recurrent_state is not None:
            self.out_keys.append(("next", RECURRENT_STATE))
        self.actor, self.config, self.source = actor, config, dict(source)
        self.guards = guard_settings(config.get("guards"))  # of its training, and of the environments of make_env

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action of each observation."""
        observation = entry(tensordict, "observation", self)
        if self.inputs not in (None, observation.shape[-1]):
            raise UavrlError(
                f"The policy reads observations of {self.inputs} numbers and got {observation.shape[-1]}: it needs the "
                f"cells and frames of its training, as its make_env() makes them."
            )
        weights = next(self.parameters(), observation)  # the host may compute elsewhere, and in another precision
        read = TensorDict({"observation": observation.to(weights)}, tensordict.batch_size)
        if self.recurrent_state is not None:
            for key in (IS_INIT, RECURRENT_STATE):
                if tensordict.get(key, None) is None:
                    primer = f"TensorDictPrimer({{{RECURRENT_STATE!r}: Unbounded({self.recurrent_state})}}"
                    remedy = f"append TorchRL's InitTracker() and {primer}, expand_specs=True) to your environment"
                    raise MissingEntry(self, key, "the data contain", tensordict.keys(True, True), remedy)
            read.set(IS_INIT, tensordict[IS_INIT].to(weights.device))
            read.set(RECURRENT_STATE, tensordict[RECURRENT_STATE].to(weights))
        with torch.no_grad(), deterministic():
            acted = self.actor(read)
        for key in self.out_keys:
            tensordict.set(key, acted[key].to(observation.device))
        return tensordict

    def make_env(
        self,
        *changes: str,
        num_uavs: int = 1,
        valleys: Sequence[int] | None = None,
        seed: int = 20_000,
        tasks: Sequence[int] | None = None,
        keep_cloud: bool = False,
        guards: Any = None,
        allow_unseen: bool = False,
    ) -> TransformedEnv:
        """An environment as that of its training, with the inputs and the reward that it was trained with.

        Args:
            *changes: as ``uavrl-evaluate`` takes them: ``"env=dynamic"``, ``"randomize=none"``,
                ``"env.world.obstacles=90"``, ``"perception.lidar.range_noise=0.02"``.
            num_uavs: number of vehicles, the environment's batch size.
            valleys: seeds of the valleys, each built when a task needs it; by default 100, which no packaged policy
                was trained in.
            seed: of the tasks.
            tasks: those to fly, in this order; None: all from 0 on. Task 24 of ``uavrl-evaluate`` is ``tasks=[24]``
                with ``valleys=range(100, 110)``.
            keep_cloud: whether it also gives the point clouds, and whether an episode begins.
            guards: filters between the policy and the environment: ``"all"``, ``"none"`` or a list of names, as
                :func:`~uavrl_onboard.guards.settings.guard_settings` reads it. None: those of the policy.
            allow_unseen: whether the policy may fly with a LiDAR that never sees some of its cells.

        Raises:
            UavrlError: for a change that the policy cannot be asked to bear, for an unknown guard, and for a LiDAR that
                never sees some of the policy's cells.

        Examples:
            >>> from uavrl import load_policy
            >>> env = load_policy("best").make_env("randomize=none", num_uavs=4, valleys=[100])
            >>> env.reset()["observation"].shape
            torch.Size([4, 237])
        """
        keys = keys_of(changes)
        for key in keys:
            if (key not in _TAKEN and not key.startswith(("env.", *OF_SENSOR))) or key == "env.num_uavs":
                taken = "env, env.KEY, randomize, perception.lidar.KEY and perception.blind"
                raise UavrlError(f"make_env takes changes of {taken}, and its arguments, got {key!r}.")
        try:
            composed = compose(*changes, name="evaluate")
        except Exception as error:  # of Hydra, whose further lines are about its own syntax
            raise UavrlError(f"make_env cannot take {', '.join(changes)}. {str(error).splitlines()[0]}") from error
        OmegaConf.update(composed, "packages", self.config.packages)
        run = validate(with_overrides(self.config, composed, list(changes)))
        if valleys is not None:
            require_valley(run.env, run.choices, "valleys")
        unseen = "world" in run.env and run.env.world.VARIES and "env.world.seeds" not in keys
        if valleys is not None or unseen:
            run.env["world"] = replace(run.env.world, seeds=tuple(valleys or [FIRST_UNSEEN]))
        if tasks is not None:
            require_valley(run.env, run.choices, "tasks")
        chosen = guard_settings(guards, self.guards)
        sensor = trained_sensor(self.config)
        check_field_of_view(run.perception, sensor, run.packages, allowed=allow_unseen)
        perception = with_sight(with_trained_view(run.perception, sensor, run.packages), chosen, keys)
        context: dict[str, Any] = {
            "packages": run.packages,
            "num_uavs": num_uavs,
            "seed": seed,
            "tasks": tasks,
            "keep_cloud": keep_cloud,
            "mark_resets": keep_cloud,
            "recurrent_state": self.recurrent_state,
            "guards": chosen,
        }
        return make_env(run.env, perception, run.reward, **context)
