"""The controllers that head along a way that the environment emits."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from uavrl.config import compose
from uavrl.envs.privileged import as_moving_objects, nearest_planes
from uavrl.policies.baselines import COSTS, VectorFieldHistogram
from uavrl.policies.privileged import CAUTION, HEADWAY, MappedVFH, PrivilegedVFH, TrapMappedVFH

COST = replace(COSTS["range_image", "proximity"], caution=CAUTION, headway=HEADWAY)
TOLD = {"reduction": "range_image", "last_action": True}


def states(count: int, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    faces = torch.rand(count, 72, generator=generator) * 3 * (torch.rand(count, 72, generator=generator) < 0.3)
    return TensorDict(
        {
            "faces": faces,
            "altitude": torch.full((count, 1), 3.5),
            "heading_deg": torch.rand(count, 1, generator=generator) * 360,
            "observation": torch.rand(count, 20, generator=generator) - 0.5,
            "velocity": torch.randn(count, 3, generator=generator),
            "attitude": torch.randn(count, 3, generator=generator) * torch.tensor([0.0, 0.0, 1.0]),
        },
        [count],
    )


@pytest.mark.parametrize(
    ("led", "way"), [(PrivilegedVFH(planes=False, **TOLD), "way"), (MappedVFH(**TOLD), "mapped_way")]
)
def test_it_is_vfh_with_a_headway_where_the_way_leads_straight_to_the_goal(led: MappedVFH, way: str) -> None:
    state = states(64)
    heading = torch.deg2rad(state["heading_deg"])
    told = state.copy().set(way, torch.cat([heading.cos(), heading.sin()], -1)).exclude("heading_deg")
    plain = VectorFieldHistogram(costs=COST, **TOLD)(state.copy())["action"]
    torch.testing.assert_close(led(told)["action"], plain, atol=1e-4, rtol=0)
    assert plain.std(0).min() > 0.05


def test_it_evades_planes_as_vfh_evades_moving_objects() -> None:
    state = states(64, seed=1)
    rng = np.random.default_rng(0)
    planes, velocities = rng.uniform(-6, 6, (3, 3)) * [1, 1, 0.1], rng.uniform(-3, 3, (3, 3)) * [1, 1, 0]
    known = nearest_planes(np.zeros((64, 3)), rng.uniform(-3, 3, 64), planes, velocities)
    heading = torch.deg2rad(state["heading_deg"])
    told = state.copy().set("way", torch.cat([heading.cos(), heading.sin()], -1)).exclude("heading_deg")
    told["planes"] = torch.from_numpy(known).float()
    seen = state.copy().set("moving_objects", torch.from_numpy(as_moving_objects(known)).float())
    evading = VectorFieldHistogram(costs=COST, motion=12.0, **TOLD)(seen)["action"]
    torch.testing.assert_close(PrivilegedVFH(**TOLD)(told)["action"], evading, atol=1e-4, rtol=0)
    alone = PrivilegedVFH(planes=False, **TOLD)(told)["action"]
    assert (alone - evading).abs().amax(-1).gt(0.1).float().mean() > 0.2


def test_it_follows_the_map_where_there_are_dead_ends_alone() -> None:
    told = states(64, seed=2)
    told["mapped_way"] = torch.nn.functional.normalize(torch.randn(64, 2, generator=torch.Generator().manual_seed(3)))
    told["traps"] = torch.arange(64)[:, None] % 3 * 1.0
    among, mapped = TrapMappedVFH(**TOLD)(told.copy())["action"], MappedVFH(**TOLD)(told.copy())["action"]
    plain = VectorFieldHistogram(costs=COST, **TOLD)(told.copy())["action"]
    torch.testing.assert_close(among, torch.where(told["traps"] > 0, mapped, plain))
    assert (mapped - plain).abs().amax(-1).gt(0.1).float().mean() > 0.5


def test_its_costs_are_those_of_vfh_headway() -> None:
    written = compose("preset=dagger").demonstrator.costs
    assert dataclasses.asdict(COST) == dict(written)
    assert PrivilegedVFH(**TOLD).costs == MappedVFH(**TOLD).costs == TrapMappedVFH(**TOLD).costs == COST
    assert dict(compose("preset=dagger", "demonstrator=vfh_mapped").demonstrator.costs) == dict(written)
    assert dict(compose("preset=dagger", "demonstrator=vfh_mapped_traps").demonstrator.costs) == dict(written)


def test_absent_planes_are_unknown() -> None:
    told = as_moving_objects(nearest_planes(np.zeros((1, 3)), np.zeros(1), np.array([[50.0, 0, 0]]), np.ones((1, 3))))
    assert not told.any()


def test_it_names_what_it_reads() -> None:
    assert PrivilegedVFH(**TOLD).in_keys == [
        "faces", "altitude", "way", "observation", "planes", "velocity", "attitude",
    ]  # fmt: skip
    assert "planes" not in PrivilegedVFH(planes=False).in_keys
    assert MappedVFH(**TOLD).in_keys == ["faces", "altitude", "mapped_way", "observation"]
    assert TrapMappedVFH(**TOLD).in_keys == [
        "faces", "altitude", "mapped_way", "observation", "heading_deg", "traps",
    ]  # fmt: skip
    assert "moving_objects" in MappedVFH(motion=12.0, **TOLD).in_keys
