"""What is wrong with a log: of the file, of its clocks, and of the numbers in it."""

from fuselog.replay.doctor.examine import Examination, examine
from fuselog.replay.doctor.finding import Finding

__all__ = ["Examination", "Finding", "examine"]
