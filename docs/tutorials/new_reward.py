# %% [markdown]
# # A new reward, a sweep and a report
#
# In this tutorial you write a reward, train with two values of a setting and three seeds each, and read the report. The environment is the corridor
# of [examples/own_parts](../own_parts.md), in which a point flies 2 m without touching the walls. A training takes seconds there. In the valley you
# would follow the same steps. `shell` is [a file with two helpers](index.md#what-they-share).

# %%
import os
import tempfile
from pathlib import Path

from shell import sh, size

from uavrl.reporting.report import make_report
from uavrl.runs.episodes import success_text

FLIGHTS = size("FLIGHTS", 60)
examples = Path.cwd().resolve().parents[1] / "examples" / "own_parts"
folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The reward
#
# A reward is a TorchRL transform that writes `reward`. This one rewards success, and penalises collisions and every step. We want to know whether
# the cost of a step, `step_cost`, helps.
#
# The annotations define which values are valid. They are checked before the training starts.

# %%
(folder / "my_parts").mkdir()
(folder / "my_parts" / "__init__.py").touch()
_ = (folder / "my_parts" / "rewards.py").write_text(
    """
from torchrl.envs import Transform

from uavrl_onboard.ranges import NonNegative, Positive


class Hurry(Transform):
    def __init__(self, prize: Positive = 10.0, step_cost: NonNegative = 0.1) -> None:
        super().__init__(in_keys=["arrived", "collided"], out_keys=["reward"])
        self.prize, self.step_cost = prize, step_cost

    def _step(self, tensordict, next_tensordict):
        arrived, collided = (next_tensordict[key].float() for key in self.in_keys)
        return next_tensordict.set("reward", self.prize * (arrived - collided) - self.step_cost)
""",
    encoding="utf-8",
)

# %% [markdown]
# A YAML file makes the class a choice of `reward=`. Its keys are the constructor's arguments.

# %%
(folder / "conf" / "reward").mkdir(parents=True)
_ = (folder / "conf" / "reward" / "mine.yaml").write_text(
    """
_target_: my_parts.rewards.Hurry
prize: 10.0      # reward for success; a collision costs as much
step_cost: 0.1   # cost of every step
""",
    encoding="utf-8",
)
os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), str(examples), *filter(None, [os.environ.get("PYTHONPATH")])])

# %% [markdown]
# ## The sweep
#
# `-m` trains each combination of the comma-separated values. Two costs and three seeds are six runs. If you start it again, it skips finished runs.
# `packages` lists the packages whose code may be executed. The corridor's YAML file is in the examples, so we copy it next to ours.

# %%
(folder / "conf" / "env").mkdir()
_ = (folder / "conf" / "env" / "corridor.yaml").write_text(
    (examples / "conf" / "env" / "corridor.yaml").read_text(encoding="utf-8"), encoding="utf-8"
)
sh(
    f"uavrl-train -m --config-dir {folder / 'conf'} packages=[my_parts,own_parts] env=corridor reward=mine "
    f"reward.step_cost=0,0.5 seed=0,1,2 trainer.episodes={FLIGHTS} algo.learning_starts=300 algo.hidden=[32,32] "
    "algo.actor_lr=1e-3 algo.critic_lr=1e-3 "
    f"trainer.execution=captured trainer.progress=false run_dir={folder / 'runs' / 'run'}"
)

# %% [markdown]
# ## The report
#
# One command makes a page about all runs below a folder. It also prints which group is ahead.

# %%
sh(f"uavrl-report runs={folder / 'runs'} window={FLIGHTS // 3} output={folder / 'report.html'}")

# %% [markdown]
# The page starts with a table of groups, best first. The same facts are available in Python:

# %%
report = make_report([folder / "runs"], window=FLIGHTS // 3)
for group in report.groups:
    success = group["last"]["success"]
    seeds = ", ".join(f"{100 * rate:.0f}" for rate in group["success_by_seed"])
    print(f"{group['label']}: {success_text(success, group['last']['episodes'], 'training episode')}")
    print(f"  by seed: {seeds} %")

# %% [markdown]
# ## How to read it
#
# - **Do the intervals overlap?** Then these episodes show no significant difference between the groups.
# - **Do the seeds of one group differ more than the groups?** Then the difference may be due to the seeds, even if the intervals are narrow. An
#   interval counts the episodes of all seeds together. It does not cover the spread between trainings.
# - **Three seeds are few.** Even if every seed of one group is above every seed of the other, this happens by chance in 1 of 10 cases (in either
#   direction). To add seeds, change one argument: `seed=0,1,2,3,4`. Finished runs are kept.
# - **Compare success rates, not returns.** The groups have different rewards, so their returns are not comparable.
