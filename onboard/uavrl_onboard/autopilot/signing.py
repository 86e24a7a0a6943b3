"""MAVLink's signatures: keys, and which messages bear one (https://mavlink.io/en/guide/message_signing.html)."""

from __future__ import annotations

import logging
import string
import time
from pathlib import Path
from typing import Any

from uavrl_onboard.errors import UavrlError

KEY = 32  # bytes of a key
INVALID = "Invalid signature"  # pymavlink's reason for a message that it refuses
_LINK = 191  # number of our stream of signatures, of one that no other sender of the system has
_EPOCH = 1_420_070_400  # s from 1970 to 2015, where times in signatures begin
_UNITS = 100_000  # of those times in a second
_SIGNED = 1  # MAVLINK_IFLAG_SIGNED


def read_key(path: str | Path) -> bytes:
    """Read a key: a file of 32 bytes, or of 64 hexadecimal digits.

    Raises:
        UavrlError: for a file that cannot be read, or holds something else.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "key"
        >>> _ = file.write_text("6b" * 32)
        >>> read_key(file) == b"k" * 32
        True
    """
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise UavrlError(f"{path} cannot be read ({error.strerror}): give the file with the signing key.") from error
    text = content.decode("ascii", "replace").strip()
    if len(content) == KEY:
        return content
    if len(text) == 2 * KEY and set(text) <= set(string.hexdigits):
        return bytes.fromhex(text)
    raise UavrlError(
        f"{path} holds {len(content)} bytes and is no signing key: a key file has 32 bytes, or 64 hexadecimal digits. "
        "For the key of a passphrase, write the passphrase's SHA-256 to a file."
    )


def start_signing(link: Any, key: bytes) -> None:
    """Let a ``MAVLink`` of pymavlink sign what it sends, and refuse what is not signed with the key."""
    link.signing.secret_key, link.signing.sign_outgoing, link.signing.link_id = key, True, _LINK
    keep_time(link)
    logging.getLogger(type(link).__module__).setLevel(logging.WARNING)  # it tells of each stream and each old message


def keep_time(link: Any) -> None:
    """Move the time in a link's signatures on, which never goes back."""
    link.signing.timestamp = max(int((time.time() - _EPOCH) * _UNITS), link.signing.timestamp)


def is_signed(message: Any) -> bool:
    """Return whether a message that came bears a signature, right or wrong."""
    packed = message.get_msgbuf() or b""
    return len(packed) > 2 and packed[0] == 0xFD and bool(packed[2] & _SIGNED)
