# %% [markdown]
# # The reduction and LifeGuard in another environment
#
# uavrl's parts do not depend on the valley. In this tutorial you use them in a Gymnasium environment that has nothing to do with uavrl: a ball with a
# sensor moves in a room with pillars. You will see how a point cloud becomes 32 numbers, and how LifeGuard learns which actions end in a crash.
# `shell` is [a file with two helpers](index.md#what-they-share).

# %%
import gymnasium
import matplotlib.pyplot as plt
import numpy as np
import torch
from gymnasium.spaces import Box, Dict
from shell import size
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import CatTensors, Compose, GymWrapper, StepCounter, TransformedEnv
from torchrl.modules import AdditiveGaussianModule
from torchrl.objectives import SoftUpdate

from uavrl.losses import LifeGuard, TD3Loss
from uavrl.models import Actor, Critic
from uavrl.transforms import TruncatedIcosahedron
from uavrl.transforms.icosahedron import truncated_icosahedron

STEPS = size("STEPS", 4000)
_ = torch.manual_seed(0)

# %% [markdown]
# ## An environment
#
# The room is 4 m wide and has four pillars. Touching a pillar or a wall is a crash. The sensor returns points on the pillars in metres, relative to
# the ball. A LiDAR, a radar or a depth camera returns such points. The reward is higher near the goal, which is in a corner.

# %%
PILLARS = np.array([[-0.8, -0.8], [0.8, -0.8], [-0.8, 0.8], [0.8, 0.8]])
TURN = np.linspace(0, 2 * np.pi, 60, endpoint=False)
SURFACE = np.concatenate([p + 0.3 * np.stack([np.cos(TURN), np.sin(TURN)], -1) for p in PILLARS])
GOAL = np.array([1.6, 1.6])


