"""Domains of DDS, entered so that nodes on ROS 2's default middleware are heard without an environment variable."""

from __future__ import annotations

import os
import threading
from typing import Any

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.libraries import needed

FAST_DDS = "1.15"  # eProsima's vendor number
_SETTINGS = (
    "<CycloneDDS><Domain><Compatibility>"
    f"<IgnoreTypeInformation>{FAST_DDS}</IgnoreTypeInformation>"
    "</Compatibility></Domain></CycloneDDS>"
)

_entered: dict[int, Any] = {}
_changes = threading.Lock()


def cyclonedds(module: str) -> Any:
    """Import a module of `cyclonedds`.

    Raises:
        UavrlError: where it is not installed.
    """
    otherwise = (
        ". On Linux for ARM, where it has no wheel, install Cyclone DDS, set CYCLONEDDS_HOME, and run pip install "
        "cyclonedds"
    )
    return needed(f"cyclonedds.{module}", "ROS 2", "ros2", otherwise)


def configuration(users: str) -> str:
    """Our settings for Cyclone DDS followed by the user's, which win where both set the same element.

    Fast DDS announces type information that Cyclone DDS cannot look up, and readers and writers then do not match. The
    settings ignore it, so types match by their names, as between nodes of ROS 2.

    Args:
        users: the content of ``CYCLONEDDS_URI``: XML, a file, or several of them separated by commas; or nothing.

    Examples:
        >>> configuration("file:///etc/cyclonedds.xml").endswith("</CycloneDDS>,file:///etc/cyclonedds.xml")
        True
    """
    return ",".join(each for each in (_SETTINGS, users.strip()) if each)


def enter(domain: int) -> Any:
    """Return a new participant in a domain, which is configured by `configuration` if nobody has entered it yet.

    A domain that this process has entered before without us, by `cyclonedds` itself, keeps its own configuration.

    Raises:
        UavrlError: where cyclonedds is missing, or the domain cannot be entered.
    """
    core, domains = cyclonedds("core"), cyclonedds("domain")
    users = os.environ.get("CYCLONEDDS_URI", "")
    try:
        with _changes:
            if domain not in _entered:
                try:
                    _entered[domain] = domains.Domain(domain, configuration(users))
                except core.DDSException as error:
                    if error.code != core.DDSException.DDS_RETCODE_PRECONDITION_NOT_MET:  # it exists already
                        raise
            return domains.DomainParticipant(domain)
    except (core.DDSException, UnicodeEncodeError) as error:
        reason = error.msg if isinstance(error, core.DDSException) else "CYCLONEDDS_URI may hold ASCII characters only"
        leave(domain)
        raise UavrlError(
            f"The domain {domain} of ROS 2 cannot be entered ({reason}): is there a network, and does "
            "CYCLONEDDS_URI fit it?"
        ) from error


def leave(domain: int) -> None:
    """Give up a domain that `enter` configured, if no participant of this process is left in it."""
    with _changes:
        if domain in _entered and not _entered[domain].get_participants():
            del _entered[domain]
