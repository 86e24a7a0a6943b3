"""Episodes kept step by step, with their valley, and their file."""

import json
import zipfile
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from uavrl.envs.array_file import load_npz
from uavrl.errors import UavrlError
from uavrl.evaluation.rollout import EpisodeResult
from uavrl.runs.episodes import OUTCOMES
from uavrl_onboard.files import replacing

FORMAT = "uavrl flights 3"
MOST_BYTES = 2**32  # of a file, unpacked; some episodes take a few million


@dataclass(frozen=True)
class RecordedFlight:
    """One episode of T steps: T + 1 moments, the last after the last step. Positions are in the valley's own frame."""

    summary: EpisodeResult  #: Task, outcome, lengths and clearance, as an evaluation gives them
    position_stats: dict[str, Any]  #: where it flew, as :class:`uavrl.evaluation.position_stats.PositionStats` has it
    times: np.ndarray  #: ``[T + 1]`` in s
    positions: np.ndarray  #: ``[T + 1, 3]``, the airframe's centre in m
    attitudes: np.ndarray  #: ``[T + 1, 4]``, quaternions (x, y, z, w) from body to world axes
    velocities: np.ndarray  #: ``[T + 1, 3]`` in m/s, world axes
    goal: np.ndarray  #: ``[3]``, the middle of the goal cylinder in m
    observations: np.ndarray  #: ``[T + 1, W]``, what the policy reads
    actions: np.ndarray  #: ``[T, 4]`` – forward, left, up in m/s and yaw rate in rad/s
    rewards: np.ndarray  #: ``[T, R]``, the terms whose sum is the reward
    reward_names: tuple[str, ...]  #: R names
    distances: np.ndarray  #: ``[T + 1]``, to the goal in m
    clearances: np.ndarray  #: ``[T + 1]``, from the hull to the nearest thing in m
    #: ``[T]``, the probability of a collision that LifeGuard sees in each action; ``[0]`` without LifeGuard
    risks: np.ndarray
    planes: np.ndarray  #: ``[T + 1, K, 4]`` – x, y, z in m and yaw in rad
    faces: np.ndarray  #: ``[T + 1, cells]``, the reduction of the scan in m; 0 where a cell reports nothing
    points: np.ndarray  #: ``[P, 3]`` in m in the sensor's frame – the points of all scans, one scan after the other
    point_ends: np.ndarray  #: ``[T + 1]``, how many points there are up to and with each scan
    #: ``[T + 1, M, 7]``, what the vehicle sees to move: places in m, velocities in m/s (world axes), sizes in m, which
    #: are 0 where there is none; M is 0 where it does not look for any
    objects: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 7)))
    #: ``[T + 1]``, where a memory leads, from east to the left in rad; ``[0]`` without one
    bearings: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def cloud(self, moment: int) -> np.ndarray:
        """Returns the points ``[M, 3]`` of one scan in m, in the sensor's frame."""
        start = self.point_ends[moment - 1] if moment else 0
        return self.points[start : self.point_ends[moment]]


@dataclass(frozen=True)
class Scenery:
    """What stands in one valley, in the valley's own frame, and the bodies that fly in it."""

    #: ``[X, Y]``, the ground in m over a regular grid around the origin; ``[0, 0]`` where the obstacles hold it
    heights: np.ndarray
    size: np.ndarray  #: ``[2]``, extent along x and y in m
    vertices: np.ndarray  #: ``[V, 3]``, corners of all obstacles in m
    triangles: np.ndarray  #: ``[F, 3]``, their triangles
    kinds: np.ndarray  #: ``[F]``, each triangle's kind of obstacle, an index into ``kind_names``
    kind_names: tuple[str, ...]  #: Names of the kinds
    plane_vertices: np.ndarray  #: ``[A, 3]`` in m, a plane with its nose along x
    plane_triangles: np.ndarray  #: ``[B, 3]``
    goal: np.ndarray  #: ``[2]``, radius and height of the goal cylinder in m
    ball: float  #: Circumradius of the reduction in m
    directions: np.ndarray  #: ``[cells, 3]``, unit vectors through its cells in body axes
    statistic: str  #: What a face reports (``"face"``, ``"range"`` or ``"proximity"``)
    sensor: np.ndarray  #: ``[3]``, the LiDAR's centre in body axes in m


@dataclass(frozen=True)
class Recording:
    """Episodes of one policy, kept step by step."""

    source: dict[str, Any]  #: The policy, for a heading (run, checkpoint, seed of the tasks, environment)
    flights: tuple[RecordedFlight, ...]  #: In the order of the tasks asked for
    sceneries: dict[int | None, Scenery]  #: The valley of each seed that occurs in them

    def scenery(self, flight: RecordedFlight) -> Scenery:
        """The valley of one of the episodes."""
        return self.sceneries[flight.summary.world_seed]


