"""A model that Stable-Baselines3 saved, as a policy of an environment."""

from __future__ import annotations

from pathlib import Path

import torch
from tensordict import TensorDictBase

from uavrl.errors import UavrlError


class StableBaselinesPolicy:
    """Acts as a saved model does without noise: TD3, SAC, PPO or any other whose file names its policy.

    It reads ``observation``, so it was trained on ``gymnasium.make("uavrl:uavrl/Valley-v0")`` or on what equals it.
    Opening the file runs whatever program it holds: open none that you do not trust.

    Args:
        path: The ``.zip`` that ``model.save`` wrote.

    Raises:
        UavrlError: where Stable-Baselines3 is missing, the file is none of its models, or its state has another width.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            from stable_baselines3.common.save_util import load_from_zip_file
        except ImportError as error:
            raise UavrlError(f"{path} needs Stable-Baselines3: pip install stable-baselines3.") from error
        if not Path(path).is_file():
            raise UavrlError(f"Expected a model of Stable-Baselines3 at {path} and found no file: check the name.")
        try:
            data, parameters, _ = load_from_zip_file(path, device="cpu")
            data = data or {}  # without them: the error below
            spaces = data["observation_space"], data["action_space"]
            self._policy = data["policy_class"](*spaces, lambda _: 0.0, **data["policy_kwargs"])
            self._policy.load_state_dict(parameters["policy"])
        except Exception as error:  # whatever its pickles raise
            raise UavrlError(f"{path} is no model that Stable-Baselines3 saved ({error}): save it again.") from error
        self._policy.set_training_mode(False)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` from ``observation``."""
        state, width = tensordict["observation"], self._policy.observation_space.shape
        if state.shape[-1:] != width:
            raise UavrlError(
                f"The model reads states of shape {width}, got {tuple(state.shape[-1:])}: change perception."
            )
        action, _ = self._policy.predict(state.cpu().numpy(), deterministic=True)
        return tensordict.set("action", torch.as_tensor(action, device=state.device))
