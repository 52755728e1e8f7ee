"""Checkpoints of filters on disk: one file for each, replaced as a whole."""

import os
from contextlib import suppress
from pathlib import Path

_SUFFIX = ".checkpoint"
_LARGEST = 256 << 20  # bytes that are read of one


def write_checkpoint(folder: Path, id: str, data: bytes) -> None:
    """Put a checkpoint in the place of the one before; a crash leaves one of the two. Raises ``OSError``."""
    folder.mkdir(parents=True, exist_ok=True)
    fresh = folder / f".{id}.new"
    with fresh.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(folder / f"{id}{_SUFFIX}")


def read_checkpoint(folder: Path, id: str) -> bytes | None:
    """The checkpoint of a filter, None where there is none."""
    try:
        with (folder / f"{id}{_SUFFIX}").open("rb") as file:
            return file.read(_LARGEST)
    except FileNotFoundError:
        return None
    except OSError as error:
        return str(error).encode()  # no checkpoint begins like that: refused with the others that are none


def remove_checkpoint(folder: Path, id: str) -> None:
    """Forget the checkpoint of a filter."""
    with suppress(OSError):  # it can be tried again
        (folder / f"{id}{_SUFFIX}").unlink(missing_ok=True)
