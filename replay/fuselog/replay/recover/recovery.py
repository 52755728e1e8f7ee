"""A damaged log to a sound one that holds all that could be read of it."""

import os
import secrets
from collections import Counter
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import mcap.records
import numpy as np

from fuselog.replay.mcap_file import records
from fuselog.replay.mcap_file.decompress import Limits
from fuselog.replay.mcap_file.framing import OVERHEAD
from fuselog.replay.mcap_file.writer import LogWriter
from fuselog.replay.opening import open_log
from fuselog.replay.recover.damage import Damage
from fuselog.replay.recover.fingerprint import Fingerprint
from fuselog.replay.recover.salvage import Item, Salvage
from fuselog.schemas.errors import LogError
from fuselog.schemas.messages import Messages


@dataclass(frozen=True, slots=True)
class TopicRecovery:
    """How many messages of a channel were kept, and how many are known to be lost."""

    topic: str
    type: str
    kept: int
    lost: int


@dataclass(frozen=True, slots=True)
class Recovery:
    """What came of a recovery. ``sha256`` is the `Fingerprint` of what was written, and was read back."""

    path: str
    output: str
    topics: list[TopicRecovery]
    attachments: int
    metadata: int
    damages: list[Damage]
    sha256: str

    @property
    def messages(self) -> int:
        """Kept, of all topics."""
        return sum(topic.kept for topic in self.topics)

    @property
    def lossy(self) -> bool:
        """Whether anything was lost."""
        return any(damage.lost for damage in self.damages)

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "schema": 1,
            "path": self.path,
            "output": self.output,
            "messages": self.messages,
            "attachments": self.attachments,
            "metadata": self.metadata,
            "lossy": self.lossy,
            "topics": [asdict(topic) for topic in self.topics],
            "damages": [asdict(damage) for damage in self.damages],
            "sha256": self.sha256,
        }


def recover(
    path: str | PathLike[str],
    output: str | PathLike[str],
    *,
    limits: Limits | None = None,
    trust_damaged: bool = False,
    force: bool = False,
) -> Recovery:
    """Write all that `Salvage` reads of ``path`` to the new log ``output``, in file order, and read it back.

    The output appears only when it is whole, and replaces another file only with ``force``. Raises LogError
    when nothing can be read, the output cannot be written or is the input, or does not read back as written.
    """
    output = Path(output)
    if output.exists() and Path(path).exists() and output.samefile(path):
        raise LogError(str(output), 0, "the output is the input")
    if output.exists() and not force:
        raise LogError(str(output), 0, "there is such a file already")
    part = output.with_name(f".fuselog-{secrets.token_hex(8)}.part")
    limits = limits or Limits()
    try:
        recovery = _copy(Salvage(path, limits=limits, trust_damaged=trust_damaged), part, limits)
        _verify(recovery, part, limits)
        _place(part, output, force=force)
    finally:
        part.unlink(missing_ok=True)
    return replace(recovery, output=str(output))


