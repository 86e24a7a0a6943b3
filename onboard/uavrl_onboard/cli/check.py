"""``uavrl-check``: one look before take-off at all that a flight needs, with the keys of ``uavrl-fly``."""

from __future__ import annotations

import json
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from uavrl_onboard.cli.command import command
from uavrl_onboard.cli.fly import FlyConfig, make_guards, make_vehicle, open_feed, open_link
from uavrl_onboard.cli.help import About
from uavrl_onboard.cli.ros2_keys import ROS2
from uavrl_onboard.errors import UavrlError
from uavrl_onboard.files import replacing, writable
from uavrl_onboard.flight.check import OBSERVED, Evidence, Item, Level, Listener, Setup, everywhere, observe
from uavrl_onboard.flight.check_items import judge
from uavrl_onboard.flight.health import FlightHealth
from uavrl_onboard.flight.loop import Flight
from uavrl_onboard.flight.safety import SafetyLayer
from uavrl_onboard.guards.settings import GuardSettings
from uavrl_onboard.policy.policy import Policy
from uavrl_onboard.sentences import require

FAILED, WARNED = 1, 2  # exit codes
_SILENT = {"set_mode": False, "arm": False}

ABOUT = About(
    "uavrl-check",
    "Checks before take-off that everything is ready for a flight. It sends nothing that could move the vehicle.",
    ["policy=FOLDER model=VLP16 goal=[20,5,2.5]", "policy=FOLDER model=VLP16 goal=[20,5,2.5] json=FILE"],
    "policy goal lidar model metadata mount vehicle autopilot system signing_key_file seconds log json",
)


@command(ABOUT, FlyConfig)
def main(settings: FlyConfig) -> None:
    """Listens for some seconds, prints each item, and exits with 0 only if all pass."""
    require(settings.is_live, "lidar", "a sensor, udp://:2368 or ros2:///TOPIC, for a check", settings.lidar)
    numbers = None if settings.json is None else writable(Path(settings.json), "json=FILE")
    items = check(settings)
    counts = {level: sum(item.level is level for item in items) for level in Level}
    for item in items:
        print(f"{item.level:<5} {item.name:<14} {item.sentence}")
    if numbers is not None:
        told = {"passed": counts[Level.PASS] == len(items), "items": [item._asdict() for item in items]}
        with replacing(numbers) as partial:
            partial.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
        print(f"Written to {numbers}")
    print(_verdict(counts), flush=True)
    if counts[Level.FAIL] or counts[Level.WARN]:
        sys.exit(FAILED if counts[Level.FAIL] else WARNED)


def check(settings: FlyConfig) -> list[Item]:
    """Return the items of a check; of a policy that cannot be read there is only that one."""
    try:
        policy = Policy(str(settings.policy))
        policy.fly_with(make_vehicle(settings, policy))
    except UavrlError as error:
        return [Item("policy", Level.FAIL, str(error))]
    print(f"Listening for {OBSERVED:g} s …", flush=True)
    with ExitStack() as opened:
        link = opened.enter_context(closing(open_link(settings, **_SILENT)))
        feed = opened.enter_context(closing(open_feed(settings, link)))
        return [_of_policy(policy), *judge(_observed(settings, policy, link, feed))]


def _observed(settings: FlyConfig, policy: Policy, link: Any, feed: Any) -> Evidence:
    """What came of a flight into nothing."""
    assert settings.goal is not None
    guards, stamped = make_guards(settings, policy), settings.lidar.startswith(ROS2)
    sights = _sights(guards.settings, policy)
    setup = Setup(
        policy.contract,
        settings.goal,
        settings.safety,
        make_vehicle(settings, policy),
        feed,
        stamped,
        None if settings.autopilot is None else link,
        sights,
        uses_motion=bool(sights) or bool(guards.guards),
        log=None if settings.log is None else Path(settings.log),
        seconds=settings.seconds,
    )
    listener, layer = Listener(link), SafetyLayer(everywhere(settings.safety))
    moves = settings.autopilot is not None
    more: dict[str, Any] = {"radius": settings.radius, "guards": guards, "moves": moves}
    more |= {"rotation": settings.rotation, "box": settings.box}
    flight = Flight(policy, settings.goal, listener, layer, **more)
    remarks = {"stamped": stamped, "remarks": feed.remarks}
    health = FlightHealth(feed.trouble, 1.0 / flight.period, settings.safety.pose_age, **remarks)
    evidence = Evidence(setup, flight, health)
    observe(evidence, listener)
    return evidence


def _sights(guards: GuardSettings, policy: Policy) -> dict[str, float]:
    """How far guards and policy look, m, where that is farther than the policy's cells."""
    motion = policy.contract.motion
    found: dict[str, Any] = {
        "the map": guards.map and guards.map.sight,
        "evasion": guards.evasion and guards.evasion.sight,
    }
    found["the policy's motion detection"] = motion and motion.max_range
    return {name: sight for name, sight in found.items() if sight}


def _of_policy(policy: Policy) -> Item:
    """A policy that could be read is whole: its hash is the contract's, and the contract holds together."""
    contract, network = policy.contract, policy.contract.network
    assert network is not None
    cells = f"{contract.cells.count} cells of {contract.cells.reduction} up to {contract.cells.radius:g} m"
    checked = f"The network's hash is that of the contract ({network.sha256[:12]}…), and the contract holds together"
    return Item("policy", Level.PASS, f"{checked}: {cells}, {contract.rate_hz:g} actions per second.")


def _verdict(counts: dict[Level, int]) -> str:
    told = [f"{counts[Level.PASS]} pass"]
    told += [f"{counts[Level.WARN]} warn"] if counts[Level.WARN] else []
    told += [f"{counts[Level.FAIL]} fail"] if counts[Level.FAIL] else []
    if counts[Level.FAIL]:
        return f"{', '.join(told)}: do not take off."
    return (
        f"{', '.join(told)}: {'take off once you can explain each warning.' if counts[Level.WARN] else 'all is there.'}"
    )


if __name__ == "__main__":
    main()
