"""Time of one TD3 update beside what a user would otherwise write or install.

Run `python benchmarks/update.py [--json FILE]`. All rows make the same update: state 105, action 4, networks 400-300,
batch 100, float32, Adam for critics and actor, actor and targets every second step, on one thread and on a ready-made
batch; Stable-Baselines3's row also draws its batch, as its `train` does. "matrix products" times the products of an
update alone, which no implementation can do without. "torch.compile" compiles `value_loss` and `actor_loss` of a loss,
with PyTorch's fused Adam and TorchRL's SoftUpdate. The library's rows, those and the products alone are multiplied by
what `--matmul` says, the others by PyTorch's default. Rows are interleaved and repeated; medians count.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
import warnings
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import gymnasium
import numpy as np
import torch
from common import machine
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor
from torch.nn import functional
from torchrl.data import Bounded
from torchrl.objectives import LossModule, SoftUpdate
from torchrl.objectives import TD3Loss as StockTD3Loss

from uavrl.losses import TD3Loss
from uavrl.models import Actor, Critic
from uavrl.training.compiled import Execution
from uavrl.training.matmul import MatmulBackend, matmul_backend, multiply_by
from uavrl.training.update import ActorCriticStepper
from uavrl_onboard.cli.process import one_sentence

STATE, ACTION, BATCH, HIDDEN = 105, 4, 100, (400, 300)
Row = Callable[[], object]


def batch() -> TensorDict:
    """A batch of random transitions."""
    flags = torch.rand(BATCH, 1) < 0.01
    following = {"observation": torch.randn(BATCH, STATE), "reward": torch.randn(BATCH, 1)}
    return TensorDict(
        {
            "observation": torch.randn(BATCH, STATE),
            "action": torch.rand(BATCH, ACTION) * 4 - 2,
            "next": {**following, "done": flags, "terminated": flags.clone()},
        },
        [BATCH],
    )


def modules() -> tuple[TensorDictModule, list[TensorDictModule]]:
    """An actor and two critics."""
    actor = TensorDictModule(Actor(STATE, ACTION), ["observation"], ["action"])
    critics = [
        TensorDictModule(Critic(STATE, ACTION), ["observation", "action"], ["state_action_value"]) for _ in range(2)
    ]
    return actor, critics


def ours(execution: Execution) -> Row:
    """The library's optimisation step."""
    stepper = ActorCriticStepper(our_loss(), execution=execution)
    data = batch()
    return lambda: stepper.step(None, data)


def handwritten() -> Row:
    """TD3 as a single-file implementation writes it, with fused Adam."""
    actor, critics = Actor(STATE, ACTION), [Critic(STATE, ACTION), Critic(STATE, ACTION)]
    target_actor, target_critics = deepcopy(actor), deepcopy(critics)
    critic_parameters = [p for critic in critics for p in critic.parameters()]
    actor_optimizer = torch.optim.Adam(actor.parameters(), lr=1e-4, fused=True)
    critic_optimizer = torch.optim.Adam(critic_parameters, lr=1e-3, fused=True)
    pairs = [(p, t) for net, target in ((actor, target_actor), *zip(critics, target_critics, strict=True))
             for p, t in zip(net.parameters(), target.parameters(), strict=True)]  # fmt: skip
    data = batch()
    state, action, following = data["observation"], data["action"], data["next", "observation"]
    reward, alive = data["next", "reward"], (~data["next", "terminated"]).float()
    count = 0

    def step() -> None:
        nonlocal count
        count += 1
        with torch.no_grad():
            noise = (torch.randn_like(action) * 0.4).clamp(-1.0, 1.0)
            smoothed = (target_actor(following) + noise).clamp(-2.0, 2.0)
            value = torch.min(*(target(following, smoothed) for target in target_critics))
            goal = reward + alive * 0.99 * value
        loss = sum(functional.mse_loss(critic(state, action), goal) for critic in critics)
        critic_optimizer.zero_grad()
        loss.backward()  # type: ignore[union-attr]
        critic_optimizer.step()
        if count % 2 == 0:
            actor_loss = -critics[0](state, actor(state)).mean()
            actor_optimizer.zero_grad()
            actor_loss.backward()
            actor_optimizer.step()
            with torch.no_grad():
                for parameter, target in pairs:
                    target.lerp_(parameter, 0.005)

    return step


