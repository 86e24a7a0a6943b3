"""Ports of this machine."""

import socket


def free_ports() -> tuple[int, int]:
    """Two that nobody listens to; other tests may run at the same time."""
    kind = (socket.AF_INET, socket.SOCK_DGRAM)
    with socket.socket(*kind) as one, socket.socket(*kind) as other:
        one.bind(("127.0.0.1", 0))
        other.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]
