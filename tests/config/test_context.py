"""What a run hands to a constructor, nobody can write: a value that is recorded is a value that was used."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from omegaconf import DictConfig, OmegaConf
from torch import nn
from torchrl.envs import EnvBase

from tests.helpers.configs import composed
from tests.helpers.runs import small_config
from tests.helpers.small_env import SmallEnv
from uavrl.cli import evaluate as evaluate_command
from uavrl.cli import replay as replay_command
from uavrl.cli import train as train_command
from uavrl.config import conf_dir, validate
from uavrl.config.build import TARGET, arguments, build, find_class
from uavrl.config.context import CONTEXT, context_of
from uavrl.config.parts import PARTS
from uavrl.envs.quadrotor import Airframe
from uavrl.errors import UavrlError
from uavrl.evaluation import environment
from uavrl.losses import networks
from uavrl.losses.networks import NetworkSizes
from uavrl.training import build as build_module
from uavrl.training import loggers

ROOT = Path(__file__).resolve().parents[2]
CHOICES = sorted((path.parent.name, path.stem) for path in conf_dir().glob("*/*.yaml") if path.parent.name in PARTS)


def parts_of(part: Any, key: str) -> Iterator[tuple[str, str]]:
    """The class of a part and those of the parts inside of it, each with its key."""
    if isinstance(part, dict) and part.get(TARGET) is not None:
        yield key, part[TARGET]
        for name in part:
            yield from parts_of(part[name], f"{key}.{name}")


def pairs() -> Iterator[tuple[str, str]]:
    """A choice, and a key that it could be given on the command line, for each name that a run hands to its classes."""
    for group, choice in CHOICES:
        content = yaml.safe_load((conf_dir() / group / f"{choice}.yaml").read_text())
        for key, target in parts_of(content.get(group, content), group):  # one without a class has that of another
            for name in sorted(set(context_of(key)) & set(arguments(find_class(target, object)))):
                yield f"{group}={choice}", f"{key}.{name}"


@pytest.mark.parametrize(("choices", "key"), pairs())
def test_no_name_that_the_run_hands_over_can_be_written(choices: str, key: str) -> None:
    config = composed("config", *choices.split())
    OmegaConf.update(config, key, 1, force_add=True)
    with pytest.raises(UavrlError, match=rf"^{re.escape(key)} is set by the run itself: leave it out\.$"):
        validate(config)


def test_it_is_refused_before_a_folder_is_made(tmp_path: Path, refused: Callable[..., str]) -> None:
    sentence = refused(train_command.main, "fork=on", "+fork.gamma=0.5", f"run_dir={tmp_path / 'run'}")
    assert sentence == "uavrl: fork.gamma is set by the run itself: leave it out."
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("+perception.seed=7", "There is no key 'perception.seed'"),
        ("+algo.execution=eager", "There is no key 'algo.execution'"),
        ("+algo.loss=1", "There is no key 'algo.loss'"),
        ("+perception.max_steps=5", "perception.max_steps and env.max_steps are the same value: leave one of the two"),
        (
            "+env.lidar.max_range=2",
            "The LiDAR 'own' needs one kind of rays: give elevations and azimuth_steps",
        ),  # a sensor of one's own
    ],
)
def test_nor_does_a_part_take_the_place_of_another(override: str, told: str) -> None:
    with pytest.raises(UavrlError, match=re.escape(told)):
        validate(composed("config", override))


def test_the_guard_where_objects_are_made() -> None:
    network = {TARGET: "uavrl.models.Actor", "limit": 3.0}
    with pytest.raises(UavrlError, match=r"uavrl\.models\.Actor\.limit is set by the run itself: leave it out"):
        build(network, nn.Module, observations=6, actions=2, limit=1.0)
    fork = validate(composed("config", "fork=on")).fork
    fork.system_network["observations"] = 3
    with pytest.raises(UavrlError, match=r"SystemNet\.observations is set by the run itself"):
        build(fork, nn.Module, base=None, gamma=0.9, observations=6, actions=2)


@pytest.mark.parametrize(
    ("main", "told"),
    [(evaluate_command.main, "write num_uavs=N"), (replay_command.main, "a replay flies one vehicle")],
    ids=["evaluate", "replay"],
)
def test_how_many_are_evaluated_at_a_time_is_said_in_one_place(
    main: Callable[[], None], told: str, refused: Callable[..., str]
) -> None:
    for whose in ("policy=straight", "policy=best"):
        sentence = refused(main, whose, "env.num_uavs=4")
        assert sentence == f"uavrl: env.num_uavs is set by the command itself: leave it out, {told}."


@pytest.mark.parametrize(
    ("airframe", "told"),
    [(None, {}), ("somebody's", {}), (Airframe(lidar_position=(0, 0, -0.3)), {"sensor_position": (0, 0, -0.3)})],
)
def test_perception_is_told_where_the_lidar_is_on_an_airframe_that_has_one(
    airframe: object, told: dict[str, object], monkeypatch: pytest.MonkeyPatch
) -> None:
    handed: list[dict[str, object]] = []

    def recorded(_: object, kind: type, *, packages: object, **context: object) -> object:
        handed.append(context)
        return SmallEnv() if kind is EnvBase else None

    monkeypatch.setattr(environment, "build", recorded)
    monkeypatch.setattr(environment, "require_keys", lambda *_, **__: None)
    environment.make_env({"airframe": airframe}, {})
    assert handed == [{"key": "env"}, told]


# ---------------------------------------------------------------------- one list, in the code and in the docs


@pytest.fixture
def handed_over(monkeypatch: pytest.MonkeyPatch) -> dict[str, set[str]]:
    """The names with which ``build`` is called, by the class that is made."""
    found: dict[str, set[str]] = {}

    def recorded(part: DictConfig, kind: type, *, packages: Any = (), key: str = "", **context: Any) -> Any:
        found.setdefault(str(part[TARGET]), set()).update(context)
        return build(part, kind, packages=packages, key=key, **context)

    for module in (environment, networks, build_module, loggers):
        monkeypatch.setattr(module, "build", recorded)
    return found


def test_the_list_is_what_a_run_hands_over(
    handed_over: dict[str, set[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = ["fork=on", "lifeguard=linear", "backward_reward=abr", "demonstrator=vfh", "actor_penalty=imitation"]
    config = small_config(tmp_path / "run", *chosen, "cloning=dagger", "validation=unseen")
    settings = validate(config)
    sizes, cpu = NetworkSizes(state=105, frames=3, actions=4, limit=2.0), torch.device("cpu")
    for module in (environment, build_module):
        monkeypatch.setattr(module, "require_keys", lambda *_, **__: None)

    class Env:  # of which the factory only asks what is in it
        base_env = None

        def append_transform(self, transform: object) -> None:
            pass

    told = {"seed": 1, "measure_clearance": True, "tasks": [0], "critic_reads": ["wind"]}
    environment.make_env(settings.env, settings.perception, settings.reward, **told).close()
    build_module.build(settings.demonstrator, object)
    remembering = validate(small_config(tmp_path / "run", "recurrent=gru"))
    networks.make_memory(remembering, sizes)
    actor = networks.make_actor(settings, sizes)
    loss = build_module.make_loss(settings, actor, sizes, cpu)
    build_module.make_cloning(settings, loss, sizes, "captured")
    build_module.make_validation(settings, config, actor, sizes)
    build_module.make_backward_reward(settings, sizes, tmp_path / "artifact")
    build_module.make_buffer(settings, Env(), sizes, cpu)  # type: ignore[arg-type]
    loggers.make_logger(settings.logger, tmp_path / "run", "run", "csv")
    groups = [group for group in PARTS if group not in ("algo", "collector")]
    of = {"recurrent": remembering}
    assert {group: handed_over[settings_part(of.get(group, settings), group)] for group in groups} == {
        group: set(CONTEXT.get(group, ())) for group in groups
    }
    assert handed_over[settings.algo.actor[TARGET]] == set(context_of("algo.actor"))


def settings_part(settings: Any, group: str) -> str:
    return str(getattr(settings, group)[TARGET])


def test_the_list_is_what_a_collector_gets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = validate(small_config(tmp_path / "run"))
    sizes = NetworkSizes(state=105, frames=3, actions=4, limit=2.0)

    class Collector:
        is_remote = True

        def __init__(self, create_env_fn: object, **kwargs: object) -> None:
            self.got = {"create_env_fn", *kwargs}

    monkeypatch.setattr(build_module, "collector_class", lambda settings: Collector)
    actor = networks.make_actor(settings, sizes)
    made: Any = build_module.make_collector(settings, lambda: None, actor, sizes, torch.device("cpu"))  # type: ignore[arg-type,return-value]
    assert made.got == set(CONTEXT["collector"])


def test_the_documentation_lists_them_all() -> None:
    """Each row names the part, the argument and what it is; a row without a part goes on with the one above."""
    told: dict[str, set[str]] = {}
    groups: list[str] = []
    for row in re.findall(r"^\| (.*)\| `(\w+)` \| \S.* \|$", (ROOT / "docs/own_parts.md").read_text(), re.MULTILINE):
        named = re.findall(r"`([a-z_.]+)[`=]", row[0])
        groups = named or groups
        for group in groups:
            told.setdefault(group, set()).add(row[1])
    networks = {key: set(context_of(key)) for key in ("algo.actor", "algo.critic")}
    assert told == {group: set(names) for group, names in CONTEXT.items()} | networks
