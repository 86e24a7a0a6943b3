"""How often a run's policy asks for the most that a vehicle can do, in the states that the run has flown.

python studies/saturation.py RUN_FOLDER

A policy that does so nearly always no longer looks at what it is given: tanh has no slope there to learn by.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from tensordict import TensorDict

from uavrl.evaluation.actor import read_policy
from uavrl.pretraining import read_states
from uavrl_onboard.cli.process import one_sentence

ACTIONS = ("forward", "sideways", "up", "turn")


def main() -> None:
    """Prints one line for each action."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("--states", type=int, default=20_000, help="the last so many")
    args = parser.parse_args()
    states = torch.as_tensor(read_states(args.run).states[-args.states :])
    policy = read_policy(args.run)
    with torch.no_grad():
        action = policy(TensorDict({"observation": states}, [len(states)]))["action"]
    print(f"{len(states):,} states; share of them in which the policy asks for 99 % of the most or more")
    limit = action.abs().amax()
    for name, values in zip(ACTIONS, action.T, strict=True):
        print(f"{name:10}{(values.abs() > 0.99 * limit).float().mean():>7.1%}  mean {values.mean():+.2f}")


if __name__ == "__main__":
    with one_sentence():
        main()
