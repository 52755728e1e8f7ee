"""A file of any content as bytes in memory, without reading it."""

import mmap
import os
import stat

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.errors import LogError


def map_file(path: str) -> NDArray[np.uint8]:
    """The bytes of the file, mapped; LogError if there is none, or no bytes in it.

    A pipe without a writer is refused like any other thing that is no file; it is not waited for.
    """
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise LogError(path, 0, "not a file")
            if os.fstat(file.fileno()).st_size == 0:
                raise LogError(path, 0, "the file is empty")
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise LogError(path, 0, getattr(error, "strerror", None) or str(error)) from error
    return np.frombuffer(mapped, np.uint8)


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)
