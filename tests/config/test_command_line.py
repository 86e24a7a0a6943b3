"""A command that is printed can be typed: the shell and Hydra read from it what was meant."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st

from uavrl.config.command_line import command_line, readable

NAMES = [
    "runs/a b",
    "a=1",
    "müll",
    "it's",
    'say "a"',
    "a\\",
    "100",
    "1e5",
    "true",
    "null",
    "nan",
    "a,b",
    "[a]",
    "~",
    ".",
]


def as_typed(value: str | Path) -> str:
    """What Hydra makes of what a shell hands it."""
    command, word = shlex.split(command_line("uavrl-evaluate", run=value))
    assert command == "uavrl-evaluate"
    override = OverridesParser.create().parse_override(word)
    assert override.key_or_group == "run" and isinstance(override.value(), str)
    return str(override.value())


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_of_any_name_is_the_same_folder_when_it_is_typed(name: str) -> None:
    assert as_typed(name) == name


@given(st.text(alphabet=list("ab1._-/ =ü'\"\\,[]{}()~#&*?!:%+@e\n"), min_size=1, max_size=8))
def test_so_is_any_text(name: str) -> None:
    assert as_typed(name) == name


def test_a_folder_that_is_called_as_the_home_folder_lies_here() -> None:
    assert as_typed(Path("./~")) == "./~"
    assert command_line("uavrl-export", Path("~/a b")) == "uavrl-export './~/a b'"


def test_plain_words_stay_plain() -> None:
    told = command_line("uavrl-replay", run=Path("runs/2026-01-01_static"), packages=["mine"], episodes=4)
    assert told == "uavrl-replay run=runs/2026-01-01_static 'packages=[mine]' episodes=4"


def as_read(given: str) -> object:
    """What a command takes a word for."""
    return OverridesParser.create().parse_override(readable(given)).value()


@pytest.mark.parametrize("name", ["/home/jürgen/runs (1)", "学习/a b", "a=1", "a^2", "a;b", "€", "a\\ü\\", "~/a"])
def test_a_text_that_hydras_grammar_does_not_know_needs_no_quotes(name: str) -> None:
    assert as_read(f"run_dir={name}") == name


def test_blanks_around_it_are_dropped_as_hydra_drops_them() -> None:
    assert as_read("a= ü ") == "ü" and as_read("a= u ") == "u"


@pytest.mark.parametrize(
    "given",
    ["a=1", "a=[1,2]", "a=1,2", "a='b", "a=[1", "a=[ü,]", "a=[1,2;]", "~a", "a", "a=", "=ü", "ü=3", "a=${b}", "a=x y"],
)
def test_all_else_stays_as_it_was(given: str) -> None:
    assert readable(given) == given
