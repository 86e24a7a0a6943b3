"""A package that uavrl knows nothing of brings a perception and a model to train."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torchrl.checkpoint import Checkpoint

from tests.helpers.commands import in_process
from tests.helpers.own_parts import CHOSEN, CONFIG_DIR, SMALL, TRUSTED
from tests.helpers.pages import unpack
from uavrl.cli import replay as replay_command
from uavrl.cli import train as train_command
from uavrl.evaluation.recording import RecordedFlight, load_recording
from uavrl.runs.checkpoint import restore, rotation
from uavrl.viewer.flight_page import page_data


def test_a_reduction_that_uavrl_knows_nothing_of_is_flown_with_and_replayed(tmp_path: Path) -> None:
    run = f"run_dir={tmp_path / 'run'}"
    little = [*SMALL[1:], "trainer.episodes=2", "env.num_uavs=2", "env.max_steps=20", "env.world.obstacles=5"]
    chosen = ["perception=sectors", "perception.frames=2", "backward_reward=abr", run]
    assert in_process(train_command.main, *CONFIG_DIR, TRUSTED, *little, *chosen) == 0
    written = [f"output={tmp_path / 'page.html'}", f"data={tmp_path / 'flights.npz'}"]
    watched = ["task=1", *written, "points=100000", "progress=false"]
    assert in_process(replay_command.main, f"run={tmp_path / 'run'}", TRUSTED, *watched) == 0
    recording = load_recording(tmp_path / "flights.npz")
    (flight,), (place,) = recording.flights, recording.sceneries.values()
    assert flight.faces.shape[1:] == (8,) and flight.observations.shape[1:] == (2 * (8 + 3),)
    assert place.directions.shape == (8, 3) and place.statistic == "proximity"
    assert set(unpack(page_data(recording)["ball"]["faces"]).tolist()) == set(range(8))
    np.testing.assert_allclose(flight.faces, sectors_of(flight), atol=1e-5)


def sectors_of(flight: RecordedFlight) -> np.ndarray:
    """The same from the points."""
    told = np.zeros((len(flight.times), 8))
    for moment, row in enumerate(told):
        for x, y, z in flight.cloud(moment):
            sector = round(math.atan2(y, x) / (math.pi / 4)) % 8
            row[sector] = max(row[sector], 4.0 - math.sqrt(x * x + y * y + z * z))
    return told


class Optimisers:
    """Takes what a checkpoint has of the stepper."""

    def state_dict(self) -> dict[str, Any]:
        return {}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        self.found = state_dict


@pytest.mark.parametrize("execution", ["eager", "captured"])
def test_a_model_that_uavrl_knows_nothing_of_is_trained_and_goes_on_with_its_run(
    execution: str, tmp_path: Path
) -> None:
    chosen = [
        *CHOSEN[:2],
        "actor_penalty=wary",
        *SMALL,
        f"trainer.execution={execution}",
        f"run_dir={tmp_path / 'run'}",
    ]
    assert in_process(train_command.main, *CONFIG_DIR, TRUSTED, *chosen) == 0
    assert in_process(train_command.main, f"resume={tmp_path / 'run'}", TRUSTED, "trainer.episodes=9") == 0
    optimisers = Optimisers()
    restore(Checkpoint(stepper=optimisers), rotation(tmp_path / "run").latest(), ["stepper"])
    updates = json.loads((tmp_path / "run/summary.json").read_text())["updates"]
    adam = optimisers.found["model_optimizer_0"]
    assert updates > 0 and [float(state["step"]) for state in adam["state"].values()] == [updates] * 4
    assert adam["param_groups"][0]["lr"] == 1e-3
