"""LifeGuard in a TorchRL script of one's own: `python examples/lifeguard_pendulum.py 20000` (frames).

Pendulum-v1 has no failure: here an episode ends, at a price, above 5 rad/s, and nothing else terminates one, so
``terminated`` is what LifeGuard calls ``collided``. Without a goal, the penalty keeps its weight.
"""

import sys

import gymnasium
import torch
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import GymWrapper
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate

from uavrl.losses import LifeGuard, TD3Loss
from uavrl.models import Actor, Critic


class SpeedLimit(gymnasium.Wrapper):  # noqa: D101
    def step(self, action):  # noqa: D102
        state, reward, _, truncated, info = self.env.step(action)
        failed = bool(abs(state[2]) > 5.0)
        return state, -100.0 if failed else 10.0 + reward, failed, truncated, info


frames = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
env = GymWrapper(SpeedLimit(gymnasium.make("Pendulum-v1")))
env.set_seed(0)
spec = env.full_action_spec["action"]
policy = TensorDictModule(Actor(3, 1, (64, 64)), ["observation"], ["action"])
critics = [TensorDictModule(Critic(3, 1, (64, 64)), ["observation", "action"], ["state_action_value"]) for _ in "12"]
base = TD3Loss(policy, critics, action_spec=spec)
loss = LifeGuard(base, observations=3, actions=1, model="mlp", success_window=None, min_collisions=5)
loss.set_keys(collided="terminated")
adam = [torch.optim.Adam(p.parameters(), lr=1e-3) for p in (loss.critic_network_params, loss.actor_network_params)]
classifier, targets = loss.make_optimizer(), SoftUpdate(base, tau=0.005)
buffer = ReplayBuffer(storage=LazyTensorStorage(100_000), batch_size=100)
explore = TensorDictSequential(policy, AdditiveGaussianModule(spec, sigma_init=0.3, sigma_end=0.3))
collector = Collector(env, explore, total_frames=frames, trajs_per_batch=1, frames_per_batch=200, traj_format="cat")
failures = []
for episode in collector:
    buffer.extend(episode)
    loss.observe(episode)
    loss.fit(buffer.sample, len(episode), classifier)
    for step in range(len(episode)):
        batch = buffer.sample()
        for method, optimizer in list(zip((loss.value_loss, loss.actor_loss), adam, strict=True))[: 1 + step % 2]:
            optimizer.zero_grad()
            method(batch)[0].backward()
            optimizer.step()
        targets.step()
    failures.append(bool(episode["next", "terminated"].any()))
    if len(failures) % 20 == 0:
        numbers = {key.removeprefix("lifeguard_"): round(value, 2) for key, value in loss.diagnostics().items()}
        print(f"{len(failures)} episodes, {sum(failures[-20:])} of the last 20 failed;", numbers)
collector.shutdown()
