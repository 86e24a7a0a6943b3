"""``uavrl-sitl``: our simulator as a vehicle, for a companion that speaks MAVLink and reads a LiDAR."""

from __future__ import annotations

import json
import logging
import signal
import sys
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from omegaconf import DictConfig

from uavrl.cli.command import command, given_overrides
from uavrl.config import validate
from uavrl.config.parts import Part
from uavrl.config.settings import Valleys
from uavrl.envs.sensors import SENSORS
from uavrl.errors import Stopped, UavrlError
from uavrl.sitl.faults import Faults
from uavrl.sitl.simulated_autopilot import FirmwareName
from uavrl.sitl.sitl import AUTOPILOT, LIDAR, ROS2
from uavrl_onboard.autopilot.mavlink import mavlink
from uavrl_onboard.cli.process import terminable
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.lidar.mount import UPRIGHT
from uavrl_onboard.lidar.udp import address
from uavrl_onboard.ranges import Folder, NonNegative, Positive, Seed, Text, Whole
from uavrl_onboard.ros2.dds import topic_of
from uavrl_onboard.sentences import require

if TYPE_CHECKING:
    from uavrl.envs.navigation import NavigationEnv
    from uavrl.sitl.live import LiveEpisode
    from uavrl.sitl.sitl import Result


log = logging.getLogger(__name__)


@dataclass
class SitlConfig:
    """conf/sitl.yaml: one task."""

    env: Part
    perception: Part
    reward: Part
    choices: dict[str, str] = field(default_factory=dict)
    packages: tuple[Text, ...] = ()
    task: Whole = 0
    seed: Seed = 20_000
    valleys: Valleys | None = None
    lidar: Folder = LIDAR
    autopilot: Folder = AUTOPILOT
    firmware: FirmwareName = "px4"
    armed: bool = True
    speed: Positive | Literal["lockstep"] = 1.0
    patience: Positive = 60.0
    linger: NonNegative = 1.0
    pilot_takes_over: NonNegative | None = None
    json: Folder | None = None
    faults: Faults = field(default_factory=Faults)

    def __post_init__(self) -> None:
        """Checks the addresses, and that the environment is a valley."""
        by_ros = self.lidar.startswith(ROS2)
        if by_ros:
            topic_of(self.lidar)
        for key, example in (("lidar", LIDAR), ("autopilot", AUTOPILOT)):
            told = f"udp://HOST:PORT, where to send to, such as {example}"
            if key == "lidar":
                told += ", or ros2:///TOPIC for point clouds"
            require(_is_host(getattr(self, key)) or (by_ros and key == "lidar"), key, told, getattr(self, key))
        require("world" in self.env, "env", "a valley", self.choices.get("env"))
        sensor = "one that reads a LiDAR, such as truncated_icosahedron: its perception.lidar is the vehicle's sensor"
        require(self.perception.get("_target_") is not None, "perception", sensor, self.choices.get("perception"))
        device = self.perception.lidar.device
        if not by_ros and (device.pattern, device.stride) != ("vlp16", 1):
            raise UavrlError(
                f"By UDP, uavrl-sitl sends the data packets of a Velodyne VLP-16, and the LiDAR {device.name} has "
                "none: publish its point clouds with lidar=ros2:///points, which uavrl-fly reads from the same address."
            )


@command("sitl")
def main(config: DictConfig) -> None:
    """Flies one task by a companion's set-points."""
    log.info("Loading the simulator ...")  # before all else: validating the environment loads torch
    settings = validate(config, SitlConfig)
    mavlink()  # what is missing is told before torch is loaded
    if any(override.startswith("env.num_uavs=") for override in given_overrides()):
        raise UavrlError("env.num_uavs is set by the command itself: leave it out, a companion flies one vehicle.")
    file = None if settings.json is None else writable(Path(settings.json), "json=FILE")
    # Imported here: --help, a mistyped key and a value out of range answer without loading torch.
    import torch

    torch.set_num_threads(1)
    env = _environment(settings)
    try:
        print(_sentence(_play(settings, env, file)))
    finally:
        env.close()


