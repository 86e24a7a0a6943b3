"""Which episodes enter a replay buffer: falls always, successes rarely."""

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase

from uavrl.buffers.functional import is_admitted


class FailureBias:
    """Keeps most successful episodes out of a buffer, so that a good policy does not forget how it fell.

    The fall counter grows by 1 with each fall and sinks by ``falls_per_success`` with each success that is stored.

    Args:
        success_return: return, as the environment gave it, from which an episode without a fall is a success.
        probability: of a success to be stored while the counter is positive.
        falls_per_success: see above.
        seed: of the coin.
        fell: key of the flag that the last step of an episode carries if it fell.
        episode_return: key of the return so far, as TorchRL's ``RewardSum`` writes it.

    Examples:
        >>> from tensordict import TensorDict
        >>> def walk(fell: bool, value: float) -> TensorDict:
        ...     after = {"collided": torch.tensor([[False], [fell]]), "episode_reward": torch.tensor([[0.0], [value]])}
        ...     return TensorDict({"next": after}, [2])
        >>> bias = FailureBias(probability=1.0)
        >>> bias.admits(walk(False, 300.0)), bias.admits(walk(True, 20.0)), bias.admits(walk(False, 300.0)), bias.falls
        (False, True, True, -9)
    """

    def __init__(
        self,
        success_return: float = 250.0,
        probability: float = 0.5,
        falls_per_success: int = 10,
        seed: int = 0,
        *,
        fell: NestedKey = ("next", "collided"),
        episode_return: NestedKey = ("next", "episode_reward"),
    ) -> None:
        self.success_return = success_return
        self.probability = probability
        self.falls_per_success = falls_per_success
        self.fell = fell
        self.episode_return = episode_return
        self.falls = 0
        self.left_out = 0
        self._generator = torch.Generator().manual_seed(seed)

    def admits(self, episode: TensorDictBase) -> bool:
        """Whether one whole episode ``[T]`` is stored; counts its fall.

        Raises:
            KeyError: when a key is missing.
        """
        last = episode[-1]
        fell, value = last.get(self.fell, None), last.get(self.episode_return, None)
        if fell is None or value is None:
            raise KeyError(
                f"FailureBias expected the keys {self.fell!r} and {self.episode_return!r}, found "
                f"{list(last.keys(True, True))}: put TorchRL's RewardSum into the environment."
            )
        self.falls += int(fell)
        coin = float(torch.rand((), generator=self._generator))
        success = not bool(fell) and float(value) >= self.success_return
        admitted = is_admitted(
            float(value), bool(fell), self.falls, coin,
            success_return=self.success_return, probability=self.probability,
        )  # fmt: skip
        self.falls -= self.falls_per_success * (success and admitted)
        self.left_out += not admitted
        return admitted

    def diagnostics(self) -> dict[str, float]:
        """The fall counter, and how many episodes were left out."""
        return {"buffer_falls": float(self.falls), "buffer_left_out": float(self.left_out)}

    def state_dict(self) -> dict[str, Any]:
        """Counters and generator."""
        return {"falls": self.falls, "left_out": self.left_out, "generator": self._generator.get_state()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.falls, self.left_out = int(state_dict["falls"]), int(state_dict["left_out"])
        self._generator.set_state(state_dict["generator"].cpu())
