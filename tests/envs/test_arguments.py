"""What constructors and steps are given by hand: NumPy's numbers are taken, what makes no sense ends in a sentence."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
import torch

from uavrl.envs.gym import ValleyEnv
from uavrl.envs.lidar import Lidar, LidarConfig
from uavrl.envs.navigation import NavigationEnv
from uavrl.envs.quadrotor import GRAVITY, Aerodynamics, Airframe, most_lift
from uavrl.envs.randomization import Randomization
from uavrl.envs.simulation import Simulation
from uavrl.envs.world import World, WorldConfig
from uavrl.errors import UavrlError
from uavrl.planners.vfh_star import VFHStar

SMALL = WorldConfig(size=(14.0, 12.0), obstacles=3, min_goal_distance=5.0)
NAN, INF = float("nan"), float("inf")


@pytest.fixture(scope="module")
def env() -> Iterator[NavigationEnv]:
    env = NavigationEnv(2, world=SMALL, lidar=LidarConfig(max_range=4.0))
    yield env
    env.close()


@pytest.mark.parametrize(
    "dtype", [torch.bfloat16, torch.float16, torch.float32, torch.float64, torch.int64, torch.uint8]
)
def test_an_action_may_be_of_any_real_type(env: NavigationEnv, dtype: torch.dtype) -> None:
    """1 and 2 are the same number in all of them."""
    flown = []
    for kind in (torch.float32, dtype):
        env.set_seed(0)
        state = env.reset()
        state["action"] = torch.tensor([[1, 0, 0, 2], [2, 1, 0, 0]], dtype=kind)
        flown.append(env.step(state)["next", "position"])
    assert torch.equal(*flown)


def test_a_complex_action_is_refused(env: NavigationEnv) -> None:
    state = env.reset()
    state["action"] = torch.zeros(2, 4, dtype=torch.complex64)
    with pytest.raises(UavrlError, match="action of real numbers, got torch"):
        env.step(state)


@pytest.mark.parametrize("tasks", [[], 3])
def test_tasks_are_a_list_of_some(tasks: object) -> None:
    with pytest.raises(UavrlError, match="tasks takes a list of one task or more, or None for any"):
        NavigationEnv(1, world=SMALL, tasks=tasks)  # type: ignore[arg-type]


def test_numpys_numbers_are_taken() -> None:
    whole, real = np.int64, np.float64
    world = WorldConfig(
        seeds=np.array([0, 3]), size=np.array([14.0, 12.0]), obstacles=whole(3), planes=whole(0),
        min_goal_distance=real(5.0),
    )  # fmt: skip
    assert (world.seeds, world.obstacles) == ((0, 3), 3) and type(world.seeds[0]) is type(world.obstacles) is int
    assert WorldConfig(seeds=(0, 1), obstacles=np.array([3, 4])).obstacles == (3, 4)
    lidar = LidarConfig(max_range=np.float32(4.0), range_noise=real(0.01))
    air = Aerodynamics(wind=np.array([1.0, 0.0, 0.0]), gust_intensity=real(0.5))
    made = NavigationEnv(whole(1), world=world, lidar=lidar, aerodynamics=air, max_steps=whole(3), seed=whole(5))
    assert made.rollout(2)["next", "task"].flatten().tolist() == [0, 0]
    made.close()
    gym = ValleyEnv(world=world, max_steps=whole(3))
    assert gym.reset(seed=whole(5))[0].shape == (105,)  # type: ignore[arg-type]
    gym.close()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: NavigationEnv(1, seed=-1), "seed must be a whole number, 0 or more, got -1"),
        (lambda: NavigationEnv(1, seed=1.5), "seed must be a whole number, 0 or more, got 1.5"),  # type: ignore[arg-type]
        (lambda: NavigationEnv(1).set_seed(-1), "seed must be a whole number, 0 or more, got -1"),
        (lambda: NavigationEnv(0), "num_uavs must be a whole number, 1 or more, got 0"),
        (lambda: NavigationEnv(2.0), "num_uavs must be a whole number, 1 or more, got 2.0"),  # type: ignore[arg-type]
        (lambda: NavigationEnv(1, max_steps=None), "max_steps must be a whole number, 1 or more, got None"),  # type: ignore[arg-type]
        (lambda: NavigationEnv(1, tasks=[-2]), "tasks must be a whole number, 0 or more, got -2"),
        (lambda: ValleyEnv(seed=-1), "seed must be a whole number, 0 or more, got -1"),
        (lambda: ValleyEnv().reset(seed=-1), "seed must be a whole number, 0 or more, got -1"),
        (lambda: WorldConfig(seeds=0), "seeds takes a list of numbers, got 0"),  # type: ignore[arg-type]
        (lambda: WorldConfig(seeds=(-1,)), "seeds must be a whole number, 0 or more, got -1"),
        (lambda: WorldConfig(seeds=(1.5,)), "seeds must be a whole number, 0 or more, got 1.5"),  # type: ignore[arg-type]
        (lambda: WorldConfig(size=40.0), "size takes a list of numbers, got 40.0"),  # type: ignore[arg-type]
        (lambda: WorldConfig(obstacles=2.5), "obstacles must be a whole number, 0 or more, got 2.5"),  # type: ignore[arg-type]
        (lambda: WorldConfig(obstacles=None), "obstacles must be a whole number, 0 or more, got None"),  # type: ignore[arg-type]
        (lambda: WorldConfig(planes=1.5), "planes must be a whole number, 0 or more, got 1.5"),  # type: ignore[arg-type]
        (lambda: WorldConfig(ceiling=NAN), "ceiling must be a finite number, got nan"),
        (lambda: WorldConfig(min_goal_distance="far"), "min_goal_distance must be a finite number, got 'far'"),  # type: ignore[arg-type]
        (lambda: WorldConfig(plane_speed=(3.0, INF)), "plane_speed must be finite numbers"),
        (lambda: Aerodynamics(wind=(NAN, 0.0, 0.0)), r"wind must be finite numbers, got \(nan, 0.0, 0.0\)"),
        (lambda: Aerodynamics(wind=3.0), "wind takes three numbers, one for each axis, got 3.0"),  # type: ignore[arg-type]
        (lambda: Aerodynamics(gust_intensity=NAN), "gust_intensity must be a finite number, got nan"),
        (lambda: Aerodynamics(air_density=INF), "air_density must be a finite number, got inf"),
        (lambda: Airframe(mass=NAN), "mass must be a finite number, got nan"),
        (lambda: LidarConfig(max_range=NAN), "max_range must be a finite number, got nan"),
        (lambda: LidarConfig(dropout="no"), "dropout must be a finite number, got 'no'"),  # type: ignore[arg-type]
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(make: Callable[[], object], said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        make()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Airframe(mass=-1.0), r"of an airframe must be above 0, got -1.0, \("),
        (lambda: Airframe(inertia=(1.0, 1.0)), "inertia takes three numbers"),  # type: ignore[arg-type]
        (lambda: Aerodynamics(force_coefficients=()), "force_coefficients takes three numbers"),  # type: ignore[arg-type]
        (lambda: Airframe(lidar_mass=-1.0), "lidar_mass must not be negative, got -1.0 kg"),
        (lambda: Airframe(mass=0.1 + 0.2, max_total_thrust=1.0), r"airframe of 1.13 kg must lift its weight of 11.1 N"),
        (lambda: Airframe(tilt_limit=2.0), r"tilt_limit must be an angle in \(0, π/2\) rad, got 2.0"),
        (lambda: Airframe(max_total_thrust=-1.0), "must lift its weight.* give a max_total_thrust above 0"),
        (lambda: Airframe(lidar_mass=4.0), "To make it hover, raise max_total_thrust to at least 68.1 N"),
        (lambda: Aerodynamics(air_density=-1.0), r"must not be negative, got -1.0, \("),
    ],
)
def test_a_vehicle_that_cannot_be_is_told_with_its_numbers(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: WorldConfig(size=(1e9, 1e9)), "lower size"),
        (lambda: WorldConfig(seeds=tuple(range(1000))), "give fewer seeds"),
        (lambda: WorldConfig(planes=10**9), "planes must be at most 100"),
        (lambda: LidarConfig(max_range=1e30), "max_range must be a positive length in metres, at most"),
    ],
)
def test_what_no_memory_holds_is_refused(make: Callable[[], object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        make()


GIVEN: dict[str, tuple[type, dict[str, Any]]] = {
    "world": (WorldConfig, {"seeds": [0], "size": [14.0, 12.0], "obstacles": 3, "min_goal_distance": 5.0}),
    "lidar": (LidarConfig, {"max_range": 4.0, "range_noise": 0.01}),
    "airframe": (Airframe, {"mass": 1.6, "inertia": [0.012, 0.012, 0.022]}),
    "aerodynamics": (Aerodynamics, {"wind": [0.5, 0.0, 0.0]}),
    "randomize": (Randomization, {"mass": [0.9, 1.1]}),
}


def test_a_dict_of_settings_is_the_configuration() -> None:
    """In all of an environment's arguments, with the same episode."""
    flown = []
    for given in (
        {name: kind(**values) for name, (kind, values) in GIVEN.items()},
        {name: values for name, (_, values) in GIVEN.items()},
    ):
        env = NavigationEnv(2, **given)  # type: ignore[arg-type]
        torch.manual_seed(0)  # of the random actions
        flown.append(env.rollout(3)["next"])
        env.close()
    assert set(flown[0].keys()) == set(flown[1].keys())
    for key, values in flown[0].items():
        np.testing.assert_array_equal(values.numpy(), flown[1][key].numpy())


