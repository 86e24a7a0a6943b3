"""A model that Stable-Baselines3 saved, as a policy of an environment."""

from __future__ import annotations

import json
import logging
import pickle
import re
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from uavrl.errors import UavrlError

log = logging.getLogger(__name__)
# What makes the policy. Nothing else of the file is unpickled: schedules and buffers break with other versions most.
NEEDED = ("policy_class", "observation_space", "action_space", "policy_kwargs")
LIBRARIES = ("Stable-Baselines3", "Numpy")  # as system_info.txt calls them
# No state of the valley has so many negative numbers: altitude, goal angles and last action, at most 7 of 39.
NEGATIVE = 0.2
UNTOUCHED = 0.8  # of a last observation's numbers: so many are nearer to 0 than to what VecNormalize makes of 0
STATISTICS = ("vecnormalize.pkl", "vec_normalize.pkl")  # as RL Zoo and Stable-Baselines3's documentation call them


class StableBaselinesPolicy:
    """Acts as the model in a ``.zip`` of ``model.save`` does without noise: any whose file names its policy.

    It reads ``observation``, so it was trained on ``gymnasium.make("uavrl:uavrl/Valley-v0")`` or on what equals it.
    Opening the file runs whatever program it holds: open none that you do not trust.

    A model that has learned in a ``VecNormalize`` needs its statistics, a pickle too: ``vecnormalize.pkl`` or
    ``vec_normalize.pkl`` beside the file, or what ``CheckpointCallback`` wrote with it. Whether there was one shows in
    the last observation, which the file keeps: an empty cell reads 0, and less once its mean was taken off.

    Raises:
        UavrlError: where Stable-Baselines3 is missing, the file is none of its models, cannot be opened by the versions
            that are installed, lacks its statistics, or its state has another width.
    """

    def __init__(self, path: str | Path) -> None:
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
        except Exception as error:  # whatever its pickles raise
            raise UavrlError(_cannot_be_opened(path, error)) from error
        self._policy.set_training_mode(False)
        self._statistics = _statistics(path, stored, self._policy.observation_space.shape)

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


def _statistics(path: Path, stored: dict[str, Any], width: tuple[int, ...]) -> Any:
    """The ``VecNormalize`` by which a model sees; None for one that sees observations as they are."""
    of_checkpoint = re.sub(r"_(\d+_steps)$", r"_vecnormalize_\1", path.stem) + ".pkl"
    beside = [path.with_name(name) for name in (of_checkpoint, *STATISTICS)]
    file = next((file for file in beside if file.is_file()), None)
    last = _last_observation(stored)
    if file is None:
        if last is not None and (last < 0).mean() > NEGATIVE:
            raise UavrlError(
                f"{path} has learned from observations that VecNormalize had changed: put the statistics that "
                f"VecNormalize.save wrote beside it as {STATISTICS[0]}."
            )
        return None
    found = _normalizer(file, width)
    if last is not None and _untouched(last, found):
        log.warning("%s is left out: %s has learned from observations as they are.", file, path.name)
        return None
    return found


def _untouched(last: np.ndarray, normalizer: Any) -> bool:
    """Whether an observation is as the valley gives it, and not as a ``VecNormalize`` would have changed it."""
    empty = normalizer.normalize_obs(np.zeros(last.shape[-1], np.float32))
    telling = np.abs(empty) > 0.05
    return bool(telling.any() and (np.abs(last - empty) > np.abs(last))[..., telling].mean() > UNTOUCHED)


def _last_observation(stored: dict[str, Any]) -> np.ndarray | None:
    """The last one of a training, ``[vehicles, width]``; None where there was none, or it cannot be unpickled here."""
    from stable_baselines3.common.save_util import json_to_data

    with suppress(Exception):  # whatever its pickle raises
        last = json_to_data(json.dumps({"_last_obs": stored["_last_obs"]}))["_last_obs"]
        return np.asarray(last, np.float64) if isinstance(last, np.ndarray) else None
    return None


def _normalizer(file: Path, width: tuple[int, ...]) -> Any:
    from stable_baselines3.common.vec_env import VecNormalize

    try:
        found = pickle.loads(file.read_bytes())
        fits = isinstance(found, VecNormalize) and found.observation_space.shape == width
    except Exception as error:  # whatever a pickle raises
        raise UavrlError(f"{file} cannot be opened ({error}): write it again with VecNormalize.save.") from error
    if not fits:
        raise UavrlError(f"Expected statistics of observations of shape {width} in {file}, it holds something else.")
    return found
