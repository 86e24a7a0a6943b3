"""Which way LifeGuard pushes an action, with a linear and with an MLP classifier, where the truth is known.

    python studies/lifeguard_gradients.py [--output PNG]

The world: an obstacle is to the left or to the right (the observation, in [-1, 1]), and an action (sideways, forward)
collides with a probability that rises as it heads for the obstacle and flies forward. Both classifiers see the same
samples through LifeGuard. Arrows go where the actor is pushed: down the gradient of the penalty in the action.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule as Mod
from torch.nn.functional import normalize

from uavrl.losses import DDPGLoss, LifeGuard
from uavrl.models import Actor, Critic
from uavrl_onboard.cli.process import one_sentence


def risk(side: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    """The probability ``[*B]`` that an action ``[*B, 2]`` collides with an obstacle at ``side`` ``[*B, 1]``."""
    return (8 * (side[..., 0] * action[..., 0] + 0.5 * action[..., 1] - 0.3)).sigmoid()


def samples(count: int) -> TensorDict:
    """Episodes of one step."""
    side, action = 2 * torch.rand(count, 1) - 1, 2 * torch.rand(count, 2) - 1
    collided = (torch.rand(count) < risk(side, action))[:, None]
    after = {"done": torch.ones_like(collided), "collided": collided}
    return TensorDict({"observation": side, "action": action, "next": after}, [count])


def drawn(data: TensorDict, count: int) -> TensorDict:
    """So many at random."""
    return data[torch.randint(len(data), (count,))]


def push(loss: LifeGuard, side: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    """Minus the penalty's gradient in the action, ``[*B, 2]``."""
    action = action.clone().requires_grad_()
    if not loss.active:
        raise SystemExit("The classifier is not trusted.")
    term, _ = loss.actor_term(TensorDict({"observation": side, "action": action}, action.shape[:-1]))
    (gradient,) = torch.autograd.grad(term.sum(), action)
    return -gradient


def main() -> None:
    """Trains both, prints how well their directions fit the truth, and draws them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("docs/img/lifeguard_gradients.png"))
    args = parser.parse_args()
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 7), sharex=True, sharey=True)
    line = torch.linspace(-0.9, 0.9, 9)
    grid = torch.stack(torch.meshgrid(line, line, indexing="xy"), -1).reshape(-1, 2)
    models: tuple[Literal["linear", "mlp"], ...] = ("linear", "mlp")
    for row, model in zip(axes, models, strict=True):
        torch.manual_seed(0)
        critic = Mod(Critic(1, 2), ["observation", "action"], ["state_action_value"])
        base = DDPGLoss(Mod(Actor(1, 2), ["observation"], ["action"]), critic)
        loss = LifeGuard(base, observations=1, actions=2, model=model, success_window=None, min_true_negative_rate=0.0)
        data = samples(5000)
        loss.observe(data)
        optimizer = loss.make_optimizer()
        for _ in range(30):
            loss.fit(partial(drawn, data), 50, optimizer)
        directions: list[torch.Tensor] = []
        for axis, place in zip(row, (-0.8, 0.0, 0.8), strict=True):
            side = torch.full((len(grid), 1), place)
            truth = grid.clone().requires_grad_()
            (gradient,) = torch.autograd.grad(risk(side, truth).sum(), truth)
            push_here = normalize(push(loss, side, grid).double(), dim=-1)
            directions.append(push_here)
            cosine = (push_here * normalize(-gradient.double(), dim=-1)).sum(-1).mean()
            axis.tricontourf(*grid.T, risk(side, grid), levels=torch.linspace(0, 1, 11), cmap="OrRd")
            axis.quiver(*grid.T, *push_here.T, angles="xy", scale=14, width=0.006)
            axis.set_title(f"{model}, obstacle at {place:+.1f} (cosine {cosine:.2f})")
            print(f"{model}: obstacle at {place:+.1f}, mean cosine with the true direction {cosine:.2f}")
        spread = torch.cat(directions)
        print(f"{model}: smallest cosine between any two of its directions {(spread @ spread.T).min():.2f}")
    figure.supxlabel("action: sideways")
    figure.supylabel("action: forward")
    figure.suptitle("Where LifeGuard pushes the action (arrows), over the true risk of collision (colour)")
    figure.tight_layout()
    figure.savefig(args.output, dpi=110)
    print(f"wrote {args.output}")


if __name__ == "__main__":
    with one_sentence():
        main()
