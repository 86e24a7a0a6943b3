"""Flying in one process while another learns."""

from __future__ import annotations

import multiprocessing
import signal
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from tensordict import TensorDictBase
from torchrl.collectors import MultiAsyncCollector
from torchrl.envs import EnvBase
from torchrl.weight_update import SharedMemWeightSyncScheme

from uavrl.errors import UavrlError


class AsyncCollector(MultiAsyncCollector):
    """TorchRL's asynchronous process collector, as a run needs it: its state is what the learner has been given.

    The worker flies ``frames_per_batch`` steps ahead while the learner updates, and is handed new weights after each
    episode learned from, in mid-flight. When they come depends on how fast both are, hence no two runs are the same.
    A resumed run starts new episodes.

    Raises:
        UavrlError: while iterating, when the worker has died.
    """

    def __init__(self, create_env_fn: Sequence[Callable[[], EnvBase]], *args: Any, **kwargs: Any) -> None:
        workers = [partial(_undisturbed, make) for make in create_env_fn]
        super().__init__(workers, *args, weight_sync_schemes={"policy": _SharedWeights()}, **kwargs)

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Yields one batch of whole episodes after the other; the worker gets the weights that were learned from it."""
        self.update_policy_weights_()  # a checkpoint may have been loaded since the worker began
        for batch in super().__iter__():
            yield batch
            self.update_policy_weights_()

    def iterator(self) -> Iterator[TensorDictBase]:
        """Yields what was flown, ``frames_per_batch`` steps at a time."""
        batches = super().iterator()
        while True:
            try:
                batch = next(batches)
            except StopIteration:
                return
            except RuntimeError as error:
                raise UavrlError(
                    "The process that flies has ended, and printed its reason above: mend that, and go on with "
                    "resume=RUN_FOLDER."
                ) from error
            yield batch

    def state_dict(self) -> OrderedDict[str, Any]:
        """How many frames and batches the learner has been given; open flights are not kept."""
        return OrderedDict(frames=self._frames, iter=self._iter)

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._frames, self._iter = state_dict["frames"], state_dict["iter"]


class _SharedWeights(SharedMemWeightSyncScheme):
    """Does not wait for ever until a worker has its weights: it may have died, which the next batch would tell."""

    def _wait_for_ack(self, worker_ids: int | list[int] | None = None, timeout: float | None = None) -> None:
        super()._wait_for_ack(worker_ids, timeout=5.0 if timeout is None else timeout)


def _undisturbed(make_env: Callable[[], EnvBase]) -> EnvBase:
    """Makes the environment in a worker that ignores Ctrl-C: that is the learner's to handle, which ends the worker."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return make_env()
