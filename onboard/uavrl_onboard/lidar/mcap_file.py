"""MCAP files as far as they go: one whose writer was killed ends in the middle, without the index of its end."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.files import RecordFile
from uavrl_onboard.libraries import needed

WHAT = "A recording in MCAP"
MAGIC = b"\x89MCAP0\r\n"
LARGEST = 2**28  # bytes of a record, and of a chunk when it is unpacked


class Channel(NamedTuple):
    """A topic of a file, as `rosbags` describes it."""

    topic: str
    msgtype: str


class McapFile:
    """Reads the records of a file in their order, and ends where the file is damaged or cut off.

    Args:
        path: the file.
        extra: of `uavrl-onboard`, which installs the library.

    Attributes:
        whole: whether the last reading reached the file's own end.
    """

    def __init__(self, path: Path, extra: str = "lidar") -> None:
        self.path, self.whole = path, False
        self._kinds = needed("mcap.records", WHAT, extra)
        self._reader = needed("mcap.stream_reader", WHAT, extra).StreamReader

    def records(self) -> Iterator[Any]:
        """Yield the library's records, also those in chunks: schemas, channels, messages, metadata, attachments."""
        self.whole = False
        with self.path.open("rb") as file:
            try:
                for record in self._records(file):
                    if isinstance(record, self._kinds.DataEnd):
                        self.whole = True
                        return
                    if isinstance(record, self._kinds.Chunk):
                        yield from self._records_in(record)
                    else:
                        yield record
            except UavrlError:
                raise
            except Exception:  # the library and its decompressors meet errors of many kinds in damaged bytes
                return

    def _records(self, file: BinaryIO, **options: bool) -> Iterator[Any]:
        """Yield the records of a file, chunks as they are: the library unpacks them to any size."""
        bounded = RecordFile(file, LARGEST)
        for record in self._reader(bounded, emit_chunks=True, record_size_limit=LARGEST, **options).records:
            bounded.next_record()
            yield record

    def _records_in(self, chunk: Any) -> Iterator[Any]:
        with suppress(EOFError):  # the library reads on to a footer, which a chunk does not have
            for record in self._records(BytesIO(unpacked(chunk)), skip_magic=True):
                if isinstance(record, self._kinds.Chunk):  # a few kilobytes could unpack to more than any memory holds
                    raise ValueError("a chunk in a chunk")
                yield record

    # What `uavrl_onboard.lidar.bags` asks of a reader.

    @property
    def connections(self) -> list[Channel]:
        """The topics whose messages are of ROS 2."""
        return list({channel: None for channel, _, _ in self._messages()})

    def messages(self, connections: Iterable[Channel]) -> Iterator[tuple[Channel, int, bytes]]:
        """The messages of some topics.

        Raises:
            EOFError: at the end, where the file is not whole.
        """
        asked = set(connections)
        yield from (found for found in self._messages() if found[0] in asked)
        if not self.whole:
            raise EOFError(f"{self.path} ends in the middle")

    def _messages(self) -> Iterator[tuple[Channel, int, bytes]]:
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        for record in self.records():
            if isinstance(record, self._kinds.Schema):
                schemas[record.id] = record.name
            elif isinstance(record, self._kinds.Channel) and record.message_encoding == "cdr":
                channels[record.id] = Channel(record.topic, schemas.get(record.schema_id, ""))
            elif isinstance(record, self._kinds.Message) and record.channel_id in channels:
                yield channels[record.channel_id], record.log_time, record.data


def unpacked(chunk: Any) -> bytes:
    """Return the content of a chunk, and no more of it than the chunk says.

    The library's own function unpacks as much as the compressed data holds, which may be more than any memory.
    """
    size = chunk.uncompressed_size
    if size > LARGEST:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        decompressor = needed("zstandard", WHAT, "lidar").ZstdDecompressor()
        data: bytes = decompressor.stream_reader(chunk.data).read(size)
    elif chunk.compression == "lz4":
        data = needed("lz4.frame", WHAT, "lidar").LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    else:
        data = chunk.data
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a damaged chunk")
    return data
