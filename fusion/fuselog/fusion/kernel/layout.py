"""Where the numbers of a filter lie in flat memory, and the words that kernels compare; compiled with ``step``."""

from fuselog.fusion.kernel.blank import ALIKE, LD, SENSORS, M, N, U, X
from fuselog.fusion.kernel.tables import SAMPLE_WIDTH, Tables
from fuselog.schemas.compiled import inline

COVARIANCE = X  # a row of state: x, P with rows padded to LD, input and its noise, which states are known
INPUT = COVARIANCE + LD * LD
KNOWN = INPUT + 2 * U
LINE = 8  # numbers of a line of the cache
ROW = -(-(KNOWN + N) // LINE) * LINE
BEHIND = ROW - INPUT  # numbers of a row behind P
PACKED = N * (N + 1) // 2

SAMPLE = M + SAMPLE_WIDTH  # numbers of a row of z
HP = 2 * LD * LD  # places in Work.rows, after the two products of ``predict``
G = HP + M * LD
APART = G + M * LD
JOSEPH = APART + M * LD
DELTA = JOSEPH + M * LD
SCRATCH = DELTA + LD

BEGUN, VARIANT, ACQUIRING, AT, RESETS, MARKS = 0, 1, 2, 3, 4, 5  # a row of marks: these, and behind them by sensor
LAST, STREAK, SENSOR_MARKS = 0, 1, 2  # the moment it was last fused, and how many samples it had gated since
MARKED = MARKS + SENSORS * SENSOR_MARKS

PROCESS, LEARNED = 0, 1  # a row of what is learned: this, and behind it the memories of some sensors
FACTOR, SEEN, RECOVERED = 0, 1, 2  # a memory: factor on R, learned of how many; forced openings of the gate
COUNT, AGE = 3, 4  # samples of the stretch that is looked at for a standstill, and its length in ns
JUDGED, STANDING, STOOD, REFUSED = 5, 6, 7, 8  # stretches, whether the last was still, how many were, against the state
MEMORY = 9  # where a stretch's means begin, and behind them its sums of squares
# a sensor's row of ``Tables.tuning``
FADING, LEAST, GREATEST, PATIENCE, WAIT, TAIL, SPAN, SURE, SLOW, STRAIGHT, TUNING = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
HUBER, STUDENT_T, LEARNS, RECOVERS, STANDS, TEACHES = 1, 2, 4, 8, 16, 32  # of Care

# literals that kernels compare with: Decision, Role, Gain, Missing and Condition by number
FUSED, GATED, LATE, DUPLICATE, UNINITIALISED, SKIPPED, UNDECIDED = 0, 1, 2, 3, 9, 10, 255
BAD_NUMBER, BAD_CLOCK, BAD_COVARIANCE, SINGULAR = 4, 7, 8, 11
MEASURES, DRIVES_NEXT, DRIVES_PREVIOUS = 0, 1, 2
OPTIMAL, ABSORB, STATE, MATRIX = 0, 1, 2, 3
PREDICTION, RENORMALIZE, RESCALE, SKIP = 0, 1, 2, 3
IF_AGE, IF_STATE, IF_SPEED, IF_SENSOR = 0, 1, 2, 3


@inline
def rows_of(tables: Tables, sensor: int) -> int:
    """How many numbers a sample of the sensor measures."""
    return M if ALIKE else tables.rows[sensor]