class Room(gymnasium.Env):
    observation_space = Dict(cloud=Box(-9, 9, (len(SURFACE), 3)), place=Box(-2, 2, (2,)))
    action_space = Box(-1, 1, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place = self.np_random.uniform(-0.3, 0.3, 2)
        return self._seen(), {}

    def step(self, action):
        self.place = self.place + 0.2 * np.asarray(action, float)
        crashed = bool(np.abs(self.place).max() > 2 or np.linalg.norm(PILLARS - self.place, axis=1).min() < 0.4)
        reward = -10.0 if crashed else 1.0 - 0.3 * float(np.linalg.norm(GOAL - self.place))
        return self._seen(), reward, crashed, False, {}

    def _seen(self):
        flat = np.pad(SURFACE - self.place, ((0, 0), (0, 1)))  # all at the ball's height
        return {"cloud": flat.astype(np.float32), "place": self.place.astype(np.float32)}


# %% [markdown]
# ## The cloud becomes 32 numbers
#
# {class}`~uavrl.transforms.TruncatedIcosahedron` is a TorchRL transform. Pass the key of your point cloud and the radius of the ball around the
# sensor. Points farther away do not count. The transform removes the cloud from the output.

# %%
env = TransformedEnv(
    GymWrapper(Room()),
    Compose(
        TruncatedIcosahedron(in_keys=["cloud"], out_keys=["faces"], radius=1.5),
        CatTensors(["faces", "place"], "observation", del_keys=False),
        StepCounter(max_steps=30),
    ),
)
env.set_seed(0)
begin = env.reset()
print("keys:", sorted(begin.keys()))
print("faces with a point:", int((begin["faces"] > 0).sum()), "of 32")

# %% [markdown]
# ## A loss, and LifeGuard around it
#
# {class}`~uavrl.losses.LifeGuard` wraps TorchRL's own TD3, DDPG, SAC, REDQ and CrossQ losses, and ours. Pass it the key of a failure. Here every
# end of an episode other than a time-out is a crash, so the key is `terminated`. Reaching the goal does not end an episode, so there is no success
# rate. `success_window=None` makes LifeGuard's weight independent of success.

# %%
spec = env.full_action_spec["action"]
policy = TensorDictModule(Actor(34, 2, (64, 64), limit=1.0), ["observation"], ["action"])
critics = [
    TensorDictModule(Critic(34, 2, (64, 64)), ["observation", "action"], ["state_action_value"]) for _ in range(2)
]
base = TD3Loss(policy, critics, action_spec=spec)
loss = LifeGuard(
    base,
    observations=34,
    actions=2,
    model="mlp",
    penalty_weight=5.0,
    success_window=None,
    min_collisions=5,
    min_true_negative_rate=0.8,
)
loss.set_keys(collided="terminated")

# %% [markdown]
# The rest is standard TorchRL, except for two lines: `observe` passes an episode to LifeGuard, and `fit` trains its classifier. LifeGuard needs whole
# episodes, so the collector yields one at a time.

# %%
adam = [torch.optim.Adam(p.parameters(), lr=1e-3) for p in (loss.critic_network_params, loss.actor_network_params)]
classifier, targets = loss.make_optimizer(), SoftUpdate(base, tau=0.005)
buffer = ReplayBuffer(storage=LazyTensorStorage(100_000), batch_size=100)
explore = TensorDictSequential(policy, AdditiveGaussianModule(spec, sigma_init=0.3, sigma_end=0.3))
collector = Collector(
    env,
    explore,
    total_frames=STEPS,
    frames_per_batch=30,
    trajs_per_batch=1,
    traj_format="cat",
    auto_register_policy_transforms=False,  # the policy has no state of its own
)
crashed = []
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
    crashed.append(bool(episode["next", "terminated"].any()))
collector.shutdown()
half = len(crashed) // 2
print(
    f"{sum(crashed[:half])} of the first {half} episodes crashed, {sum(crashed[half:])} of the last {len(crashed) - half}"
)
print("LifeGuard's penalty is enabled:", loss.active)

# %% [markdown]
# One training cannot show how much of this is due to LifeGuard. For that, train with and without it, with several seeds ([another
# tutorial](new_reward.py) shows how to read the result). Here we look at what its classifier has learned.
#
# ## The predicted risk
#
# We compare two positions, each half a metre from the middle of a pillar. One is on the way to the goal, where many episodes crashed. Few episodes
# reached the other. For each direction at full speed, we compute the predicted risk of a crash. 0° points straight at the pillar. A step within 49°
# of that direction touches it.

# %% mystnb={"image": {"alt": "The predicted risk by the direction of the action, at a position on the way to the goal and at one off it"}}
room = Room()
angles = torch.linspace(-np.pi, np.pi, 73)
touches = angles.abs() < np.deg2rad(49)
plt.figure(figsize=(7, 3))
for name, place, bearing in (("on the way", (0.45, 0.45), np.pi / 4), ("off the way", (0.3, -0.8), 0.0)):
    room.place = np.array(place)
    faces = truncated_icosahedron(torch.tensor(room._seen()["cloud"]), radius=1.5)  # the transform as a function
    state = torch.cat([faces, torch.tensor(place)])
    actions = torch.stack([(angles + bearing).cos(), (angles + bearing).sin()], -1)
    with torch.no_grad():
        risk = loss.classifier(torch.cat([state.expand(73, -1), actions], -1)).sigmoid()
    print(f"{name}: risk {risk[touches].mean():.2f} where it would crash, {risk[~touches].mean():.2f} elsewhere")
    plt.plot(angles.rad2deg(), risk, label=name)
plt.axvspan(-49, 49, alpha=0.15, label="touches the pillar")
plt.xlabel("direction of the action, degrees from the pillar")
plt.ylabel("predicted risk")
plt.ylim(0, 1)
plt.legend()
plt.show()

# %% [markdown]
# LifeGuard learns from the collisions that it has seen. Where episodes crashed, it distinguishes the directions. Elsewhere it does not, and its penalty
# does not help. The 32 faces look alike at both pillars, but a few dozen crashes are too few to generalise from one to the other.
