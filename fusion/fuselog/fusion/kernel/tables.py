"""A configuration and a filter's memory as plain arrays: all that a kernel sees of either."""

from enum import IntEnum, IntFlag
from typing import Annotated, Any, NamedTuple

import numpy as np

NEVER = np.iinfo(np.int64).min  # the time of a filter that has seen nothing

DECISIONS = 13  # kinds of ``Decision``
SAMPLE_WIDTH = 3  # numbers that come with a sample besides what was measured: the position of a beacon

# A flat array outside of a kernel, a bare pointer inside; no one type describes both.
Ints = Annotated[Any, np.int64]
Floats = Annotated[Any, np.float64]
Bytes = Annotated[Any, np.uint8]
# The same of each filter's own where a kernel moves several; all others of whole numbers are the same for them.
OwnInts = Annotated[Any, np.int64, "own"]
OwnBytes = Annotated[Any, np.uint8, "own"]
# The same that a kernel writes once and does not read.
OutInts = Annotated[Any, np.int64, "own", "out"]
OutFloats = Annotated[Any, np.float64, "out"]


class Role(IntEnum):
    """What a sensor's sample does to the filter."""

    MEASURES = 0  # corrects the state
    DRIVES_NEXT = 1  # is the input from its stamp on
    DRIVES_PREVIOUS = 2  # was the input up to its stamp


class Gain(IntEnum):
    """How a sensor's gain is made (reference: Bezmen 2019, eq. 27 and 29)."""

    OPTIMAL = 0  # P H' S^-1
    ABSORB = 1  # a fixed share of each innovation
    STATE = 2  # fixed weights of measured numbers in states
    MATRIX = 3  # fixed numbers, in units of a state by units of a measured number


class Missing(IntEnum):
    """What happens to the weight of a sensor that a cycle has no sample of (``design.present_weights``)."""

    PREDICTION = 0  # it stays with the prediction
    RENORMALIZE = 1  # the others take it
    RESCALE = 2  # the others take what they would if the sensor did not exist
    SKIP = 3  # the cycle is left out


class Care(IntFlag):
    """What is done with a sensor's samples besides fusing them or not."""

    HUBER = 1  # far ones weigh less, by the square root of their NIS
    STUDENT_T = 2  # far ones weigh less, by their NIS
    LEARNS = 4  # the size of its noise is learned
    RECOVERS = 8  # its gate lets in what it has long refused
    STANDS = 16  # it says when the body stands
    TEACHES = 32  # it teaches the size of the process noise


class Condition(IntEnum):
    """What a schedule of gains looks at, before the samples of a moment."""

    AGE = 0  # s since the filter began
    STATE = 1  # a state
    SPEED = 2  # the length of the velocity
    SENSOR = 3  # whether a sensor was fused within ``max_age_ns``: 1 or 0


class Tables(NamedTuple):
    """A configuration in numbers, for S sensors of at most M measured numbers each, N states, K noise densities.

    There are V variants of the gain; a filter without a schedule has one. The samples of one moment, a stamp or a cycle
    of stamps, are weighed by the same variant. M and S are constants in a kernel (``fit.Fit``).

    All arrays are flat, row by row; the shapes are those that a row has.
    """

    M: int
    S: int
    role: Ints  # (S,) of Role
    rows: Ints  # (S,) numbers that a sample measures
    what: Ints  # (S, M) a state's index, or -1 - q for generated quantity q
    seed: Ints  # (S, M) the state that this number gives at once while that state is unknown, or -1
    level: Ints  # (S,) where the specific force begins among the numbers, for roll and pitch to begin with; or -1
    turn: Ints  # (S,) where roll, pitch, yaw of a whole attitude begin among the numbers; or -1
    angle: Bytes  # (S, M) whether the number is an angle
    threshold: Floats  # (S, M) gate: most that the NIS of 1 to M numbers may be; inf for no gate
    sensor: Floats  # (S, 7) lever arm x y z (m, body), gravity (m/s²), station x y z (m, world)
    gain: Ints  # (V, S) of Gain
    weight: Floats  # (V, S, M) share of the innovation absorbed
    table: Floats  # (V, S, M, N) weight of number q in state f, or the gain itself
    when: Ints  # (C, 3) variant, Condition, and the state or sensor that it is about
    conditions: int  # C
    between: Floats  # (C, 2) a variant is taken when all its conditions are between these; the last has none
    speeds: int  # W
    speed: Ints  # (W,) the states, or N + the inputs, whose length is the speed
    cycles: int  # whether samples of the same moment share their weights
    period_ns: int  # of a cycle; 0: a moment is one stamp
    missing: int  # of Missing
    max_age_ns: int  # how long a sensor may be silent before it is missing
    gap_ns: int  # silence of all sensors after which the optimal gain acquires the state anew; -1: never
    acquire: Floats  # (2,) ratio of P to its steady value above which that goes on, once begun, and begins
    settled: Floats  # (N,) 1 over the steady variance before a correction, over how many have one; 0 where none
    covariance: int  # whether P is computed
    scaled: int  # whether the fixed gain is formed with ``scales`` in place of P
    scales: Floats  # (N,) standard deviations
    q: Floats  # (K,) process noise densities, then the model's parameters
    care: Ints  # (S,) of Care; 0 for a sensor that is only gated
    learned: int  # numbers in a row of ``History.learned``; 0 where nothing is learned
    memory: Ints  # (S,) where the sensor's memory begins in it, or -1
    tuning: Floats  # (S, TUNING + M + 2 M) numbers in ``layout``'s order, then Huber's NIS of 1 to M numbers, then
    # the most that the sd and the absolute mean of each number may be while the body stands
    process: Floats  # (3,) share of a sample in the learned process noise (0: off), least and greatest factor on it
    stills: int  # what a standstill tells, of all sensors
    still: Ints  # (stills, 4) sensor, state, the number whose mean that then is or -1 for 0, place of the variance
    window_ns: int  # how late a sample may be
    step_ns: int  # that the model moves by; 0: any time
    iterations: int  # of the iterated filter: most linearisations of one sample
    tolerance: float  # change, in standard deviations, at which it is done


