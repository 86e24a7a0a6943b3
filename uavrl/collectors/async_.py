"""Collecting in other processes while one learns."""

from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import active_children, resource_tracker
from multiprocessing.process import BaseProcess
from multiprocessing.util import Finalize
from typing import Annotated, Any, ClassVar

from pydantic import Field
from tensordict import TensorDictBase
from torchrl.collectors import MultiAsyncCollector
from torchrl.envs import EnvBase

from uavrl.errors import FlyingEnded, UavrlError
from uavrl.runs.interrupts import interrupts_end


class AsyncCollector(MultiAsyncCollector):
    """TorchRL's asynchronous process collector, as a run needs it.

    Each of ``processes`` workers takes ``frames_per_batch`` steps ahead while the learner updates, with the weights as
    they are at each step: all share their memory. How far these have come depends on how fast all are, hence no two
    runs are the same. A resumed run starts new episodes.

    Raises:
        UavrlError: when policy and worker cannot share memory.
        FlyingEnded: while iterating, when a worker has died.
    """

    is_remote: ClassVar[bool] = True

    def __init__(
        self, create_env_fn: Callable[[], EnvBase], *, processes: Annotated[int, Field(ge=1, le=256)] = 1, **kwargs: Any
    ) -> None:
        others = active_children()
        try:
            resource_tracker.ensure_running()  # starting it later would let interrupts through again
            with interrupts_end(lambda: _kill_all_but(others)):
                super().__init__([create_env_fn] * processes, **kwargs)
        except BaseException:  # Ctrl-C too: it is ours after the library has been told that its processes are gone
            _kill_all_but(others)
            self._end_schemes()
            raise
        Finalize(self, _kill, (self.procs,), exitpriority=0)
        if not all(parameter.is_shared() for parameter in self.policy.parameters()):
            self.shutdown()
            raise UavrlError(
                "collector=async needs a device whose memory two processes can share, cpu or cuda: "
                "choose one of these, or collector=sync."
            )

    def iterator(self) -> Iterator[TensorDictBase]:
        """Yields ``frames_per_batch`` steps at a time."""
        batches = super().iterator()
        while True:
            with _worker_errors():
                batch = next(batches, None)
            if batch is None:
                return
            yield batch

    def set_seed(self, *args: Any, **kwargs: Any) -> int:
        """Seeds the worker's environment."""
        with _worker_errors():
            return super().set_seed(*args, **kwargs)

    def reset(self, *args: Any, **kwargs: Any) -> None:
        """Starts new episodes."""
        with _worker_errors():
            super().reset(*args, **kwargs)

    def restart(self, seed: int, episodes: int) -> None:
        """Starts new episodes from a seed, another one in each process; open ones go on. All count."""
        if not self.running:
            self.set_seed(seed)
            self.reset()

    def drain(self) -> bool:
        """Nothing need end: open episodes go on through a checkpoint."""
        return True

    def shutdown(self, *args: Any, **kwargs: Any) -> None:
        """Ends the workers, and what TorchRL would end when it is collected: too late where Python itself is ending.

        The workers are killed: asked to end, each would first finish its batch, which takes seconds.
        """
        _kill(getattr(self, "procs", ()))
        super().shutdown(*args, **kwargs)
        self._end_schemes()

    def _end_schemes(self) -> None:
        for scheme in (getattr(self, "_weight_sync_schemes", None) or {}).values():
            scheme.shutdown()

    def state_dict(self) -> OrderedDict[str, Any]:
        """How many frames and batches have come from the worker; open episodes are not kept."""
        return OrderedDict(frames=self._frames, iter=self._iter)

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._frames, self._iter = state_dict["frames"], state_dict["iter"]


@contextmanager
def _worker_errors() -> Iterator[None]:
    """Turns what TorchRL raises when the worker does not answer into a sentence."""
    try:
        yield
    except (RuntimeError, OSError, EOFError) as error:
        raise FlyingEnded(str(error).strip() or type(error).__name__) from error


def _kill_all_but(others: Sequence[BaseProcess]) -> None:
    _kill([process for process in active_children() if process not in others])


def _kill(processes: Sequence[BaseProcess]) -> None:
    """Kills processes and waits for them: Python would wait at its end, after a SIGTERM that they block."""
    for process in processes:
        if process.is_alive():
            process.kill()
            process.join()
