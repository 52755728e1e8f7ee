"""What a recording may be told: how often it is safe, how it is cut, and what it keeps."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

Compression = Literal["lz4", "zstd", "none"]
Durability = Literal["none", "flush", "fsync"]


class Bounds(NamedTuple):
    """How much may be in memory only: bytes of messages, and seconds since the first of them."""

    bytes: int
    seconds: float
    sync: bool  # to the disk itself, not only to the system


# Half of the second that is promised is left for the way to the disk.
BOUNDS: dict[Durability, Bounds] = {
    "none": Bounds(4 << 20, float("inf"), False),
    "flush": Bounds(256 << 10, 0.5, False),
    "fsync": Bounds(256 << 10, 0.5, True),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordOptions:
    """How to record.

    ``durability``: "flush" hands all to the system within 1 s or 256 KiB, so that a killed process loses no more;
    "fsync" takes it to the disk, so that a power cut does not either; "none" waits for 4 MiB.
    """

    compression: Compression = "lz4"
    durability: Durability = "flush"
    max_bytes: int | None = None  # of messages in a file, as compressed; a larger single message has its own
    max_ns: int | None = None  # of log time in a file
    snapshot_ns: int | None = None  # keep so much in memory, and write it only when asked
    snapshot_bytes: int = 256 << 20  # of memory for it
    latched: tuple[str, ...] = ("/tf_static",)  # topics said once and true ever after: repeated in every file
    resume: bool = False  # number files on from those that are there, rather than refuse

    @property
    def numbered(self) -> bool:
        """Whether there may be several files: NAME_0.mcap, NAME_1.mcap, ..."""
        return self.resume or any(cut is not None for cut in (self.max_bytes, self.max_ns, self.snapshot_ns))