class History(NamedTuple):
    """The last entries of a filter in time order: the samples and the state after each; flat arrays.

    Entry ``head`` is the base that a rewind starts from. A row of ``state`` is x, P, the input, which states are known.
    """

    capacity: int  # C
    cursor: Ints  # (3,) head, tail, newest stamp admitted
    counts: OwnInts  # (S, DECISIONS) the ledger
    t: Ints  # (C,)
    sensor: Ints  # (C,)
    seq: Ints  # (C,)
    decision: OwnBytes  # (C,)
    z: Floats  # (C, M + SAMPLE_WIDTH)
    R: Floats  # (C, M * M)
    marks: OwnInts  # (C, MARKED) what is remembered besides the state, such as its moment
    learned: Floats  # (C, learned) factors on noises, and stretches that may be standstills
    state: Floats  # (C, ROW)
    nis: Floats  # (C,)
    dof: OwnInts  # (C,)
    nu: Floats  # (C, M)
    S: Floats  # (C, M) variances of the innovations
    absorbed: Floats  # (C, M) diagonal of H G


class Samples(NamedTuple):
    """``Events`` as a kernel takes them; flat arrays."""

    size: int  # n
    t_ns: Ints  # (n,)
    sensor: Ints  # (n,)
    seq: Ints  # (n,)
    fault: Bytes  # (n,)
    z: Floats  # (n, M + SAMPLE_WIDTH)
    R: Floats  # (n, M * M)


class Work(NamedTuple):
    """Scratch of one step; holds nothing between steps."""

    rows: Floats  # two products of N rows, then MOST rows each of H P, G', L^-1 H P and Joseph's T' H', and dx
    S: Floats  # (M,) diagonal of H P H'
    L: Floats  # (M, M) with L D L' = S, the ones in its diagonal left out
    D: Floats  # (M,) the inverse of that diagonal matrix
    B: Floats  # (M, M) L^-1 R, above the diagonal
    y: Floats  # (M,) L^-1 nu
    nu: Floats  # (M,)
    hv: Floats  # (M + 1, WIDTH) non-zero derivatives of each measured number, and of one looked at in passing
    hi: Ints  # (M + 1, WIDTH) the states that they belong to
    hn: Ints  # (M + 1,) how many
    active: Ints  # (M,) the numbers that take part in this update
    factor: Floats  # (1,) on R of the sample at hand
    diagonal: Ints  # (1,) whether that is diagonal
    modest: Ints  # (1,) whether the short form of the covariance will do for it
    q: Floats  # (K,) q with the process noise as it is learned
    here: Ints  # (S,) the last entry of each sensor in the moment, or -1
    single: Ints  # of several filters: the places of each one's tables, and of a history and a work for one of them


class Linear(NamedTuple):
    """The filter at a state, as matrices; flat arrays."""

    F: Floats  # (N, N)
    Q: Floats  # (N, N)
    h: Floats  # (M,)
    H: Floats  # (M, N)


class Rows(NamedTuple):
    """What a kernel writes for each event; flat arrays that become a ``Track``, P with LD to spare."""

    t_ns: OutInts  # (n,)
    decision: OwnBytes  # (n,)
    nis: OutFloats  # (n,)
    dof: OutInts  # (n,)
    x: OutFloats  # (n, N)
    P: OutFloats  # (n, N (N + 1) / 2)
    nu: OutFloats  # (n, M)
    S: OutFloats  # (n, M)
    absorbed: OutFloats  # (n, M)
