"""What ``--help`` says, made of the comments in the yaml files."""

import re
import sys
from pathlib import Path
from typing import NamedTuple

from uavrl.config import conf_dir
from uavrl.runs.cache import FOLDER, MOST_BYTES, valley_folder
from uavrl_onboard.cli.command import table

ABOUT = {
    "config": ("uavrl-train", "Trains one policy, or with -m one for each combination of values."),
    "evaluate": ("uavrl-evaluate", "Rolls out a policy in fixed tasks without noise: its success rate."),
    "replay": ("uavrl-replay", "Writes a page that plays a few tasks back, flown without noise."),
    "report": ("uavrl-report", "Compares any number of runs in one page: curves, rates, intervals."),
    "export": ("uavrl-export", "Writes the policy of a run on its own, small enough to give away, or its data set."),
    "sitl": ("uavrl-sitl", "Plays a vehicle in the simulator: VLP-16 packets and MAVLink by UDP."),
    "pretrain": ("uavrl-pretrain", "Learns the trajectory classifier of ABR⁺ from a run's states."),
}
EXAMPLES = {
    "config": [
        "preset=dagger",
        "env=dynamic algo=sac seed=1",
        "-m seed=0,1,2 algo.gamma=0.98,0.99",
        "resume=RUN_FOLDER",
    ],
    "evaluate": [
        "policy=best",
        "run=RUN_FOLDER episodes=100",
        "run=RUN_FOLDER valleys=training",
        "run=RUN_FOLDER suite=all",
    ],
    "replay": ["policy=best tasks=[0,1,2,3]", "run=RUN_FOLDER task=7"],
    "report": ["runs=runs", "runs=[RUN_FOLDER,RUN_FOLDER] output=compare.html"],
    "export": ["run=RUN_FOLDER output=my_policy", "policy=best output=my_policy", "run=RUN_FOLDER data=my_data"],
    "sitl": ["task=3 json=task.json", "valleys=[100] randomize=real", "speed=lockstep firmware=ardupilot"],
    "pretrain": ["run=RUN_FOLDER", "run=RUN_FOLDER pretrain=quick"],
}
MOST_USED = {
    "config": "run_dir resume seed device trainer.episodes trainer.steps env.num_uavs "
    "env.world.obstacles algo.learning_starts packages",
    "evaluate": "run policy episodes suite valleys output seed checkpoint num_uavs",
    "replay": "run policy task tasks output checkpoint",
    "report": "runs output window threshold title",
    "export": "run policy output data checkpoint",
    "sitl": "task seed valleys lidar autopilot firmware armed speed patience linger pilot_takes_over json",
    "pretrain": "run output seed",
}
BUILDS_VALLEYS = ("config", "evaluate", "replay", "sitl")
_KEY = re.compile(r"^(?P<indent> *)(?P<key>\w+):(?P<value>.*?)(?:\s+#\s*(?P<meaning>.*))?$")


class Key(NamedTuple):
    """A key of a yaml file."""

    name: str
    value: str
    meaning: str


def help_text(name: str, *, every_key: bool = False) -> str:
    """What the command whose configuration is ``conf/NAME.yaml`` takes, for a screen or in full."""
    command, about = ABOUT[name]
    main = conf_dir() / f"{name}.yaml"
    groups = {
        group: [path.stem for path in sorted((conf_dir() / group).glob("*.yaml"))]
        for group, _ in _defaults(main)
        if (conf_dir() / group).is_dir()
    }
    lines = [f"{command}: {about}", "", "Usage: " + f"{command} KEY=VALUE …", ""]
    lines += [f"  {command} {example}" for example in EXAMPLES[name]]
    chosen = dict(_defaults(main))
    choices = {
        group: ", ".join(f"[{choice}]" if choice == chosen[group] else choice for choice in found)
        for group, found in groups.items()
        if len(found) > 1 or chosen[group] == "null"
    }
    if choices:
        lines += ["", "Choices, with [the default] in brackets", *table(choices)]
    known = _known(main, groups, chosen)
    if every_key:
        shown = {key.name: f"{key.meaning} ({key.value})" if key.value else key.meaning for key in known.values()}
        lines += ["", "All keys, with their default in brackets", *table({k: v for k, v in shown.items() if v})]
    else:
        most_used = {key: known[key].meaning for key in MOST_USED[name].split()}
        lines += ["", "Most common keys", *table(most_used)]
        lines += ["", f"All keys: {command} --help=all    The resolved configuration: {command} … --cfg job"]
    if name in BUILDS_VALLEYS:
        kept = f"Built valleys are kept in {valley_folder()}, at most {MOST_BYTES / 1e6:.0f} MB"
        lines += [f"{kept}.", f"The environment variable {FOLDER} names another folder."]
    return "\n".join(lines)


def keys(path: Path, prefix: str = "") -> list[Key]:
    """The keys of a yaml file that have a comment, in its order."""
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
    """The keys of a choice by their names, with those that it takes from the files in its defaults."""
    path = conf_dir() / group / f"{choice}.yaml"
    text = path.read_text(encoding="utf-8")
    if "# @package" in text:  # its place is elsewhere
        return {}
    known: dict[str, Key] = {}
    for taken in re.findall(r"^  - ([\w/]+)(?:@_here_)?(?:\s+#.*)?$", text, flags=re.MULTILINE):
        if taken != "_self_":
            known |= choice_keys(group, taken)
    return known | {key.name: key for key in keys(path, f"{group}.")}


def _known(main: Path, groups: dict[str, list[str]], chosen: dict[str, str]) -> dict[str, Key]:
    """All keys by their names, as the command itself has them, or else the choice that is its default."""
    known = {key.name: key for key in keys(main)}
    for group, found in groups.items():
        for choice in sorted(found, key=lambda choice: choice != chosen[group]):  # that of the defaults first
            known |= {name: key for name, key in choice_keys(group, choice).items() if name not in known}
        for path in sorted((conf_dir() / group).glob("*/*.yaml")):  # what is chosen with another part
            known |= {key.name: key for key in keys(path, f"{group}.") if key.name not in known}
    return known


def _defaults(path: Path) -> list[tuple[str, str]]:
    """Groups and their choices in the defaults of a yaml file."""
    text = path.read_text(encoding="utf-8").partition("defaults:")[2]
    found = re.findall(r"^  - (?!override)(\w+): (\S+)", text, flags=re.MULTILINE)
    return [(group, choice.strip("\"'")) for group, choice in found]


def show(name: str) -> bool:
    """Prints the help or the version that the command line asks for; False where it asks for neither."""
    if sys.argv[1:2] == ["--version"]:
        show_version()
        return True
    asked = [argument for argument in sys.argv[1:] if argument in ("--help", "-h", "--help=all")]
    if asked:
        print(help_text(name, every_key=asked[0] == "--help=all"))
    return bool(asked)


def show_version() -> None:
    """Prints which uavrl this is."""
    from importlib.metadata import version

    print(f"uavrl {version('uavrl')}")
