"""An exported policy that acts on scans and poses: numpy and ONNX Runtime, no PyTorch and no simulator."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.libraries import needed
from uavrl_onboard.perception.motion.rays import ScanPattern
from uavrl_onboard.perception.observation import FrameStack, navigation_observation
from uavrl_onboard.perception.reductions import REDUCTIONS
from uavrl_onboard.policy.contract import CONTRACT, NETWORK, REMEDY, Contract, read_contract, read_file
from uavrl_onboard.policy.motion import MotionReader
from uavrl_onboard.vehicle import Vehicle

LARGEST = 2**28  # bytes of policy.onnx; ours have less than a million
# The key by which ONNX names another file that holds a network's numbers, as it is written: behind its length, which
# ends in 8 or 0. The checksum is of policy.onnx alone.
OTHER_FILE = re.compile(rb"[\x00\x08]location")


class Policy:
    """Flies one vehicle by a folder that ``uavrl-export`` wrote, which holds ``contract.json`` and ``policy.onnx``.

    The checksum of ``policy.onnx`` must be the contract's. Nothing in the folder is code: ONNX Runtime computes the
    network with its own operators alone. One object belongs to one vehicle, since it keeps the last observations and
    the last action; :meth:`copy` gives another one of the same network.

    Args:
        folder: the exported policy.

    Attributes:
        contract: what the folder says about the policy.
        cells: ``[cells]`` in m, what it saw of the latest scan; ``None`` before the first.
        last_action: ``[4]``, what it reads as its last action, which is the one it gave. Where the vehicle got another
            one, set it to that.

    Raises:
        UavrlError: where a file is missing, damaged, too large or of another version, where contract and network do not
            belong together, or ONNX Runtime is not installed.

    Examples:
        >>> import numpy as np
        >>> policy = Policy("my_policy")  # doctest: +SKIP
        >>> policy(np.full((1, 3), np.nan), altitude=3.5, heading_deg=0.0, elevation_deg=0.0)  # doctest: +SKIP
        array([1.9, 0. , 0. , 0.1], dtype=float32)
    """

    def __init__(self, folder: str | Path) -> None:
        self.contract = read_contract(Path(folder))
        self.cells: np.ndarray | None
        self._network = _Network(Path(folder), self.contract)
        self.fly_with(self.contract.vehicle)

    def fly_with(self, vehicle: Vehicle) -> None:
        """Begin with another vehicle than that of the training, whose LiDAR motion detection has to know."""
        self._pattern = ScanPattern(*vehicle.lidar_elevations, repeats=vehicle.lidar_repeats)
        self._begin()

    def _begin(self) -> None:
        limit, frames = self.contract.action_limit, self.contract.state.frames
        self._state = FrameStack(frames, limit is not None, limit or 1.0)
        motion = self.contract.motion
        self._motion = None if motion is None else MotionReader(motion, self._pattern)
        self.cells = None
        self.last_action = np.zeros(len(self.contract.action.order), np.float32)
        self._memory = self._network.new_memory(1)

    def copy(self) -> Policy:
        """The same policy for another vehicle, at the beginning of an episode."""
        other = Policy.__new__(Policy)
        other.contract, other._network, other._pattern = self.contract, self._network, self._pattern
        other._begin()
        return other

    def reset(self) -> None:
        """Forgets observations, action, memory and what has moved, as at the beginning of an episode."""
        self._state.reset()
        if self._motion is not None:
            self._motion.reset()
        self.last_action = np.zeros_like(self.last_action)
        self._memory = self._network.new_memory(1)

    def __call__(
        self,
        cloud: np.ndarray,
        altitude: float,
        heading_deg: float,
        elevation_deg: float,
        velocity: Sequence[float] | np.ndarray | None = None,
        attitude: Sequence[float] | np.ndarray | None = None,
        elapsed: float | None = None,
    ) -> np.ndarray:
        """The action that answers one scan and the pose of its moment: call it ``contract.rate_hz`` times a second.

        Args:
            cloud: ``[P, 3]`` in m in the sensor frame (x forward, y left, z up), in any order; NaN, infinity and zeros
                are misses.
            altitude: z above the mean level of the ground, m.
            heading_deg: from the vehicle's head to the goal, left positive, degrees; turned by the
                map, where that is on.
            elevation_deg: from the horizontal up to the goal, degrees.
            velocity: ``[3]`` of the vehicle in the world's axes, m/s; it is read where ``contract.motion`` is not None,
                as is the next one. The world's axes are any whose z points up, the same at all times.
            attitude: ``[3]``, its roll, pitch and yaw in these axes, rad, by which a vector of the vehicle is turned
                about its own forward, left and up: first by the roll, then by the pitch, then by the yaw.
            elapsed: since the scan before, s, which is read there too. None: ``1 / contract.rate_hz``.

        Returns:
            ``float32 [4]``: forward, left and up in m/s in the yaw-aligned body frame, yaw rate in rad/s, within the
            contract's limits.

        Raises:
            UavrlError: for a cloud of another shape, for a pose that is not finite, for a velocity or an attitude that
                is needed and missing or not finite, and where the network's answer is not finite: then the last action
                stays what it was.
        """
        state = self.state(cloud, altitude, heading_deg, elevation_deg, velocity, attitude, elapsed)
        actions, self._memory = self._network(state[None], self._memory)
        self.last_action = actions[0]
        return self.last_action.copy()

    def state(
        self,
        cloud: np.ndarray,
        altitude: float,
        heading_deg: float,
        elevation_deg: float,
        velocity: Sequence[float] | np.ndarray | None = None,
        attitude: Sequence[float] | np.ndarray | None = None,
        elapsed: float | None = None,
    ) -> np.ndarray:
        """Takes a scan and a pose in, and returns what the network reads of them and those before, ``float32 [S]``."""
        terms, pose = self.contract, (altitude, heading_deg, elevation_deg)
        if not np.isfinite(pose).all():
            raise UavrlError(f"altitude, heading_deg and elevation_deg must be finite numbers, got {pose}.")
        own = None if self._motion is None else self._motion.checked(velocity, attitude, elapsed)
        cells, seen = terms.cells, np.full((1, 3), np.nan) if terms.cloud.blind else cloud
        reduce, options = REDUCTIONS[cells.reduction], {**cells.options, "view": terms.view}
        self.cells = reduced = reduce(seen, cells.radius, cells.statistic, **options)
        scales = {"radius": cells.radius, "flight_level": terms.flight_level}
        observed = navigation_observation(reduced, *pose, **scales, angles=terms.angles)
        if self._motion is not None and own is not None:
            observed = np.concatenate([observed, self._motion(seen, *own)])
        return self._state(observed, self.last_action)


class _Network:
    """``policy.onnx``: states ``float32 [N, S]`` to actions ``[N, 4]`` within the contract's limits.

    What it remembers is ``[N, M]``, and ``[N, 0]`` for a network that remembers nothing.
    """

    def __init__(self, folder: Path, contract: Contract) -> None:
        self._path, about = folder / NETWORK, contract.network
        if about is None or about.file != NETWORK:
            raise UavrlError(
                f"{folder / CONTRACT} names no {NETWORK}: pip install 'uavrl[export]' and {REMEDY}, or fly it with "
                f"PyTorch as run={folder}."
            )
        content = read_file(self._path, LARGEST)
        if hashlib.sha256(content).hexdigest() != about.sha256:
            raise UavrlError(
                f"{self._path} is damaged, or of another policy than {CONTRACT} (its checksum differs): {REMEDY}."
            )
        self._limits = np.array(contract.action.low, np.float32), np.array(contract.action.high, np.float32)
        self._inputs, self._outputs = {about.input: contract.state.size}, {about.output: len(self._limits[0])}
        self._remembered, self._initial = 0, 0.0
        if about.memory is not None:
            self._remembered, self._initial = about.memory.size, about.memory.initial
            self._inputs[about.memory.input] = self._outputs[about.memory.output] = self._remembered
        self._session = self._opened(content)
        for number in (1, 3):
            self(np.zeros((number, contract.state.size), np.float32), self.new_memory(number))

    def _opened(self, content: bytes) -> Any:
        onnxruntime = needed("onnxruntime", str(self._path), "onnx")
        _check_numpy(onnxruntime.__version__)
        if OTHER_FILE.search(content):
            raise UavrlError(f"{self._path} has its numbers in another file: {REMEDY}.")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # what it has to say comes as an error
        try:
            session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:
            raise UavrlError(
                f"{self._path} is no network that ONNX Runtime opens ({_reason(error)}): {REMEDY}."
            ) from error
        found = [[(part.name, part.type, part.shape[1:]) for part in parts] for parts in _ends(session)]
        ends = (self._inputs, self._outputs)
        if found != [[(name, "tensor(float)", [width]) for name, width in end.items()] for end in ends]:
            raise UavrlError(f"{self._path} reads and gives {found}, which is not what {CONTRACT} says: {REMEDY}.")
        return session

    def new_memory(self, number: int) -> np.ndarray:
        """Return what is remembered at the beginning of an episode, ``float32 [number, M]``."""
        return np.full((number, self._remembered), self._initial, np.float32)

    def __call__(self, states: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return actions and the next memory."""
        read = dict(zip(self._inputs, (states, memory), strict=False))
        try:
            given = self._session.run(list(self._outputs), read)
        except Exception as error:
            raise UavrlError(f"{self._path} fails on a state of its contract ({_reason(error)}): {REMEDY}.") from error
        for part, width in zip(given, self._outputs.values(), strict=True):
            if part.shape != (len(states), width):
                raise UavrlError(f"{self._path} gives {part.shape} for {len(states)} states: {REMEDY}.")
            if not np.isfinite(part).all():
                raise UavrlError(f"{self._path} answers with numbers that are not finite: do not fly it.")
        return given[0].clip(*self._limits), given[1] if self._remembered else memory


def _check_numpy(runtime: str) -> None:
    """Refuse versions of ONNX Runtime that were built for NumPy 1: with NumPy 2 they crash, and Python with them."""
    if _numbers(runtime) < (1, 19) and _numbers(np.__version__) >= (2, 0):
        raise UavrlError(
            f"ONNX Runtime {runtime} does not work with NumPy {np.__version__}: pip install 'numpy<2', or a newer "
            "onnxruntime."
        )


def _numbers(version: str) -> tuple[int, int]:
    """Return the first two numbers of a version."""
    major, minor = re.findall(r"\d+", version)[:2]
    return int(major), int(minor)


def _ends(session: Any) -> tuple[Any, Any]:
    return session.get_inputs(), session.get_outputs()


def _reason(error: Exception) -> str:
    """ONNX Runtime's own words, in one line."""
    return " ".join(str(error).split())[:200]
