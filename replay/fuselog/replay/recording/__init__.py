"""Messages as they come into files that a crash leaves readable. Knows no middleware and starts no clock of its own."""

from fuselog.replay.recording.files import RecordingError
from fuselog.replay.recording.ledger import Account
from fuselog.replay.recording.options import Compression, Durability, RecordOptions
from fuselog.replay.recording.recording import Recording, RecordingStatus

__all__ = ["Account", "Compression", "Durability", "RecordOptions", "Recording", "RecordingError", "RecordingStatus"]
