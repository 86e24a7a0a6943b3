"""One page that plays flights back in three dimensions and needs no network."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from uavrl.envs.terrain import HeightField
from uavrl.evaluation.interventions import intervention_texts
from uavrl.evaluation.recording import RecordedFlight, Recording, Scenery, thinned
from uavrl.evaluation.smoothness import smoothness_texts
from uavrl.viewer.colours import ENDED, GOAL, KINDS, LED, OTHER_KIND, OUTCOMES, PLANE, SEEN
from uavrl_onboard.files import replacing
from uavrl_onboard.pages.assembly import filled, pack
from uavrl_onboard.pages.shapes import BODY, Shell, football, shell, vehicle

PARTS = ("flight.css", "flight_charts.js", "drawing.js", "flight_log.js", "flight.js")
POINT_BYTES = 5_000_000  # for all scans of a page, before base64 makes four characters of three bytes


def page_data(recording: Recording) -> dict[str, Any]:
    """The content of the page, as JSON."""
    scans = sum(len(flight.times) for flight in recording.flights)
    most = max(POINT_BYTES // (6 * max(scans, 1)), 20)
    place = next(iter(recording.sceneries.values()), None)
    shape = football(4.0) if place is None else shell(place.directions, place.ball)
    return {
        **drawn_parts(shape),
        "source": recording.source,
        "sceneries": {str(seed): _scenery(scenery) for seed, scenery in recording.sceneries.items()},
        "flights": [_flight(flight, most) for flight in recording.flights],
    }


def drawn_parts(shape: Shell) -> dict[str, Any]:
    """What every page draws: the vehicle, the cells around it, and the colours."""
    return {
        "colours": {**OUTCOMES, "ended": ENDED, "body": BODY, "plane": PLANE, "goal": GOAL, "seen": SEEN, "led": LED},
        "vehicle": [
            {"vertices": pack(mesh.vertices), "triangles": pack(mesh.faces), "colour": colour}
            for mesh, colour in vehicle()
        ],
        "ball": {name: pack(value) for name, value in shape._asdict().items()},
    }


def packed_points(clouds: list[np.ndarray], most: int) -> dict[str, Any]:
    """At most ``most`` points ``[M, 3]`` of each scan, and where each scan ends."""
    clouds = [thinned(cloud, most) for cloud in clouds]
    points = np.concatenate(clouds)
    farthest = float(np.abs(points).max(initial=1e-3))
    ends = pack(np.cumsum([len(cloud) for cloud in clouds]))
    return {"points": pack(points, scale=farthest / 32767), "point_ends": ends}


def above_ground(scenery: Scenery) -> dict[str, np.ndarray]:
    """Returns ``vertices``, ``triangles`` and ``kinds`` of the parts of obstacles that are visible inside the valley.

    Triangles under the ground or beyond the valley's edge are left out; corners that stick through it are put on it.
    """
    if not scenery.heights.size:  # the obstacles hold the ground
        return {"vertices": scenery.vertices, "triangles": scenery.triangles, "kinds": scenery.kinds}
    size = (float(scenery.size[0]), float(scenery.size[1]))
    inside = (np.abs(scenery.vertices[:, :2]) < scenery.size / 2).all(1)
    xy = np.clip(scenery.vertices[:, :2], -scenery.size / 2, scenery.size / 2)
    ground = HeightField(scenery.heights, size).at(xy)
    shown = (inside & (scenery.vertices[:, 2] > ground))[scenery.triangles].any(1)
    vertices = np.column_stack([xy, np.maximum(scenery.vertices[:, 2], ground)])
    return {"vertices": vertices, "triangles": scenery.triangles[shown], "kinds": scenery.kinds[shown]}


def _scenery(scenery: Scenery) -> dict[str, Any]:
    values = {field.name: getattr(scenery, field.name) for field in fields(scenery)} | above_ground(scenery)
    data = {name: pack(value) if isinstance(value, np.ndarray) else value for name, value in values.items()}
    if not scenery.heights.size:
        del data["heights"]
        x, y = (scenery.size / 2 + 1.0).tolist()
        z = scenery.vertices[:, 2]
        top = max(float(scenery.goal[1]), float(z.max(initial=0.0)))
        data["box"] = [[-x, x], [-y, y], [min(-2.0, float(z.min(initial=0.0))), top + 1.0]]
    return {**data, "kind_colours": [KINDS.get(kind, OTHER_KIND) for kind in scenery.kind_names]}


def _flight(flight: RecordedFlight, most: int) -> dict[str, Any]:
    values = {field.name: getattr(flight, field.name) for field in fields(flight)}
    data = {name: pack(value) for name, value in values.items() if isinstance(value, np.ndarray)}
    shown = ("task", "world_seed", "outcome", "steps", "path_efficiency", "clearance")
    return {
        **data,
        "observations": None,  # the page shows the scans instead
        **packed_points([flight.cloud(moment) for moment in range(len(flight.times))], most),
        "reward_names": list(flight.reward_names),
        **{name: getattr(flight.summary, name) for name in shown},
        "position_stats": flight.position_stats,
        "smoothness": {
            **smoothness_texts(flight.summary.action_change, flight.summary.yaw_reversals),
            **intervention_texts(flight.summary.guard_share, flight.summary.guard_change),
        },
    }


def make_page(recording: Recording) -> str:
    """The page, with its data, its programs and plotly's inside."""
    return filled("flight.html", PARTS, page_data(recording), package=__name__)


def write_page(recording: Recording, output: Path) -> None:
    """Writes the page of some flights."""
    write_data(page_data(recording), output)


def write_data(data: dict[str, Any], output: Path) -> None:
    """Writes the page of what :func:`page_data` gives, or a log."""
    text = filled("flight.html", PARTS, data, package=__name__)
    with replacing(output) as partial:
        partial.write_text(text, encoding="utf-8")
