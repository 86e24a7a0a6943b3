"""Where the yaml files lie, how Hydra composes them, and what a run is called."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict

from uavrl.config.command_line import readable
from uavrl.errors import UavrlError, extras
from uavrl.locks import OneAtATime
from uavrl_onboard.guards.command_line import join_guards
from uavrl_onboard.vehicle import sight_for

NONE = "none"  # the choice that leaves a part out
_ONE_AT_A_TIME = OneAtATime()  # Hydra is one for the whole process


def conf_dir() -> Path:
    """The folder of yaml files: inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for candidate in (package / "conf", package.parent / "conf"):
        if (candidate / "config.yaml").is_file():
            return candidate
    raise UavrlError(f"Expected the yaml files in {package / 'conf'} and found none: install uavrl again.")


def register_resolvers() -> None:
    """Teaches OmegaConf the resolvers of our yaml files.

    ``${uavrl_run_name:}`` is made of environment, what learns, and reward; ``${uavrl_sight:SPEED}`` is
    :func:`sight_for`.
    """
    OmegaConf.register_new_resolver("uavrl_run_name", _run_name, replace=True)
    OmegaConf.register_new_resolver("uavrl_sight", sight_for, replace=True)


def compose(*overrides: str, name: str = "config", own: Iterable[Path] = ()) -> DictConfig:
    """What ``uavrl-train OVERRIDES`` composes, for use in Python, also in a program that uses Hydra itself.

    Args:
        *overrides: as on the command line.
        name: the yaml file to begin with.
        own: folders of further yaml files: what ``--config-dir`` names.

    Examples:
        >>> compose("algo=sac", "reward=traditional").choices.algo
        'sac'
    """
    with extras():  # imported where it is needed: a packaged policy loads without Hydra
        from hydra import initialize_config_dir

    register_resolvers()
    if folders := ["'file://" + str(folder.resolve()).replace("'", "\\'") + "'" for folder in own]:
        overrides = (*overrides, f"hydra.searchpath=[{','.join(folders)}]")
    with _ONE_AT_A_TIME, _hydra_of_our_own(), initialize_config_dir(str(conf_dir()), version_base="1.3"):
        return compose_again(*map(readable, join_guards(overrides)), name=name)


@contextmanager
def _hydra_of_our_own() -> Iterator[None]:
    """Puts the Hydra of the calling program aside, such as that of ``@hydra.main``, and back again at the end."""
    from hydra.core.global_hydra import GlobalHydra
    from hydra.core.hydra_config import HydraConfig
    from hydra.version import VersionBase

    theirs, version, chosen = GlobalHydra.instance(), VersionBase.instance(), HydraConfig.instance()
    hydra, base, config = theirs.hydra, version.version_base, chosen.cfg
    theirs.hydra = chosen.cfg = None
    try:
        yield
    finally:
        GlobalHydra.set_instance(theirs)  # Hydra would leave a copy of it
        theirs.hydra, version.version_base, chosen.cfg = hydra, base, config


def compose_again(*overrides: str, name: str) -> DictConfig:
    """The same where Hydra is at work: it finds what it found before, in the user's ``--config-dir`` too."""
    from hydra import compose as hydra_compose

    config = hydra_compose(name, list(overrides), return_hydra_config=True)
    choices = config.hydra.runtime.choices
    with open_dict(config):
        del config.hydra
    return with_choices(config, choices) if "env" in config else config


def with_choices(config: DictConfig, choices: Mapping[str, Any]) -> DictConfig:
    """Writes into a composed configuration which yaml file each part came from: names are made of that."""
    own = {str(group): str(choice) for group, choice in choices.items() if choice and "/" not in str(group)}
    with open_dict(config):
        config.choices = own
    return config


def learner_name(choices: Mapping[str, str]) -> str:
    """What learns in a run, as part of a name.

    Examples:
        >>> learner_name({"algo": "ddpg", "lifeguard": "linear", "backward_reward": "abr_plus"})
        'ddpg_lg_abr_plus'
        >>> learner_name({"algo": "td3", "recurrent": "gru"})
        'td3_gru'
    """
    usual = {
        "recurrent": ("", ""),
        "fork": ("fork", "on"),
        "lifeguard": ("lg", "linear"),
        "actor_penalty": ("", ""),
        "smoothness": ("", ""),
        "cloning": ("", ""),
        "backward_reward": ("", ""),
    }
    parts = [choices["algo"]]
    for group, (short, plain) in usual.items():
        choice = choices.get(group, NONE)
        if choice != NONE:
            parts += [text for text in (short, choice if choice != plain else "") if text]
    return "_".join(parts)


def _run_name(*, _root_: DictConfig) -> str:
    from hydra.core.hydra_config import HydraConfig

    chosen = OmegaConf.select(_root_, "choices")
    choices = HydraConfig.get().runtime.choices if chosen is None else chosen
    return f"{choices['env']}_{learner_name(choices)}_{choices['reward']}"
