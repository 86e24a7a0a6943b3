# %% [markdown]
# # Train in a small valley and watch
#
# You train a policy where training is quick, see what it learned, and look at a flight. The valley is half as wide as usual and nearly empty, so
# two minutes of training are enough. The commands are those for the real valley; only the values differ.
#
# `sh` types a command. In a terminal you would type the line yourself. `shell` is [a file of two helpers](index.md#what-they-share).

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
# `preset=best` chooses what `make train` trains: a scripted controller flies the first `algo.learning_starts` steps, then the policy flies and
# learns what the controller would do in each state that it reaches. The words after it make valley, networks and training small. Every word is a key of a yaml file;
# `uavrl-train --help` shows the ones used most.

# %%
sh(
    f"uavrl-train preset=best collector=sync randomize=none run_dir={run} trainer.episodes={FLIGHTS} "
    "trainer.progress=false env.num_uavs=8 env.world.seeds=[0] env.world.size=[20,16] env.world.obstacles=8 "
    "env.world.min_goal_distance=5 env.max_steps=100 algo.hidden=[128,128] algo.learning_starts=800 "
    "cloning.steps=6000 cloning.updates_per_step=1 cloning.batch_size=128 trainer.execution=captured trainer.window=50"
)

# %% [markdown]
# ## What it learned
#
# A run folder holds one row for each flight in `episodes.csv`. The first flights are the scripted controller's. The policy flies the others, with
# noise; in so easy a valley it keeps up with the controller from the beginning.

# %%
with (run / "episodes.csv").open(encoding="utf-8") as file:
    flights = list(csv.DictReader(file))
arrived = [row["outcome"] == "arrived" for row in flights]
third = len(flights) // 3
for name, part in (("first", arrived[:third]), ("second", arrived[third : 2 * third]), ("last", arrived[2 * third :])):
    print(f"{name} third: {sum(part)} of {len(part)} flights arrived")

# %% mystnb={"image": {"alt": "Share of the last flights that arrived, over all flights of the training"}}
window = max(len(arrived) // 5, 1)
rate = [100 * sum(arrived[i - window : i]) / window for i in range(window, len(arrived) + 1)]
plt.figure(figsize=(7, 3))
plt.plot(range(window, len(arrived) + 1), rate)
plt.xlabel("flights")
plt.ylabel(f"% of the last {window} that arrived")
plt.ylim(0, 100)
plt.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## Measure it
#
# Training flights are flown with noise, and each meets another policy. `uavrl-evaluate` flies fixed tasks without noise. The interval says how much
# the number of tasks leaves open: with few tasks, much.

# %%
sh(f"uavrl-evaluate run={run} episodes={size('TASKS', 20)} progress=false")

# %% [markdown]
# ## Watch
#
# `flight.html` plays the flight in any browser: press space, drag to turn, choose a view. `data=` keeps the numbers of the same flight, from which
# we draw it here as seen from above: obstacles grey, the way of the quadrotor, and the goal as a circle.

# %%
sh(f"uavrl-replay run={run} task=0 output={folder / 'flight.html'} data={folder / 'flight.npz'} progress=false")

# %% mystnb={"image": {"alt": "The flight from above: obstacles grey, the way of the quadrotor from its start, the goal as a circle"}}
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
# ## The real thing
#
# `make train` is this in 48 valleys of 40 m × 30 m with 45 or 90 obstacles and vehicles that differ from what their controllers believe, with larger networks and more flights, and measures it in valleys
# that the policy never saw. [What it gave](../results.md#which-policy-flies-best).
