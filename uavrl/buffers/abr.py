"""The two backward rewards of the thesis: BackwardReward with their classifiers."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uavrl.buffers.backward_reward import BackwardReward
from uavrl.errors import UavrlError
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.psae import TrajectoryClassifier, packaged_artifact
from uavrl.runs.weights import ARTIFACT
from uavrl_onboard.ranges import Count, Folder, NonNegative, Share, Whole


class ABR(BackwardReward):
    """The backward reward with classes by one-shot learning (Chansuparp (2022), §3.4).

    Args:
        multiplier: p_addReward.
        threshold: cosine similarity from which a state joins a class (Table 4.1).
        max_classes: largest number of classes.
        seed: seed of the convolution that computes the features.
        stacked: observations in a state.
        observations: width of the state.

    Raises:
        UavrlError: for states of one observation, since it convolves over time.

    Examples:
        >>> ABR(observations=70, stacked=2).frames
        2
    """

    def __init__(
        self,
        multiplier: NonNegative = 0.2,
        threshold: Share = 0.98,
        max_classes: Count = 20_000,
        seed: Whole = 0,
        *,
        stacked: int = 3,
        observations: int = 105,
    ) -> None:
        if stacked < 2:
            raise UavrlError(
                f"With backward_reward=abr perception.frames must be at least 2, got {stacked}: it convolves over time."
            )
        classifier = OneShotClassifier(
            width=observations // stacked,
            frames=stacked,
            features=10 * (stacked - 1),  # 20 for 3 frames (Table 4.1)
            threshold=threshold,
            max_classes=max_classes,
            seed=seed,
        )
        super().__init__(classifier, stacked, multiplier)


class ABRPlus(BackwardReward):
    """The backward reward with classes by the trained classifier (Chansuparp (2022), §3.4, Algorithm 3.1).

    Args:
        multiplier: p_addReward.
        artifact: a folder that ``uavrl-pretrain`` wrote, or ``"packaged"``, which fits the default states.
        stacked: observations in a state.
        observations: width of the state.
        perception: settings of the run's perception, compared with those that the artifact records.
        kept: folder for a copy of the artifact, which is read if it is there; None makes no copy.

    Raises:
        UavrlError: when the artifact is missing, damaged, or made for other states.

    Examples:
        >>> ABRPlus().classifier.inputs
        105
    """

    def __init__(
        self,
        multiplier: NonNegative = 0.2,
        artifact: Folder = "packaged",
        *,
        stacked: int = 3,
        observations: int = 105,
        perception: Mapping[str, Any] | None = None,
        kept: Path | None = None,
    ) -> None:
        source = packaged_artifact() if artifact == "packaged" else Path(artifact)
        if kept is not None and kept.exists():
            source = kept
        classifier = TrajectoryClassifier.load(source)
        _require_its_states(classifier, str(artifact), observations, perception or {})
        if kept is not None and kept != source:
            kept.mkdir()
            for name in (ARTIFACT.safetensors, ARTIFACT.json):
                shutil.copyfile(source / name, kept / name)
        super().__init__(classifier, stacked, multiplier)


def _require_its_states(
    classifier: TrajectoryClassifier, artifact: str, observations: int, perception: Mapping[str, Any]
) -> None:
    remedy = "make one by uavrl-pretrain from a run with this perception, and name it, backward_reward.artifact=FOLDER."
    for key, known in classifier.perception.items():
        value = perception.get(key)
        if None not in (known, value) and value != known:  # None is the default of the class
            raise UavrlError(
                f"The artifact {artifact} is of perception.{key}={known!s:.80}, and this is {value!s:.80}: {remedy}"
            )
    if classifier.inputs != observations:
        raise UavrlError(
            f"The artifact {artifact} classifies states of {classifier.inputs} numbers, these have {observations}: "
            f"{remedy}"
        )
