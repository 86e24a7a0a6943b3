"""Domains of DDS: our configuration and the user's, and who is left in them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from tests.helpers.ros2_peer import LOOPBACK, until

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.ros_messages import TWIST
from uavrl_onboard.ros2.dds import Node, idl_type
from uavrl_onboard.ros2.domain import enter, leave

pytest.importorskip("cyclonedds", reason="needs cyclonedds, which has no wheel for this machine")

DOMAIN = 201  # above those of the other tests
ON_LOOPBACK = LOOPBACK.replace("<Compatibility><IgnoreTypeInformation>1.16</IgnoreTypeInformation></Compatibility>", "")
QUIET = "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General></Domain></CycloneDDS>"
OTHER_VENDOR = "<Domain><Compatibility><IgnoreTypeInformation>1.1</IgnoreTypeInformation></Compatibility></Domain>"


def settings(uri: str, trace: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """What Cyclone DDS says that it was configured with."""
    tell = f"<Tracing><Category>config</Category><OutputFile>{trace}</OutputFile></Tracing>"
    monkeypatch.setenv("CYCLONEDDS_URI", ",".join(each for each in (uri, f"<Domain>{tell}</Domain>") if each))
    participant = enter(DOMAIN)
    del participant
    leave(DOMAIN)
    lines = [line.partition("config: ")[2] for line in trace.read_text().splitlines()]
    told = (line.removesuffix("}").partition("/#text: ") for line in lines)
    return {name.removeprefix("Domain/"): value.partition(" {")[0] for name, _, value in told}


def test_fast_dds_s_type_information_is_ignored_beside_what_the_user_sets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "cyclonedds.xml"
    file.write_text(f'<?xml version="1.0" encoding="UTF-8" ?>\n{QUIET}')
    ignored, multicast = "Compatibility/IgnoreTypeInformation", "General/AllowMulticast"
    for number, (uri, expected) in enumerate(
        [
            ("", ("1.15", "default")),
            (QUIET, ("1.15", "false")),
            (f"file://{file}", ("1.15", "false")),
            (f"{file},{OTHER_VENDOR}", ("1.1", "false")),
            (f"{OTHER_VENDOR},file://{file}", ("1.1", "false")),
        ]
    ):
        read = settings(uri, tmp_path / f"trace{number}", monkeypatch)
        assert (read[ignored], read[multicast]) == expected, uri


def test_a_configuration_that_cannot_be_read_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for uri in ("file:///nowhere/cyclonedds.xml", "<Domain><Nothing>1</Nothing></Domain>", "file:///home/jürgen/a.xml"):
        monkeypatch.setenv("CYCLONEDDS_URI", uri)
        with pytest.raises(UavrlError, match=r"domain 201 of ROS 2 cannot be entered .*does CYCLONEDDS_URI fit it\?"):
            Node(DOMAIN)
    monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
    with closing(Node(DOMAIN)):
        pass


def test_who_else_is_in_the_domain_stays_there(monkeypatch: pytest.MonkeyPatch) -> None:
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
    ours, another = Node(DOMAIN), Node(DOMAIN)
    theirs = DomainParticipant(DOMAIN)  # of a program that uses us as a library
    ours.close()
    reader = DataReader(theirs, Topic(theirs, "rt/cmd_vel", idl_type(TWIST)))
    another.writes("/cmd_vel", TWIST)
    until(lambda: another.listeners("/cmd_vel"), "a match")
    another.close()
    assert theirs.guid and reader.take(1) == []