class _Copier:
    """Takes items of one log and writes them to another, whose channels have numbers of their own."""

    def __init__(self, salvage: Salvage, writer: LogWriter, limits: Limits) -> None:
        self._salvage = salvage
        self._writer = writer
        self._largest = limits.chunk_bytes - OVERHEAD
        self.numbers = np.zeros(records.CHANNELS, np.int32)  # in the new log, by channel; 0 when it has none yet
        self.counts = np.zeros(records.CHANNELS, np.int64)
        self.fingerprint = Fingerprint()
        self.records: Counter[type] = Counter()

    def declare(self) -> None:
        """Declare the channels that were met since the last call."""
        for id, channel in self._salvage.channels().items():
            if not self.numbers[id]:
                schema = channel.schema
                self.numbers[id] = self._writer.add_channel(
                    channel.topic,
                    schema.name,
                    schema.encoding,
                    schema.data,
                    encoding=channel.encoding,
                    metadata=channel.metadata,
                )

    def take(self, item: Item) -> None:
        """Write one item."""
        match item:
            case Messages():
                self._messages(item)
            case mcap.records.Attachment():
                self._writer.add_attachment(
                    item.name,
                    item.data,
                    media_type=item.media_type,
                    log_time=item.log_time,
                    create_time=item.create_time,
                )
            case _:
                self._writer.add_metadata(item.name, item.metadata)
        if not isinstance(item, Messages):
            self.records[type(item)] += 1
            self.fingerprint.add_record(item)

    def _messages(self, messages: Messages) -> None:
        fits = messages.length <= self._largest
        if not fits.all():
            reason = f"messages of more than {self._largest} bytes, which is the limit of a chunk"
            self._salvage.damages.add(Damage(0, 0, reason, messages=int((~fits).sum())))
            messages = messages.take(np.flatnonzero(fits))
        if self.numbers[messages.stream].min(initial=1) == 0:
            self.declare()
        self.counts += np.bincount(messages.stream, minlength=records.CHANNELS)
        renumbered = replace(messages, stream=self.numbers[messages.stream])
        self._writer.write(renumbered)
        self.fingerprint.add(renumbered)


def _copy(salvage: Salvage, part: Path, limits: Limits) -> Recovery:
    """Write what can be read; LogError when that is nothing."""
    with LogWriter(part, profile=salvage.header.profile) as writer:
        copier = _Copier(salvage, writer, limits)
        for item in salvage.items():
            copier.take(item)
        copier.declare()
    topics = [
        TopicRecovery(channel.topic, channel.schema.name, int(copier.counts[id]), salvage.lost(id))
        for id, channel in salvage.channels().items()
    ]
    recovery = Recovery(
        path=salvage.path,
        output="",
        topics=topics,
        attachments=copier.records[mcap.records.Attachment],
        metadata=copier.records[mcap.records.Metadata],
        damages=list(salvage.damages),
        sha256=copier.fingerprint.hexdigest(),
    )
    if recovery.lossy and not (recovery.messages or recovery.attachments or recovery.metadata):
        worst = next(damage for damage in recovery.damages if damage.lost)
        raise LogError(salvage.path, worst.begin, f"nothing could be read: {worst.reason}")
    return recovery


def _verify(recovery: Recovery, part: Path, limits: Limits) -> None:
    """Read back what was written: the same hash, the same counts, and nothing wrong with it."""
    again, fingerprint = Salvage(part, limits=limits), Fingerprint()
    for item in again.items():
        if isinstance(item, Messages):
            fingerprint.add(item)
        else:
            fingerprint.add_record(item)
    problems = [damage.reason for damage in again.damages]
    if fingerprint.hexdigest() != recovery.sha256:
        problems.append("its hash differs")
    with open_log(part, limits=limits) as log:
        problems += [loss.reason for loss in log.losses]
        counts = [(channel.topic, channel.count) for channel in log.channels.values()]
    if counts != [(topic.topic, topic.kept) for topic in recovery.topics]:
        problems.append("its counts differ")
    if problems:
        raise LogError(recovery.path, 0, f"what was written does not read back: {problems[0]}")


def _place(part: Path, output: Path, *, force: bool) -> None:
    """Give the finished file its name; without ``force`` not that of another file, not even of a new one."""
    try:
        with part.open("rb") as file:
            os.fsync(file.fileno())
        if not force and _linked(part, output):
            return
        part.replace(output)
    except FileExistsError as error:
        raise LogError(str(output), 0, "there is such a file already") from error
    except OSError as error:
        raise LogError(str(output), 0, error.strerror or str(error)) from error


def _linked(part: Path, output: Path) -> bool:
    """Whether the output is there now; False on a file system without links."""
    try:
        os.link(part, output)
    except FileExistsError:
        raise
    except OSError:
        return False
    return True
