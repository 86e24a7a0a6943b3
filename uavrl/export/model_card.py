"""The model card of a policy: ``README.md`` beside its weights, with the metadata that model hubs read."""

import json
import logging
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from uavrl.errors import UavrlError
from uavrl.evaluation.worlds import unseen_seeds
from uavrl.runs.config import read_config
from uavrl.runs.episodes import RATES, SAID, rate_cell
from uavrl.runs.weights import POLICY
from uavrl_onboard.files import replacing
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.policy.contract import CONTRACT, NETWORK, Contract, read_contract

log = logging.getLogger(__name__)
CARD, STATEMENTS = "README.md", "card.yaml"
PIPELINE = "reinforcement-learning"  # what model hubs call the task
SAME = ("checkpoint", "training_steps")  # by which an evaluation belongs to a policy
METRICS = {name: f"{SAID[outcome]} rate" for name, outcome in RATES.items()}
_UNDECLARED = (
    "The author has not chosen a license. Add `license: NAME` to the metadata above before you share the policy."
)


@dataclass(frozen=True)
class Statements:
    """What the author of a policy says about it, in ``card.yaml`` beside its weights or its run.

    Args:
        license: identifier of the license, such as ``"mit"``.
        command: the command line that trains the policy.
        use: sentences about its purpose.
        limits: sentences about what it cannot do.
    """

    license: str | None = None
    command: str | None = None
    use: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()


def read_statements(folder: Path) -> Statements:
    """Return the statements in ``card.yaml`` of a folder; none where there is no such file.

    Raises:
        UavrlError: if the file holds something else.
    """
    path = folder / STATEMENTS
    if not path.is_file():
        return Statements()
    known = {field.name: field.name in ("use", "limits") for field in fields(Statements)}
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
        wrong = [key for key, value in content.items() if not _fits(value, several=known.get(key))]
    except (OSError, ValueError, AttributeError, yaml.YAMLError) as error:
        raise UavrlError(f"{path} cannot be read as YAML: write KEY: VALUE with {', '.join(known)}.") from error
    if wrong:
        raise UavrlError(
            f"{path} must hold license and command, each a text, and use and limits, each a list of sentences: change "
            f"{', '.join(map(str, wrong))}."
        )
    values: dict[str, Any] = {key: tuple(value) if known[key] else value for key, value in content.items()}
    return Statements(**values)


def _fits(value: Any, several: bool | None) -> bool:
    """Whether a value is a text, or several texts; no value fits a key that is not known."""
    if several is None:
        return False
    return (
        isinstance(value, list) and all(isinstance(each, str) for each in value) if several else isinstance(value, str)
    )


def write_card(folder: Path, name: str, evaluated: Path | None = None) -> Path:
    """Write the model card of a policy into its folder, and return its path.

    Args:
        folder: of the policy: ``policy.json``, ``config.yaml``, and what else it has.
        name: of the policy.
        evaluated: the folder whose evaluations are read; None for the policy's own.
    """
    about = json.loads((folder / POLICY.json).read_bytes())
    contract = read_contract(folder) if (folder / CONTRACT).is_file() else None
    evaluations = read_evaluations(evaluated or folder, about)
    text = model_card(name, about, read_config(folder), contract, evaluations, read_statements(folder))
    with replacing(folder / CARD) as partial:
        partial.write_text(text, encoding="utf-8")
    return folder / CARD


