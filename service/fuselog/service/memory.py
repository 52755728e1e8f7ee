"""What the allocator does with memory that is given back."""

import ctypes
from contextlib import suppress

_MMAP_THRESHOLD, _TRIM_THRESHOLD = -3, -1  # of glibc's mallopt


def keep_freed_memory() -> None:
    """Let freed memory be used again instead of going back to the system, which would have to clear it anew.

    Arrays of a batch are some MB each, and the next batch wants the same: page faults are a tenth of the time of
    ``reprocess``. For a process that does one thing; where the C library has no ``mallopt``, nothing changes.
    """
    with suppress(AttributeError, OSError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, 32 << 20)
        mallopt(_TRIM_THRESHOLD, 256 << 20)
