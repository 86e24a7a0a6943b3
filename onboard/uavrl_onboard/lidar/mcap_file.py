"""MCAP files as far as they go: one whose writer was killed ends in the middle, without the index of its end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.libraries import needed

WHAT = "A recording in MCAP"
MAGIC = b"\x89MCAP0\r\n"
LARGEST = 2**28  # bytes of a record, and of a chunk when it is unpacked


class Channel(NamedTuple):
    """A topic of a file, as `rosbags` describes it."""

    topic: str
    msgtype: str


class McapFile:
    """Reads the records of a file in their order; what is damaged or not there any more ends it.

    Args:
        path: the file.

    Attributes:
        whole: whether the last reading came to the file's own end.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.whole = path, False
        self._kinds = needed("mcap.records", WHAT)
        self._opcodes = needed("mcap.opcode", WHAT).Opcode

    def records(self) -> Iterator[Any]:
        """The library's records, those in chunks, too: schemas, channels, messages, metadata and attachments."""
        self.whole = False
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) == MAGIC:
                try:
                    yield from self._records(file)
                except UavrlError:
                    raise
                except Exception:  # what the library and its decompressors meet in damaged bytes is of many kinds
                    return

    def _records(self, file: BinaryIO, *, in_chunk: bool = False) -> Iterator[Any]:
        codes, kinds = self._opcodes, self._kinds
        read = {
            codes.SCHEMA: kinds.Schema.read,
            codes.CHANNEL: kinds.Channel.read,
            codes.METADATA: kinds.Metadata.read,
            codes.ATTACHMENT: kinds.Attachment.read,
        }
        stream = needed("mcap.data_stream", WHAT).ReadDataStream
        while head := file.read(9):
            opcode, length = struct.unpack("<BQ", head)
            if length > LARGEST:
                raise ValueError(f"a record of {length} bytes")
            body = file.read(length)
            if len(body) < length:
                raise EOFError
            if opcode == codes.MESSAGE:
                yield kinds.Message.read(stream(BytesIO(body)), length)
            elif opcode == codes.CHUNK:
                if in_chunk:  # a few kilobytes could unpack to more than any memory holds
                    raise ValueError("a chunk in a chunk")
                content = unpacked(kinds.Chunk.read(stream(BytesIO(body))))
                yield from self._records(BytesIO(content), in_chunk=True)
            elif opcode == codes.DATA_END:
                self.whole = True
                return
            elif opcode in read:
                yield read[opcode](stream(BytesIO(body)))

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
    """What is in a chunk, and no more of it than the chunk says."""
    size = chunk.uncompressed_size
    if size > LARGEST:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        decompressor = needed("zstandard", WHAT).ZstdDecompressor()
        data: bytes = decompressor.stream_reader(chunk.data).read(size)
    elif chunk.compression == "lz4":
        data = needed("lz4.frame", WHAT).LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    else:
        data = chunk.data
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a damaged chunk")
    return data
