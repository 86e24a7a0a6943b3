"""Collecting in processes on many machines, through Ray, while one learns."""

import copy
import logging
import os
import signal
import sys
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from pydantic import Field
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.collectors.distributed import RayCollector as TorchRLRayCollector
from torchrl.envs import EnvBase

from uavrl.errors import FlyingEnded, UavrlError
from uavrl.runs.interrupts import interrupts_held_back
from uavrl.upstream import ray_job
from uavrl_onboard.cli.process import SAFE_PATH
from uavrl_onboard.pluralize import pluralize

log = logging.getLogger(__name__)
OBJECTS = 512 * 2**20  # bytes that a Ray of our own keeps for episodes and weights on their way


class Worker(Collector):
    """TorchRL's collector under a short name: Ray begins each line that a worker prints with it."""

    def __repr__(self) -> str:
        return "worker"

    def begin(self, seed: int, frames: int) -> None:
        """Begins anew, as one that has collected so many frames: those with random actions are among the first."""
        torch.manual_seed(seed)  # of random actions and of noise
        self.set_seed(seed)
        self._frames = frames
        self.reset()


class RayCollector(TorchRLRayCollector):
    """TorchRL's collector of Ray's workers, as a run needs it.

    Every worker sends each episode when it has ended, is answered with the learner's weights of that moment, and goes
    on while the learner updates, all through Ray's object store. How old an episode's weights are depends on how fast
    everybody is, hence no two runs are the same. A resumed run starts new episodes.

    Args:
        create_env_fn: makes an environment, on the worker's machine.
        policy: what the learner trains; workers use copies of it on their CPUs.
        workers: processes, each with its own vehicles.
        address: of a Ray cluster, ``"auto"`` for the one that runs on this machine; None starts one of our own here.
        num_threads: processors of the cluster that each worker takes.
        trajs_per_batch, traj_format, auto_register_policy_transforms, kwargs: as TorchRL's collector has them.

    Raises:
        UavrlError: when Ray is not installed, the cluster cannot be reached or has fewer processors than workers.
        FlyingEnded: while iterating, when a worker has died.
    """

    is_remote: ClassVar[bool] = True
    copies_policy: ClassVar[bool] = True  # of the policy, on CPUs

    def __init__(
        self,
        create_env_fn: Callable[[], EnvBase],
        policy: TensorDictModuleBase,
        *,
        workers: Annotated[int, Field(ge=1, le=4096)] = 2,
        address: str | None = None,
        num_threads: int = 1,
        trajs_per_batch: int = 1,
        traj_format: str = "cat",
        auto_register_policy_transforms: bool = False,
        **kwargs: Any,
    ) -> None:
        self._learned, self._running = policy, False
        self._frames = self._batches = 0
        each = {
            "trajs_per_batch": trajs_per_batch,
            "traj_format": traj_format,
            "auto_register_policy_transforms": auto_register_policy_transforms,
        }
        self._connected = _connect(address, workers * num_threads)
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "async distributed data collection with init_random_frames")
                super().__init__(
                    [create_env_fn] * workers,
                    copy.deepcopy(policy).to("cpu"),
                    collector_class=Worker,
                    collector_kwargs=[dict(each) for _ in range(workers)],  # one for all would be one dictionary
                    remote_configs={"num_cpus": num_threads},
                    weight_sync_schemes={},  # through the object store instead
                    # with a total of -1 frames nothing would come; only the learner's machine need have its device
                    **{**kwargs, "total_frames": sys.maxsize, "policy_device": "cpu"},
                )
        except BaseException:
            if self._connected:
                self._leave()
            raise

    def iterator(self) -> Iterator[TensorDictBase]:
        """Yields each batch of episodes as it comes; its worker goes on meanwhile."""
        import ray

        self._running = True
        promised = dict(map(self._request, self.remote_collectors))
        while True:
            with _worker_errors():
                ended = ray.wait(list(promised))[0][0]
                worker, updated = promised.pop(ended)
                ray.get(updated)
                batch = ray.get(ended)
            del ended, updated  # their memory is given back
            promised.update([self._request(worker)])
            self._frames += batch.numel()
            self._batches += 1
            yield batch

    def _request(self, worker: Any) -> tuple[Any, tuple[Any, Any]]:
        """Sends a worker the weights of now: the promise of its next batch, the worker, and that it has taken them."""
        updated = worker.update_policy_weights_.remote(TensorDict.from_module(self._learned).data.cpu())
        return worker.next.remote(), (worker, updated)

    def restart(self, seed: int, episodes: int) -> None:
        """Starts new episodes from a seed, another one in each worker; open ones go on. All count."""
        if not self._running:
            seeds = np.random.SeedSequence(seed).generate_state(self.num_collectors)
            with _worker_errors():
                self.map_fn("begin", [(int(own), self._frames // self.num_collectors) for own in seeds])

    def drain(self) -> bool:
        """Nothing need end: open episodes go on through a checkpoint."""
        return True

    def shutdown(self, *args: Any, **kwargs: Any) -> None:
        """Ends the workers, and leaves the cluster that was joined or started for them."""
        try:
            super().shutdown(*args, **kwargs)
        except Exception:  # what has ended the workers may have ended Ray, too; the run says so
            log.debug("Ray's workers did not end as asked.", exc_info=True)
        if self._connected:
            self._leave()

    def _leave(self) -> None:
        """Leaves the cluster, and forgets its workers: TorchRL's ``__del__`` would start another Ray to end them."""
        getattr(self, "remote_collectors", []).clear()
        _leave()

    def state_dict(self) -> OrderedDict[str, Any]:
        """How many frames and batches have come from the workers; open episodes are not kept."""
        return OrderedDict(frames=self._frames, iter=self._batches)

    def load_state_dict(self, state_dict: OrderedDict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self._frames, self._batches = state_dict["frames"], state_dict["iter"]


def _connect(address: str | None, processors: int) -> bool:
    """Joins the cluster of an address, or starts one here with so many processors; False where it was joined before."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a run tells nobody of itself
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else Ray warns of its next version
    try:
        import ray
    except ImportError as error:
        raise UavrlError("collector=ray needs Ray: install it by pip install 'uavrl[ray]'.") from error
    joined_before = ray.is_initialized()
    if not joined_before:
        _join(address, processors)
    if (there := ray.cluster_resources().get("CPU", 0)) < processors:
        if not joined_before:
            _leave()
        raise UavrlError(
            f"collector.workers asks for {pluralize(processors, 'processor')}, and the Ray cluster has {there:.0f}: "
            f"lower it, or add machines by ray start --address=ADDRESS."
        )
    return not joined_before


def _join(address: str | None, processors: int) -> None:
    import ray

    own: dict[str, Any] = {"num_cpus": processors, "object_store_memory": OBJECTS, "include_dashboard": False}
    try:
        with interrupts_held_back(), _handlers_kept():
            own = {} if address else own
            folders = [str(Path(one).absolute()) for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if one]
            job = ray_job(folders) if os.environ.get(SAFE_PATH) else None
            ray.init(address=address or "local", job_config=job, logging_level=logging.ERROR, **own)  # type: ignore[arg-type]
    except (ConnectionError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())
        if address is None:
            raise UavrlError(f"Ray does not start on this machine ({reason}): try ray start --head by hand.") from error
        raise UavrlError(
            f"collector.address={address} cannot be reached ({reason}): start Ray there by ray start --head, or leave "
            f"collector.address out."
        ) from error


def _leave() -> None:
    import ray

    ray.shutdown()


@contextmanager
def _handlers_kept() -> Iterator[None]:
    """Ray takes SIGTERM for itself; a run has its own way to end."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


@contextmanager
def _worker_errors() -> Iterator[None]:
    """Turns what Ray raises when a worker does not answer into a sentence."""
    import ray

    try:
        yield
    except (ray.exceptions.RayError, ConnectionError) as error:
        cause = getattr(error, "cause", None) or error
        raise FlyingEnded(next(iter(str(cause).strip().splitlines()), type(cause).__name__)) from error
