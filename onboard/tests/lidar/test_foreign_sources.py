"""What is no source, or a damaged one, gives a sentence; nothing in it is executed."""

from __future__ import annotations

import gzip
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.captures import KINDS, PACKETS, captured, recorded

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.sources import ScanSource


def foreign_files(folder: Path) -> dict[str, tuple[Path, str]]:
    def file(name: str, content: bytes) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    rng, capture = np.random.default_rng(0), captured(folder).read_bytes()
    whole = recorded("ros1")(folder).read_bytes()
    (folder / "folder").mkdir()
    (folder / "rosbag2").mkdir()
    (folder / "rosbag2/metadata.yaml").write_text("rosbag2_bagfile_information: !!python/object/apply:os.system [ls]")
    return {
        "missing": (folder / "none.bin", "There is no"),
        "empty": (file("empty.pcap", b""), "is empty"),
        "random": (file("random.bin", rng.bytes(5000)), "is of no known kind"),
        "pickle": (file("a.pkl", pickle.dumps({"a": 1})), "is of no known kind"),
        "gzip": (file("a.gz", gzip.compress(capture)), "is of no known kind"),
        "folder": (folder / "folder", "without metadata.yaml"),
        "yaml": (folder / "rosbag2", "is no recording of ROS, or is damaged"),
        "half a packet": (file("half.bin", PACKETS[0][:500]), "1 packet of another size"),
        "flag alone": (file("flag.bin", b"\xff\xee"), "gave no scan"),
        "capture of nothing": (file("nothing.pcap", capture[:24]), "too few packets for one turn"),
        "capture's beginning": (file("begin.pcap", capture[:10]), "too few packets"),
        "capture, then noise": (file("noise.pcap", capture[:24] + rng.bytes(3000)), "too few packets"),
        "pcapng, then noise": (file("noise.pcapng", b"\x0a\x0d\x0d\x0a" + rng.bytes(3000)), "too few packets"),
        "half a rosbag1": (file("half.bag", whole[: len(whole) // 2]), "is no recording of ROS, or is damaged"),
        "a rosbag1's name": (file("name.bag", b"#ROSBAG V2.0\n" + rng.bytes(900)), "is no recording of ROS"),
        "sqlite's name": (file("a.db3", b"SQLite format 3\0" + rng.bytes(3000)), "is no recording of ROS"),
        "mcap's name": (file("a.mcap", b"\x89MCAP0\r\n" + rng.bytes(3000)), "is no recording of ROS"),
    }


def test_what_is_no_source_gives_one_sentence(tmp_path: Path) -> None:
    for name, (path, said) in foreign_files(tmp_path).items():
        with pytest.raises(UavrlError) as caught:
            list(ScanSource(path, "VLP16"))
        assert said in str(caught.value), name
        assert str(path) in str(caught.value) and "\n" not in str(caught.value), name


def test_a_damaged_recording_gives_what_is_whole_or_a_sentence(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    for kind in ("rosbag1", "rosbag2", "mcap", "pcap", "pcapng"):
        (tmp_path / kind).mkdir()
        whole = KINDS[kind](tmp_path / kind)
        path = whole if whole.is_file() else next(p for p in whole.iterdir() if p.suffix in (".db3", ".mcap"))
        content = np.frombuffer(path.read_bytes(), np.uint8)
        for _ in range(12):
            damaged = content.copy()
            damaged[rng.integers(0, len(damaged), 60)] = rng.integers(0, 256, 60)
            (tmp_path / path.name).write_bytes(damaged.tobytes()[: rng.integers(1000, len(damaged) + 1)])
            try:
                scans = list(ScanSource(tmp_path / path.name, "VLP16"))
                assert all(np.isfinite(scan.points).all() for scan in scans)
            except UavrlError as error:
                assert "\n" not in str(error)


def test_what_a_file_says_of_its_types_is_never_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rosbags.typesys import store as typestore

    path = recorded("mcap")(tmp_path)
    list(ScanSource(path, "VLP16"))
    compiled: list[str] = []
    monkeypatch.setattr(typestore, "exec", lambda code, *_: compiled.append(code), raising=False)
    assert len(list(ScanSource(path, "VLP16"))) == 3
    assert compiled == []


def test_without_rosbags_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = recorded("db3")(tmp_path)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(UavrlError, match=r"^A recording of ROS needs rosbags: pip install 'uavrl-onboard\[lidar\]'\.$"):
        ScanSource(path, "VLP16")