def test_all_that_take_a_configuration_take_a_dict() -> None:
    assert World({"size": (14.0, 12.0), "obstacles": 3, "min_goal_distance": 5.0}).config.obstacles == 3  # type: ignore[dict-item]
    assert Lidar([], config={"max_range": 4.0}).config == LidarConfig(max_range=4.0)
    simulation = Simulation([], 1, airframe={"mass": 1.6}, aerodynamics={"wind": (1.0, 0.0, 0.0)})
    assert (simulation.airframe.mass, simulation.aerodynamics.wind) == (1.6, (1.0, 0.0, 0.0))
    simulation.close()
    assert VFHStar(airframe={"collision_radius": 0.4}).vehicle.hull[0] == 0.4
    gym = ValleyEnv(world=GIVEN["world"][1], lidar={"max_range": 5.0}, randomize={"mass": (0.9, 1.1)})
    assert gym._base.lidar_config.max_range == 5.0 and gym._base.randomize == Randomization(mass=(0.9, 1.1))
    gym.close()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: NavigationEnv(1, world={"plane": 3}), "world has no setting 'plane': did you mean planes?"),
        (lambda: NavigationEnv(1, airframe={"masss": 3}), "airframe has no setting 'masss': did you mean mass?"),
        (lambda: ValleyEnv(world={"plane": 3}), "world has no setting 'plane': did you mean planes?"),
        (lambda: ValleyEnv(lidar={"colour": 3}), "lidar has no setting 'colour': it takes max_range, min_range"),
        (lambda: NavigationEnv(1, randomize={"mas": (1, 1)}), "randomize has no setting 'mas': did you mean mass?"),
        (lambda: Simulation([], 1, aerodynamics={1: 2}), "aerodynamics has no setting 1: it takes air_density"),
        (lambda: NavigationEnv(1, world=3), "world takes a WorldConfig or a dict of its settings, got 3"),  # type: ignore[arg-type]
        (lambda: NavigationEnv(1, world=Airframe()), "world takes a WorldConfig or a dict of its settings, got Airf"),  # type: ignore[arg-type]
        (lambda: NavigationEnv(1, world={"planes": -1}), "planes must be a whole number, 0 or more, got -1"),
    ],
)
def test_settings_that_nothing_takes_are_refused_in_a_sentence(make: Callable[[], object], said: str) -> None:
    with pytest.raises(UavrlError, match=said):
        make()