def _play(settings: SitlConfig, env: NavigationEnv, file: Path | None) -> Result:
    """Flies the task, and writes it before and after."""
    from uavrl.sitl.live import LiveEpisode
    from uavrl.sitl.sitl import Sitl

    episode = LiveEpisode(env, settings.task)
    told = _task(settings, episode)
    keys = ("firmware", "armed", "speed", "patience", "linger", "pilot_takes_over", "faults")
    options = {key: getattr(settings, key) for key in keys}
    options |= {"max_steps": env.max_steps, "max_speed": env.max_speed}
    with closing(Sitl(episode, settings.lidar, settings.autopilot, **options)) as sitl:
        _write(file, told)
        _introduce(settings, told)
        try:
            with terminable():
                sitl.run()
        except KeyboardInterrupt as error:
            number = getattr(error, "number", signal.SIGINT)
            raise Stopped(_stopped(sitl.result), number) from error
        finally:
            _write(file, told | sitl.result.facts())
    return sitl.result


def _environment(settings: SitlConfig) -> NavigationEnv:
    from uavrl.envs.navigation import NavigationEnv
    from uavrl.evaluation.environment import make_env

    if settings.valleys is not None:
        settings.env["world"] = replace(settings.env.world, seeds=settings.valleys)
    context: dict[str, Any] = {"packages": settings.packages, "seed": settings.seed, "num_uavs": 1}
    base = make_env(settings.env, settings.perception, tasks=[settings.task], **context).base_env
    require(isinstance(base, NavigationEnv), "env", "a valley", settings.choices.get("env"))
    assert isinstance(base, NavigationEnv)
    return base


def _task(settings: SitlConfig, episode: LiveEpisode) -> dict[str, Any]:
    """The task, in the axes of the autopilot's origin."""
    motion = episode.motion
    places = {"goal": episode.goal, "start": motion.position}
    told: dict[str, Any] = {name: [round(float(each), 3) + 0.0 for each in place] for name, place in places.items()}
    told |= {"yaw": round(motion.yaw, 4), "distance_at_start": round(episode.distance, 3)}
    told |= {"task": settings.task, "seed": settings.seed, "valley": episode.world_seed}
    told |= {key: getattr(settings, key) for key in ("lidar", "autopilot", "firmware", "speed")}
    return told | {"env": settings.choices.get("env"), "outcome": None}


def _introduce(settings: SitlConfig, told: dict[str, Any]) -> None:
    goal = ",".join(f"{each:g}" for each in told["goal"])
    start = ", ".join(f"{each:g}" for each in told["start"])
    where = f"from ({start}) to goal=[{goal}], {told['distance_at_start']:.1f} m"
    print(f"Task {settings.task} in valley {told['valley']}: {where}.")
    print(f"LiDAR to {settings.lidar}, MAVLink ({settings.firmware}) to {settings.autopilot}.")
    if (device := settings.perception.lidar.device) != SENSORS["vlp16"]:
        low, high = (f"{round(each, 1):g}" for each in device.field_of_view[2:])
        repeats = "" if device.repeats else " hull.repeats=false"
        mount = "" if device.mount == UPRIGHT else f" mount=[{','.join(f'{each:g}' for each in device.mount)}]"
        reads = f"lidar={settings.lidar}" if settings.lidar.startswith(ROS2) else "model=VLP16"
        print(f"For uavrl-fly: {reads}{mount} hull.elevations=[{low},{high}]{repeats}")
    sys.stdout.flush()


def _sentence(result: Result) -> str:
    """How it went."""
    if not result.setpoints:
        return "No set-point was obeyed."
    ended = result.outcome.replace("_", "-").capitalize()
    went = f"{ended} after {result.seconds:.1f} s, {result.distance:.1f} m from the goal"
    kept = ""
    if any(result.packets_late_ms):
        late = "{:.1f} ms (median), at most {:.0f} ms".format(*result.packets_late_ms)
        kept = f"; {100 * result.rate:.0f} % of the speed was held, packets were late by {late}"
    return f"{went} (nearest {result.least_distance:.1f} m){kept}."


def _stopped(result: Result) -> str:
    """How it went until it was stopped, behind the command's name."""
    text = _sentence(result)
    return f"s{text[1:]}" if text.startswith("Stopped") else f"stopped: {text}"


def _is_host(where: str) -> bool:
    """Whether something can be sent to an address, which needs its host."""
    try:
        return bool(address(where)[0])
    except UavrlError:
        return False


def _write(file: Path | None, told: dict[str, Any]) -> None:
    if file is not None:
        with replacing(file) as partial:
            partial.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
