"""The two backward rewards of the thesis: BackwardReward with their classifiers."""

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

from tensordict import NestedKey
from torch import Tensor

from uavrl.buffers.backward_reward import BackwardReward
from uavrl.buffers.functional import stacked_frames
from uavrl.buffers.history import TrajectoryHistory
from uavrl.errors import UavrlError
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.psae import TrajectoryClassifier, packaged_artifact
from uavrl.runs.weights import ARTIFACT
from uavrl_onboard.ranges import Count, Folder, NonNegative, Share, Whole

CHANNELS = 10  # of the convolution: 20 features for 3 frames (Table 4.1)
FRAMES = 3  # p_frames (Table 4.1)


class ABR(BackwardReward):
    """The backward reward with classes by one-shot learning (Chansuparp (2022), §3.4).

    The classifier convolves over the observations that are stacked in a state. Unless you pass the sizes, they are read
    off the first episode that the buffer stores: in it each state is the state before it, moved up by one observation.
    A window has as many steps as a state has observations.

    Args:
        multiplier: p_addReward.
        threshold: cosine similarity from which a state joins a class (Table 4.1).
        max_classes: largest number of classes.
        seed: seed of the convolution that computes the features.
        stacked: observations in a state, oldest first; None to read it off the first episode.
        observations: width of the state; None to read it off the first episode.
        history, observation, reward, arrived, done, reward_raw: as in :class:`BackwardReward`.

    Raises:
        UavrlError: for states of one observation, since it convolves over time; at a write, for states that are not
            stacked, or of another width than before.

    Examples:
        >>> ABR(observations=70, stacked=2, arrived=("next", "success")).frames
        2
        >>> ABR(arrived=("next", "success"))
        ABR(arrived=('next', 'success'))
    """

    def __init__(
        self,
        multiplier: NonNegative = 0.2,
        threshold: Share = 0.98,
        max_classes: Count = 20_000,
        seed: Whole = 0,
        *,
        stacked: int | None = None,
        observations: int | None = None,
        history: TrajectoryHistory | None = None,
        observation: NestedKey = "observation",
        reward: NestedKey = ("next", "reward"),
        arrived: NestedKey = ("next", "arrived"),
        done: NestedKey = ("next", "done"),
        reward_raw: NestedKey = ("next", "reward_raw"),
    ) -> None:
        if stacked is not None and stacked < 2:
            raise UavrlError(
                f"With backward_reward=abr perception.frames must be at least 2, got {stacked}: it convolves over time."
            )
        keys = {"observation": observation, "reward": reward, "arrived": arrived, "done": done}
        super().__init__(_undecided, stacked or FRAMES, multiplier, history=history, reward_raw=reward_raw, **keys)
        self.stacked, self.observations = stacked, observations
        self.threshold, self.max_classes, self.seed = threshold, max_classes, seed
        if stacked is not None and observations is not None:
            self._fit(stacked, observations)

    def prepare(self, states: Tensor, done: Tensor) -> None:
        """Make the classifier for the states ``[T, S]`` of the first episode, unless it is made."""
        if isinstance(self.classifier, OneShotClassifier):
            return
        width = states.shape[-1]
        if states.ndim != 2 or self.observations not in (None, width):
            expected = "[T, S]" if self.observations is None else f"[T, {self.observations}]"
            raise UavrlError(f"ABR expected states {expected}, got {list(states.shape)}: check observation=.")
        if self.stacked is not None:
            self._fit(self.stacked, width)
        elif not bool(done[:-1].all()):  # some state follows another one
            found = stacked_frames(states, done)
            if not found:
                raise UavrlError(
                    f"ABR compares the observations that are stacked in a state, and these states of {width} numbers "
                    f"are not stacked: stack observations with CatFrames(N=3, dim=-1), or pass stacked=."
                )
            if len(found) == 1:
                self._fit(found[0], width)

    def _fit(self, stacked: int, observations: int) -> None:
        if observations % stacked:
            raise UavrlError(f"ABR cannot split a state of {observations} numbers into {stacked} observations.")
        self.frames = stacked
        self.classifier = OneShotClassifier(
            width=observations // stacked,
            frames=stacked,
            features=CHANNELS * (stacked - 1),
            threshold=self.threshold,
            max_classes=self.max_classes,
            seed=self.seed,
        )

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *args: Any) -> None:
        """Makes a classifier for the states that the saved one knew; none where there was none."""
        weight, exemplars = (state_dict.get(f"{prefix}classifier.{name}") for name in ("weight", "exemplars"))
        if weight is None or exemplars is None:
            del self.classifier  # a module cannot be replaced by a function
            self.classifier = _undecided
        elif not isinstance(self.classifier, OneShotClassifier):
            stacked = exemplars.shape[1] // CHANNELS + 1
            self._fit(stacked, stacked * weight.shape[1])
        super()._load_from_state_dict(state_dict, prefix, *args)


