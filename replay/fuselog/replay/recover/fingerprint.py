"""A hash of what a log holds, the same however its messages lie in chunks."""

import hashlib

import mcap.records
import numpy as np

from fuselog.replay.log.merge import copy_payloads
from fuselog.replay.mcap_file.sink import encode
from fuselog.schemas.messages import Messages


class Fingerprint:
    """SHA-256 over messages, attachments and metadata, each in their order; channel numbers are part of it."""

    def __init__(self) -> None:
        self._columns = [hashlib.sha256() for _ in range(6)]
        self._other = hashlib.sha256()

    def add(self, messages: Messages) -> None:
        """Take the next messages; one batch or many makes no difference."""
        end = np.cumsum(messages.length)
        payloads = np.empty(int(end[-1]) if len(end) else 0, np.uint8)
        copy_payloads(messages.data, messages.start, messages.length, end - messages.length, payloads)
        columns = (messages.stream, messages.log_time, messages.publish_time, messages.sequence, messages.length)
        for hashed, column in zip(self._columns, (*columns, payloads), strict=True):
            hashed.update(np.ascontiguousarray(column).data)

    def add_record(self, record: mcap.records.Attachment | mcap.records.Metadata) -> None:
        """Take the next attachment or metadata."""
        self._other.update(encode(record))

    def hexdigest(self) -> str:
        """Of all that was taken."""
        return hashlib.sha256(b"".join(part.digest() for part in (*self._columns, self._other))).hexdigest()
