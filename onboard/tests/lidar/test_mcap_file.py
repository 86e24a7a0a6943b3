"""MCAP files that end in the middle, lie about their lengths or unpack to more than any memory holds."""

from __future__ import annotations

import struct
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata
from mcap.writer import CompressionType, Writer

from uavrl_onboard.errors import UavrlError
from uavrl_onboard.lidar.mcap_file import MAGIC, McapFile, unpacked


def written(path: Path, compression: CompressionType = CompressionType.ZSTD, size: int = 100) -> Path:
    """A file of two chunks with a message each, and metadata."""
    with path.open("wb") as file:
        writer = Writer(file, size, compression)
        writer.start("ros2")
        channel = writer.register_channel("/x", "cdr", writer.register_schema("x", "ros2msg", b"int8 a"))
        for number in range(2):
            writer.add_message(channel, number, bytes([number]) * size, number)
        writer.add_metadata("last", {"a": "b"})
        writer.finish()
    return path


def kinds(path: Path) -> list[str]:
    wanted = ("Schema", "Channel", "Message", "Metadata")
    return [kind for kind in (type(record).__name__ for record in McapFile(path).records()) if kind in wanted]


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def chunk(content: bytes, size: int | None = None, compression: str = "zstd", crc: int = 0) -> bytes:
    builder = RecordBuilder()
    Chunk(compression, content, 0, 0, crc, len(content) if size is None else size).write(builder)
    return builder.end()


def metadata(name: str) -> bytes:
    builder = RecordBuilder()
    Metadata(name=name, metadata={}).write(builder)
    return builder.end()


@pytest.mark.parametrize("compression", CompressionType)
def test_all_records_come_in_their_order(compression: CompressionType, tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", compression)
    file = McapFile(path)
    messages = [data for _, _, data in file.messages(file.connections)]
    assert messages == [bytes(100), b"\1" * 100] and file.whole
    assert kinds(path)[:3] == ["Schema", "Channel", "Message"] and kinds(path).count("Metadata") == 1


def test_a_file_that_is_cut_anywhere_gives_what_came_before(tmp_path: Path) -> None:
    content, cut = written(tmp_path / "a.mcap").read_bytes(), tmp_path / "cut.mcap"
    whole, counts = kinds(tmp_path / "a.mcap"), []
    for end in range(len(content) + 1):
        cut.write_bytes(content[:end])
        counts.append(len(kinds(cut)))
        assert kinds(cut) == whole[: counts[-1]]
    assert counts == sorted(counts) and (counts[0], counts[-1]) == (0, len(whole))


FIRST = metadata("first")
LYING = {
    "a record of 2^60 bytes": record(Opcode.MESSAGE, b"", 2**60),
    "an attachment of 2^60 bytes": record(Opcode.ATTACHMENT, bytes(24) + struct.pack("<Q", 2**60)),
    "an attachment of 20 MB": record(Opcode.ATTACHMENT, bytes(24) + struct.pack("<Q", 20_000_000)),
    "a name of 4 GB": record(Opcode.METADATA, struct.pack("<I", 2**32 - 1)),
    "a mapping of 4 GB": record(Opcode.METADATA, struct.pack("<II", 0, 2**32 - 1)),
    "a chunk of 2^60 bytes": record(Opcode.CHUNK, bytes(32) + struct.pack("<Q", 2**60)),
    "a chunk of 20 MB": record(Opcode.CHUNK, bytes(32) + struct.pack("<Q", 20_000_000)),
    "a message of less than its head": record(Opcode.MESSAGE, bytes(5)),
    "a record of a private kind, without end": record(0x90, b"", 2**40),
}


@pytest.mark.parametrize("name", LYING)
def test_a_length_that_lies_takes_no_memory(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavrl_onboard.lidar.mcap_file.LARGEST", 2**20)
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + FIRST + LYING[name] + bytes(2**25))
    tracemalloc.start()
    try:
        assert kinds(path)[:1] == ["Metadata"]
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


BOMBS: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "zstd": (zstandard.compress, "zstd"),
    "zstd that does not say how much it holds": (
        lambda data: zstandard.ZstdCompressor(write_content_size=False).compress(data),
        "zstd",
    ),
    "lz4": (lz4.frame.compress, "lz4"),
}


@pytest.mark.parametrize("name", BOMBS)
@pytest.mark.parametrize("says", [1000, 2**40])
def test_a_chunk_that_unpacks_to_more_than_it_says_is_not_unpacked(name: str, says: int, tmp_path: Path) -> None:
    pack, compression = BOMBS[name]
    packed = pack(bytes(2**26))
    (tmp_path / "a.mcap").write_bytes(MAGIC + FIRST + chunk(packed, says, compression) + FIRST)
    tracemalloc.start()
    try:
        found = kinds(tmp_path / "a.mcap")
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()
    assert found == (["Metadata"] if says > 1000 else ["Metadata", "Metadata"])


def test_a_chunk_of_another_checksum_or_size_is_damaged() -> None:
    def opened(content: bytes, size: int, crc: int = 0) -> bytes:
        return unpacked(Chunk("zstd", zstandard.compress(content), 0, 0, crc, size))

    assert opened(b"seen", 4, zlib.crc32(b"seen")) == b"seen"
    for size, crc in ((4, 1), (5, 0)):
        with pytest.raises(ValueError, match="a damaged chunk"):
            opened(b"seen", size, crc)
    with pytest.raises(ValueError, match="a damaged chunk"):
        unpacked(Chunk("none of these", b"seen", 0, 0, 1, 4))


def test_a_chunk_in_a_chunk_is_not_unpacked(tmp_path: Path) -> None:
    """Each could unpack to 256 MB, and hold the next one."""
    path, content, found = tmp_path / "f.mcap", metadata("within"), []
    for _ in range(2):
        content = chunk(zstandard.compress(content), len(content))
        path.write_bytes(MAGIC + content)
        found.append([each.name for each in McapFile(path).records()])
    assert found == [["within"], []]


@pytest.mark.parametrize(
    ("module", "compression"), [("zstandard", CompressionType.ZSTD), ("lz4.frame", CompressionType.LZ4)]
)
def test_without_the_library_of_a_compression_it_is_named(
    module: str, compression: CompressionType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path: Any = written(tmp_path / "a.mcap", compression, 1000)
    monkeypatch.setitem(sys.modules, module, None)
    name = module.partition(".")[0]
    with pytest.raises(UavrlError, match=rf"A recording in MCAP needs {name}: pip install 'uavrl-onboard\[lidar\]'"):
        list(McapFile(path).records())
