"""The two backward rewards of the thesis, with the classifiers that make them."""

import shutil
from pathlib import Path

from uavrl.buffers.backward_reward import BackwardReward
from uavrl.buffers.functional import Scale
from uavrl.errors import UavrlError
from uavrl.models.one_shot import OneShotClassifier
from uavrl.models.trajectory_classifier import TrajectoryClassifier, packaged_artifact
from uavrl.ranges import Count, NonNegative, Share, Whole
from uavrl.runs.weights import ARTIFACT


class ABR(BackwardReward):
    """The backward reward with classes by one-shot learning (Chansuparp (2022), §3.4).

    Args:
        multiplier: p_addReward.
        threshold: cosine similarity from which a state joins a class (Table 4.1).
        max_classes: classes that are founded at most.
        seed: of the convolution that gives the features.
        scale, window: as :class:`BackwardReward` has them.
        stacked: observations in a state.
        observations: width of the state.

    Raises:
        UavrlError: for states of one observation: it convolves over time.

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
        scale: Scale = "rank",
        window: Count = 1000,
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
        super().__init__(classifier, stacked, multiplier, scale=scale, window=window)


_NOT_PACKAGED = {
    "packaged_raw": "perception.angles=raw",
    "packaged_range": "perception.statistic=range",
    "packaged_proximity": "perception.statistic=proximity",
}


class ABRPlus(BackwardReward):
    """The backward reward with classes by the trained classifier (Chansuparp (2022), §3.4, Algorithm 3.1).

    Args:
        multiplier: p_addReward.
        artifact: a folder that ``uavrl-pretrain`` wrote, or ``"packaged"``: of states as the default has them. None
            comes with uavrl for others, ``"packaged_raw"``, ``_range`` and ``_proximity``.
        scale, window: as :class:`BackwardReward` has them.
        stacked: observations in a state.
        observations: width of the state.
        kept: a copy of the artifact, made here at the first time and read from then on; None keeps none.

    Raises:
        UavrlError: when the artifact is missing, damaged, or of other states.

    Examples:
        >>> ABRPlus().classifier.inputs
        105
    """

    def __init__(
        self,
        multiplier: NonNegative = 0.2,
        artifact: str = "packaged",
        scale: Scale = "rank",
        window: Count = 1000,
        *,
        stacked: int = 3,
        observations: int = 105,
        kept: Path | None = None,
    ) -> None:
        if artifact in _NOT_PACKAGED:
            raise UavrlError(
                f"No artifact of ABR⁺ comes with uavrl for {_NOT_PACKAGED[artifact]}: make one by uavrl-pretrain from "
                "a run with that, and name its folder, backward_reward.artifact=FOLDER."
            )
        source = packaged_artifact() if artifact == "packaged" else Path(artifact)
        if kept is not None and not kept.exists():
            TrajectoryClassifier.load(source)
            kept.mkdir()
            for name in (ARTIFACT.safetensors, ARTIFACT.json):  # and nothing that lies beside them
                shutil.copyfile(source / name, kept / name)
        classifier = TrajectoryClassifier.load(source if kept is None else kept)
        if classifier.inputs != observations:
            raise UavrlError(
                f"The artifact {artifact} classifies states of {classifier.inputs} numbers, these have "
                f"{observations}: make one with uavrl-pretrain from a run with "
                f"this perception, perception.frames={stacked} and all."
            )
        super().__init__(classifier, stacked, multiplier, scale=scale, window=window)
