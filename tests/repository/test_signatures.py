"""The API pages show what a constructor takes: names, types with their ranges, defaults."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

import pytest

from tests.helpers.docs_modules import docs_module
from uavrl.buffers import ABR, EpisodeBuffer, PrioritizedBuffer
from uavrl.buffers.backward_reward import StateClassifier
from uavrl.collectors.async_ import AsyncCollector
from uavrl.collectors.sync import SyncCollector
from uavrl.config import EvaluateConfig
from uavrl.envs import NavigationEnv
from uavrl.losses import Imitation, TD3Loss
from uavrl.models import Actor
from uavrl_onboard.ranges import (
    Count,
    Discount,
    Folder,
    Fraction,
    NonNegative,
    Pairs,
    Positive,
    Share,
    Text,
    Whole,
    Widths,
)


@pytest.fixture(scope="module")
def shown() -> Any:
    return docs_module("signatures")


@pytest.mark.parametrize(
    ("hint", "words"),
    [
        (Positive, "float > 0"),
        (NonNegative, "float ≥ 0"),
        (Fraction, "float in [0, 1]"),
        (Discount, "float in [0, 1)"),
        (Share, "float in (0, 1]"),
        (Count, "int ≥ 1"),
        (Whole | None, "int ≥ 0 | None"),
        (Pairs, "int, an even number from 2"),
        (Widths, "Sequence[int], one or more widths above 0"),
        (dict[str, tuple[Positive, ...]], "dict[str, tuple[float > 0, ...]]"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_range_is_told_in_words(hint: Any, words: str, shown: Any) -> None:
    assert shown.has_range(hint) and shown.in_words(hint) == words


def test_what_has_no_range_stays_a_type(shown: Any) -> None:
    assert not any(map(shown.has_range, (float, Sequence[int], int | None, "Positive")))
    assert shown.signature_of(TD3Loss).parameters["reduction"].annotation is str


@pytest.mark.parametrize(
    ("kind", "begins"),
    [
        (
            NavigationEnv,
            "(num_uavs: 'int in [1, 512]' = 8, *, world: uavrl.envs.valley.WorldConfig | None = None, lidar: ",
        ),
        (Actor, "(observations: int, actions: int, hidden: 'Sequence[int], one or more widths above 0' = (400, 300), "),
        (ABR, "(multiplier: 'float ≥ 0' = 0.2, threshold: 'float in (0, 1]' = 0.98, max_classes: 'int ≥ 1' = 20000, "),
        (PrioritizedBuffer, "(capacity: 'int ≥ 1' = 1000000, alpha: 'float in [0, 1]' = 0.6, "),
        (EpisodeBuffer, "(capacity: 'int ≥ 1' = 1000000, *, frames: int = 1, "),
        (Imitation, "(base: torchrl.objectives.common.LossModule, *, limit: 'float > 0' = 1.0, weight: 'float ≥"),
    ],
)
def test_a_class_is_shown_by_its_own_constructor(kind: type, begins: str, shown: Any) -> None:
    assert str(shown.signature_of(kind)).startswith(begins)
    assert list(shown.signature_of(kind).parameters) == list(inspect.signature(kind.__init__).parameters)[1:]  # type: ignore[misc]


def test_what_only_a_configuration_needs_is_left_out(shown: Any) -> None:
    def made(name: Text, folder: Folder | None = None) -> Text:
        return name

    signature = shown.signature_of(made)
    assert [each.annotation for each in signature.parameters.values()] == [str, str | None]
    assert signature.return_annotation is str
    table = shown.ranges_in_words().splitlines()
    assert "| `Discount` | float in [0, 1) |" in table and not any("Text" in row or "Folder" in row for row in table)


def test_a_protocol_has_no_arguments_and_what_is_made_anew_is_three_dots(shown: Any) -> None:
    assert str(shown.signature_of(StateClassifier)) == "()"
    assert "choices: dict[str, str] = ..., " in str(shown.signature_of(EvaluateConfig))
    assert shown.signature_of(EvaluateConfig).parameters["episodes"].default == 500


def test_a_method_is_shown_as_it_is_called_and_a_collector_by_what_it_takes(shown: Any) -> None:
    assert list(shown.signature_of(AsyncCollector.reset, bound=True).parameters) == ["args", "kwargs"]
    assert list(shown.signature_of(SyncCollector).parameters) == ["create_env_fn", "policy", "kwargs"]


def test_a_function_keeps_what_it_returns(shown: Any) -> None:
    def twice(number: Positive = 1.0) -> float:
        return 2 * number

    assert str(shown.signature_of(twice)) == "(number: 'float > 0' = 1.0) -> float"
