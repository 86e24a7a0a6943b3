"""What the commands that Hydra configures share: mistakes on the command line end in one sentence."""

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl.cli.help import ABOUT, EXAMPLES, show
from uavrl.cli.keys import check_choices, choices_with, known_keys
from uavrl.cli.logs import configure_logging
from uavrl.config import conf_dir
from uavrl.config.command_line import readable
from uavrl.config.parts import PARTS, names_taken
from uavrl.config.yaml_files import compose, register_run_name, with_choices
from uavrl.errors import UavrlError
from uavrl.runs.shared_memory import shared_memory_explained
from uavrl_onboard.cli.process import command_process, one_sentence
from uavrl_onboard.sentences import did_you_mean

SLIP = 0.85  # of the pen: so near is a key to the one that was meant that no class is asked, for which torch would load
LAUNCHERS = ("joblib", "submitit_local", "submitit_slurm")  # those that uavrl[launchers] brings
FULL_ERROR = "HYDRA_FULL_ERROR"  # with it set to 1 Hydra hands its errors on instead of printing them


def command(name: str) -> Callable[[Callable[[DictConfig], Any]], Callable[[], None]]:
    """Makes a console command of a function that takes the configuration ``conf/NAME.yaml``, as overridden."""
    register_run_name()

    def decorate(function: Callable[[DictConfig], Any]) -> Callable[[], None]:
        begun = False  # whether Hydra has handed over to the command itself

        @wraps(function)
        def composed(config: DictConfig) -> Any:
            nonlocal begun
            begun = True
            configure_logging()  # again: Hydra has silenced what was there, or a launcher has started this process
            with (
                one_sentence(),
                shared_memory_explained(),
            ):  # also here: Hydra prints a line of its own about errors that it sees
                choices = HydraConfig.get().runtime.choices
                check_choices(choices, _command_line()[0])
                return function(with_choices(config, choices) if "env" in config else config)

        by_hydra = hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name=name)(composed)

        @wraps(function)
        def main() -> None:
            nonlocal begun
            begun = False
            with command_process():
                if show(name):
                    return
                _refuse_options(name)
                _read_texts()
                configure_logging()
                with _explaining(name, lambda: begun):
                    by_hydra()

        return main

    return decorate


@contextmanager
def _explaining(name: str, begun: Callable[[], bool]) -> Iterator[None]:
    """Turns what Hydra raises, or what breaks inside it, into a sentence; errors of the command itself pass."""
    if os.environ.get(FULL_ERROR) == "1":  # the user asked for Hydra's own errors
        yield
        return
    os.environ[FULL_ERROR] = "1"
    try:
        with shared_memory_explained():
            yield
    except (UavrlError, BrokenPipeError):
        raise
    except Exception as error:
        if begun() and not isinstance(error, HydraException | OmegaConfBaseException):
            raise
        raise UavrlError(explained(error, name)) from error
    finally:
        del os.environ[FULL_ERROR]


def explained(error: Exception, name: str) -> str:
    """What is wrong on the command line of the command whose configuration is ``conf/NAME.yaml``."""
    first = next(iter(str(error).splitlines()), type(error).__name__)
    if isinstance(error, OverrideParseException):
        return f"The override {error.override!r} cannot be read: {_hint(str(error.override), name)}."
    if isinstance(error, BrokenProcessPool):
        return (
            "A process of the sweep was killed, often because memory ran out: start the same command again to resume "
            "its runs, with fewer at a time if memory was short (hydra.launcher.n_jobs=1)."
        )
    if "UncompletedJobError" in [kind.__name__ for kind in type(error).__mro__]:  # submitit's, which need not be there
        return (
            f"A job of the sweep did not finish ({first.rstrip('.')}): start the same command again to resume its "
            f"runs, with more time if that was short (hydra.launcher.timeout_min)."
        )
    if isinstance(error, OSError) and error.filename is not None:
        return (
            f"{error.filename} cannot be written ({error.strerror}), and a sweep writes there: start it in another "
            f"folder, or set hydra.sweep.dir=FOLDER."
        )
    if isinstance(error, MissingConfigException) and error.options and error.missing_cfg_file:
        group, choice = error.missing_cfg_file.rsplit("/", 1)
        if group == "hydra/launcher" and choice in LAUNCHERS:
            return f"{group}={choice} needs a plugin of Hydra: install it with pip install 'uavrl[launchers]'."
        folders, _ = _command_line()
        yours = "A choice of your own needs --config-dir FOLDER."
        own = f"{folders[0]} has no {group}/{choice}.yaml." if folders else yours
        near = did_you_mean(choice, error.options, ": ")
        return f"{group} must be one of {', '.join(error.options)}, got {choice!r}{near} {own}"
    if isinstance(error, ConfigCompositionException) and "Could not override '" in first:
        return _no_such_key(first.split("'")[-2].split("@")[0], name)
    deleted = [override[1:] for override in _command_line()[1] if override.startswith("~")]
    if first.startswith("Error resolving interpolation") and deleted:
        return f"~{deleted[0]} removes a group that other groups depend on: select a choice with {deleted[0]}=NAME."
    if isinstance(error, AssertionError):
        return "An override sets a key below a key that has no keys below it: --help=all lists all keys."
    if first.startswith("Additional config directory"):  # Hydra's words for a folder that is not there
        return f"{first}: pass an existing folder of YAML files to --config-dir."
    reason = next(iter(str(error.__cause__).splitlines()), "") if error.__cause__ is not None else ""
    return f"{first}: {reason}" if reason and reason not in first else first


