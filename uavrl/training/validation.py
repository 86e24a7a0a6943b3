"""The policy's success in unseen valleys, measured at intervals while it trains."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass
from multiprocessing.connection import Connection
from multiprocessing.util import Finalize
from typing import Annotated, Any, Protocol

import numpy as np
import torch
from pydantic import Field
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, multiprocessing
from torchrl.envs import EnvBase

from uavrl.errors import FlyingEnded, ValidationFailed
from uavrl.evaluation.rollout import episodes_as_they_end
from uavrl.evaluation.sequential import ERROR, has_exceeded
from uavrl.runs.interrupts import interrupts_held_back
from uavrl_onboard.pluralize import pluralize
from uavrl_onboard.ranges import Count, Rule

LISTENS = "the process listens"
Weights = dict[str, Tensor]
Seeds = Annotated[tuple[int, ...], Rule("a list of seeds from 0", lambda seeds: len(seeds) > 0 and min(seeds) >= 0)]


@dataclass(frozen=True)
class Validated:
    """The successes of one validation.

    Examples:
        >>> print(Validated(steps=10_000, tasks=20, successes=19))
        success 95.0 % of 20 tasks
    """

    steps: int  #: training steps of the policy
    tasks: int
    successes: int

    @property
    def rate(self) -> float:
        """The success rate."""
        return self.successes / self.tasks

    def __str__(self) -> str:
        return f"success {100 * self.rate:.1f} % of {pluralize(self.tasks, 'task')}"


class Flight:
    """An environment, and a policy that takes the weights of the one that learns."""

    def __init__(self, env: EnvBase, policy: TensorDictModuleBase) -> None:
        self.env, self.policy = env, policy.eval()

    def outcomes(self, weights: Weights, tasks: int, seed: int) -> Iterator[bool]:
        """Rolls out tasks 0 to ``tasks - 1`` of a seed; yields whether each one succeeded, as they end."""
        self.policy.load_state_dict(weights)
        self.env.set_seed(seed)
        for episode in episodes_as_they_end(self.env, self.policy, tasks):
            yield episode.outcome == "arrived"


class Flier(Protocol):
    """Rolls out a validation's tasks, here or elsewhere."""

    def begin(self, weights: Weights, tasks: int, seed: int) -> None:
        """Begins with the tasks of a seed."""

    def successes(self) -> int | None:
        """How many of the tasks succeeded; None before all have ended."""

    def close(self) -> None:
        """Stop a rollout in progress."""


class Validation:
    """Evaluates the policy every ``interval`` steps of training, each time in ``tasks`` new tasks.

    A run that collects in other processes has one more for this, and goes on learning meanwhile. One that collects in
    its own process waits: its validations come at the same steps when it is repeated, and do not affect the training.
    Once the last of them exceeds the rate that ends the run, the next one follows at once.

    Args:
        new_flier: takes seeds of valleys and returns the :class:`Flier` that rolls out tasks there.
        policy: whose weights are validated.
        seed: of the run, an integer from 0.
        interval: environment steps of training from one validation to the next.
        tasks: of one validation.
        seeds: of the valleys.
        error: probability that :meth:`reached` ever holds although the policy never exceeded the rate.
    """

    def __init__(
        self,
        new_flier: Callable[[Sequence[int]], Flier],
        policy: torch.nn.Module,
        seed: int,
        *,
        interval: Count = 10_000,
        tasks: Annotated[int, Field(ge=1, le=10_000)] = 20,
        seeds: Seeds = tuple(range(210, 220)),
        error: Annotated[float, Field(gt=0, lt=1)] = ERROR,
    ) -> None:
        self.interval, self.tasks, self.error = interval, tasks, error
        self.found: list[Validated] = []
        self._policy, self._seed, self._flier = policy, seed, new_flier(seeds)
        self._began: int | None = None  # steps of training when the validation that goes on began

    def advance(self, steps: int, until_success: float | None = None) -> Validated | None:
        """Begins a validation that is due after ``steps`` steps of training; returns one that has ended."""
        if self._began is None and self._is_due(steps, until_success):
            self._begin(steps)
        if self._began is None or (successes := self._flier.successes()) is None:
            return None
        self.found.append(Validated(self._began, self.tasks, successes))
        self._began = None
        return self.found[-1]

    def _is_due(self, steps: int, until_success: float | None) -> bool:
        last = self.found[-1] if self.found else Validated(0, 1, 0)
        promising = until_success is not None and last.rate > until_success
        return steps - last.steps >= self.interval or (promising and steps > last.steps)

    def _begin(self, steps: int) -> None:
        weights = {name: value.detach().cpu().clone() for name, value in self._policy.state_dict().items()}
        seed = int(np.random.SeedSequence([self._seed, len(self.found), steps]).generate_state(1)[0])
        self._flier.begin(weights, self.tasks, seed)
        self._began = steps

    def reached(self, rate: float) -> bool:
        """Whether the policy has exceeded this success rate, by a sequential test of all validations."""
        return has_exceeded(rate, [(each.successes, each.tasks) for each in self.found], self.error)

    def close(self) -> None:
        """Ends a validation that goes on."""
        self._flier.close()

    def state_dict(self) -> dict[str, Any]:
        """The validations that have ended; one that goes on is made again."""
        return {"found": [list(astuple(each)) for each in self.found]}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.found = [Validated(*each) for each in state_dict["found"]]


