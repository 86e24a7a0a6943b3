"""What vehicles and planes did during the time of a control period, for sensors that report late."""

import numpy as np


class StateHistory:
    """The newest state and those of the physics steps of a control period before it; planes likewise.

    Args:
        count: Number of vehicles N.
        planes: Number of planes K.
        steps: Physics steps T in a period.
    """

    def __init__(self, count: int, planes: int, steps: int) -> None:
        self._steps = steps
        self._states: list[np.ndarray] = []
        self._planes = np.zeros((1, planes, 4))
        self._age = np.zeros(count, dtype=np.int64)  # physics steps from the reset to the end of the period

    def reset(self, index: np.ndarray, states: np.ndarray) -> None:
        """Takes ``states [N, 13]`` as those of now; the vehicles in ``index`` have no earlier ones."""
        self._states[-1:] = [states]
        self._age[index] = 0

    def place_planes(self, poses: np.ndarray) -> None:
        """Takes ``poses [K, 4]`` as those of now."""
        self._planes = np.array(poses)[None]

    def begin(self, steps: int, plane_path: np.ndarray | None) -> None:
        """Takes in that physics steps follow, in which planes fly ``plane_path [steps, K, 4]`` or stay where they are.

        What is older than a control period when they have been added is forgotten.
        """
        del self._states[: -(self._steps + 1 - steps)]
        self._age += steps
        if plane_path is not None:
            self._planes = np.concatenate([self._planes, plane_path])[-(self._steps + 1) :]

    def add(self, states: np.ndarray) -> None:
        """Adds the states ``[N, 13]`` after a physics step."""
        self._states.append(states)

    def since_reset(self, delay: np.ndarray, index: np.ndarray) -> np.ndarray:
        """The delays ``[M]`` of the vehicles in ``index``, in physics steps, but not beyond their resets."""
        return np.minimum(delay, self._age[index])

    def states(self, delay: np.ndarray, index: np.ndarray) -> np.ndarray:
        """The states ``[M, 13]`` of the vehicles in ``index``, ``delay [M]`` physics steps ago."""
        return np.stack(self._states)[-1 - delay, index]

    def planes(self, delay: np.ndarray) -> np.ndarray:
        """Where the planes were ``delay [M]`` physics steps ago, ``[M, K, 4]``."""
        return self._planes[np.maximum(len(self._planes) - 1 - delay, 0)]
