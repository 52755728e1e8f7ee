"""What can be read of a damaged log, as a sound one."""

from fuselog.replay.recover.recovery import Recovery, recover

__all__ = ["Recovery", "recover"]
