"""The worlds of an evaluation: valleys that a policy was not trained in, unless its training's own are asked for."""

from collections.abc import Collection, Mapping, Sequence
from itertools import count, islice
from typing import Any

from omegaconf import DictConfig

from uavrl_onboard.pluralize import pluralize

UNSEEN, TRAINING = "unseen", "training"
VALLEYS = ("static", "dynamic")  # env=; the other worlds of several seeds are no valleys
FIRST_UNSEEN, COUNT = 100, 10  # the seeds of the suite's row held_out, which no preset trains in


def unseen_seeds(trained: Collection[int] = ()) -> tuple[int, ...]:
    """The seeds of ten valleys in which nothing was trained: those of the suite's row ``held_out``, if that holds.

    Examples:
        >>> unseen_seeds([0, 1])[0], unseen_seeds([0, 1])[-1]
        (100, 109)
        >>> unseen_seeds([100, 101])[0]
        102
    """
    return tuple(islice((seed for seed in count(FIRST_UNSEEN) if seed not in trained), COUNT))


def without_variety(run: DictConfig, composed: DictConfig, given: Collection[str]) -> DictConfig:
    """A run's configuration without what only its training varies, as the suite's rows are: only valleys differ.

    Vehicles are as their controllers believe, and all valleys have the first of the numbers of obstacles that those of
    the training have in turn. What the command line gives stays.

    Args:
        run: the configuration, with the overrides of the command line.
        composed: what the command line composes.
        given: the keys of these overrides.
    """
    if "world" not in run.env or "env" in given:
        return run
    result = run.copy()
    if "randomize" in result.env and not any(key.startswith(("randomize", "env.randomize")) for key in given):
        result.env.randomize = composed.env.get("randomize")
    numbers = result.env.world.get("obstacles")
    if "env.world.obstacles" not in given and not isinstance(numbers, int | None):
        result.env.world.obstacles = numbers[0]
    return result


def worlds_text(result: Mapping[str, Any]) -> str:
    """Which worlds an evaluation has flown in, for a person.

    Args:
        result: has ``env``; of a valley also ``valleys``, and ``training_valleys`` where these are known.

    Examples:
        >>> worlds_text({"env": "static", "valleys": [100, 101, 102], "training_valleys": [0]})
        '3 unseen valleys (seeds 100–102), env=static'
        >>> worlds_text({"env": "static", "valleys": [0, 1], "training_valleys": [0, 1, 2]})
        '2 of its training valleys (seeds 0–1), env=static'
        >>> worlds_text({"env": "dynamic", "valleys": [7]})
        '1 valley (seed 7), env=dynamic'
        >>> worlds_text({"env": "forest", "valleys": [100, 101], "training_valleys": [0]})
        '2 unseen worlds (seeds 100–101), env=forest'
    """
    env, valleys = f"env={result['env']}", result.get("valleys")
    if not valleys:
        return env
    kind = "valley" if result["env"] in VALLEYS else "world"
    trained, several = result.get("training_valleys"), pluralize(len(valleys), kind)
    seen = set(valleys) & set(trained or ())
    if trained is not None:
        number, noun = several.split()
        several = f"{number} unseen {noun}"
        if seen == set(trained):
            several = f"its {'' if len(seen) == 1 else f'{len(seen):,} '}training {noun}"
        elif len(seen) == len(set(valleys)):
            several = f"{number} of its training {kind}s"
        elif seen:
            several = f"{number} {kind}s, {len(seen):,} of them from its training"
    return f"{several} (seed{'' if len(valleys) == 1 else 's'} {seed_ranges(valleys)}), {env}"


def seed_ranges(seeds: Sequence[int]) -> str:
    """Seeds in order, with consecutive ones as a range.

    Examples:
        >>> seed_ranges([0, 100, 101, 102, 7])
        '0, 7, 100–102'
    """
    runs: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if runs and seed == runs[-1][-1] + 1:
            runs[-1].append(seed)
        else:
            runs.append([seed])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]}–{run[-1]}" for run in runs)
