"""What the commands that Hydra configures share: mistakes on the command line end in one sentence."""

import os
import shlex
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from functools import wraps

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import ConfigCompositionException, HydraException, MissingConfigException, OverrideParseException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from uavrl.cli.errors import configure_logging, one_sentence
from uavrl.cli.help import show
from uavrl.cli.process import command_process
from uavrl.command_line import override
from uavrl.configs import conf_dir, register_resolvers
from uavrl.configs.checks import did_you_mean
from uavrl.configs.choices import check_choices, choices_with, known_keys
from uavrl.configs.registry import with_choices
from uavrl.errors import UavrlError

FULL_ERROR = "HYDRA_FULL_ERROR"  # with it set to 1 Hydra hands its errors on instead of printing them


def command(name: str) -> Callable[[Callable[[DictConfig], None]], Callable[[], None]]:
    """Makes a console command of a function that takes the configuration ``conf/NAME.yaml``, as overridden."""
    register_resolvers()

    def decorate(function: Callable[[DictConfig], None]) -> Callable[[], None]:
        @wraps(function)
        def checked(config: DictConfig) -> None:
            mistakes.composed = True
            configure_logging()  # again: Hydra has silenced what was there, or a launcher has started this process
            with one_sentence():  # also here: Hydra prints a line of its own about errors that it sees
                choices = HydraConfig.get().runtime.choices
                check_choices(choices)
                function(with_choices(config, choices) if "env" in config else config)

        mistakes = _Mistakes(name)
        by_hydra = hydra.main(version_base="1.3", config_path=str(conf_dir()), config_name=name)(checked)

        @wraps(function)
        def main() -> None:
            with command_process():
                if show(name):
                    return
                configure_logging()
                with mistakes:
                    by_hydra()

        return main

    return decorate


class _Mistakes:
    """Turns what Hydra raises into a sentence; errors of the command itself pass.

    Hydra answers some mistakes by its own errors, and others by whatever breaks inside it.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self.composed = False  # whether the command itself has begun
        self._by_us = True

    def __enter__(self) -> None:
        self.composed = False
        self._by_us = os.environ.get(FULL_ERROR) != "1"  # else the user asked for Hydra's own errors
        if self._by_us:
            os.environ[FULL_ERROR] = "1"

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> None:
        if not self._by_us:
            return
        del os.environ[FULL_ERROR]
        expected = (HydraException, OmegaConfBaseException) if self.composed else Exception
        if isinstance(error, expected) and not isinstance(error, UavrlError | BrokenPipeError):
            raise UavrlError(explained(error, self._name)) from error


def explained(error: Exception, name: str) -> str:
    """What is wrong on the command line of the command whose configuration is ``conf/NAME.yaml``."""
    first = next(iter(str(error).splitlines()), type(error).__name__)
    if isinstance(error, OverrideParseException):
        return f"The override {error.override!r} cannot be read: {_readable(str(error.override))}."
    if isinstance(error, BrokenProcessPool):
        return (
            "A process that flew runs of the sweep was killed, often for want of memory: start the same command again, "
            "which goes on with its runs, and with fewer at a time where memory was short (hydra.launcher.n_jobs=1)."
        )
    if isinstance(error, OSError) and error.filename is not None:
        return (
            f"{error.filename} cannot be written ({error.strerror}): a sweep writes there what it flies; start it in "
            f"another folder, or choose one with hydra.sweep.dir=FOLDER."
        )
    if isinstance(error, MissingConfigException) and error.options and error.missing_cfg_file:
        group, choice = error.missing_cfg_file.rsplit("/", 1)
        choices = error.options
        return f"{group} must be one of {', '.join(choices)}, got {choice!r}{did_you_mean(choice, choices, ': ')}"
    if isinstance(error, ConfigCompositionException) and "Could not override '" in first:
        key = first.split("'")[-2].split("@")[0]
        known, group = known_keys(name), key.partition(".")[0]
        if key in known:
            having = f"{group}={' or '.join(choices_with(key))}"
            return f"{key} belongs to another choice of {group} than the one made: choose {having}, or leave it out."
        return f"There is no key {key!r}" + did_you_mean(key, known, ": ", "--help=all lists all keys.")
    if isinstance(error, AssertionError):
        return "An override changes something below a key that has nothing below it: --help=all lists all keys."
    reason = next(iter(str(error.__cause__).splitlines()), "") if error.__cause__ is not None else ""
    return f"{first}: {reason}" if reason and reason not in first else first


def _readable(given: str) -> str:
    """How to write an override that Hydra cannot read."""
    key, equals, value = given.partition("=")
    if equals and key and value and not set(value) & set("\"'[]{}(),"):
        return f"if the value is a text, type {shlex.quote(override(key, value))}"
    return "write KEY=VALUE, and quotes around special characters"


def given_overrides() -> list[str]:
    """What was given on the command line, without the plus signs of what was added."""
    return [override.lstrip("+") for override in HydraConfig.get().overrides.task]