def stock_loss() -> StockTD3Loss:
    """TorchRL's TD3Loss with the thesis's squared error."""
    actor, critics = modules()
    loss = StockTD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (ACTION,)), loss_function="l2")
    loss.make_value_estimator(gamma=0.99)
    return loss


def our_loss() -> TD3Loss:
    """The library's TD3Loss."""
    actor, critics = modules()
    return TD3Loss(actor, critics, action_spec=Bounded(-2.0, 2.0, (ACTION,)))


def with_stock_tools(loss: LossModule, *, compiled: bool) -> Row:
    """A loss with PyTorch's fused Adam and TorchRL's SoftUpdate, its two methods as written or by `torch.compile`."""
    actor_optimizer = torch.optim.Adam([*loss.actor_network_params.values(True, True)], lr=1e-4, fused=True)
    critic_optimizer = torch.optim.Adam([*loss.qvalue_network_params.values(True, True)], lr=1e-3, fused=True)
    targets = SoftUpdate(loss, tau=0.005)
    value_loss, actor_loss = loss.value_loss, loss.actor_loss
    if compiled:
        value_loss, actor_loss = torch.compile(value_loss), torch.compile(actor_loss)
    data = batch()
    count = 0

    def step() -> None:
        nonlocal count
        count += 1
        critic_optimizer.zero_grad()
        value_loss(data)[0].backward()
        critic_optimizer.step()
        if count % 2 == 0:
            actor_optimizer.zero_grad()
            actor_loss(data)[0].backward()
            actor_optimizer.step()
            targets.step()

    return step


class _Spaces(gymnasium.Env):
    """Nothing but the spaces."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (STATE,), np.float32)
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (ACTION,), np.float32)


def stable_baselines() -> Row:
    """Stable-Baselines3's TD3.train for one gradient step, its own sampling included."""
    from stable_baselines3 import TD3
    from stable_baselines3.common.logger import configure

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = TD3(
            "MlpPolicy", _Spaces(), batch_size=BATCH, buffer_size=10_000, device="cpu", learning_rate=1e-3,
            policy_kwargs={"net_arch": list(HIDDEN)},
        )  # fmt: skip
    model.set_logger(configure(None, []))
    assert model.replay_buffer is not None
    for _ in range(1000):
        states = np.random.default_rng(0).normal(size=(2, 1, STATE)).astype(np.float32)
        model.replay_buffer.add(states[0], states[1], np.zeros((1, ACTION)), np.zeros(1), np.zeros(1), [{}])
    return lambda: model.train(1, BATCH)


def matrix_products() -> Row:
    """The products of half an actor's and one critic's update: weights, gradients and inputs ready-made."""

    def network(inputs: int, outputs: int) -> list[tuple[Tensor, Tensor, Tensor]]:
        sizes = [inputs, *HIDDEN, outputs]
        return [(torch.randn(BATCH, i), torch.randn(o, i), torch.randn(BATCH, o)) for i, o in itertools.pairwise(sizes)]

    actor, critic = network(STATE, ACTION), network(STATE + ACTION, 1)

    def forward(layers: list[tuple[Tensor, Tensor, Tensor]]) -> None:
        for x, w, _ in layers:
            x @ w.T

    def backward(layers: list[tuple[Tensor, Tensor, Tensor]], *, weights: bool, inputs: bool) -> None:
        for i, (x, w, g) in enumerate(layers):
            if weights:
                g.T @ x
            if inputs or i > 0:
                g @ w

    count = 0

    def step() -> None:
        nonlocal count
        count += 1
        for layers in (actor, critic, critic, critic, critic):  # target actor, two targets, two critics
            forward(layers)
        for _ in range(2):
            backward(critic, weights=True, inputs=False)
        if count % 2 == 0:
            forward(actor)
            forward(critic)
            backward(critic, weights=False, inputs=True)
            backward(actor, weights=True, inputs=False)

    return torch.no_grad()(step)


