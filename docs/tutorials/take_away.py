# %% [markdown]
# # Take a policy with you
#
# In this tutorial you export the policy of a run, run it in plain PyTorch, and compute its action for a recorded scan. This is all you need to use a
# policy without uavrl's trainer. `shell` is [a file with two helpers](index.md#what-they-share).

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
# You can export any run. This one has only two episodes and learns nothing, because we only need its files.

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
# The run also contains the optimisers and the replay buffer, so that it can be resumed. The policy consists of four small files: the weights
# (without a pickle), their description, the configuration, and `contract.json`, which specifies the policy's inputs and outputs.
#
# ## In plain PyTorch
#
# From here on we use `best`, a policy that comes with uavrl and was exported in the same way. The actor consists of linear layers with ReLU between
# them, and 2 tanh at the end. Its output is the velocity forward, left and up in m/s, and the yaw rate in rad/s.

# %%
weights = load_file(PACKAGED / "best" / "policy.safetensors")
layers = [(weights[f"module.net.{i}.weight"], weights[f"module.net.{i}.bias"]) for i in (0, 2, 4)]


def act(state: torch.Tensor) -> torch.Tensor:
    for weight, bias in layers[:-1]:
        state = torch.relu(state @ weight.T + bias)
    weight, bias = layers[-1]
    return 2 * torch.tanh(state @ weight.T + bias)


# %% [markdown]
# Roll it out in the simulator. The Gymnasium environment includes the reduction, the last action and the stacked frames, so this is the usual loop.

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
# A few episodes show that it works, but not how well. For that, see [500 fixed tasks](../policies.md#how-they-fly).
#
# ## From a recorded scan
#
# On a real vehicle there is no environment, only a scan. We take a scan from a recorded episode: `data=` writes the recording, and `points=` sets how
# many points of each scan it contains.

# %%
sh(
    "uavrl-replay policy=best env=static task=0 points=100000 progress=false "  # more points than a scan has: keep all
    f"output={folder / 'flight.html'} data={folder / 'flight.npz'}"
)
flight = load_recording(folder / "flight.npz").flights[0]
moment = len(flight.actions) // 2
cloud = torch.tensor(flight.cloud(moment))  # [P, 3] in metres, in the sensor's frame: x forward, y left, z up
print(f"{len(cloud):,} points, the nearest {cloud.norm(dim=-1).min():.2f} m away")

# %% [markdown]
# The reduction turns it into 72 numbers, each 4 m minus the distance to the nearest point in a cell. The recording contains the numbers that the
# policy received in the episode, so we can compare.

# %%
cells = range_image(cloud, radius=4.0)
print(f"{int((cells > 0).sum())} of 72 cells contain a point")
print(f"largest difference to the cells in flight: {(cells - torch.tensor(flight.faces[moment])).abs().max():.4f} m")

# %% [markdown]
# The state consists of the last three observations. Each contains the 72 cells divided by 4 m, the altitude, two angles and the last action. We
# replace the newest cells by ours, and compute the action.

# %%
state = torch.tensor(flight.observations[moment], dtype=torch.float32).clone()
state[158:230] = cells / 4.0
command = act(state)
for name, ours, flown in zip(("forward", "left", "up", "yaw rate"), command, flight.actions[moment], strict=True):
    print(f"{name:9} {ours:+.3f}   in flight {flown:+.3f}")

# %% [markdown]
# The actions are the same. On another vehicle you need point clouds in metres in the sensor's frame, the altitude above the ground of the start, the
# two angles to the goal, and a controller that follows velocities. [The contract](../elsewhere.md#the-contract) specifies all of these.
# A real sensor is noisier than the simulated one. Try `perception.lidar.range_noise=0.02` in `uavrl-evaluate` first.