def read_evaluations(folder: Path, about: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the evaluations of a policy that lie beside it, by a name for each.

    They are ``evaluation*.json`` and the rows of ``suite.json`` in a run's folder, in its folder ``suite``, or beside
    exported weights. Those of another checkpoint, and files that cannot be read, are left out.

    Args:
        folder: of a run or a policy.
        about: what ``policy.json`` says of the policy.
    """
    found: dict[str, dict[str, Any]] = {}
    for path in (folder / "suite.json", folder / "suite" / "suite.json"):
        found |= _read(path)
    for path in sorted(folder.glob("evaluation*.json")):
        content = _read(path)
        found |= {path.stem: content} if content else {}
    wanted = [about.get(key) for key in SAME]
    return {name: row for name, row in found.items() if _is_result(row) and [row.get(key) for key in SAME] == wanted}


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes()) if path.is_file() else {}
    except (OSError, ValueError):
        log.warning("%s cannot be read, so the model card leaves it out.", path)
        return {}
    return content if isinstance(content, dict) else {}


def _is_result(row: Any) -> bool:
    """Whether a row has the numbers that a card shows."""
    if not isinstance(row, dict) or not isinstance(row.get("episodes"), int):
        return False
    rates = [row.get(name) for name in RATES]
    keys = ("rate", "low", "high")
    return all(isinstance(rate, dict) and all(isinstance(rate.get(key), int | float) for key in keys) for rate in rates)


def model_card(
    name: str,
    about: Mapping[str, Any],
    config: DictConfig,
    contract: Contract | None,
    evaluations: Mapping[str, Mapping[str, Any]],
    said: Statements | None = None,
) -> str:
    """Return the card of a policy as Markdown, with YAML metadata before it.

    Source: Mitchell et al. (2019), https://doi.org/10.1145/3287560.3287596, for the sections; the metadata are those of
    https://huggingface.co/docs/hub/model-cards.

    Args:
        name: of the policy.
        about: what ``policy.json`` says of it.
        config: of its training.
        contract: its interface; None where it has none.
        evaluations: results of ``uavrl-evaluate``, by a name for each; without any, the card says so.
        said: what its files do not tell.
    """
    said = said or Statements()
    plain: Any = OmegaConf.to_container(config, resolve=True)
    sections = [
        f"# {name}",
        _summary(plain, about, contract),
        "## Intended use",
        *(said.use or ("Research on navigation by LiDAR, in simulation.",)),
        "## Limits",
        "\n".join(f"- {limit}" for limit in [*_limits(contract), *said.limits]),
        "## Training",
        _training(plain, about, said.command),
        "## Results",
        _results(evaluations, contract),
        "## Files and how to use them",
        _usage(contract),
        "## License",
        f"`{said.license}`" if said.license else _UNDECLARED,
    ]
    return f"---\n{_metadata(name, plain, contract, evaluations, said)}---\n\n" + "\n\n".join(sections) + "\n"


def _metadata(
    name: str,
    plain: Mapping[str, Any],
    contract: Contract | None,
    evaluations: Mapping[str, Mapping[str, Any]],
    said: Statements,
) -> str:
    algo = str(plain["choices"].get("algo", "")) if plain.get("choices") else ""
    tags = [PIPELINE, "torchrl", *([algo] if algo else [])]
    tags += ["robotics", "quadrotor", "lidar", "navigation"] if contract is not None else []
    tags += ["onnx"] if contract is not None and contract.network is not None else []
    data: dict[str, Any] = {"license": said.license} if said.license else {}
    data |= {"library_name": "uavrl", "pipeline_tag": PIPELINE, "tags": tags}
    if evaluations:
        task = {"type": PIPELINE, "name": PIPELINE}
        results = [
            {"task": task, "dataset": {"name": f"uavrl {key}", "type": f"uavrl-{key}"}, "metrics": _metrics(row)}
            for key, row in evaluations.items()
        ]
        data["model-index"] = [{"name": name, "results": results}]
    return str(yaml.dump(data, Dumper=_Plain, sort_keys=False, allow_unicode=True))


class _Plain(yaml.SafeDumper):
    """Writes equal parts out again, since hubs read no references."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _metrics(row: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "type": name.replace(" ", "_").replace("-", "_"),
            "name": f"{name} in %",
            "value": round(100 * row[key]["rate"], 1),
        }
        for key, name in METRICS.items()
    ]


def _summary(plain: Mapping[str, Any], about: Mapping[str, Any], contract: Contract | None) -> str:
    algo = str(plain["algo"]["_target_"]).rpartition(".")[2].removesuffix("Loss")
    steps = about.get("training_steps")
    trained = f", trained with {algo} for {pluralize(steps, 'environment step')}" if isinstance(steps, int) else ""
    if contract is None:
        return f"A policy of the TorchRL library uavrl{trained}."
    *inputs, last = _inputs(contract)
    return (
        f"A policy that flies a quadrotor to a goal{trained}. Its inputs are {', '.join(inputs)} and {last}, over "
        f"{contract.state.frames} time steps. Its output is a velocity and a yaw rate, {contract.rate_hz:g} times per "
        "second."
    )


def _inputs(contract: Contract) -> list[str]:
    """The quantities of an observation, in words."""
    cells, motion = contract.cells, contract.motion
    inputs = [
        f"how near the closest obstacle is in {cells.count} directions (up to {cells.radius:g} m, from a LiDAR)",
        "the altitude",
        "the direction to the goal",
    ]
    if motion is not None:
        inputs += [
            f"the {motion.objects} nearest moving objects (up to {motion.max_range:g} m)",
            "the threat that they are in each direction",
        ]
    return [*inputs, *(["the last action"] if contract.action_limit is not None else [])]


def _limits(contract: Contract | None) -> list[str]:
    limits = ["The policy was trained and evaluated in simulation only. The card reports no flight of a real vehicle."]
    if contract is not None:
        radius, motion = f"{contract.cells.radius:g} m", contract.motion
        sensed = f"obstacles up to {radius} away"
        if motion is not None:
            sensed = f"static obstacles up to {radius} and moving obstacles up to {motion.max_range:g} m away"
        limits += [
            f"It senses {sensed}, within the field of view of its LiDAR.",
            "It does not guarantee a minimum clearance, with or without guards.",
        ]
    return limits


