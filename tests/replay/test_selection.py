"""What is not asked for is not touched: chunks are chosen by their index, messages by time and topic."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import IndexType

from fuselog.replay import Log, open_log
from fuselog.replay.mcap_file.opener import Opener

CHUNKS = [[(100 * k + i, 0, 1 + (k % 2 if k > 2 else i % 2), i, bytes([k, i])) for i in range(50)] for k in range(8)]
ROWS = [row for chunk in CHUNKS for row in chunk]


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The first log time of every chunk that is opened, in order."""
    met: list[int] = []
    original = Opener.unpack

    def count(self: Opener, chunk: object) -> object:
        met.append(chunk.start_ns)
        return original(self, chunk)

    monkeypatch.setattr(Opener, "unpack", count)
    return met


def damage(path: Path, chunks: list[int]) -> None:
    """Break the payload of these chunks."""
    with open_log(path) as log:
        places = [chunk.end for chunk in log.parts[0]._contents.chunks]
    content = bytearray(path.read_bytes())
    for k in chunks:
        content[places[k] - 10 : places[k]] = bytes(10)
    path.write_bytes(content)


WINDOWS = [(None, None), (0, 1), (120, 330), (None, 120), (649, None), (150, 200), (800, 900), (330, 120)]
WINDOWS.append((-5, 2**63 - 1))


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("topics", [None, "/a", ["/b"], re.compile("/[b-z]"), ["/absent"]])
def test_a_window_gives_what_filtering_all_messages_gives(
    make_log: Callable, window: tuple[int | None, int | None], chunked: bool, topics: object
) -> None:
    start, end = window
    wanted = {None: {1, 2}, "/a": {1}, str(["/b"]): {2}, str(re.compile("/[b-z]")): {2}, str(["/absent"]): set()}
    channels = wanted[topics if topics is None or isinstance(topics, str) else str(topics)]
    with open_log(make_log(CHUNKS, chunked=chunked)) as log:
        got = [tuple(m) for m in log.messages(topics, start_ns=start, end_ns=end)]
        assert log.losses == []
    low, high = -1 if start is None else start, 2**63 if end is None else end
    assert got == [row for row in ROWS if low <= row[0] < high and row[2] in channels]


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.CHUNK])
def test_chunks_outside_of_the_window_are_not_opened(make_log: Callable, opened: list[int], index: IndexType) -> None:
    with open_log(make_log(CHUNKS, index=index)) as log:
        opened.clear()
        assert len(list(log.messages(start_ns=120, end_ns=330))) == 30 + 50 + 30
    assert opened == [100, 200, 300]


def test_chunks_without_the_topic_are_not_opened(make_log: Callable, opened: list[int]) -> None:
    with open_log(make_log(CHUNKS)) as log:
        assert len(list(log.messages("/a"))) == 3 * 25 + 2 * 50
        assert opened == [0, 100, 200, 400, 600]
        opened.clear()
        assert len(list(log.messages("/a", start_ns=300, end_ns=500))) == 50
        assert opened == [400]


def test_damage_elsewhere_is_not_met(make_log: Callable) -> None:
    path = make_log(CHUNKS)
    damage(path, [0, 3, 7])
    with open_log(path) as log:
        assert [tuple(m) for m in log.messages(start_ns=100, end_ns=300)] == [r for r in ROWS if 100 <= r[0] < 300]
        assert log.losses == []
        assert len(list(log.messages(start_ns=100, end_ns=301))) == 100
        (loss,) = log.losses
        assert (loss.messages, loss.path) == (50, str(path))


def test_a_chunk_that_tells_no_end_of_its_time_is_opened(make_log: Callable) -> None:
    path = make_log(CHUNKS, summary=False, index=IndexType.NONE)
    with open_log(path) as log:
        places = [chunk.offset for chunk in log.parts[0]._contents.chunks]
    content = bytearray(path.read_bytes())
    for place in places:
        content[place + 17 : place + 25] = bytes(8)
    path.write_bytes(content)
    with open_log(path) as log:
        assert [tuple(m) for m in log.messages(start_ns=120, end_ns=330)] == [r for r in ROWS if 120 <= r[0] < 330]


def test_a_topic_is_read_as_columns_of_a_stretch(shared: Path) -> None:
    with open_log(shared / "logs" / "rl_test1_husky.mcap") as log:
        whole = log.read("/fix", ["latitude"])
        times = np.concatenate([batch.log_time for batch in log.batches("/fix")])
        cut = log.read("/fix", ["latitude"], start_ns=int(times[10]), end_ns=int(times[20]))
        assert np.array_equal(cut["latitude"], whole["latitude"][10:20])
        assert len(log.read("/fix", ["latitude"], start_ns=0, end_ns=1)) == 0
        assert log.losses == []


def test_a_name_is_not_a_collection_of_letters(make_log: Callable) -> None:
    log: Log
    with open_log(make_log(CHUNKS)) as log:
        assert {m.channel_id for m in log.messages("/a")} == {1}
        assert {m.channel_id for m in log.messages(re.compile("a"))} == set()