class HereFlier:
    """Rolls out the tasks before it returns, and draws nothing from the process's generators."""

    def __init__(self, new_flight: Callable[[], Flight]) -> None:
        self._new_flight = new_flight
        self._flight: Flight | None = None
        self._successes: int | None = None

    def begin(self, weights: Weights, tasks: int, seed: int) -> None:
        """Roll out the tasks of a seed."""
        with torch.random.fork_rng(devices=[]):
            self._flight = self._flight or self._new_flight()
            self._successes = sum(self._flight.outcomes(weights, tasks, seed))

    def successes(self) -> int | None:
        """Return the number of successes."""
        return self._successes

    def close(self) -> None:
        """Closes the environment."""
        if self._flight is not None:
            self._flight.env.close()


class ProcessFlier:
    """Rolls out the tasks in a process of its own, which ends with this object and with this process.

    Raises:
        FlyingEnded: from :meth:`begin` and :meth:`successes`, when that process has died.
        ValidationFailed: from :meth:`successes`, when it could not fly.
    """

    def __init__(self, new_flight: Callable[[], Flight], threads: int) -> None:
        spawn = multiprocessing.get_context("spawn")
        self._connection, self._theirs = spawn.Pipe()
        arguments = (new_flight, threads, self._theirs)
        self._process = spawn.Process(target=_serve, args=arguments, daemon=True, name="validation")
        self._end = Finalize(self, _end, (self._process, self._connection), exitpriority=0)
        self._asked: tuple[dict[str, np.ndarray], int, int] | None = None  # not sent before the process listens
        self._listens = False

    def begin(self, weights: Weights, tasks: int, seed: int) -> None:
        """Roll out the tasks of a seed in the other process."""
        if self._process.pid is None:
            with interrupts_held_back():  # inherited: this process alone ends it
                self._process.start()
            self._theirs.close()
        self._asked = {name: value.numpy() for name, value in weights.items()}, tasks, seed
        self._send()

    def _send(self) -> None:
        """Sends what is asked for once the process listens: before that, the pipe would hold the sender up."""
        if self._listens and self._asked is not None:
            try:
                self._connection.send(self._asked)
            except OSError as error:
                raise self._died() from error
            self._asked = None

    def successes(self) -> int | None:
        """Return the number of successes once all tasks have ended."""
        try:
            answer = self._connection.recv() if self._connection.poll() else None
        except (EOFError, OSError) as error:
            raise self._died() from error
        if answer == LISTENS:
            self._listens = True
            self._send()
            return None
        if isinstance(answer, str):
            raise ValidationFailed(
                f"The validation failed ({answer}), and the run has ended with a checkpoint: correct that, or resume "
                "it with validation=none."
            )
        return answer

    def close(self) -> None:
        """Ends the process."""
        self._end()

    def _died(self) -> FlyingEnded:
        self._process.join(1.0)
        return FlyingEnded(f"the validation, exit code {self._process.exitcode}")


def _end(process: Any, connection: Connection) -> None:
    if process.pid is not None:
        process.kill()
        process.join()
    connection.close()


def _serve(new_flight: Callable[[], Flight], threads: int, connection: Connection) -> None:
    """Roll out the requested tasks until the connection is closed, which is checked after each task."""
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)
    flight: Flight | None = None
    with suppress(EOFError, OSError):  # that end is closed, or its process has died
        connection.send(LISTENS)
        while True:
            arrays, tasks, seed = connection.recv()
            try:
                flight = flight or new_flight()
                weights, successes = {name: torch.from_numpy(value) for name, value in arrays.items()}, 0
                for success in flight.outcomes(weights, tasks, seed):
                    successes += success
                    if connection.poll():  # nothing is sent meanwhile
                        return
            except Exception as error:
                connection.send(" ".join(f"{type(error).__name__}: {error}".split()))
            else:
                connection.send(successes)
