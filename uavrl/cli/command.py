"""What the commands that Hydra configures share: mistakes on the command line end in one sentence."""

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl import __version__
from uavrl.cli import BEGAN
from uavrl.cli.help import ABOUT, help_text
from uavrl.cli.keys import check_choices, choices_with, known_keys
from uavrl.cli.logs import configure_logging
from uavrl.config import conf_dir
from uavrl.config.command_line import readable
from uavrl.config.yaml_files import register_resolvers, with_choices
from uavrl.errors import UavrlError
from uavrl.runs.clock import start_clock
from uavrl.runs.shared_memory import shared_memory_explained
from uavrl_onboard.cli.command import SLIP, refuse_option
from uavrl_onboard.cli.help import show
from uavrl_onboard.cli.process import command_process, one_sentence
from uavrl_onboard.guards.command_line import KEY as GUARDS
from uavrl_onboard.guards.command_line import join_guards
from uavrl_onboard.sentences import did_you_mean

_ENDED_JOBS = {"BrokenProcessPool", "UncompletedJobError"}  # of joblib and of submitit, which need not be there
_first = [BEGAN]  # further commands, of tests for instance, begin when they are called
_FILES: dict[str, dict[str, str | None]] = {
    "evaluate": {"output": None},
    "replay": {"output": None, "data": None, "video": None},
    "report": {"output": "report.html", "json": None},
    "sitl": {"json": None},
}
"""By configuration: keys of files that a command writes, with their defaults, where these are the same for all jobs."""
FULL_ERROR = "HYDRA_FULL_ERROR"  # with it set to 1 Hydra hands its errors on instead of printing them


def command(name: str) -> Callable[[Callable[[DictConfig], Any]], Callable[[], None]]:
    """Makes a console command of a function that takes the configuration ``conf/NAME.yaml``, as overridden."""
    register_resolvers()

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
                check_choices(choices, _own_folders())
                return function(with_choices(config, choices) if "env" in config else config)

        by_hydra = hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name=name)(composed)

        @wraps(function)
        def main() -> None:
            nonlocal begun
            begun = False
            start_clock(_first.pop() if _first else None)
            with command_process():
                if show(sys.argv[1:], f"uavrl {__version__}", partial(help_text, name)):
                    return
                _refuse_options(name)
                _refuse_shared_files(name)
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
    about, folders = ABOUT[name], _own_folders()
    if isinstance(error, OverrideParseException):
        example = f"as in {about.name} {about.examples[0]}"
        how = example if "=" not in str(error.override) else "and quotes around special characters"
        return f"The override {error.override!r} cannot be read: write KEY=VALUE, {how}."
    if _ENDED_JOBS & {kind.__name__ for kind in type(error).__mro__}:
        return (
            f"A job of the sweep did not finish ({first.rstrip('.')}): start the same command again, which "
            "goes on with its runs, with fewer at a time where memory was short (hydra.launcher.n_jobs=1), and with "
            "more time where that was short (hydra.launcher.timeout_min)."
        )
    if isinstance(error, OSError) and error.filename is not None:
        told = "a sweep writes there; start it in another folder, or choose one with hydra.sweep.dir=FOLDER."
        return f"{error.filename} cannot be written ({error.strerror}): {told}"
    if isinstance(error, MissingConfigException) and error.options and error.missing_cfg_file:
        group, choice = error.missing_cfg_file.rsplit("/", 1)
        own = "A choice of your own needs --config-dir FOLDER."
        if folders:
            own = f"{folders[0]} has no {group}/{choice}.yaml."
        if group == "hydra/launcher":
            own = "joblib, submitit_local and submitit_slurm come with pip install 'uavrl[launchers]'."
        near = did_you_mean(choice, error.options, ": ")
        return f"{group} must be one of {', '.join(error.options)}, got {choice!r}{near} {own}"
    if isinstance(error, ConfigCompositionException) and "Could not override '" in first:
        key = first.split("'")[-2].split("@")[0]
        if key == GUARDS:
            others = "give it to uavrl-train, uavrl-evaluate, uavrl-replay, uavrl-export or uavrl-fly"
            return f"{about.name} has no key 'guards': {others}."
        return _no_such_key(key, known_keys(name, folders), choices_with(key, folders))
    if first.startswith("Ambiguous value for argument '"):
        key, _, values = first.split("'")[1].partition("=")
        each = "or add -m to train with" if name == "config" else "and start the command once for"
        return f"{key} got several values, {values}: give one, {each} each of them. A list is written {key}=[{values}]."
    if isinstance(error, AssertionError):
        return "An override changes something below a key that has nothing below it: --help=all lists all keys."
    if first.startswith("Additional config directory"):  # Hydra's words for a folder that is not there
        return f"{first}: give --config-dir a folder of yaml files that is there."
    reason = next(iter(str(error.__cause__).splitlines()), "") if error.__cause__ is not None else ""
    return f"{first}: {reason}" if reason and reason not in first else first


