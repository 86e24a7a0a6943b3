# %% [markdown]
# # A new reward, a sweep, and what the report says
#
# You write a reward, train it with two values and three seeds each, and read the report. The environment is the corridor of
# [examples/own_parts](../own_parts.md), in which a training takes seconds: a point flies 2 m along a corridor without touching its walls.
# In the valley the steps are the same. `shell` is [a file of two helpers](index.md#what-they-share).

# %%
import os
import tempfile
from pathlib import Path

from shell import sh, size

from uavrl.reporting.report import make_report

FLIGHTS = size("FLIGHTS", 60)
examples = Path.cwd().resolve().parents[1] / "examples" / "own_parts"
folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The reward
#
# A reward is a TorchRL transform that writes `reward`. This one pays for arriving, punishes a collision, and lets every step cost something.
# `step_cost` is what we want to know about: does it help to be in a hurry?
#
# The annotations say which values have a sense. They are checked before anything is trained.

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
# A yaml file makes it a choice of `reward=`. Its keys are the constructor's arguments.

# %%
(folder / "conf" / "reward").mkdir(parents=True)
_ = (folder / "conf" / "reward" / "mine.yaml").write_text(
    """
_target_: my_parts.rewards.Hurry
prize: 10.0      # for arriving, and lost for colliding
step_cost: 0.1   # of every step
""",
    encoding="utf-8",
)
os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), str(examples), *filter(None, [os.environ.get("PYTHONPATH")])])

# %% [markdown]
# ## The sweep
#
# `-m` trains each combination of the values that commas part: two costs and three seeds are six runs. Started again, it skips what is finished.
# `packages` is your word that the code in them may run. The corridor's yaml lies in the examples, so we put a copy beside ours.

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
# One command makes a page of all runs below a folder. In the terminal it says who is ahead.

# %%
sh(f"uavrl-report runs={folder / 'runs'} window={FLIGHTS // 3} output={folder / 'report.html'}")

# %% [markdown]
# The page opens with a table of groups, best first. The same facts can be had in Python, and here they are.

# %%
report = make_report([folder / "runs"], window=FLIGHTS // 3)
for group in report.groups:
    success = group["last"]["success"]
    seeds = ", ".join(f"{100 * rate:.0f}" for rate in group["success_by_seed"])
    print(
        f"{group['label']}: {100 * success['rate']:.0f} % arrived "
        f"({100 * success['low']:.0f} to {100 * success['high']:.0f}); by seed {seeds} %"
    )

# %% [markdown]
# ## How to read it
#
# - **Do the intervals overlap?** Then these flights do not tell the groups apart.
# - **Do the seeds of one group differ more than the groups?** Then what you see is the luck of a seed, however narrow the interval: it counts the flights of all
#   seeds together and knows nothing of the spread between trainings.
# - **Three seeds are few.** If every seed of one group is above every seed of the other, that happens by chance in 1 of 10 cases for a difference in either
#   direction. More seeds are one word: `seed=0,1,2,3,4`. What is finished stays.
# - **Success is not the return.** The groups have different rewards, so their returns cannot be compared. Success can.
