# %% [markdown]
# # Take a policy with you
#
# You export the policy of a run, fly it with plain PyTorch, and ask it what it would do about a recorded scan. This is what it takes to fly a policy
# where uavrl's training is not wanted. `shell` is [a file of two helpers](index.md#what-they-share).

# %%
import tempfile
from pathlib import Path

import gymnasium
import torch
from safetensors.torch import load_file
from shell import sh, size

from uavrl.evaluation.policies import PACKAGED
from uavrl.evaluation.recording import load_recording
from uavrl.transforms.range_image import range_image

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## From a run to an exported policy
#
# Any run will do. This one flies a few times and learns nothing: we only want its files.

# %%
sh(
    f"uavrl-train run_dir={folder / 'run'} trainer.episodes=2 env.num_uavs=2 env.max_steps=20 algo.learning_starts=20 "
    "algo.hidden=[32,32] buffer.capacity=1000 trainer.execution=captured trainer.progress=false"
)
sh(f"uavrl-export run={folder / 'run'} output={folder / 'my_policy'}")

# %%
for path in sorted((folder / "my_policy").iterdir()):
    print(f"{path.name:20} {path.stat().st_size:7,} bytes")

# %% [markdown]
# The run itself holds optimisers and every state that was flown, for going on. The policy is four small files: weights without any pickle, what
# they are, the configuration, and `contract.json`, which says what the policy reads and writes.
#
# ## In plain PyTorch
#
# From here on we take `best`, a policy that comes with uavrl and was exported in the same way. The actor is linear layers with ReLU between, and
# 2 tanh at the end: forward, left and up in m/s, and a yaw rate in rad/s.

# %%
weights = load_file(PACKAGED / "best" / "policy.safetensors")
layers = [(weights[f"module.net.{i}.weight"], weights[f"module.net.{i}.bias"]) for i in (0, 2, 4)]


def act(state: torch.Tensor) -> torch.Tensor:
    for weight, bias in layers[:-1]:
        state = torch.relu(state @ weight.T + bias)
    weight, bias = layers[-1]
    return 2 * torch.tanh(state @ weight.T + bias)


# %% [markdown]
# Fly it. The Gymnasium environment has reduction, last action and frames inside, so the loop is the one of every tutorial on Gymnasium.

# %%
env = gymnasium.make("uavrl:uavrl/Valley-v0", reduction="range_image", last_action=True)
for seed in range(size("FLIGHTS", 3)):
    state, info = env.reset(seed=seed)
    steps, ended = 0, False
    while not ended:
        state, _, terminated, truncated, info = env.step(act(torch.tensor(state)).numpy())
        steps, ended = steps + 1, terminated or truncated
    outcome = "arrived" if info["is_success"] else "collided" if info["collided"] else "timed out"
    print(f"seed {seed}: {outcome} after {steps} steps")
env.close()

# %% [markdown]
# A few flights show that it works, not how well. [500 fixed tasks](../policies.md) do.
#
# ## From a recorded scan
#
# On a real vehicle there is no environment, only a scan. A recorded flight has some: `data=` keeps what was seen, `points=` says how much of each scan.

# %%
sh(
    "uavrl-replay policy=best env=static task=0 points=100000 progress=false "  # points that a page shows at most: here all
    f"output={folder / 'flight.html'} data={folder / 'flight.npz'}"
)
flight = load_recording(folder / "flight.npz").flights[0]
moment = len(flight.actions) // 2
cloud = torch.tensor(flight.cloud(moment))  # [P, 3] in metres, in the sensor's frame: x forward, y left, z up
print(f"{len(cloud):,} points, the nearest {cloud.norm(dim=-1).min():.2f} m away")

# %% [markdown]
# The reduction makes 72 numbers of it, each 4 m minus the distance to the nearest point in a cell. The recording says what the policy saw in flight, so we can compare.

# %%
cells = range_image(cloud, radius=4.0)
print(f"{int((cells > 0).sum())} of 72 cells see something")
print(f"largest difference to the cells in flight: {(cells - torch.tensor(flight.faces[moment])).abs().max():.4f} m")

# %% [markdown]
# The state is the last three observations, each of 72 cells over 4 m, altitude, two angles and the last action. Replace the newest cells by ours, and
# ask the policy.

# %%
state = torch.tensor(flight.observations[moment], dtype=torch.float32).clone()
state[158:230] = cells / 4.0
command = act(state)
for name, ours, flown in zip(("forward", "left", "up", "yaw rate"), command, flight.actions[moment], strict=True):
    print(f"{name:9} {ours:+.3f}   in flight {flown:+.3f}")

# %% [markdown]
# The same command. What you need for another vehicle: clouds in metres in the frame of the sensor, the altitude above the ground of the start, the two
# angles to the goal, and something that follows velocities. [Its contract](../elsewhere.md#the-contract) says all of it.
# A real sensor is noisier than the simulated one, which no policy here has met: try `perception.lidar.range_noise=0.02` in `uavrl-evaluate` first.