def _no_such_key(key: str, known: list[str], choices: list[str]) -> str:
    """Why a key cannot be changed: another choice of its group has it, or there is none."""
    group = key.partition(".")[0]
    if key in known:
        owner = " or ".join(choices) or f"another choice of {group} than the one made"
        other = f"add {'one of them' if len(choices) > 1 else 'that'} to the command, even if a run was trained with it"
        return f"{key} belongs to {owner}: {other}, or write +{key}=VALUE where the class of this one takes it."
    place = key.rpartition(".")[0]
    beside = {each[len(place) + 1 :].partition(".")[0] for each in known if each.startswith(f"{place}.")}
    nested = place != group and beside
    otherwise = f"{place} has {', '.join(sorted(beside))}." if nested else "--help=all lists all keys."
    told = f"There is no key {key!r}{did_you_mean(key, known, ': ', otherwise)}"
    is_slip = did_you_mean(key, known, cutoff=SLIP) != "."
    return told if is_slip or group not in known else f"{told} If the class of {group} takes it, write +{key}=VALUE."


def _refuse_options(name: str) -> None:
    """Refuses options that Hydra does not know, such as ``--output FILE``, at which it would print all of its own."""
    command, parser = ABOUT[name].name, get_args_parser()
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
            raise UavrlError(f"{command} takes options before all that is KEY=VALUE: {option} stands behind one.")
        refuse_option(command, option, known_keys(name))


def _refuse_shared_files(name: str) -> None:
    """Refuses a sweep whose jobs would all write the same file, so that the last one's alone would be left."""
    given = get_args_parser().parse_args(sys.argv[1:])
    if not given.multirun:
        return
    told = {key.lstrip("+"): value for key, _, value in (each.partition("=") for each in given.overrides)}
    if "suite" in told:  # whose scenarios have files of their own, which several commands may share
        return
    for key, default in _FILES.get(name, {}).items():
        value = told.get(key, default)
        if value not in (None, "null") and not re.search(r"[,$]|^(choice|range|glob)\(", value):
            raise UavrlError(
                f"Each job of the sweep would replace the {key}={value} of the one before: let it differ, such as "
                f"{key}='{Path(value).with_name('${hydra:job.num}_' + Path(value).name)}'."
            )


def _read_texts() -> None:
    """Has Hydra read the overrides whose values it could not read as texts."""
    overrides = get_args_parser().parse_args(sys.argv[1:]).overrides
    options = [each for each in sys.argv[1:] if each not in overrides]
    sys.argv[1:] = [*options, *map(readable, join_guards(overrides))]


def _own_folders() -> list[Path]:
    """Return the user's folders of yaml files: none or one."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd", type=Path)
    given = parser.parse_known_args(sys.argv[1:])[0].config_dir
    return [given] if given else []


def given_overrides() -> list[str]:
    """What was given on the command line, without the plus signs of what was added."""
    return [override.lstrip("+") for override in HydraConfig.get().overrides.task]
