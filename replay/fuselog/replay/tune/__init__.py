"""Settings found from a log: what it says of rates, noises and gains, and whether they are better."""

from fuselog.replay.tune.forms import Form
from fuselog.replay.tune.gains import Method, Noise, Tuned, tune_gains

__all__ = ["Form", "Method", "Noise", "Tuned", "tune_gains"]
