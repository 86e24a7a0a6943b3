from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import pytest
from plotly.offline import get_plotlyjs

from tests.helpers.commands import in_process
from tests.helpers.folders import POSITION_STATS, evaluation, run_folder
from uavrl.cli.report import main
from uavrl.config.command_line import override
from uavrl.reporting.page import page
from uavrl.reporting.report import make_report

VOID = {"meta", "input", "br", "link", "img", "hr"}


class Reader(HTMLParser):
    """Collects text and attributes, and checks that every element that is opened is closed in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.parts: list[str] = []
        self.fetched: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.feed(html)
        self.close()
        assert not self.open
        self.text = " ".join(" ".join(self.parts).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {key: value or "" for key, value in attrs}
        if tag == "a":
            self.links.append(values.pop("href"))
        self.fetched += [values[key] for key in ("src", "href", "srcset", "data", "action") if key in values]
        self.fetched += re.findall(r"url\([^)]*\)", values.get("style", ""))
        self.ids += [values["id"]] if "id" in values else []
        self.open += [tag] if tag not in VOID else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "style":
            assert "url(" not in data and "@import" not in data
        elif self.open and self.open[-1] != "script":
            self.parts.append(data)


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    for seed in (0, 1):
        evaluation(run_folder(tmp_path / f"runs/td3_{seed}", "ccaa", seed=seed), 8, 10)
    run_folder(tmp_path / "runs/plus", "caac", {"reward": "navigation", "backward_reward": "abr_plus"})
    (run_folder(tmp_path / "runs/bad", "ca") / "episodes.csv").unlink()
    return tmp_path / "runs"


def test_the_page_holds_together_and_fetches_nothing(runs: Path) -> None:
    html = page(make_report([runs], window=2))
    reader = Reader(html)
    assert reader.fetched == []
    assert all(link.startswith("#") and link[1:] in reader.ids for link in reader.links)
    assert len(reader.ids) == len(set(reader.ids))
    assert html.count(get_plotlyjs()[:2000]) == 1
    assert "default-src 'none'" in html


def test_the_page_says_what_the_facts_say(runs: Path) -> None:
    html = page(make_report([runs], window=2, title="Mine & yours"))
    text = Reader(html).text
    for expected in (
        "Mine & yours",
        "TD3 + ABR⁺, Eq. 3.6 One seed: the spread between seeds is unknown. 50.0 %",
        "1 folder left out",
        "episodes.csv is missing",
        "Steps to 78 %",
        "82.4 %",
        "4 episodes, not 5,000",
        "TD3, prize 80.0 % 58.4–91.9 2 (0, 1) 20 80.0–80.0",  # 16 of 20: z² = 3.841459
        "80.0 % 49.0–94.3",
        "version not recorded",
        "“Unlike the thesis” compares the reward's name, LifeGuard's model and the number of episodes, and no other",
        "algo:",
    ):
        assert expected in text, expected
    best, second = text.index("TD3, prize 100.0 %"), text.index("TD3 + ABR⁺, Eq. 3.6 One seed")
    assert best < second < text.index("Learning curves"), "the answer comes first, and the best group"
    compared = html[html.index('id="thesis"') : html.index('id="settings"')]
    rows = re.findall(r'<tr><td class="l">(\w+)</td><td class="l">([^<]+)</td>', compared)
    assert set(rows) == {("td3", "ABR⁺")}, "of the thesis only the rows of the runs"


def test_the_success_rate_comes_right_after_the_group_which_a_phone_shows(runs: Path) -> None:
    text = page(make_report([runs]))
    heads = re.findall(r"<thead><tr><th>Group</th><th[^>]*>([^<]*)</th>", text)
    assert heads[:2] == ["Success in training", "Success"]
    first = re.search(r'<td class="l">.*?</td>(<td class="n">[\d.]+ %<span class="ci">)', text, re.DOTALL)
    assert first is not None


def test_what_is_not_there_is_not_shown(tmp_path: Path) -> None:
    """Twelve episodes make no curve in steps of fifty, and the thesis has no row with this reward."""
    run_folder(tmp_path / "short", "ccaccaccacca")
    reader = Reader(html := page(make_report([tmp_path / "short"])))
    assert "Too short to draw: TD3, prize. A curve begins at episode 50, a tenth of the window" in reader.text
    assert "No run of this report has the learner and the reward of one of the thesis's rows." in reader.text
    assert "Thesis: success" not in reader.text
    assert "plot-steps-success" not in reader.ids and 'class="switch"' not in html
    assert "plot-steps-success" in Reader(page(make_report([tmp_path / "short"], window=10))).ids
    run_folder(tmp_path / "long", "ca" * 30, {"reward": "navigation"})
    reader = Reader(page(make_report([tmp_path])))
    assert "Too short to draw: TD3, prize." in reader.text and "plot-steps-success" in reader.ids


def test_names_from_files_cannot_write_html(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script><img src=x>"
    folder = run_folder(tmp_path / "<b>run", "ca", {"reward": evil})
    run_folder(tmp_path / "other", "ca")
    evaluation(folder, 1, 2, env=evil, valleys=evil)
    html = page(make_report([tmp_path], window=2, title=evil))
    assert "<script>alert" not in html and "<img src=x" not in html and "<b>run" not in html
    assert Reader(html).fetched == []


def test_evaluations_with_missing_or_strange_values_and_with_positions(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", "ca")
    evaluation(folder, 1, 2, env=None, valleys=[3], path_efficiency="x", median_clearance=None, training_steps=None)
    content = json.loads((folder / "evaluation.json").read_text())
    del content["steps_per_arrival"], content["valleys"]
    (folder / "evaluation_2.json").write_text(json.dumps(content))
    html = page(make_report([tmp_path], window=2))
    assert "evaluation_2.json" in html and "Positions: altitude" not in html
    evaluation(folder, 1, 2, "evaluation_valleys=7.json", valleys=[7], position_stats=POSITION_STATS)
    text = Reader(page(make_report([tmp_path], window=2))).text
    row = "evaluation_valleys=7.json 2.0 / 3.5 / 4.9 1.1 / 6.2 / 13.3 12.5 % 25.0 % 50.0 % 12.5 %"
    assert row in text[text.index("Positions: altitude") :] and "Smoothness" not in text
    evaluation(folder, 1, 2, "evaluation_valleys=8.json", action_change=[0.21, 0.05, 0.02, 0.4], yaw_reversals=0.06)
    evaluation(folder, 1, 2, "evaluation_env=other.json", env="other", action_change=[0.1, 0.2])
    text = Reader(page(make_report([tmp_path], window=2))).text
    row = "evaluation_valleys=8.json 0.21 / 0.05 / 0.02 m/s, 0.40 rad/s 6.0 %"
    assert row in text[text.index("Smoothness:") :] and "evaluation_env=other.json 0.10 / 0.20 –" in text


def test_more_groups_than_colours(tmp_path: Path) -> None:
    for i in range(9):
        run_folder(tmp_path / f"run{i}", "ca", algo__gamma=0.9 + i / 100)
    Reader(page(make_report([tmp_path], window=2)))


@pytest.fixture
def report(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    def run(runs: object, **values: object) -> tuple[int, str, str]:
        code = in_process(main, *(override(key, value) for key, value in {"runs": runs, **values}.items()))
        return code, *capsys.readouterr()

    return run


def test_the_command_writes_page_and_facts(
    runs: Path, tmp_path: Path, report: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = report(runs, window=2)
    assert code == 0
    told = out.splitlines()[-1]
    assert told == "Open report.html in a browser; report.json holds the facts."
    *_, where, first, second, _ = out.splitlines()
    assert where == "In evaluation in static, valleys 0, 10 tasks of seed 20000:"
    assert first == "  TD3, prize  Success rate: 80.0 % (95 % CI 58.4–91.9 %, 20 tasks)"
    assert second == "  Not evaluated there: TD3 + ABR⁺, Eq. 3.6"
    assert "uavrl: bad is left out. episodes.csv is missing" in err
    assert json.loads((tmp_path / "report.json").read_text())["window"] == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "report.json", "runs"]
    assert report(runs, output="deep/a.html", json="deep/b.json")[0] == 0
    assert sorted(p.name for p in (tmp_path / "deep").iterdir()) == ["a.html", "b.json"]
    monkeypatch.chdir(runs)
    one, *_ = sorted(path.name for path in runs.iterdir() if path.name != "bad")
    for chosen in (f"{one[:-1]}?", [one]):
        assert report(chosen, output="one.html")[0] == 0
        assert one in json.loads((runs / "one.json").read_text())["runs"][0]["name"]


@pytest.mark.parametrize(
    ("outcomes", "said"),
    [
        (("c" * 8, "c" * 7 + "a"), "No group is ahead: the intervals overlap."),
        (("c" * 20, "a" * 20), "TD3, TR is ahead of all other groups: its interval lies above theirs."),
    ],
)
def test_a_group_is_ahead_only_where_the_intervals_are_apart(
    outcomes: tuple[str, str], said: str, tmp_path: Path, report: Callable[..., tuple[int, str, str]]
) -> None:
    for name, flown, reward in zip("ab", outcomes, ("navigation", "traditional"), strict=True):
        run_folder(tmp_path / "runs" / name, flown, {"reward": reward})
    code, out, _ = report(tmp_path / "runs", output=str(tmp_path / "report.html"))
    assert code == 0 and said in out and "In the last training episodes, with exploration noise:" in out
    assert f"<p>{said}</p>" in (tmp_path / "report.html").read_text()


def test_the_command_ends_in_one_sentence(
    runs: Path, tmp_path: Path, report: Callable[..., tuple[int, str, str]]
) -> None:
    output = tmp_path / "page.html"
    folder = "{} cannot be written (it is a folder): choose another with {}=FILE."
    for values, expected in (
        ({"runs": tmp_path / "nowhere"}, "There is nothing to report"),
        ({"runs": tmp_path / "nowhere*"}, "There is nothing to report"),
        ({"threshold": 78}, "threshold must be in (0, 1], got 78"),
        ({"window": 0}, "window must be at least 1, got 0"),
        ({"json": output}, "json must be another file than output"),
        ({"json": runs}, "cannot be written"),
        ({"json": Path()}, folder.format(".", "json")),
        *(({"output": Path(path)}, folder.format(path, "output")) for path in (".", "/", "..")),
    ):
        code, _, err = report(**{"runs": runs, "output": output, **values})
        assert code == 1 and expected in err.splitlines()[-1] and "Traceback" not in err
        assert not output.exists()


@pytest.mark.parametrize("package", ["plotly", "jinja2"])
def test_a_missing_package_is_told(
    package: str, runs: Path, report: Callable[..., tuple[int, str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == package] + [package]:
        monkeypatch.setitem(sys.modules, name, None)
    code, _, err = report(runs)
    assert code == 1 and f"needs {package}" in err and "pip install 'uavrl[report]'" in err