def _training(plain: Mapping[str, Any], about: Mapping[str, Any], command: str | None) -> str:
    env, choices = plain["env"], plain.get("choices") or {}
    world = env.get("world")
    world = world if isinstance(world, Mapping) else {}
    rows = {
        "Data": "episodes that it flew in simulation during its training; no data set",
        "Environment": f"`{env['_target_']}`",
        "Training valleys": len(world["seeds"]) if world.get("seeds") else None,
        "Obstacles in a valley": _range(world.get("obstacles")),
        "Moving obstacles": world.get("planes"),
        "Domain randomisation": f"`{choices['randomize']}`" if choices.get("randomize", "none") != "none" else None,
        "Scripted controller": f"`{choices['demonstrator']}`"
        if choices.get("demonstrator", "none") != "none"
        else None,
        "Reward": f"`{choices['reward']}`" if choices.get("reward") else None,
        "Environment steps": f"{about['training_steps']:,}" if "training_steps" in about else None,
        "Episodes": f"{about['training_episodes']:,}" if "training_episodes" in about else None,
        "Seed": plain.get("seed"),
        "Commit of uavrl": f"`{about['commit']}`" if about.get("commit") else None,
        "Versions": ", ".join(
            f"{key} {value}" for key, value in (about.get("versions") or {}).items() if key != "commit"
        ),
    }
    table = "\n".join(f"| {key} | {value} |" for key, value in rows.items() if value not in (None, ""))
    told = (
        f"```sh\n{command}\n```" if command else "The command line was not recorded. All settings are in `config.yaml`."
    )
    return f"| | |\n|---|---|\n{table}\n\n{told}"


def _range(value: Any) -> str | None:
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 2:
        return f"{value[0]} or {value[1]}"
    return None if value is None else str(value)


def _results(evaluations: Mapping[str, Mapping[str, Any]], contract: Contract | None) -> str:
    if not evaluations:
        return "There is no evaluation of this policy yet: `uavrl-evaluate run=FOLDER` measures its success rate."
    lines = [
        "| evaluation | tasks | guards | success in % | collision in % | time-out in % |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in evaluations.items():
        rates = [row[key] for key in METRICS]
        shown = [rate_cell(each) for each in rates]
        lines.append(f"| {name} | {row['episodes']:,} | {', '.join(_guards(row)) or 'none'} | {' | '.join(shown)} |")
    note = (
        "Fixed tasks without exploration noise, with 95 % confidence intervals (Wilson). The intervals cover the tasks "
        "and not the choice of the training seed. These keys of `uavrl-evaluate run=FOLDER` choose the tasks:"
    )
    by_default = contract is not None and contract.guards is not None
    keys = [f"- {name}: `{shlex.join(_keys(row, by_default))}`" for name, row in evaluations.items()]
    return "\n\n".join(["\n".join(lines), note, "\n".join(keys)])


def _keys(row: Mapping[str, Any], guarded: bool) -> list[str]:
    """The keys of an evaluation, for a policy that flies with guards by default or not."""
    told = [str(each) for each in row.get("overrides") or []]
    keys = [each for each in told if not each.startswith(("policy=", "run=", "num_uavs="))]
    flown, named = row.get("valleys"), any(each.startswith(("valleys=", "env.world.seeds=")) for each in keys)
    if flown and not named and tuple(flown) != unseen_seeds(row.get("training_valleys", ())):
        keys.insert(0, f"valleys=[{','.join(map(str, flown))}]")
    keys += ["guards=none"] if guarded and not _guards(row) else []
    keys += [f"episodes={row['episodes']}"]
    return keys


def _guards(row: Mapping[str, Any]) -> list[str]:
    """The guards of an evaluation, as its file names them."""
    guards = row.get("guards")
    return [str(name) for name, settings in guards.items() if settings] if isinstance(guards, Mapping) else []


def _usage(contract: Contract | None) -> str:
    files = [
        "- `policy.safetensors` and `policy.json`: the weights, and their checksum and origin. They contain no code.",
        "- `config.yaml`: the configuration of the training.",
    ]
    if contract is not None:
        files.append("- `contract.json`: units, axes, scaling and time of each input and output, for other programs.")
        if contract.network is not None:
            files.append(f"- `{NETWORK}`: the network for ONNX Runtime.")
    code = 'import uavrl\n\npolicy = uavrl.load_policy("FOLDER")  # this folder'
    return "\n".join(files) + f"\n\n```python\n{code}\n```"
