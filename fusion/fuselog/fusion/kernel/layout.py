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

# literals that kernels compare with: Decision, Role and Gain by number
FUSED, GATED, LATE, DUPLICATE, BAD_COVARIANCE, UNINITIALISED, UNDECIDED = 0, 1, 2, 3, 8, 9, 255
DRIVES_NEXT, DRIVES_PREVIOUS = 1, 2
OPTIMAL, ABSORB, STATE, MATRIX = 0, 1, 2, 3
