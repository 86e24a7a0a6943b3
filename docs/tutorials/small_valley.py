# %% [markdown]
# # Train in a small valley and watch
#
# In this tutorial you train a policy, evaluate it, and watch one of its episodes. The valley is half as wide as usual and nearly empty, so two
# minutes of training are enough. For the full valley you use the same commands with other values.
#
# `sh` runs a command that you would otherwise type in a terminal. `shell` is [a file with two helpers](index.md#what-they-share).

# %%
import csv
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from shell import sh, size

from uavrl.evaluation.recording import load_recording

FLIGHTS = size("FLIGHTS", 150)
folder = Path(tempfile.mkdtemp())
run = folder / "run"

# %% [markdown]
# ## Train
#
# `preset=dagger` selects the recipe of `make train`. A scripted controller flies the first `algo.learning_starts` steps. Then the policy flies, and
# learns the controller's action in each state that it reaches. The other arguments make the valley, the networks and the training small. Each
# argument is a key of a YAML file. `uavrl-train --help` shows the most common keys.

# %%
sh(
    f"uavrl-train preset=dagger collector=sync randomize=none run_dir={run} trainer.episodes={FLIGHTS} "
    "trainer.progress=false env.num_uavs=8 env.world.seeds=[0] env.world.size=[20,16] env.world.obstacles=8 "
    "env.world.min_goal_distance=5 env.max_steps=100 algo.hidden=[128,128] algo.learning_starts=800 "
    "cloning.steps=6000 cloning.updates_per_step=1 cloning.batch_size=128 trainer.execution=captured trainer.window=50"
)

# %% [markdown]
# ## The learning curve
#
# The run folder contains `episodes.csv`, with one row for each episode. The scripted controller flies the first episodes. The policy flies the
# others, with exploration noise. In such an easy valley it is as good as the controller from the beginning.

# %%
with (run / "episodes.csv").open(encoding="utf-8") as file:
    flights = list(csv.DictReader(file))
arrived = [row["outcome"] == "arrived" for row in flights]
third = len(flights) // 3
for name, part in (("first", arrived[:third]), ("second", arrived[third : 2 * third]), ("last", arrived[2 * third :])):
    print(f"{name} third: {sum(part)} of {len(part)} episodes successful")

# %% mystnb={"image": {"alt": "Success rate of the last episodes, over all episodes of the training"}}
window = max(len(arrived) // 5, 1)
rate = [100 * sum(arrived[i - window : i]) / window for i in range(window, len(arrived) + 1)]
plt.figure(figsize=(7, 3))
plt.plot(range(window, len(arrived) + 1), rate)
plt.xlabel("episodes")
plt.ylabel(f"success rate of the last {window}, %")
plt.ylim(0, 100)
plt.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## Evaluate
#
# Training episodes have exploration noise, and each has a different policy. `uavrl-evaluate` rolls out the trained policy in fixed tasks without
# noise. The confidence interval is wide because there are few tasks.

# %%
sh(f"uavrl-evaluate run={run} episodes={size('TASKS', 20)} progress=false")

# %% [markdown]
# ## Watch
#
# `flight.html` plays the episode in any browser. Press space to play, drag to turn, or choose a view. `data=` also writes the numbers of the
# episode. From these we draw it here from above, with grey obstacles, the path of the quadrotor, and the goal as a circle.

# %%
sh(f"uavrl-replay run={run} task=0 output={folder / 'flight.html'} data={folder / 'flight.npz'} progress=false")

# %% mystnb={"image": {"alt": "The episode from above: grey obstacles, the path of the quadrotor from its start, the goal as a circle"}}
recording = load_recording(folder / "flight.npz")
flight = recording.flights[0]
valley = recording.scenery(flight)
_, axes = plt.subplots(figsize=(7, 5))
axes.tripcolor(
    *valley.vertices[:, :2].T, valley.triangles, facecolors=np.ones(len(valley.triangles)), cmap="Greys", vmin=0, vmax=3
)
axes.plot(*flight.positions[:, :2].T, lw=2)
axes.plot(*flight.positions[0, :2], "o", label="start")
axes.add_patch(plt.Circle(flight.goal[:2], valley.goal[0], fill=False, lw=2, label="goal"))
axes.set(
    aspect="equal",
    xlabel="m",
    ylabel="m",
    title=f"{flight.summary.outcome.replace('_', ' ')} after {flight.summary.steps} steps",
)
axes.legend()
plt.show()

# %% [markdown]
# ## The full training
#
# `make train` does the same with 32 valleys of 40 m × 30 m, 45 or 90 obstacles, domain randomisation, larger networks and more episodes. It
# evaluates the policy in unseen valleys. See [the results](../results.md#which-policy-flies-best).
