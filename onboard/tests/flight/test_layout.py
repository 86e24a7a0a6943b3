"""The layout for Foxglove names topics, fields and frames that a flight log really has."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.helpers.logged import write_log

LAYOUT = json.loads((Path(__file__).resolve().parents[3] / "docs/foxglove_layout.json").read_text())
PATH = re.compile(r"(?P<topic>/[\w/]+)(?P<fields>(\.\w+)*)")
PANELS = {"3D", "Plot", "RosOut", "RawMessages", "StateTransitions"}


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """The messages of each topic of a log."""
    path, _ = write_log(tmp_path_factory.mktemp("log") / "flight.mcap")
    types, found = get_typestore(Stores.ROS2_HUMBLE), dict[str, list[Any]]()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if schema.name not in types.types:  # ours: a viewer reads the definition in the file, too
                types.register(get_types_from_msg(schema.data.decode(), schema.name))
            found.setdefault(channel.topic, []).append(types.deserialize_cdr(message.data, schema.name))
    return found


def paths() -> Iterator[str]:
    """All message paths that the layout names."""
    for config in LAYOUT["configById"].values():
        yield from (each["value"] for each in config.get("paths", []))
        yield from config.get("topics", {})
        yield from (config[key] for key in ("topicPath", "topicToRender") if key in config)


def panels(layout: Any) -> Iterator[str]:
    """The panels in the tree of the layout."""
    if isinstance(layout, str):
        yield layout
    else:
        yield from (*panels(layout["first"]), *panels(layout["second"]))


@pytest.mark.parametrize("path", sorted(set(paths())))
def test_a_path_is_in_a_log(path: str, logged: dict[str, list[Any]]) -> None:
    match = PATH.fullmatch(path)
    assert match is not None, path
    value = logged[match["topic"]][0]
    for name in match["fields"].split(".")[1:]:
        value = getattr(value, name)
    assert value is not None


def test_frames_and_colours_are_in_a_log(logged: dict[str, list[Any]]) -> None:
    scene = LAYOUT["configById"]["3D!flight"]
    told = {(each.header.frame_id, each.child_frame_id) for message in logged["/tf"] for each in message.transforms}
    frames = {name for pair in told for name in pair}
    named = {scene["followTf"], *(layer["frameId"] for layer in scene["layers"].values())}
    assert named | {key.removeprefix("frame:") for key in scene["transforms"]} <= frames
    fields = {field.name for field in logged["/uavrl/points"][0].fields}
    assert scene["topics"]["/uavrl/points"]["colorField"] in fields


def test_each_panel_is_shown_once() -> None:
    shown = list(panels(LAYOUT["layout"]))
    assert sorted(shown) == sorted(LAYOUT["configById"]) and len(shown) == len(set(shown))
    assert {name.partition("!")[0] for name in shown} <= PANELS