def thinned(points: np.ndarray, most: int) -> np.ndarray:
    """At most ``most`` of the points ``[M, 3]``, spread over all of them, always the same ones."""
    if len(points) <= most:
        return points
    return points[np.sort(np.random.default_rng(0).permutation(len(points))[:most])]


def save_recording(recording: Recording, path: Path) -> None:
    """Writes episodes and valleys into one ``.npz`` file, which holds numbers and text alone, no pickles."""
    items: dict[str, RecordedFlight | Scenery] = {f"flight{i}": flight for i, flight in enumerate(recording.flights)}
    items |= {f"scenery{seed}": scenery for seed, scenery in recording.sceneries.items()}
    about: dict[str, Any] = {
        "format": FORMAT,
        "source": recording.source,
        "flights": len(recording.flights),
        "sceneries": list(recording.sceneries),
        "items": {},
    }
    arrays: dict[str, Any] = {}
    for name, item in items.items():
        values = {each.name: getattr(item, each.name) for each in fields(item)}
        plain = {key: value for key, value in values.items() if not isinstance(value, np.ndarray)}
        about["items"][name] = {k: asdict(v) if isinstance(v, EpisodeResult) else v for k, v in plain.items()}
        arrays |= {f"{name}/{key}": value for key, value in values.items() if key not in plain}
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)


def load_recording(path: Path) -> Recording:
    """Reads what :func:`save_recording` wrote; a file that is missing, damaged or another one is a ``UavrlError``."""
    if not path.is_file():
        raise UavrlError(f"Expected flights in {path} and found no such file: give one that data=FILE.npz wrote.")
    try:
        arrays = _read_arrays(path)
        about = json.loads(str(arrays.pop("about")))
        if about["format"] != FORMAT:
            raise ValueError(f"its format is {about['format']!r}")
        flights = tuple(_flight(arrays, about, f"flight{i}") for i in range(about["flights"]))
        sceneries = {seed: _scenery(arrays, about, f"scenery{seed}") for seed in about["sceneries"]}
        recording = Recording(about["source"], flights, sceneries)
        for flight in flights:
            if flight.faces.shape[1:] != recording.scenery(flight).directions.shape[:1]:
                raise ValueError("its cells lie in other directions")
        return recording
    except (OSError, UavrlError):
        raise
    except Exception as error:
        raise UavrlError(f"{path} contains no episodes, or is damaged: write it again with data=FILE.npz.") from error


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > MOST_BYTES:
        raise ValueError(f"it holds {size} bytes")
    return load_npz(path)


def _of(arrays: dict[str, np.ndarray], name: str) -> dict[str, Any]:
    return {key.partition("/")[2]: value for key, value in arrays.items() if key.startswith(f"{name}/")}


def _flight(arrays: dict[str, np.ndarray], about: dict[str, Any], name: str) -> RecordedFlight:
    plain = about["items"][name]
    summary = EpisodeResult(**plain["summary"])
    counts = (summary.task, summary.steps, summary.world_seed)
    lengths = [summary.straight, summary.flown, summary.clearance, summary.yaw_reversals or 0.0]
    lengths += [0.0] * 4 if summary.action_change is None else summary.action_change
    numbers = all(isinstance(c, int) for c in counts) and all(isinstance(m, int | float) for m in lengths)
    if summary.outcome not in OUTCOMES or not numbers or len(lengths) != 8 or summary.episode_return is not None:
        raise ValueError(f"its summary is {summary}")
    plain |= {"summary": summary, "reward_names": tuple(map(str, plain["reward_names"]))}
    flight = RecordedFlight(**plain, **_of(arrays, name))
    if flight.objects.shape[1:] != (0, 7) and flight.objects.shape != (len(flight.times), flight.objects.shape[1], 7):
        raise ValueError(f"what moves has the shape {flight.objects.shape}")
    if flight.bearings.shape not in ((0,), flight.times.shape):
        raise ValueError(f"where it was led has the shape {flight.bearings.shape}")
    return flight


def _scenery(arrays: dict[str, np.ndarray], about: dict[str, Any], name: str) -> Scenery:
    plain = about["items"][name]
    scenery = Scenery(**{**plain, "kind_names": tuple(plain["kind_names"])}, **_of(arrays, name))
    if scenery.directions.ndim != 2 or scenery.directions.shape[1] != 3 or not np.isfinite(scenery.directions).all():
        raise ValueError(f"its cells lie in {scenery.directions.shape} directions")
    return scenery