def test_configurations_hold_plain_numbers() -> None:
    """As JSON has them, whatever they were given as."""
    single = np.float32(0.5)
    made = [
        WorldConfig(size=np.array([14.0, 12.0]), min_goal_distance=np.float32(5.0)),
        LidarConfig(max_range=single * 8, far_range=np.float32(12.0)),
        Airframe(mass=np.float32(1.5), inertia=np.full(3, 0.02)),
        Aerodynamics(wind=[single, single, single]),
        Randomization(mass=np.array([0.9, 1.1])),
    ]
    for config in made:
        again = type(config)(**json.loads(json.dumps(asdict(config))))
        assert again == config


@pytest.mark.parametrize("mass", [2.3, 2.5, 3.0])
def test_an_airframe_that_cannot_hover_is_refused_with_the_greatest_mass_that_does(mass: float) -> None:
    with pytest.raises(UavrlError, match=r"lower mass to at most 2\.229 kg or raise max_total_thrust to at least"):
        Airframe(mass=mass)


@pytest.mark.parametrize(("mass", "thrust"), [(1.477, 38.0), (2.229, 38.0), (2.3, 38.9), (9.0, 122.2)])
def test_what_is_let_through_holds_its_height(mass: float, thrust: float) -> None:
    airframe = Airframe(mass=mass, max_total_thrust=thrust)
    assert airframe.total_mass * GRAVITY <= most_lift(airframe)
    simulation = Simulation([], 1, airframe=airframe)
    simulation.reset(np.arange(1), np.array([[0.0, 0.0, 50.0]]), np.zeros(1))
    for _ in range(100):
        simulation.step(np.zeros((1, 4)))
    assert simulation.position[0, 2] == pytest.approx(50.0, abs=0.05)
    simulation.close()
