"""A foreign file is refused where it is read; tests/check/cli/test_foreign_files.py tries the commands."""

from __future__ import annotations

import pickle
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.commands import TINY, newest
from tests.helpers.configs import composed
from tests.helpers.finished import finished_run
from tests.helpers.foreign import (
    CHANGES,
    COMPONENTS,
    EVERYTHING,
    FOREIGN_CONFIGS,
    MANIFESTS,
    NO_FLIGHTS,
    PLACES,
    Members,
    Payload,
    place,
    plant,
    rewrite,
)
from uavrl.config import validate
from uavrl.errors import UavrlError
from uavrl.evaluation.actor import read_policy
from uavrl.evaluation.recording import load_recording
from uavrl.runs.checkpoint import DamagedCheckpoint, RandomState, check_checkpoint
from uavrl.runs.config import read_config
from uavrl.runs.trust import check_archive


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return finished_run(tmp_path_factory.mktemp("run") / "run", *TINY, *EVERYTHING)


@pytest.fixture
def checkpoint(run: Path, tmp_path: Path) -> Path:
    """A copy of a whole one."""
    return Path(shutil.copy(newest(run), tmp_path))


def test_a_checkpoint_of_all_components_is_taken(checkpoint: Path) -> None:
    assert set(check_archive(checkpoint)["components"]) == {*COMPONENTS, "replay_data"}


@pytest.mark.parametrize("folder", PLACES)
def test_a_pickle_is_refused_in_any_part(folder: str, checkpoint: Path, tmp_path: Path) -> None:
    rewrite(checkpoint, plant(folder, tmp_path / "ran"))
    with pytest.raises(UavrlError, match=f"{folder}/other.pickle, which uavrl does not write: none of it was loaded"):
        check_archive(checkpoint)


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: change.__name__)
def test_what_uavrl_did_not_write_is_refused(
    change: Callable[[Members, Path], None], checkpoint: Path, tmp_path: Path
) -> None:
    rewrite(checkpoint, lambda members: change(members, tmp_path / "ran"))
    with pytest.raises(UavrlError, match="none of it was loaded"):
        check_archive(checkpoint)


def test_what_is_compressed_is_refused(checkpoint: Path) -> None:
    def swell(members: Members) -> None:
        members[place(members, "policy") + "/state.json"] += b" " * 20_000_000

    rewrite(checkpoint, swell, zipfile.ZIP_DEFLATED)
    with pytest.raises(UavrlError, match="members that are compressed"):
        check_archive(checkpoint)


@pytest.mark.parametrize("manifest", MANIFESTS)
def test_a_manifest_that_is_none_is_damage(manifest: bytes, run: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "checkpoint", "w") as archive:
        archive.writestr("manifest.json", manifest)
    with pytest.raises(DamagedCheckpoint, match=str(tmp_path / "checkpoint")):
        check_checkpoint(tmp_path / "checkpoint", read_config(run))


def test_a_policy_is_loaded_from_no_checkpoint_with_a_pickle(run: Path, checkpoint: Path, tmp_path: Path) -> None:
    rewrite(checkpoint, plant("policy/state", tmp_path / "ran"))
    with pytest.raises(UavrlError, match="none of it was loaded"):
        read_policy(run, str(checkpoint))
    assert not (tmp_path / "ran").exists()


def test_a_payload_does_run_where_it_is_unpickled(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Payload(tmp_path / "ran")))
    assert (tmp_path / "ran").exists()


def test_a_random_state_that_reads_beyond_its_memory_is_refused() -> None:
    state = RandomState().state_dict()
    numpy_state = list(state["numpy"])
    numpy_state[2] = 10**6
    with pytest.raises(ValueError, match="a position from 0 to 624, got 1000000"):
        RandomState().load_state_dict({**state, "numpy": tuple(numpy_state)})
    RandomState().load_state_dict(state)


@pytest.mark.parametrize(("line", "said"), FOREIGN_CONFIGS.values(), ids=FOREIGN_CONFIGS)
def test_a_configuration_works_nothing_out(
    line: str, said: str, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("A_SECRET", "the secret")
    monkeypatch.chdir(tmp_path)
    text = (run / "config.yaml").read_text().splitlines()
    kept = [each for each in text if each.partition(":")[0] != line.partition(":")[0]]
    (tmp_path / "config.yaml").write_text("\n".join([*kept, line]) + "\n")
    with pytest.raises(UavrlError) as told:
        validate(read_config(tmp_path))
    assert said in str(told.value) and "the secret" not in str(told.value)
    assert [path.name for path in tmp_path.iterdir()] == ["config.yaml"]


@pytest.mark.parametrize("target", ["uavrl.{folder}/theirs.X", "uavrl./proc/self/cwd/theirs.X"])
def test_a_source_in_the_folder_is_not_read(target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs.py").write_text("open('ran', 'w')\n\n\nclass X:\n    pass\n")
    config = composed()
    config.reward._target_ = target.format(folder=tmp_path)
    with pytest.raises(UavrlError, match="which is no name of a class"):
        validate(config)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("write", NO_FLIGHTS)
def test_flights_that_are_pickles_are_refused(write: Callable[[Path, Path], None], tmp_path: Path) -> None:
    write(tmp_path / "flights.npz", tmp_path / "ran")
    with pytest.raises(UavrlError, match="contains no episodes, or is damaged"):
        load_recording(tmp_path / "flights.npz")
    assert not (tmp_path / "ran").exists()
