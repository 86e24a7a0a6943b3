"""What a run tells the user about settings under which it learns little."""

import logging
import math

from uavrl.config.settings import TrainConfig

log = logging.getLogger(__name__)


def warn_of_random_steps(settings: TrainConfig) -> None:
    """Before the run: its random steps may not end before it does."""
    random_steps, episodes, steps = settings.algo.random_steps, settings.trainer.episodes, settings.trainer.steps
    length = f"trainer.episodes={episodes}" if steps is None else f"trainer.steps={steps}"
    if settings.guided:  # whose flights are learned from at once
        if random_steps >= min(episodes * settings.env.get("max_steps", 300) // 3, steps or math.inf):
            log.warning(
                "algo.random_steps=%d: the guide may fly the whole run, %s, and the policy nothing. Choose fewer "
                "random steps or a longer run.",
                random_steps,
                length,
            )
        return
    if steps is not None and random_steps >= steps:
        log.warning(
            "algo.random_steps=%d: nothing is learned before, and the run ends by then, by trainer.steps=%d. Choose "
            "fewer random steps or a longer run.",
            random_steps,
            steps,
        )
    elif random_steps > (expected := expected_steps(episodes, settings.env.get("max_steps", random_steps * 6))):
        log.warning(
            "algo.random_steps=%d: nothing is learned before, and trainer.episodes=%d flights may be over by then, "
            "since random ones last about %d steps together. Choose fewer random steps or a longer run.",
            random_steps,
            episodes,
            expected,
        )


def warn_of_nothing_learned(settings: TrainConfig, steps: int, updates: int) -> None:
    """After the run: it ended inside its random steps."""
    if updates == 0:
        log.warning(
            "Nothing was learned: the run ended after %d steps, inside its algo.random_steps=%d. Choose fewer random "
            "steps, or a longer run.",
            steps,
            settings.algo.random_steps,
        )


def expected_steps(episodes: int, max_steps: int) -> int:
    """About how many steps random flights make: they end after 50, or after a sixth of many that they may take."""
    return max(episodes * min(max_steps, 50), episodes * max_steps // 6)
