"""What the command line cannot do, beside the errors of logs and configurations."""

from pathlib import Path

from fuselog.schemas import FuselogError


class OutputError(FuselogError):
    """A file or folder that cannot be written."""

    def __init__(self, path: Path, reason: str) -> None:
        super().__init__(f"{path}: cannot be written: {reason}")
        self.path = path
        self.reason = reason
