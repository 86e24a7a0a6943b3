"""The help of the commands that Hydra configures, made from the comments in the yaml files."""

import re
from pathlib import Path

from uavrl.config import conf_dir
from uavrl.runs.cache import FOLDER, MOST_BYTES, valley_folder
from uavrl_onboard.cli.help import About, Key, render_help

ABOUT = {
    "config": About(
        "uavrl-train",
        "Trains one policy, or with -m one for each combination of values.",
        ["preset=dagger", "env=dynamic algo=sac seed=1", "-m seed=0,1,2 algo.gamma=0.98,0.99", "resume=RUN_FOLDER"],
        "run_dir resume seed device trainer.episodes trainer.steps env.num_uavs env.world.obstacles "
        "algo.learning_starts packages",
    ),
    "evaluate": About(
        "uavrl-evaluate",
        "Rolls out a policy in fixed tasks without noise: its success rate.",
        ["policy=best", "run=RUN_FOLDER episodes=100", "run=RUN_FOLDER valleys=training", "run=RUN_FOLDER suite=all"],
        "run policy episodes suite valleys output seed checkpoint num_uavs processes",
    ),
    "replay": About(
        "uavrl-replay",
        "Writes a page that plays a few tasks back, flown without noise.",
        ["policy=best tasks=[0,1,2,3]", "run=RUN_FOLDER task=7"],
        "run policy task tasks output checkpoint",
    ),
    "report": About(
        "uavrl-report",
        "Compares any number of runs in one page: curves, rates, intervals.",
        ["runs=runs", "runs=[RUN_FOLDER,RUN_FOLDER] output=compare.html"],
        "runs output window threshold title",
    ),
    "export": About(
        "uavrl-export",
        "Writes the policy of a run on its own, small enough to give away, or its data set.",
        ["run=RUN_FOLDER output=my_policy", "policy=best output=my_policy", "run=RUN_FOLDER data=my_data"],
        "run policy output data checkpoint",
    ),
    "sitl": About(
        "uavrl-sitl",
        "Plays a vehicle in the simulator: VLP-16 packets and MAVLink by UDP.",
        ["task=3 json=task.json", "valleys=[100] randomize=real", "speed=lockstep firmware=ardupilot"],
        "task seed valleys lidar autopilot firmware armed speed patience linger pilot_takes_over json",
    ),
    "pretrain": About(
        "uavrl-pretrain",
        "Learns the trajectory classifier of ABR⁺ from a run's states.",
        ["run=RUN_FOLDER", "run=RUN_FOLDER pretrain=quick"],
        "run output seed",
    ),
}
BUILDS_VALLEYS = ("config", "evaluate", "replay", "sitl")
_KEY = re.compile(r"^(?P<indent> *)(?P<key>\w+):(?P<value>.*?)(?:\s+#\s*(?P<meaning>.*))?$")


def help_text(name: str, *, every_key: bool = False) -> str:
    """Return the help of the command whose configuration is ``conf/NAME.yaml``, for a screen or with all keys."""
    main = conf_dir() / f"{name}.yaml"
    chosen = dict(_defaults(main))
    groups = {
        group: [path.stem for path in sorted((conf_dir() / group).glob("*.yaml"))]
        for group in chosen
        if (conf_dir() / group).is_dir()
    }
    choices = {
        group: ", ".join(f"[{choice}]" if choice == chosen[group] else choice for choice in found)
        for group, found in groups.items()
        if len(found) > 1 or chosen[group] == "null"
    }
    more = [f"The resolved configuration: {ABOUT[name].name} … --cfg job"]
    if name in BUILDS_VALLEYS:
        kept = f"Built valleys are kept in {valley_folder()}, at most {MOST_BYTES / 1e6:.0f} MB"
        more += [f"{kept}.", f"The environment variable {FOLDER} names another folder."]
    known = _known(main, groups, chosen).values()
    return render_help(ABOUT[name], known, every_key=every_key, choices=choices, more=more)


def keys(path: Path, prefix: str = "") -> list[Key]:
    """Return the keys of a yaml file that have a comment, in its order."""
    found, above = [], list[tuple[int, str]]()
    for line in path.read_text(encoding="utf-8").splitlines():
        match = _KEY.match(line)
        if match is None:
            continue
        indent = len(match["indent"])
        above = [(depth, key) for depth, key in above if depth < indent]
        name = prefix + ".".join([*(key for _, key in above), match["key"]])
        if match["meaning"] and not name.startswith(("defaults", "hydra")):
            found.append(Key(name, match["value"].strip(), match["meaning"]))
        above.append((indent, match["key"]))
    return found


def choice_keys(group: str, choice: str) -> dict[str, Key]:
    """Return the keys of a choice by their names, with those that it takes from the files in its defaults."""
    path = conf_dir() / group / f"{choice}.yaml"
    text = path.read_text(encoding="utf-8")
    if "# @package" in text:  # Its keys belong to another group.
        return {}
    known: dict[str, Key] = {}
    for taken in re.findall(r"^  - ([\w/]+)(?:@_here_)?(?:\s+#.*)?$", text, flags=re.MULTILINE):
        if taken != "_self_":
            known |= choice_keys(group, taken)
    return known | {key.name: key for key in keys(path, f"{group}.")}


def _known(main: Path, groups: dict[str, list[str]], chosen: dict[str, str]) -> dict[str, Key]:
    """Return all keys by their names, as the command itself has them, or else its default choices, or else others."""
    known = {key.name: key for key in keys(main)}
    for group, found in groups.items():
        for choice in sorted(found, key=lambda choice: choice != chosen[group]):  # the default first
            known |= {name: key for name, key in choice_keys(group, choice).items() if name not in known}
        for path in sorted((conf_dir() / group).glob("*/*.yaml")):  # files that are chosen with another part
            known |= {key.name: key for key in keys(path, f"{group}.") if key.name not in known}
    return known


def _defaults(path: Path) -> list[tuple[str, str]]:
    """Return the groups in the defaults of a yaml file, and their choices."""
    text = path.read_text(encoding="utf-8").partition("defaults:")[2]
    found = re.findall(r"^  - (?!override)(\w+): (\S+)", text, flags=re.MULTILINE)
    return [(group, choice.strip("\"'")) for group, choice in found]
