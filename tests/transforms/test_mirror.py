"""Mirror images: of points, of scans, of whole flights, and of what a buffer samples."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import TransformedEnv

from tests.helpers.flights import small_env
from uavrl.envs import NavigationEnv
from uavrl.envs.simulation import Simulation
from uavrl.transforms import Mirror, NavigationState, TruncatedIcosahedron, mirror_action, mirror_observation
from uavrl.transforms.icosahedron import truncated_icosahedron
from uavrl.transforms.observation import navigation_observation

LEFT_RIGHT = torch.tensor([1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def flown() -> TensorDict:
    """Steps ``[3, 8]`` of vehicles among obstacles, with their scans."""
    config = small_env()
    state = NavigationState()
    assert isinstance(state[0], TruncatedIcosahedron)
    state[0].del_keys = False
    env = TransformedEnv(NavigationEnv(3, world=config.world, max_steps=8, seed=1), state)
    torch.manual_seed(0)
    return env.rollout(8, break_when_any_done=False)


def observation_of(cloud: Tensor, data: TensorDict, heading: Tensor) -> Tensor:
    return navigation_observation(truncated_icosahedron(cloud), data["altitude"], heading, data["elevation_deg"])


def test_the_mirrored_scan_of_a_real_flight_reduces_to_the_mirrored_observation(flown: TensorDict) -> None:
    cloud = flown["point_cloud"]
    seen = observation_of(cloud, flown, flown["heading_deg"])
    image = observation_of(cloud * LEFT_RIGHT, flown, (360.0 - flown["heading_deg"]) % 360.0)
    assert (seen[..., :32] > 0).float().mean() > 0.1, "something is seen"
    assert not torch.equal(seen, image)
    torch.testing.assert_close(mirror_observation(seen), image, rtol=0.0, atol=1e-6)


def test_the_image_of_an_image_is_the_original(flown: TensorDict) -> None:
    assert torch.equal(mirror_observation(mirror_observation(flown["observation"])), flown["observation"])
    assert torch.equal(mirror_action(mirror_action(flown["action"])), flown["action"])
    frames = flown["observation"].unflatten(-1, (3, 35))  # each is mirrored by itself
    assert torch.equal(mirror_observation(frames).flatten(-2), mirror_observation(flown["observation"]))


def test_faces_change_places_in_pairs_and_those_straight_ahead_stay() -> None:
    """Pentagons 4 to 7 lie in the plane z = 0; those at (±φ, ±1, 0) change places, the ones at y = 0 stay."""
    moved = mirror_observation(torch.arange(35.0))
    pentagons = [1.0, 0.0]  # (0, ±1, -φ)
    assert moved[:2].tolist() == pentagons
    assert sorted(moved[:12].tolist()) == list(range(12)), "pentagons stay pentagons"
    assert sorted(moved[12:32].tolist()) == list(range(12, 32)), "hexagons stay hexagons"
    assert (moved[:32] == torch.arange(32.0)).sum() == 8, "faces with y = 0"
    assert moved[32:].tolist() == [32.0, -33.0, 34.0]


@pytest.mark.parametrize("last_action", [False, True])
def test_a_goal_straight_behind_stays_behind(last_action: bool) -> None:
    """180 degrees fold to -1 on whichever side, and 1 is never emitted; a yaw rate of -1 does change its sign."""
    seen = navigation_observation(torch.zeros(32), torch.ones(1), torch.tensor([180.0]), torch.tensor([180.0]))
    expected = seen
    if last_action:
        seen, expected = (torch.cat([seen, torch.tensor([0.0, 0.0, 0.0, rate])]) for rate in (-1.0, 1.0))
    assert seen[33:35].tolist() == [-1.0, -1.0]
    mirrored = mirror_observation(seen.repeat(2, 3), last_action=last_action)
    assert torch.equal(mirrored, expected.repeat(2, 3))


def path(action: Tensor, steps: int) -> np.ndarray:
    """Where a vehicle in empty space is after each step of one action, ``[steps, 3]``."""
    simulation = Simulation([], 1)
    simulation.reset(np.array([0]), np.array([[0.0, 0.0, 3.0]]), np.zeros(1))
    places = []
    for _ in range(steps):
        simulation.step(action[None].numpy())
        places.append(simulation.position[0].copy())
    simulation.close()
    return np.array(places)


def test_mirrored_actions_fly_the_mirrored_path() -> None:
    """A curve of 3 s: the rotors turn the same way in both, which is seen only where they are at their limits."""
    action = torch.tensor([1.0, 0.7, 0.1, 0.3], dtype=torch.float64)
    flown, image = path(action, 30), path(mirror_action(action), 30)
    assert flown[-1, 1] > 2.5
    np.testing.assert_allclose(image, flown * [1.0, -1.0, 1.0], atol=5e-3)


def transitions(count: int) -> TensorDict:
    after = {"observation": torch.rand(count, 105), "reward": torch.rand(count, 1)}
    return TensorDict({"observation": torch.rand(count, 105), "action": torch.rand(count, 4), "next": after}, [count])


def test_half_of_what_is_sampled_is_mirrored_whole_and_nothing_that_is_stored() -> None:
    torch.manual_seed(0)
    buffer = ReplayBuffer(storage=LazyTensorStorage(400), transform=Mirror())
    data = transitions(400)
    buffer.extend(data)
    read = buffer[:]
    changed = (read["action"] != data["action"]).any(-1)
    assert 160 < changed.sum() < 240
    assert torch.equal(read["action"][changed], mirror_action(data["action"][changed]))
    for key in ("observation", ("next", "observation")):
        assert torch.equal(read[key][changed], mirror_observation(data[key][changed]))
        assert torch.equal(read[key][~changed], data[key][~changed])
    assert torch.equal(read["next", "reward"], data["next", "reward"])
    assert torch.equal(buffer.storage[:]["observation"], data["observation"])


def test_another_width_and_other_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"observations \[\*B, F \* 35\], got \[2, 36\]"):
        mirror_observation(torch.zeros(2, 36))
    with pytest.raises(ValueError, match="probability must be in"):
        Mirror(probability=1.5)
    with pytest.raises(ValueError, match="reduction must be one of"):
        Mirror(reduction="cube")  # type: ignore[arg-type]
