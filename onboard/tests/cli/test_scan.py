"""``uavrl-scan``: numbers, page and JSON of a recording, and what a user may get wrong."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from onboard.tests.lidar.test_senders import capture
from tests.helpers.captures import KINDS
from tests.helpers.commands import in_process
from tests.helpers.packets import RECORDED, turns
from tests.helpers.pages import Page, unpack
from tests.helpers.recordings import CLOUD, cloud_message, store, write_bag

from uavrl_onboard.cli import scan
from uavrl_onboard.lidar.scans import Scan
from uavrl_onboard.lidar.sources import ScanSource, read_bare
from uavrl_onboard.lidar.summary import SECTORS, ScanSummary
from uavrl_onboard.lidar.vlp16 import firing_directions
from uavrl_onboard.pages.assembly import filled
from uavrl_onboard.pages.scan_page import scan_page_data
from uavrl_onboard.perception.cells import Statistic
from uavrl_onboard.perception.reductions import REDUCTIONS, STATISTICS, Reduction


def test_a_recording_is_told_in_numbers_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, facts = tmp_path / "page.html", tmp_path / "facts.json"
    assert in_process(scan.main, f"source={RECORDED}", "model=VLP16", f"output={page}", f"json={facts}") == 0
    out, err = capsys.readouterr()
    assert "2 scans at 9.91 Hz, 15,530 points each (median), 46.8 % misses" in out and err == ""
    assert "\n  ahead            0.50 m\n" in out and f"Written to {page}" in out
    told = json.loads(facts.read_text(encoding="utf-8"))
    assert (told["scans"], told["points_median"], told["nearest_m"]) == (2, 15529.5, 0.5)
    assert told["rate_hz"] == pytest.approx(9.915, abs=0.001) and told["misses"] == pytest.approx(0.4679, abs=1e-4)
    assert set(told["nearest_by_direction"]) <= set(SECTORS) and not any(told["skipped"].values())
    drawn = json.loads(Page(page.read_text(encoding="utf-8")).scripts["data"])
    assert drawn["cells"] == "32 faces" and len(drawn["scans"]) == 2


def test_points_on_the_vehicle_are_left_out(tmp_path: Path) -> None:
    facts = tmp_path / "facts.json"
    box = "vehicle=[-0.6,-0.6,-0.5,0.6,0.6,0.3]"
    arguments = (f"source={RECORDED}", "model=VLP16", "output=null", f"json={facts}")
    assert in_process(scan.main, *arguments, box) == 0
    told = json.loads(facts.read_text(encoding="utf-8"))
    assert told["nearest_m"] > 0.6 and told["points_median"] < 15000
    assert told["misses"] == pytest.approx(0.4679, abs=1e-4), "what is masked was no miss"
    assert not (tmp_path / "scan.html").exists()


def test_a_flight_log_is_not_turned_once_more(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    types = store(False)
    points = np.array([[3.0, 0.0, 0.0], [0.0, 2.0, 0.0]], np.float32)
    for topic, code in (("/uavrl/points", 1), ("/points", 0)):
        bag = write_bag(
            tmp_path / topic[1:].replace("/", "_"), "mcap", {topic: (CLOUD, [cloud_message(types, points)])}
        )
        assert in_process(scan.main, f"source={bag}", "output=null", "mount=[0,0,90]") == code
    assert "mount must be left out for a flight log, whose points are in the vehicle's axes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("mount", "open_side"),
    [
        ("[0,0,0]", "behind right"),
        ("[0,0,180]", "ahead left"),
        ("[180,0,0]", "behind left"),
        ("[0,0,90]", "ahead right"),
    ],
)
def test_directions_are_the_vehicles_of_a_lidar_that_is_mounted_otherwise(
    mount: str, open_side: str, tmp_path: Path
) -> None:
    facts = tmp_path / "facts.json"
    arguments = (f"source={RECORDED}", "model=VLP16", "output=null", f"json={facts}", f"mount={mount}")
    assert in_process(scan.main, *arguments) == 0
    nearest = json.loads(facts.read_text(encoding="utf-8"))["nearest_by_direction"]
    assert [side for side, near in nearest.items() if near > 1.0] == [open_side]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([f"source={RECORDED}", "model=VLP16", "mount=[0,0]"], "mount must be roll, pitch and yaw in degrees, for"),
        ([f"source={RECORDED}", "model=VLP16", "mount=[3.1416,0,0]"], "3.1416 looks like radians"),
        (["model=VLP16"], "source must be a file, a rosbag's folder or udp://:PORT, got None"),
        (["source=none.bin", "model=VLP16"], "There is no none.bin: give udp://:PORT, a capture (.pcap), "),
        ([f"source={RECORDED}"], "model must be one of VLP16"),
        ([f"source={RECORDED}", "model=VLP32C"], "a VLP32C has 40: name the model that sent them"),
        ([f"source={RECORDED}", "model=VLP16", "vehicle=[1,2,3]"], "vehicle must be six numbers"),
        ([f"source={RECORDED}", "model=VLP16", "vehicle=[1,0,0,0,1,1]"], "vehicle must be six numbers"),
        ([f"source={RECORDED}", "model=VLP16", "radius=0"], "radius must be in [0.1, 1000], got 0"),
        ([f"source={RECORDED}", "model=VLP16", "reduction=cube"], "reduction must be one of truncated_icosahedron"),
        ([f"source={RECORDED}", "model=VLP16", "json=scan.html"], "json must be another file than output"),
        ([f"source={RECORDED}", "modle=VLP16"], "did you mean model?"),
        (["source=udp://:99999", "model=VLP16"], "An address is udp://:PORT or udp://HOST:PORT"),
        (["source=udp://127.0.0.1:23681", "model=VLP16", "seconds=0.01"], "no packet arrived"),
    ],
)
def test_mistakes_are_one_sentence(
    arguments: list[str], said: str, refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused(scan.main, *arguments)
    assert not (tmp_path / "scan.html").exists()


@pytest.mark.parametrize("key", ["json", "output"])
@pytest.mark.parametrize("kind", ["bin", "rosbag2"])
def test_a_recording_is_never_replaced(kind: str, key: str, refused: Callable[..., str], tmp_path: Path) -> None:
    path = KINDS[kind](tmp_path)
    inside = path if path.is_file() else path / "metadata.yaml"
    (tmp_path / "link").symlink_to(inside)
    before = inside.read_bytes()
    other = "json" if key == "output" else "output"
    for written in (inside, tmp_path / "link"):
        said = refused(scan.main, f"source={path}", "model=VLP16", f"{other}=null", f"{key}={written}")
        assert f"{key} must be another file than the source, which it would replace, got" in said
    assert inside.read_bytes() == before


def test_ctrl_c_while_listening_loses_nothing_that_came(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(count: int) -> Callable[..., Iterator[tuple[float, bytes, str]]]:
        def read(*_: object, port: int) -> Iterator[tuple[float, bytes, str]]:
            assert port == 2368
            yield from [(*each, "192.168.1.201:2368") for each in read_bare(RECORDED)][:count]
            raise KeyboardInterrupt

        return read

    facts = tmp_path / "facts.json"
    arguments = ("source=udp://:2368", "model=VLP16", "output=null", f"json={facts}")
    monkeypatch.setattr("uavrl_onboard.lidar.sources.read_udp", interrupted(100))
    assert in_process(scan.main, *arguments) == 130
    assert json.loads(facts.read_text(encoding="utf-8"))["scans"] == 1
    assert capsys.readouterr().err == "uavrl: stopped: the numbers are those of the scans that came until then.\n"
    facts.unlink()
    monkeypatch.setattr("uavrl_onboard.lidar.sources.read_udp", interrupted(10))
    assert in_process(scan.main, *arguments) == 130
    assert capsys.readouterr().err == "uavrl: stopped.\n" and not facts.exists()


def test_what_was_left_out_is_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = RECORDED.read_bytes()
    damaged = tmp_path / "a.bin"
    damaged.write_bytes(content[: 1206 * 20] + content[1206 * 25 :] + b"half")
    assert in_process(scan.main, f"source={damaged}", "model=VLP16", "output=null") == 0
    _, err = capsys.readouterr()
    assert "uavrl: left out: 5 packets that never arrived\n" in err
    assert "uavrl: left out: 1 packet of another size than a data packet's\n" in err


def test_without_plotly_the_numbers_come_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    assert in_process(scan.main, f"source={RECORDED}", "model=VLP16", f"output={tmp_path / 'a.html'}") == 0
    out, err = capsys.readouterr()
    assert "2 scans" in out and "No page was drawn: A page needs plotly" in err and not list(tmp_path.iterdir())


@pytest.mark.parametrize("reduction", ["truncated_icosahedron", "range_image"])
def test_the_page_shows_what_the_reduction_makes_of_the_scan(reduction: Reduction) -> None:
    summary = ScanSummary()
    for each in ScanSource(RECORDED, "VLP16"):
        summary.add(each)
    statistic: Statistic = STATISTICS[reduction]
    data = scan_page_data(summary, "</script><script>alert(1)</script>", reduction, statistic, 4.0)
    for shown, each in zip(data["scans"], summary.kept, strict=True):
        np.testing.assert_array_equal(unpack(shown["cells"]), REDUCTIONS[reduction](each.points, 4.0, statistic))
        points = unpack(shown["points"]).reshape(-1, 3)
        assert len(points) == 6000
        nearest = np.abs(each.points[None] - points[:20, None]).max(-1).min(1)
        assert nearest.max() <= shown["points"]["scale"]
    page = Page(filled("scan.html", ("flight.css", "flight_charts.js", "drawing.js", "scan.js"), data))
    assert json.loads(page.scripts["data"])["source"] == data["source"] and len(page.scripts) == 4
    assert all(address.startswith("data:") for address in page.fetched)


def test_a_long_source_keeps_few_scans_spread_over_it() -> None:
    summary = ScanSummary(keep=4)
    for n in range(100):
        summary.add(Scan(0.1 * n, np.full((1, 3), n + 1.0, np.float32), 2, 1))
    kept = [round(10 * each.stamp) for each in summary.kept]
    assert 2 <= len(kept) <= 4 and kept[0] == 0 and len(set(np.diff(kept))) == 1 and kept[-1] >= 50
    assert summary.facts()["rate_hz"] == pytest.approx(10) and summary.facts()["misses"] == 0.5


def test_directions_lie_where_they_are_called() -> None:
    summary = ScanSummary()
    around = np.radians(45.0 * np.arange(8))
    far = 2.0 + np.arange(8)
    points = np.stack([far * np.cos(around), far * np.sin(around), np.zeros(8)], -1).astype(np.float32)
    summary.add(Scan(0.0, points, 8, 0))
    assert list(summary.sectors()) == list(SECTORS) and list(summary.sectors().values()) == pytest.approx(far, abs=1e-3)
    nothing = ScanSummary()
    nothing.add(Scan(0.0, np.full((5, 3), np.nan, np.float32), 5, 5))
    assert nothing.facts()["nearest_m"] is None and nothing.facts()["misses"] == 1.0 and nothing.sectors() == {}


def test_what_a_recording_does_not_see_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A driver's window of x > 0, a cloud without a point, and packets without a return."""
    types = store()
    seen = 3.0 * firing_directions()[::8].astype(np.float32)
    clouds = {"half": seen[seen[:, 0] > 0], "empty": seen[:0]}
    said = {
        "half": "No return has ever come from 90° to 270° (0° is ahead, 90° left): does the driver's window cut",
        "empty": "10 scans in a row hold no return at all: is the sensor covered",
    }
    for name, points in clouds.items():
        messages = [cloud_message(types, points, 5.0 + 0.1 * n) for n in range(25)]
        path = write_bag(tmp_path / name, "db3", {"/a": (CLOUD, messages)})
        assert in_process(scan.main, f"source={path}", "output=null") == 0
        assert capsys.readouterr().err.count(f"uavrl: {said[name]}") == 1
    nothing = tmp_path / "nothing.bin"
    nothing.write_bytes(b"".join(turns(2, distance=0.0)))
    assert in_process(scan.main, f"source={nothing}", "model=VLP16", "output=null") == 0
    assert "uavrl: No scan holds a return: is the sensor covered" in capsys.readouterr().err


def test_two_senders_and_stamps_that_do_not_run_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = capture(tmp_path / "a.pcap", bytes([192, 168, 1, 202]), 2368)
    assert in_process(scan.main, f"source={path}", "model=VLP16", "output=null") == 0
    out, err = capsys.readouterr()
    assert "3 scans at " in out and "28,928" in out.replace("29,184", "28,928") and "2.00 m" in out
    assert "Two senders: only 192.168.1.201:2368 is read, and the packets of 192.168.1.202:2368 are left out." in err
    types = store()
    messages = [cloud_message(types, np.ones((100, 3), np.float32)) for _ in range(11)]
    path = write_bag(tmp_path / "b", "db3", {"/a": (CLOUD, messages)})
    assert in_process(scan.main, f"source={path}", "output=null") == 0
    out, err = capsys.readouterr()
    assert "11 scans at 10.00 Hz" in out and "11 stamps of the recording are 0" in err
