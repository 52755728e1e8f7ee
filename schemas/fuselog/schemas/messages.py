"""Raw messages and decoded columns: the two shapes in which data enter fuselog."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.shown import Shown, clock


class Fault(IntEnum):
    """Why a message gave no usable row; ``NONE`` is a good one."""

    NONE = 0
    SIZE = 1  # payload truncated, or a length in it that points outside
    SCHEMA = 2  # payload of another encoding or shape than its schema says


@dataclass(frozen=True, slots=True, kw_only=True)
class Messages:
    """n raw messages of any streams, in arrival order, left where they lie in one buffer.

    ``data[start[i] : start[i] + length[i]]`` is the payload of message i. Times are ns.
    """

    stream: NDArray[np.int32]  # (n,) the reader's number of the channel
    data: NDArray[np.uint8]  # (bytes,)
    start: NDArray[np.int64]  # (n,)
    length: NDArray[np.int64]  # (n,)
    log_time: NDArray[np.int64]  # (n,) when it was received
    publish_time: NDArray[np.int64]  # (n,)
    sequence: NDArray[np.int64]  # (n,) as the publisher counted, 0 if it did not

    def __len__(self) -> int:
        return len(self.stream)

    def take(self, key: slice | NDArray[np.int64]) -> "Messages":
        """Some of the messages, over the same payload bytes."""
        return Messages(
            stream=self.stream[key],
            data=self.data,
            start=self.start[key],
            length=self.length[key],
            log_time=self.log_time[key],
            publish_time=self.publish_time[key],
            sequence=self.sequence[key],
        )


def pack(payloads: Sequence[bytes]) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.int64]]:
    """``data``, ``start`` and ``length`` of `Messages`: the payloads one after another, in read-only memory."""
    length = np.fromiter(map(len, payloads), np.int64, len(payloads))
    return np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length


@dataclass(frozen=True, slots=True, kw_only=True)
class Ragged:
    """n lists in one: message i holds ``values[offsets[i] : offsets[i + 1]]``, in the type of the schema."""

    values: NDArray[np.generic] | list[str]  # (total,)
    offsets: NDArray[np.int64]  # (n + 1,)

    def __len__(self) -> int:
        return len(self.offsets) - 1


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Columns:
    """n messages of one channel as columns: ``values[:, k]`` holds the field ``paths[k]``.

    A message that could not be decoded is a row with its ``fault``; its values are NaN and its stamp 0.
    """

    t_ns: NDArray[np.int64]  # (n,) the stamp field, exact; 0 when no stamp path was asked for
    values: NDArray[np.float64]  # (n, width)
    paths: tuple[str, ...]  # (width,)
    fault: NDArray[np.uint8]  # (n,) of Fault
    texts: dict[str, list[str]]  # string fields that were asked for
    lists: dict[str, Ragged] = field(default_factory=dict[str, Ragged])  # and those asked for as lists

    def __len__(self) -> int:
        return len(self.t_ns)

    def __getitem__(self, path: str) -> NDArray[np.float64]:
        """The column ``path`` (n,), a view."""
        return self.values[:, self.paths.index(path)]

    def __repr__(self) -> str:
        return self._shown().text()

    def _repr_html_(self) -> str:
        return self._shown().html()

    def _shown(self) -> Shown:
        n = len(self)
        when = f", from {clock(int(self.t_ns[0]))} to {clock(int(self.t_ns[-1]))}" if n else ""
        faults = int(np.count_nonzero(self.fault))
        bad = f", {faults} of them not decodable" if faults else ""
        ends = [0, -1] if n else []
        rows = [[path, *(f"{self.values[i, k]:.6g}" for i in ends)] for k, path in enumerate(self.paths)]
        rows += [[path, *(texts[i] for i in ends)] for path, texts in self.texts.items()]
        rows += [[path, f"{len(lists.values)} in lists", ""] for path, lists in self.lists.items()]
        head = ["column", "first", "last"]
        return Shown(f"Columns: {n} messages{bad}{when}", head, [row + [""] * (3 - len(row)) for row in rows])


def empty_rows(n: int, width: int) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.uint8]]:
    """Unwritten ``t_ns``, ``values`` and ``fault`` of `Columns`."""
    return np.empty(n, np.int64), np.empty((n, width)), np.empty(n, np.uint8)
