"""How long before a collision does LifeGuard's classifier warn?

    python studies/warning_time.py [--flights 900] [--json FILE] [--figure FILE]

`policy=best` flies with exploration noise through a valley with half as many obstacles again, where many
flights collide. Each form of the classifier learns from two flights in three, one after the other, as it does in a
training, and is asked of each step of the others. It warns where c exceeds what it exceeds in 1 in 100 steps of flights
that arrive. Told is, of flights that collide, the share of warnings so many steps before: 0 is the one that collides.
"""

from __future__ import annotations

import argparse
import json
import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule

from uavrl.config import compose, validate
from uavrl.evaluation.actor import load_actor
from uavrl.evaluation.environment import make_env
from uavrl.evaluation.policies import policy_folder
from uavrl.losses import LifeGuard, TD3Loss
from uavrl.losses.networks import network_sizes
from uavrl.models import Critic
from uavrl.runs.provenance import versions
from uavrl.training.build import make_collector
from uavrl_onboard.cli.process import one_sentence

FORMS: dict[str, dict[str, Any]] = {"linear (the thesis)": {"model": "linear"}, "mlp": {"model": "mlp"}}
BEFORE = range(16)  # steps
FALSE_ALARMS = 0.01
KEEP = ("observation", "action")
FLAGS = ("done", "arrived", "collided")


def fly(count: int, seed: int) -> tuple[list[TensorDictBase], TensorDictModule, Any]:
    """The first flights that begin, in the order in which they end, and who flew."""
    sight = ("perception=range_image", "perception.last_action=true")
    config = validate(compose("env.world.obstacles=68", "algo.learning_starts=0", *sight))
    env = make_env(config.env, config.perception, config.reward, seed=seed)
    folder = policy_folder(None, "best")
    assert folder is not None
    actor = load_actor(folder, None, "cpu")[1]
    sizes = network_sizes(env)
    spec = env.action_spec_unbatched
    collector: Any = make_collector(config, env, actor, sizes, torch.device("cpu"))
    collector.restart(seed, count)
    flights = []
    for flight in collector:
        kept = flight.select(*KEEP).set("next", flight["next"].select(*FLAGS))
        flights.append(kept)
        if len(flights) == count:
            break
    collector.shutdown()
    return flights, actor, spec


def drawn(steps: TensorDictBase, count: int) -> TensorDictBase:
    """So many at random."""
    return steps[torch.randint(len(steps), (count,))]


def learned(form: dict[str, Any], flights: list[TensorDictBase], actor: TensorDictModule, spec: Any) -> LifeGuard:
    """A LifeGuard that has seen these flights, one after the other."""
    torch.manual_seed(0)
    state, action = flights[0]["observation"].shape[-1], flights[0]["action"].shape[-1]
    critics = [TensorDictModule(Critic(state, action), ["observation", "action"], ["state_action_value"]) for _ in "12"]
    base = TD3Loss(actor, critics, action_spec=spec)
    lifeguard = LifeGuard(base, observations=state, actions=action, stacked=3, **form)
    optimizer = lifeguard.make_optimizer()
    steps = torch.cat(flights)  # those up to now are drawn from
    end = 0
    for flight in flights:
        end += len(flight)
        lifeguard.observe(flight)
        lifeguard.fit(partial(drawn, steps[:end]), len(flight), optimizer)
    return lifeguard


@torch.no_grad()
def warnings(lifeguard: LifeGuard, flights: list[TensorDictBase]) -> tuple[list[float], float]:
    """The share of collisions that are warned of so many steps before, and the steps from which on, in the middle."""
    said = [lifeguard.classifier(lifeguard._features(flight)).sigmoid().numpy() for flight in flights]
    arrived = np.concatenate([c for c, flight in zip(said, flights, strict=True) if flight["next", "arrived"].any()])
    limit = np.quantile(arrived, 1 - FALSE_ALARMS)
    before = [c[::-1] > limit for c, flight in zip(said, flights, strict=True) if flight["next", "collided"].any()]
    shares = [float(np.mean([c[k] for c in before if len(c) > k])) for k in BEFORE]
    from_on = [int(np.argmin(c)) if not c.all() else len(c) for c in before]  # steps without a gap to the collision
    return shares, float(np.median(from_on))


def draw(shares: dict[str, list[float]], path: Path) -> None:
    """One line for each form."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 3.6), layout="constrained")
    for name, share in shares.items():
        axes.plot([-k / 10 for k in BEFORE], [100 * value for value in share], label=name, marker=".", linewidth=1.2)
    axes.set(xlabel="seconds to the collision", ylabel="collisions warned of [%]", ylim=(0, 100))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Prints one line for each form."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=900)
    parser.add_argument("--seed", type=int, default=4242, help="of tasks and noise")
    parser.add_argument("--forms", nargs="+", choices=FORMS, default=list(FORMS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    torch.manual_seed(args.seed)
    flights, actor, spec = fly(args.flights, args.seed)
    asked = flights[2::3]
    taught = [flight for number, flight in enumerate(flights) if number % 3 != 2]
    ends = [sum(bool(flight["next", key].any()) for flight in asked) for key in ("collided", "arrived")]
    print(f"taught with {len(taught)} flights; asked in {ends[0]} that collided and {ends[1]} that arrived\n")
    print(f"{'steps before':<24}" + "".join(f"{k:>6}" for k in BEFORE) + "   warns from")
    told: dict[str, list[float]] = {}
    first: dict[str, float] = {}
    for name in args.forms:
        told[name], first[name] = warnings(learned(FORMS[name], taught, actor, spec), asked)
        print(f"{name:<24}" + "".join(f"{share:>6.0%}" for share in told[name]) + f"{first[name]:>12.0f}", flush=True)
    if args.json:
        found = {"flights": args.flights, "asked": ends, "shares": told, "warns_from": first, "versions": versions()}
        args.json.write_text(json.dumps(found, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    if args.figure:
        draw(told, args.figure)


if __name__ == "__main__":
    with one_sentence():
        main()
