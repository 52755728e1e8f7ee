"""Where MCAP records lie in a block of bytes: bounds-checked numba walks over opcode and length."""

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import HOST_IS_BIG_ENDIAN, kernel, leaf, load

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, DATA_END = 8, 9, 10, 11, 12, 13, 15
FRAME = 9  # bytes of opcode and length before the content of a record
MESSAGE_HEADER = 22  # bytes of channel, sequence and the two times before the payload
LEAST_MESSAGE = FRAME + MESSAGE_HEADER  # bytes of a message without payload
COLUMNS = 6  # of `fill`
DATA_END_SIZE, FOOTER_SIZE = 4, 20  # of their contents, which are never extended
CHANNELS = 1 << 16  # numbers of channels are u16
MAX_TIME = 2**63 - 1  # ns; later times of the file (u64) are read as this one

Integer = int | np.int64  # what a kernel works with


@leaf
def read_u64(data: NDArray[np.uint8], at: Integer) -> np.int64:
    """The eight bytes as int64: negative means 2**63 or more."""
    return load(data, at, HOST_IS_BIG_ENDIAN, np.int64)


@leaf
def read_time(data: NDArray[np.uint8], at: Integer) -> Integer:
    """A time in ns, at most MAX_TIME."""
    value = read_u64(data, at)
    return value if value >= 0 else MAX_TIME


@kernel
def measure(data: NDArray[np.uint8], begin: int, end: int) -> tuple[int, int]:
    """Walk ``data[begin:end]`` -> (Schema and Channel records, where the whole records end).

    A record whose length points beyond ``end`` stops the walk before it.
    """
    at, definitions = begin, 0
    while at + FRAME <= end:
        length = read_u64(data, at + 1)
        if length < 0 or length > end - at - FRAME:
            break
        definitions += data[at] in (SCHEMA, CHANNEL)
        at += FRAME + length
    return definitions, int(at)


@kernel
def find_definitions(data: NDArray[np.uint8], begin: int, end: int, found: NDArray[np.int64]) -> None:
    """Fill ``found`` (n, 3): opcode, content start and length of the n definitions of `measure`."""
    at, n = begin, 0
    while at + FRAME <= end:
        length = read_u64(data, at + 1)
        if data[at] in (SCHEMA, CHANNEL):
            found[n, 0], found[n, 1], found[n, 2] = data[at], at + FRAME, length
            n += 1
        at += FRAME + length


@kernel
def fill(
    data: NDArray[np.uint8],
    begin: int,
    end: int,
    wanted: NDArray[np.uint8],
    counts: NDArray[np.int64],
    rows: NDArray[np.int64],
) -> tuple[int, bool, int, int]:
    """Write the wanted messages of ``data[begin:end]``.

    -> (how many, whether in time order, messages too short for their own header, where the whole records end). A
    record whose length points beyond ``end`` stops the walk before it. ``wanted`` (65536,) by channel; ``counts``
    (65536,) grows by every message, wanted or not. ``rows`` (COLUMNS, at least (end - begin) / LEAST_MESSAGE): channel,
    sequence, log time, publish time, start and length of the payload.
    """
    at, n, ordered, last, short = begin, 0, True, np.int64(-1), 0
    while at + FRAME <= end:
        length = read_u64(data, at + 1)
        if length < 0 or length > end - at - FRAME:
            break
        if data[at] == MESSAGE and length < MESSAGE_HEADER:
            short += 1
        elif data[at] == MESSAGE:
            channel = np.int64(load(data, at + 9, HOST_IS_BIG_ENDIAN, np.uint16))
            counts[channel] += 1
            if wanted[channel]:
                log_time = read_time(data, at + 15)
                ordered &= log_time >= last
                last = log_time
                rows[0, n] = channel
                rows[1, n] = np.int64(load(data, at + 11, HOST_IS_BIG_ENDIAN, np.uint32))
                rows[2, n] = log_time
                rows[3, n] = read_time(data, at + 23)
                rows[4, n] = at + FRAME + MESSAGE_HEADER
                rows[5, n] = length - MESSAGE_HEADER
                n += 1
        at += FRAME + length
    return n, bool(ordered), short, int(at)


def count(data: NDArray[np.uint8], begin: int, end: int) -> NDArray[np.int64]:
    """Messages by channel (CHANNELS,) of the whole records of ``data[begin:end]``."""
    counts, none = np.zeros(CHANNELS, np.int64), np.zeros(CHANNELS, np.uint8)
    fill(data, begin, end, none, counts, np.empty((COLUMNS, 0), np.int64))
    return counts


@leaf
def put(
    rows: NDArray[np.int64],
    n: int,
    opcode: Integer,
    start: Integer,
    length: Integer,
    first: Integer,
    last: Integer,
) -> int:
    """Write row n of `scan` -> n + 1."""
    rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3], rows[n, 4] = opcode, start, length, first, last
    return n + 1


@kernel
def scan(data: NDArray[np.uint8], begin: int, end: int, span: int, rows: NDArray[np.int64]) -> tuple[int, int, bool]:
    """Walk top-level records without opening any -> (rows written, where to go on, whether it is the end).

    ``rows`` (capacity, 5): opcode, content start, content length, and for messages earliest and latest
    log time. Neighbouring messages, with what lies between them, become one row of about ``span`` bytes
    whose start and length take in the whole records. The walk ends at DataEnd, Footer or a broken record.
    """
    at, n, block, finish = begin, 0, np.int64(-1), np.int64(0)
    first, last = np.int64(0), np.int64(0)
    done = True
    while at + FRAME <= end:
        if n + 3 > len(rows):
            done = False
            break
        opcode, length = np.int64(data[at]), read_u64(data, at + 1)
        if length < 0 or length > end - at - FRAME:
            break
        if opcode == MESSAGE and length >= MESSAGE_HEADER:
            time = read_time(data, at + 15)
            if block < 0:
                block, first, last = at, time, time
            first, last, finish = min(first, time), max(last, time), at + FRAME + length
            if finish - block >= span:
                n, block = put(rows, n, MESSAGE, block, finish - block, first, last), np.int64(-1)
        else:
            if block >= 0 and opcode == CHUNK:
                n, block = put(rows, n, MESSAGE, block, finish - block, first, last), np.int64(-1)
            n = put(rows, n, opcode, at + FRAME, length, 0, 0)
        at += FRAME + length
        if (opcode == DATA_END and length == DATA_END_SIZE) or (opcode == FOOTER and length == FOOTER_SIZE):
            break
    if block >= 0:
        n = put(rows, n, MESSAGE, block, finish - block, first, last)
    return n, int(at), done
