"""How early does what a policy sees tell where a plane will pass?

    python studies/foresight.py                       # 6,000 steps of 16 vehicles among nine planes
    python studies/foresight.py perception.radius=8.0
    python studies/foresight.py perception=range_image perception.motion=12

Small networks are taught to tell whether a plane that passes within reach will pass above or below, left or right,
with three quarters of the steps, and are asked in the last one. Four inputs are compared, each now and at two steps
before: the numbers that a policy sees; these and the same without the planes, as if planes could be told from
rocks; mean, nearest and number of the scan's points on planes, before any reduction; and where the plane is, which no
policy knows, and which shows that the networks can learn it. With ``perception.motion`` what is reported of the plane
as a moving object is asked, too, as if it flew straight on; where nothing is reported that counts as wrong. By the time
that is left, the share of right answers is printed, and of how many; half is guessing. `policy=vfh` flies, since it can
with any reduction.
"""

from __future__ import annotations

import argparse
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from passes import TIMES, moments
from torch import nn

from uavrl.config import compose, validate
from uavrl.evaluation.policies import named_policy
from uavrl.runs.provenance import versions
from uavrl_onboard.cli.process import one_sentence

TAUGHT = 0.75  # share of the steps, from the first on
QUESTIONS = {"above or below": (2, 0.2), "left or right": (1, 0.3)}  # the axis, and m beside the middle that count
EPOCHS, NETWORKS = 40, 3


def answers(x: np.ndarray, label: np.ndarray, taught: np.ndarray) -> np.ndarray:
    """The mean log-odds ``[M]`` of networks that were taught with some of the rows of ``x [M, *]``."""
    torch.manual_seed(0)
    x = x.reshape(len(x), -1)
    data, labels, odds = torch.as_tensor(x).float(), torch.as_tensor(label).float(), torch.zeros(len(x))
    rows = torch.as_tensor(np.flatnonzero(taught))
    for _ in range(NETWORKS):
        layers = [nn.Linear(x.shape[1], 128), nn.ReLU(), nn.Dropout(0.2), nn.Linear(128, 64), nn.ReLU()]
        network = nn.Sequential(*layers, nn.Linear(64, 1), nn.Flatten(0))
        adam = torch.optim.AdamW(network.parameters(), 1e-3, weight_decay=1e-2)
        for _ in range(EPOCHS):
            for chosen in rows[torch.randperm(len(rows))].split(128):
                loss = nn.functional.binary_cross_entropy_with_logits(network(data[chosen]), labels[chosen])
                adam.zero_grad()
                loss.backward()
                adam.step()
        with torch.no_grad():
            odds += network.eval()(data) / NETWORKS
    return odds.numpy()


def main() -> None:
    """Prints one line for each question and input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--json", type=Path)
    args, overrides = parser.parse_known_args()
    torch.set_num_threads(1)
    config = validate(compose("env=dynamic", *overrides))
    vfh = named_policy("vfh", {**config.perception, "flight_level": config.env.world.flight_level}, ())
    steps, flown = [], 0
    for number, now in enumerate(moments(config, vfh, args.steps)):
        when = np.full(len(now.time), number)
        rows = (now.seen, now.hidden, now.points, now.plane, now.time, now.miss, now.told, when)
        steps.append([np.asarray(row)[now.danger] for row in rows])
        flown += len(now.time)
    seen, hidden, points, plane, time, miss, told, step = (np.concatenate(rows) for rows in zip(*steps, strict=True))
    inputs = {
        "what a policy sees": seen,
        "and the same without the planes": np.concatenate([seen, seen - hidden], 1),
        "the LiDAR's points on planes": points,
        "where the plane is and was": plane / config.perception.radius,
    }
    taught = step < TAUGHT * args.steps
    print(f"{flown:,} steps flown, in {len(seen):,} a plane is seen that passes within reach")
    print(f"{'':49}" + "".join(f"{f'{low:.2f}-{high:.1f} s':>16}" for low, high in pairwise(TIMES)))
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    for question, (axis, least) in QUESTIONS.items():
        label, clear = miss[:, axis] > 0, np.abs(miss[:, axis]) > least
        found[question] = {}
        answered = {name: answers(x, label, taught & clear) for name, x in inputs.items()}
        if np.isfinite(told).any():
            answered["the moving object, straight on"] = told[:, axis]
        for name, odds in answered.items():
            right = ((odds > 0) == label) & np.isfinite(odds)
            shares = []
            for low, high in pairwise(TIMES):
                asked = ~taught & clear & (time >= low) & (time < high)
                shares.append({"from": low, "to": high, "steps": int(asked.sum()), "right": float(right[asked].mean())})
            found[question][name] = shares
            line = "".join(f"{row['right']:11.0%}{row['steps']:5}" for row in shares)
            print(f"{question:16}{name:33}{line}", flush=True)
    if args.json:
        args.json.write_text(
            json.dumps({"versions": versions(), "overrides": overrides, "right": found}, indent=1), encoding="utf-8"
        )


if __name__ == "__main__":
    with one_sentence():
        main()