def _refuse_options(name: str) -> None:
    """Refuses options that Hydra does not know, such as ``--output FILE``, at which it would print all of its own."""
    command, known = ABOUT[name][0], known_keys(name)
    parser = get_args_parser()
    parser.exit_on_error = False
    try:
        others = parser.parse_known_args(sys.argv[1:])[1]
    except argparse.ArgumentError as error:
        if wrong := next((given for given in sys.argv[1:] if given.startswith("--help=")), None):
            helps = "--help shows the most common keys, and --help=all shows all keys."
            raise UavrlError(f"{command} has no {wrong}: {helps}") from error
        raise UavrlError(f"{command}: {error}.") from error
    for option in others:
        if not option.startswith("-"):
            raise UavrlError(
                f"{command} needs its options before the first KEY=VALUE: move the option before {option} to the front."
            )
        key, _, value = option.lstrip("-").partition("=")
        if key in known:
            raise UavrlError(f"{command} has no option {option}: write {key}={value or 'VALUE'}.")
        other = "values are written KEY=VALUE, and --help explains the keys."
        raise UavrlError(f"{command} has no option {option}{did_you_mean(key, known, ': ', other, SLIP)}")


def _read_texts() -> None:
    """Has Hydra read the overrides whose values it could not read as texts."""
    overrides = get_args_parser().parse_args(sys.argv[1:]).overrides
    sys.argv[1:] = [readable(each) if each in overrides else each for each in sys.argv[1:]]


def _hint(given: str, name: str) -> str:
    """How to write an override that Hydra cannot read."""
    if "=" not in given:
        return f"write KEY=VALUE, as in {ABOUT[name][0]} {EXAMPLES[name][0]}"
    return "write KEY=VALUE, and quotes around special characters"


def _no_such_key(key: str, name: str) -> str:
    """Why a key cannot be changed: another choice has it, the yaml of this one leaves it out, or there is none."""
    folders, overrides = _command_line()
    group, _, below = key.partition(".")
    known = known_keys(name, folders)
    if key not in known and (near := did_you_mean(key, known, ": ", cutoff=SLIP)) != ".":
        return f"There is no key {key!r}{near}"
    values = [override for override in overrides if override.partition("=")[0] == key]
    if values and (choice := _choice_that_takes(key, name, folders, [o for o in overrides if o not in values])):
        theirs = any((folder / group / f"{choice}.yaml").is_file() for folder in folders)
        return f"{choice}.yaml has no {below}: {'add it there, or ' if theirs else ''}write +{values[-1]}"
    if key in known:
        having = f"{group}={' or '.join(choices_with(key, folders))}"
        return f"{key} belongs to another choice of {group}: select {having}, or leave the key out."
    return f"There is no key {key!r}" + did_you_mean(key, known, ": ", "--help=all lists all keys.")


def _choice_that_takes(key: str, name: str, folders: list[Path], overrides: list[str]) -> str | None:
    """The choice of a key's group whose class takes it, with all else as it was asked for; None if it does not."""
    part, _, argument = key.rpartition(".")
    try:
        config = compose(*overrides, name=name, own=folders)
        taken = names_taken({group: config[group] for group in PARTS if group in config}, part, config.packages)
        return str(config.choices[part.partition(".")[0]]) if argument in taken else None
    except (HydraException, OmegaConfBaseException, UavrlError, KeyError):  # other mistakes: this one is told first
        return None


def _command_line() -> tuple[list[Path], list[str]]:
    """The user's folders of yaml files, and the overrides."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd", type=Path)
    known, others = parser.parse_known_args(sys.argv[1:])
    return [known.config_dir] if known.config_dir else [], [each for each in others if not each.startswith("-")]


def given_overrides() -> list[str]:
    """What was given on the command line, without the plus signs of what was added."""
    return [override.lstrip("+") for override in HydraConfig.get().overrides.task]
