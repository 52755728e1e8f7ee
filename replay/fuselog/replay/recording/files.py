"""The files of a recording: their names, who may write them, and one of them from its claim to its summary."""

import fcntl
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from fuselog.replay.log.channels import Channel
from fuselog.replay.mcap_file.writer import LogWriter
from fuselog.replay.recording.options import BOUNDS, RecordOptions
from fuselog.schemas import Messages
from fuselog.schemas.errors import FuselogError, LogError


class RecordingError(FuselogError):
    """A file that a recording must not, or cannot, begin."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: {reason}")
        self.path = path
        self.reason = reason


class Names:
    """The names of the files: ``path`` itself, or numbered NAME_0.mcap, NAME_1.mcap, ...

    Raises ``RecordingError`` when there is such a file already, unless numbering is to go on from it.
    """

    def __init__(self, path: Path, *, numbered: bool, resume: bool) -> None:
        self._path, self._numbered, self._resume = path, numbered, resume
        there = sorted(_numbers(path)) if numbered else []
        if there and not resume:
            raise taken(self._name(there[0]))
        self._next = there[-1] + 1 if there else 0

    def next(self) -> Path:
        """The name of the next file."""
        while self._resume and self._name(self._next).exists():
            self._next += 1
        self._next += 1
        return self._name(self._next - 1)

    def _name(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.stem}_{number}{self._path.suffix}") if self._numbered else self._path


def _numbers(path: Path) -> Iterable[int]:
    for found in path.parent.glob(f"{_literal(path.stem)}_*{_literal(path.suffix)}"):
        number = found.name[len(path.stem) + 1 : len(found.name) - len(path.suffix)]
        if number.isascii() and number.isdigit():
            yield int(number)


def _literal(text: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in text)


def claim(path: Path) -> int:
    """Make the file, which must not exist, and lock it -> its descriptor. Raises ``RecordingError``."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    except FileExistsError as error:
        raise taken(path) from error
    except OSError as error:
        raise RecordingError(path, error.strerror or str(error)) from error
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


def taken(path: Path) -> RecordingError:
    """The error for a file that is there; it says whether somebody is writing it now."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return RecordingError(path, "another recording is writing it")
    except OSError:
        pass
    return RecordingError(path, "exists already; a recording overwrites nothing")


class Part:
    """One file. What ``flush`` has returned for stays readable whatever happens to the process."""

    def __init__(self, path: Path, options: RecordOptions, channels: Iterable[Channel]) -> None:
        self.path = path
        self.first_ns: int | None = None  # log time of its first message
        self.size = 0  # bytes that are safe
        bounds = BOUNDS[options.durability]
        self._sync = bounds.sync
        self._descriptor = claim(path)
        compression = "" if options.compression == "none" else options.compression
        try:
            self._writer = LogWriter(path, compression=compression, chunk_bytes=bounds.bytes)
        except LogError:
            path.unlink()
            os.close(self._descriptor)
            raise
        try:
            for channel in channels:
                self.declare(channel)
            self.flush()
            if self._sync:
                _sync_folder(path)
        except LogError:
            self.cut()
            path.unlink()
            raise

    def declare(self, channel: Channel) -> None:
        """Declare the next channel; they have the same numbers in all files."""
        self._writer.add_channel(
            channel.topic,
            channel.schema.name,
            channel.schema.encoding,
            channel.schema.data,
            encoding=channel.encoding,
            metadata=channel.metadata,
        )

    def write(self, messages: Messages) -> None:
        """Append messages, which may stay in memory until ``flush``."""
        if self.first_ns is None:
            self.first_ns = int(messages.log_time[0])
        self._writer.write(messages)

    def flush(self) -> None:
        """Make all safe that was written."""
        self._writer.flush(sync=self._sync)
        self.size = self._writer.size

    def close(self, about: dict[str, str]) -> None:
        """Write ``about`` and the summary, and let go of the file; without room for them it ends at what was safe."""
        try:
            self._writer.add_metadata("fuselog.recording", about)
            self._writer.close()
            if self._sync:
                os.fsync(self._descriptor)
            self.size = os.fstat(self._descriptor).st_size
        except (LogError, OSError):
            self.cut()
            raise
        os.close(self._descriptor)

    def cut(self) -> None:
        """Let go of a file that cannot be written any more, at the end of what was safe."""
        with suppress(LogError):
            self._writer.close()
        with suppress(OSError):
            os.ftruncate(self._descriptor, self.size)
        os.close(self._descriptor)


def _sync_folder(path: Path) -> None:
    """So that the file has its name after a power cut too."""
    try:
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        raise LogError(str(path.parent), 0, error.strerror or str(error)) from error
