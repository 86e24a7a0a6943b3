"""Sweeps of the commands that write files: no job replaces what another one has written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.commands import in_process
from uavrl.cli import command, evaluate, replay, report


@pytest.mark.parametrize(
    ("main", "words", "name"),
    [
        (report.main, ["window=20,30", "output=deep/r.html"], "output=deep/r.html"),
        (report.main, ["window=20,30"], "output=report.html"),
        (report.main, ["window=20,30", "output=a.html,b.html", "json=facts.json"], "json=facts.json"),
        (evaluate.main, ["policy=vfh,straight", "output=o.json"], "output=o.json"),
        (replay.main, ["policy=best", "task=1,2", "data=flight.npz"], "data=flight.npz"),
    ],
)
def test_a_file_that_all_jobs_would_write_is_refused(
    main: object, words: list[str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert in_process(main, "-m", *words) == 1  # type: ignore[arg-type]
    told = capsys.readouterr().err
    assert told.startswith(f"uavrl: Each job of the sweep would replace the {name} of the one before: let it differ")
    key, _, file = name.partition("=")
    assert f"{key}='{Path(file).with_name('${hydra:job.num}_' + Path(file).name)}'." in told


@pytest.mark.parametrize("value", ["a.html,b.html", "${window}.html", "${hydra:job.num}.html", "choice(a.html,b.html)"])
def test_files_that_differ_are_not(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["uavrl-report", "-m", "window=20,30", f"output={value}"])
    command._refuse_shared_files("report")
    monkeypatch.setattr("sys.argv", ["uavrl-report", "window=20", "output=r.html"])
    command._refuse_shared_files("report")
    for words in (["policy=a,b", "output=null"], ["policy=a", "suite=[static],[dense]", "output=results"]):
        monkeypatch.setattr("sys.argv", ["uavrl-evaluate", "-m", *words])
        command._refuse_shared_files("evaluate")
