"""The page of all hyper-parameters holds each key of the configuration with its values of today."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.helpers.docs_modules import DOCS, docs_module
from uavrl.cli.help import help_text


@pytest.fixture(scope="module")
def tables() -> dict[str, str]:
    made: Any = docs_module("hyperparameters")
    return made.tables()


def row(table: str, key: str) -> list[str]:
    (found,) = [line for line in table.splitlines() if line.startswith(f"| `{key}` |")]
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", found)[2:-1]]


@pytest.mark.parametrize(
    ("table", "key", "cells"),
    [
        ("algo", "algo.gamma", ["`0.99`", ""]),
        ("algo", "algo.hidden", ["`[400,300]`", "`[256,256]`"]),
        ("algo", "algo.critic.hidden",
         ["`[400,300]`; `algo=crossq`, `algo=crossq_td3`: `[512,512]`; `algo=xqc`, `algo=xqc_td3`: `[256,256,256,256]`",
          "`[256,256]`"]),  # which says ${..hidden}
        ("algo", "algo.policy_delay",
         ["`2`; `algo=crossq`, `algo=crossq_td3`, `algo=xqc`, `algo=xqc_td3`: `3`; `algo=ddpg`, `algo=sac`: `1`", ""]),
        ("algo", "algo.temperature_lr", ["`algo=crossq`: `0.001`; `algo=sac`, `algo=xqc`: `0.0003`", ""]),
        ("actor_terms", "fork.threshold", ["`fork=on`: `0.001`", ""]),
        ("actor_terms", "actor_penalty.weight", ["`actor_penalty=imitation`: `1.0`", "`1.0`"]),
        ("reward", "reward.arrived_reward",
         ["`200.0`; `reward=navigation`, `reward=navigation_printed`: `0.0`; `reward=traditional`: `50.0`", "`50.0`"]),
        ("env", "env.world.seeds", ["`[0]`", "`[0,1,…,31]`"]),
        ("env", "env.world.file", ["`env=cloud`, `env=mesh`: `???`", ""]),
        ("env", "env.world.planes", ["`0`; `env=dynamic`: `10`", ""]),
        ("env", "env.randomize.mass", ["`null`", "`[0.8,1.2]`"]),
        ("training", "seed", ["`0`", ""]),
        ("training", "trainer.progress", ["`true`", ""]),
    ],
)  # fmt: skip
def test_the_values_of_a_key(table: str, key: str, cells: list[str], tables: dict[str, str]) -> None:
    *found, meaning = row(tables[f"keys_{table}"], key)
    assert found == cells and meaning


def test_pretraining_has_its_own(tables: dict[str, str]) -> None:
    default, meaning = row(tables["keys_pretrain"], "pretrain.states")
    assert default == "`200000`; `pretrain=quick`: `20000`" and meaning.startswith("states drawn at random")


def test_what_markdown_would_take_for_something_else_is_escaped(tables: dict[str, str]) -> None:
    assert row(tables["keys_training"], "device")[-1].count("cuda:\\<index\\>") == 1


def test_each_key_that_the_help_explains_is_on_the_page(tables: dict[str, str]) -> None:
    page = (DOCS / "howto/hyperparameters.md").read_text(encoding="utf-8")
    assert [f"{{{{ {name} }}}}" for name in tables] == re.findall(r"\{\{ \w+ \}\}", page)
    told = help_text("config", every_key=True).partition("All keys")[2]
    known = set(re.findall(r"^  ([a-z_]+(?:\.\w+)*)\b", told, re.MULTILINE))
    assert len(known) > 150
    shown = set(re.findall(r"^\| `([\w.]+)` \|", "\n".join(tables.values()), re.MULTILINE))
    parents = {key for key in known if any(other.startswith(f"{key}.") for other in known)}
    assert known - shown == parents - {"demonstrator.costs"}, "which is null with demonstrator=vfh"
