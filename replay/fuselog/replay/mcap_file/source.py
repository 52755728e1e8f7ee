"""Where the bytes of a log lie: a mapped file, or one that grows; `remote` has those of servers."""

import os
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fuselog.replay.mcap_file.mapped import map_file
from fuselog.schemas.errors import LogError


class Source(Protocol):
    """The bytes of one file. Reading raises LogError when they cannot be had, or after `close`."""

    @property
    def path(self) -> str:
        """The name under which it was opened."""
        ...

    @property
    def size(self) -> int:
        """Its length in bytes, as it was when it was opened."""
        ...

    def read(self, begin: int, end: int) -> NDArray[np.uint8]:
        """The bytes of [begin, end), read-only; fewer where that reaches out of the file."""
        ...

    def fetch(self, begin: int, end: int) -> None:
        """Told before [begin, end) is read, for who can get it meanwhile."""
        ...

    def read_all(self) -> NDArray[np.uint8]:
        """All bytes, for who must walk through the whole file."""
        ...

    def close(self) -> None:
        """Let go of the file; bytes that were handed out stay valid."""
        ...


class MappedFile:
    """A file of this machine, mapped: what is read is a view. Raises LogError if there is nothing to map."""

    def __init__(self, path: str) -> None:
        self._path = path
        data = map_file(path)
        self._size = len(data)
        self._data: NDArray[np.uint8] | None = data

    @property
    def path(self) -> str:
        """The name under which it was opened."""
        return self._path

    @property
    def size(self) -> int:
        """Its length in bytes."""
        return self._size

    def read(self, begin: int, end: int) -> NDArray[np.uint8]:
        """A view of the bytes of [begin, end)."""
        return self.read_all()[max(begin, 0) : max(end, 0)]

    def fetch(self, begin: int, end: int) -> None:
        """Nothing: the bytes are here."""

    def read_all(self) -> NDArray[np.uint8]:
        """A view of the file."""
        if self._data is None:
            raise LogError(self._path, 0, "the log is closed")
        return self._data

    def close(self) -> None:
        """Drop the mapping, which lives on in the views of it."""
        self._data = None


class GrowingFile:
    """The bytes of a file that gets longer, as a `Source`; ``size`` is that of the last `look`."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.size = 0
        try:
            self._file = open(path, "rb", buffering=0)  # noqa: SIM115  closed by `close`
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise LogError(path, 0, getattr(error, "strerror", None) or str(error)) from error

    def look(self) -> int:
        """The size now. Raises LogError when the file has become shorter."""
        size = os.fstat(self._descriptor()).st_size
        if size < self.size:
            raise LogError(self.path, size, "the file became shorter while it was followed")
        self.size = size
        return size

    def read(self, begin: int, end: int) -> NDArray[np.uint8]:
        """The bytes of [begin, end) that are there."""
        parts: list[bytes] = []
        while begin < end and (part := os.pread(self._descriptor(), end - begin, begin)):
            parts.append(part)
            begin += len(part)
        return np.frombuffer(b"".join(parts), np.uint8)

    def fetch(self, begin: int, end: int) -> None:
        """Nothing: the bytes are here."""

    def read_all(self) -> NDArray[np.uint8]:
        """All bytes so far."""
        return self.read(0, self.look())

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _descriptor(self) -> int:
        if self._file.closed:
            raise LogError(self.path, 0, "the log is closed")
        return self._file.fileno()
