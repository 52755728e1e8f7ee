"""Where the numbers of a filter lie in flat memory, and the words that kernels compare; compiled with ``step``."""

from fuselog.fusion.kernel.blank import LD, N, U, X

COVARIANCE = X  # a row of state: x, P with rows padded to LD, input and its noise, which states are known
INPUT = COVARIANCE + LD * LD
KNOWN = INPUT + 2 * U
ROW = KNOWN + N
PACKED = N * (N + 1) // 2

MOST = 9  # numbers that one sample measures at most
HP = 2 * LD * LD  # places in Work.rows, after the two products of ``predict``
G = HP + MOST * LD
WHITE = G + MOST * LD
JOSEPH = WHITE + MOST * LD
DELTA = JOSEPH + MOST * LD
SCRATCH = DELTA + LD

BEGUN, VARIANT, ACQUIRING, MARKS = 0, 1, 2, 3  # a row of marks: these, and behind them for each sensor
LAST, STREAK, SENSOR_MARKS = 0, 1, 2  # the moment it was last fused, and how many samples it had gated since

# literals that kernels compare with: Decision, Role, Gain, Missing and Condition by number
FUSED, GATED, LATE, DUPLICATE, BAD_COVARIANCE, UNINITIALISED, SKIPPED, UNDECIDED = 0, 1, 2, 3, 8, 9, 10, 255
MEASURES, DRIVES_NEXT, DRIVES_PREVIOUS = 0, 1, 2
OPTIMAL, ABSORB, STATE, MATRIX = 0, 1, 2, 3
PREDICTION, RENORMALIZE, RESCALE, SKIP = 0, 1, 2, 3
IF_AGE, IF_STATE, IF_SPEED, IF_SENSOR = 0, 1, 2, 3