def _undecided(states: Tensor) -> Tensor:
    raise UavrlError(
        f"ABR cannot tell how many observations are stacked in a state of {states.shape[-1]} numbers, since they "
        f"hardly change: pass stacked= and observations=."
    )


class ABRPlus(BackwardReward):
    """The backward reward with classes by the trained classifier (Chansuparp (2022), §3.4, Algorithm 3.1).

    Args:
        multiplier: p_addReward.
        artifact: a folder that ``uavrl-pretrain`` wrote, or ``"packaged"``, which fits the default states.
        stacked: steps in a window; None for as many as the artifact's states have observations.
        observations: width of the state; None to compare that of the first episode.
        perception: settings of the run's perception, compared with those that the artifact records.
        kept: folder for a copy of the artifact, which is read if it is there; None makes no copy.
        history, observation, reward, arrived, done, reward_raw: as in :class:`BackwardReward`.

    Raises:
        UavrlError: when the artifact is missing, damaged, or made for other states; at a write, for other states.

    Examples:
        >>> ABRPlus().classifier.inputs
        105
    """

    def __init__(
        self,
        multiplier: NonNegative = 0.2,
        artifact: Folder = "packaged",
        *,
        stacked: int | None = None,
        observations: int | None = None,
        perception: Mapping[str, Any] | None = None,
        kept: Path | None = None,
        history: TrajectoryHistory | None = None,
        observation: NestedKey = "observation",
        reward: NestedKey = ("next", "reward"),
        arrived: NestedKey = ("next", "arrived"),
        done: NestedKey = ("next", "done"),
        reward_raw: NestedKey = ("next", "reward_raw"),
    ) -> None:
        source = packaged_artifact() if artifact == "packaged" else Path(artifact)
        if kept is not None and kept.exists():
            source = kept
        classifier = TrajectoryClassifier.load(source)
        _require_its_states(classifier, str(artifact), perception or {})
        if observations is not None:
            _require_width(classifier, str(artifact), observations)
        if kept is not None and kept != source:
            kept.mkdir()
            for name in (ARTIFACT.safetensors, ARTIFACT.json):
                shutil.copyfile(source / name, kept / name)
        frames = stacked or classifier.perception.get("frames") or FRAMES
        keys = {"observation": observation, "reward": reward, "arrived": arrived, "done": done}
        super().__init__(classifier, frames, multiplier, history=history, reward_raw=reward_raw, **keys)
        self.artifact = str(artifact)

    def prepare(self, states: Tensor, done: Tensor) -> None:
        """Refuse states of another width than the artifact's."""
        assert isinstance(self.classifier, TrajectoryClassifier)
        _require_width(self.classifier, self.artifact, states.shape[-1])


REMEDY = "make one by uavrl-pretrain from a run with this perception, and name it, backward_reward.artifact=FOLDER."


def _require_its_states(classifier: TrajectoryClassifier, artifact: str, perception: Mapping[str, Any]) -> None:
    for key, known in classifier.perception.items():
        value = perception.get(key)
        if is_dataclass(value) and not isinstance(value, type):
            value = json.loads(json.dumps(asdict(value)))  # as an artifact has it
        if None not in (known, value) and value != known:  # None is the default of the class
            raise UavrlError(
                f"The artifact {artifact} is of perception.{key}={known!s:.80}, and this is {value!s:.80}: {REMEDY}"
            )


def _require_width(classifier: TrajectoryClassifier, artifact: str, observations: int) -> None:
    if classifier.inputs != observations:
        raise UavrlError(
            f"The artifact {artifact} classifies states of {classifier.inputs} numbers, these have {observations}: "
            f"{REMEDY}"
        )
