"""Independent ways to write and read logs: the `mcap` package, and shared real logs when present."""

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

SHARED = Path(__file__).parents[3] / "shared" / "data"
Row = tuple[int, int, int, int, bytes]  # log time, publish time, channel, sequence, payload
Rows = list[Row]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real logs and conformance vectors."""
    if not SHARED.is_dir():
        pytest.skip("../shared/data absent")
    return SHARED


@pytest.fixture(scope="session")
def oracle() -> Callable[[Path], Rows]:
    """All messages of a log as `mcap` reads them, by log time, ties in file order."""

    def read(path: Path) -> Rows:
        with path.open("rb") as file:
            found = [r for r in StreamReader(file, validate_crcs=True).records if isinstance(r, Message)]
        found.sort(key=lambda m: m.log_time)
        return [(m.log_time, m.publish_time, m.channel_id, m.sequence, m.data) for m in found]

    return read


@pytest.fixture
def make_log(tmp_path: Path) -> Callable[..., Path]:
    """Write a log with the writer of `mcap`: two channels, chunk by chunk."""

    def make(
        chunks: list[Rows],
        *,
        compression: CompressionType = CompressionType.ZSTD,
        chunked: bool = True,
        index: IndexType = IndexType.ALL,
        summary: bool = True,
        name: str = "log.mcap",
    ) -> Path:
        path = tmp_path / name
        with path.open("wb") as file:
            writer = Writer(
                file,
                chunk_size=1 << 30,
                compression=compression,
                index_types=index,
                use_chunking=chunked,
                repeat_channels=summary,
                repeat_schemas=summary,
                use_statistics=summary,
                use_summary_offsets=summary,
            )
            writer.start("ros2", "test")
            schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 x")
            writer.register_channel("/a", "cdr", schema)
            writer.register_channel("/b", "json", 0)
            writer.add_metadata("source", {"who": "test"})
            for rows in chunks:
                for log_time, publish_time, channel, sequence, data in rows:
                    writer.add_message(channel, log_time, data, publish_time, sequence)
                writer.flush()
            writer.finish()
        return path

    return make