def multiplied(products: MatmulBackend, row: Row) -> Row:
    """The row, multiplied by this library."""

    def run() -> None:
        multiply_by(products)
        row()

    return run


def measure(rows: dict[str, Row], repeats: int, steps: int) -> dict[str, float]:
    """Returns the median time of each row in milliseconds."""
    times: dict[str, list[float]] = {name: [] for name in rows}
    for turn in range(-1, repeats):  # turn -1 warms up
        for name, run in rows.items():
            begin = time.perf_counter()
            for _ in range(steps):
                run()
            if turn >= 0:
                times[name].append((time.perf_counter() - begin) / steps * 1e3)
    return {name: float(np.median(values)) for name, values in times.items()}


def main() -> None:
    """Measures, prints the table, and writes the JSON file if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    parser.add_argument("--repeats", type=int, default=30, help="rounds")
    parser.add_argument("--steps", type=int, default=20, help="updates of each row in a round")
    parser.add_argument("--skip-compiled", action="store_true", help="leave out the row that needs a C++ compiler")
    choices = ("mkl", "onednn", "auto")
    parser.add_argument("--matmul", choices=choices, default="auto", help="what multiplies in uavrl's rows")
    args = parser.parse_args()
    about = machine()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # as uavrl-train does; it helps every row
    torch.manual_seed(0)
    names: list[Execution] = ["eager", "captured"] if args.skip_compiled else ["eager", "captured", "compiled"]
    others: dict[str, Row] = {
        "hand-written, eager": handwritten(),
        "TorchRL's TD3Loss": with_stock_tools(stock_loss(), compiled=False),
        "Stable-Baselines3": stable_baselines(),
    }
    with matmul_backend(args.matmul) as products:
        rows = {f"uavrl, {name}": multiplied(products, ours(name)) for name in names}
        if not args.skip_compiled:
            rows["uavrl's TD3Loss, torch.compile"] = multiplied(products, with_stock_tools(our_loss(), compiled=True))
            rows["TorchRL's, torch.compile"] = multiplied(products, with_stock_tools(stock_loss(), compiled=True))
        rows |= {name: multiplied("mkl", row) for name, row in others.items()}
        rows["matrix products alone"] = multiplied(products, matrix_products())
        milliseconds = measure(rows, args.repeats, args.steps)
    chosen = f"uavrl, {names[-1]}"  # what trainer.execution=auto takes
    default = milliseconds[chosen]
    ratios = {
        "vs_eager": default / milliseconds["hand-written, eager"],
        "vs_torchrl": default / milliseconds["TorchRL's TD3Loss"],
        "vs_sb3": default / milliseconds["Stable-Baselines3"],
        "vs_matmul": default / milliseconds["matrix products alone"],
    }
    if not args.skip_compiled:
        ratios["vs_torch_compile"] = default / milliseconds["uavrl's TD3Loss, torch.compile"]
    print(f"one thread, products by {products}, median of {args.repeats} rounds of {args.steps} updates\n")
    for name, value in milliseconds.items():
        print(f"{name:32}{value:8.3f} ms{value / default:8.2f} x {chosen}")
    print("\n" + ", ".join(f"{name} {value:.2f}" for name, value in ratios.items()))
    if args.json:
        args.json.write_text(
            json.dumps({**ratios, "row": chosen, "matmul": products, "ms": milliseconds, "machine": about}, indent=2)
            + "\n",
            encoding="utf-8",
        )


if __name__ == "__main__":
    with one_sentence():
        main()
