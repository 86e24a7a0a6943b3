"""TD3 in the valley in one file: our environment, reduction, reward and loss, TorchRL's collector and replay buffer.

    python examples/td3_in_150_lines.py [--steps 60000] [--seed 0] [--uavs 8] [--device cpu]

Nothing of uavrl's trainer or configuration is used. Each line that is printed tells the success rate of the last 200
episodes, with exploration noise; the policy goes to td3.pt.
"""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Iterator

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import Compose, TransformedEnv
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate

from uavrl.buffers import MultiStep
from uavrl.envs import NavigationEnv, WorldConfig
from uavrl.losses import TD3Loss
from uavrl.models import Actor, Critic
from uavrl.transforms import Mirror, NavigationReward, NavigationState

GAMMA = 0.99
HIDDEN = (256, 256)
LEARNING_STARTS = 2_000  # steps with random actions
EXPLORATION = 0.1 * 2.0  # standard deviation of the noise: a tenth of the largest action, m/s and rad/s
BATCH = 100
POLICY_DELAY = 2  # updates of the critics for each of the actor and the targets
STORED = ["observation", "action", *(("next", key) for key in ("observation", "reward", "done", "terminated"))]


def make_env(uavs: int, seed: int, world: WorldConfig | None = None) -> TransformedEnv:
    """Vehicles in one valley: the scan becomes 32 distances, three frames of these and the goal's angles a state."""
    env = TransformedEnv(
        NavigationEnv(uavs, world=world),
        Compose(NavigationState(), NavigationReward(arrived_reward=200.0)),  # 105 numbers; Eq. 3.6 and a prize
    )
    env.set_seed(seed)
    return env


def make_loss(env: TransformedEnv, device: str) -> TD3Loss:
    """The actor, two critics with layer norm, and the loss that trains them."""
    sizes = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    actor = TensorDictModule(Actor(*sizes, HIDDEN).to(device), ["observation"], ["action"])
    critics = [Critic(*sizes, HIDDEN, layer_norm=True).to(device) for _ in range(2)]
    values = [TensorDictModule(each, ["observation", "action"], ["state_action_value"]) for each in critics]
    return TD3Loss(actor, values, action_spec=env.action_spec_unbatched.to(device), gamma=GAMMA).to(device)


def make_buffer() -> ReplayBuffer:
    """Keeps three-step transitions of whole episodes; half of what it gives is mirrored left to right."""
    return ReplayBuffer(
        storage=LazyTensorStorage(200_000), transform=Compose(MultiStep(3, GAMMA), Mirror()), batch_size=BATCH
    )


def episodes(env: TransformedEnv, actor: TensorDictModule, device: str) -> Iterator[TensorDictBase]:
    """Whole episodes ``[T]`` of the policy with exploration noise, the first ones with random actions."""
    noise = AdditiveGaussianModule(
        env.action_spec.to(device), sigma_init=EXPLORATION, sigma_end=EXPLORATION, annealing_num_steps=1, device=device
    )
    yield from Collector(
        env,
        TensorDictSequential(actor, noise),
        frames_per_batch=8 * env.batch_size.numel(),
        total_frames=-1,
        init_random_frames=LEARNING_STARTS,
        trajs_per_batch=1,
        traj_format="cat",
        policy_device=device,
        env_device="cpu",
        storing_device="cpu",
        auto_register_policy_transforms=False,
    )


class Learner:
    """TD3's updates: critics at every step, actor and targets at every second."""

    def __init__(self, loss: TD3Loss) -> None:
        self.loss = loss
        self.actor = torch.optim.Adam(loss.actor_network_params.flatten_keys().values(), lr=3e-4)
        self.critic = torch.optim.Adam(loss.qvalue_network_params.flatten_keys().values(), lr=1e-3)
        self.targets = SoftUpdate(loss, tau=0.005)
        self.updates = 0

    def update(self, batch: TensorDictBase) -> None:
        """One update on a batch of transitions."""
        self.critic.zero_grad()
        self.loss.value_loss(batch)[0].backward()
        self.critic.step()
        self.updates += 1
        if self.updates % POLICY_DELAY == 0:
            self.actor.zero_grad()
            self.loss.actor_loss(batch)[0].backward()
            self.actor.step()
            self.targets.step()


def train(env: TransformedEnv, steps: int, device: str = "cpu") -> TD3Loss:
    """Trains for some environment steps; returns the loss with its networks."""
    loss = make_loss(env, device)
    learner, buffer = Learner(loss), make_buffer()
    seen, outcomes = 0, deque[bool](maxlen=200)
    for count, episode in enumerate(episodes(env, loss.actor_network, device), start=1):
        seen += len(episode)
        outcomes.append(bool(episode["next", "arrived"][-1]))
        buffer.extend(episode.select(*STORED))
        if seen >= LEARNING_STARTS:
            for _ in range(len(episode)):
                learner.update(buffer.sample().to(device))
        if count % 50 == 0 or seen >= steps:
            print(f"{seen:>8,} steps, {count:>5,} episodes: {sum(outcomes) / len(outcomes):.0%} successful", flush=True)
        if seen >= steps:
            break
    return loss


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=60_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--uavs", type=int, default=8)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # networks as small as these are slower with more
    torch.manual_seed(arguments.seed)
    trained = train(make_env(arguments.uavs, arguments.seed), arguments.steps, arguments.device)
    torch.save(trained.actor_network_params.state_dict(), "td3.pt")
