"""Arrays put aside on disk, the last ones taken back first: what a pass leaves for the one that goes the other way."""

import os
import pickle
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from numpy.typing import NDArray

from fuselog.schemas import FuselogError

Array = NDArray[Any]


class SpillError(FuselogError):
    """The folder for what does not fit into memory cannot be written."""

    def __init__(self, folder: Path, error: OSError) -> None:
        reason = error.strerror or str(error)
        super().__init__(f"{folder}: cannot keep what smoothing puts aside ({reason}); choose a folder with --spill")


class Stack:
    """A file without a name that holds lists of arrays, and shrinks as they are taken. Raises ``SpillError``.

    It is in ``folder``, by default the system's for temporary files, and gone with the process, whatever ends that.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder or Path(tempfile.gettempdir())
        self._places: list[int] = []  # where each list begins
        try:
            self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115  closed with the stack
        except OSError as error:
            raise SpillError(self._folder, error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return len(self._places)

    def push(self, arrays: list[Array]) -> None:
        """Put a list aside."""
        try:
            self._places.append(self._file.seek(0, os.SEEK_END))
            pickle.dump(arrays, self._file, protocol=5)
        except OSError as error:
            raise SpillError(self._folder, error) from error

    def pop(self) -> list[Array]:
        """Take back the list that was put aside last."""
        start = self._places.pop()
        try:
            self._file.seek(start)
            arrays = pickle.load(self._file)  # nobody else can have written to a file without a name
            self._file.truncate(start)
        except OSError as error:
            raise SpillError(self._folder, error) from error
        return arrays
