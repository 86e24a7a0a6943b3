"""The backward reward in a TorchRL script of one's own: `python examples/backward_reward.py 5000` (frames).

A car between two hills arrives when it is over the right one. It is paid for its speed, and each window of three
steps is compared with all earlier ones from the same part of the valley that led to the goal.
"""

import sys

import gymnasium
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import GymWrapper

from uavrl.buffers import BackwardReward


class SpeedReward(gymnasium.Wrapper):  # noqa: D101
    def step(self, action):  # noqa: D102
        state, _, arrived, late, info = self.env.step(action)
        return state, 100.0 * abs(float(state[1])), arrived, late, info


def by_place_and_direction(states: Tensor) -> Tensor:
    """Twelve classes: six parts of the valley, to the left or to the right."""
    place = ((states[:, 0] + 1.2) / 0.3).long().clamp(0, 5)
    return 2 * place + (states[:, 1] > 0).long()


def swing(state: Tensor) -> Tensor:
    """Pushes where the car is going, give or take: put your policy here."""
    return (state[..., 1:].sign() + 0.5 * torch.randn_like(state[..., 1:])).clamp(-1, 1)


frames = int(sys.argv[1]) if len(sys.argv) > 1 else 5000
torch.manual_seed(0)
env = GymWrapper(SpeedReward(gymnasium.make("MountainCarContinuous-v0")))
env.set_seed(0)
backward = BackwardReward(by_place_and_direction, arrived=("next", "terminated"))
buffer = ReplayBuffer(storage=LazyTensorStorage(100_000), batch_size=100, transform=backward)
policy = TensorDictModule(swing, ["observation"], ["action"])
collector = Collector(
    env,
    policy,
    total_frames=frames,
    frames_per_batch=200,
    trajs_per_batch=1,  # whole episodes
    traj_format="cat",
    auto_register_policy_transforms=False,  # the policy has no state of its own
)
for count, episode in enumerate(collector, 1):
    buffer.extend(episode)
    batch = buffer.sample()  # your updates: the rewards are the new ones, reward_raw holds the old ones
    outcome = "arrived" if episode["next", "terminated"][-1] else "was late"
    extra = (batch["next", "reward"] - batch["next", "reward_raw"]).mean()
    print(f"episode {count} {outcome} after {len(episode)} steps; sampled steps earn {extra:.2f} more on average")
collector.shutdown()
for label in backward.history.classes:
    print(f"class {label}: sums", *backward.history.values(label))
