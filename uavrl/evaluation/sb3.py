"""A model that Stable-Baselines3 saved, as a policy of an environment."""

from __future__ import annotations

import json
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase

from uavrl.errors import UavrlError

# What makes the policy. Nothing else of the file is unpickled: schedules and buffers break with other versions most.
NEEDED = ("policy_class", "observation_space", "action_space", "policy_kwargs")
LIBRARIES = ("Stable-Baselines3", "Numpy")  # as system_info.txt calls them


class StableBaselinesPolicy:
    """Acts as the model in a ``.zip`` of ``model.save`` does without noise: any whose file names its policy.

    It reads ``observation``, so it was trained on ``gymnasium.make("uavrl:uavrl/Valley-v0")`` or on what equals it.
    Opening the file, or the statistics, runs whatever program it holds: open none that you do not trust.

    Args:
        path: the model.
        vecnormalize: the statistics of a model that was trained in a ``VecNormalize``, which ``VecNormalize.save`` or
            ``CheckpointCallback(save_vecnormalize=True)`` wrote. None: the model reads observations as they are. The
            ``.zip`` does not record which of the two holds.

    Raises:
        UavrlError: where Stable-Baselines3 is missing, the file is none of its models, cannot be opened by the versions
            that are installed, or has a recurrent policy; where the statistics are those of something else; and when
            the observation has another width.
    """

    def __init__(self, path: str | Path, vecnormalize: str | Path | None = None) -> None:
        try:
            import stable_baselines3  # noqa: F401
        except ImportError as error:
            raise UavrlError(f"{path} needs Stable-Baselines3: pip install stable-baselines3.") from error
        path = Path(path)
        if not path.is_file():
            raise UavrlError(f"Expected a model of Stable-Baselines3 at {path} and found no file: check the name.")
        try:
            with zipfile.ZipFile(path) as archive:
                stored = json.loads(archive.read("data"))  # what it says of the model: pickles stay texts
            self._policy = _policy(path, stored)
            self._policy.set_training_mode(False)
            _, state = self._policy.predict(self._policy.observation_space.sample(), deterministic=True)
        except Exception as error:  # whatever its pickles raise
            raise UavrlError(_cannot_be_opened(path, error)) from error
        if state is not None:
            raise UavrlError(
                f"{path} has a recurrent policy, whose state an evaluation would not keep: choose a model without one, "
                f"or wrap it in a class of your own that keeps it (policy=PACKAGE.MODULE.CLASS)."
            )
        width = self._policy.observation_space.shape
        self._statistics = None if vecnormalize is None else _statistics(Path(vecnormalize), width)

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes ``action`` from ``observation``."""
        state, width = tensordict["observation"], self._policy.observation_space.shape
        if state.shape[-1:] != width:
            raise UavrlError(
                f"The model reads states of shape {width}, got {tuple(state.shape[-1:])}: change perception."
            )
        seen = state.cpu().numpy()
        if self._statistics is not None:
            seen = self._statistics.normalize_obs(seen)
        action, _ = self._policy.predict(seen, deterministic=True)
        return tensordict.set("action", torch.as_tensor(action, device=state.device))


def _policy(path: Path, stored: dict[str, Any]) -> Any:
    from stable_baselines3.common.save_util import load_from_zip_file

    left_out = dict.fromkeys(stored.keys() - set(NEEDED))
    data, parameters, _ = load_from_zip_file(path, device="cpu", custom_objects=left_out)
    assert data is not None, "there is one"
    spaces = data["observation_space"], data["action_space"]
    policy = data["policy_class"](*spaces, lambda _: 0.0, **data["policy_kwargs"])
    policy.load_state_dict(parameters["policy"])
    return policy


def _cannot_be_opened(path: Path, error: Exception) -> str:
    """Why not, in a sentence that names versions where they differ."""
    from stable_baselines3.common.utils import get_system_info

    here, there = get_system_info(print_info=False)[0], {}
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if "system_info.txt" in archive.namelist():
                there = dict(re.findall(r"^- ([^:\n]+): (.*)$", archive.read("system_info.txt").decode(), re.MULTILINE))
    if all(there.get(name, here[name]) == here[name] for name in LIBRARIES):
        return f"{path} is no model that Stable-Baselines3 saved ({error}): save it again."
    saved, installed = (
        f"Stable-Baselines3 {of.get(LIBRARIES[0], '?')} and NumPy {of.get(LIBRARIES[1], '?')}" for of in (there, here)
    )
    return (
        f"{path} was saved with {saved}, and cannot be opened with {installed} ({error}): load it with the former and "
        f"save it with the latter, or install the former."
    )


def _statistics(file: Path, width: tuple[int, ...]) -> Any:
    """The ``VecNormalize`` in a file."""
    from stable_baselines3.common.vec_env import VecNormalize

    if not file.is_file():
        raise UavrlError(f"vecnormalize={file} is no file: give the one that VecNormalize.save wrote.")
    try:
        found = pickle.loads(file.read_bytes())
        fits = isinstance(found, VecNormalize) and found.observation_space.shape == width
    except Exception as error:  # whatever a pickle raises
        raise UavrlError(f"{file} cannot be opened ({error}): write it again with VecNormalize.save.") from error
    if not fits:
        raise UavrlError(f"Expected statistics of observations of shape {width} in {file}, it holds something else.")
    return found
