"""Where MCAP records lie in a block of bytes: bounds-checked numba walks over opcode and length."""

import numpy as np
from numpy.typing import NDArray

from fuselog.schemas.compiled import inline, kernel

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 5, 6, 7
CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, DATA_END = 8, 9, 10, 11, 12, 13, 15
FRAME = 9  # bytes of opcode and length before the content of a record
MESSAGE_HEADER = 22  # bytes of channel, sequence and the two times before the payload
DATA_END_SIZE, FOOTER_SIZE = 4, 20  # of their contents, which are never extended
MAX_TIME = 2**63 - 1  # ns; later times of the file (u64) are read as this one

Integer = int | np.int64  # what a kernel works with
Walk = tuple[int, int, int, int]


@inline
def read_u64(data: NDArray[np.uint8], at: Integer) -> np.int64:
    """The eight bytes as int64: negative means 2**63 or more."""
    return (
        np.int64(data[at])
        | np.int64(data[at + 1]) << 8
        | np.int64(data[at + 2]) << 16
        | np.int64(data[at + 3]) << 24
        | np.int64(data[at + 4]) << 32
        | np.int64(data[at + 5]) << 40
        | np.int64(data[at + 6]) << 48
        | np.int64(data[at + 7]) << 56
    )


@inline
def read_time(data: NDArray[np.uint8], at: Integer) -> Integer:
    """A time in ns, at most MAX_TIME."""
    value = read_u64(data, at)
    return value if value >= 0 else MAX_TIME


@kernel
def measure(data: NDArray[np.uint8], begin: int, end: int) -> Walk:
    """Walk ``data[begin:end]`` -> (messages, definitions, short messages, where the whole records end).

    A record whose length points beyond ``end`` stops the walk before it. Definitions are Schema and
    Channel records; a short message is one without room for its own header.
    """
    at, messages, definitions, short = begin, 0, 0, 0
    while at + FRAME <= end:
        length = read_u64(data, at + 1)
        if length < 0 or length > end - at - FRAME:
            break
        opcode = data[at]
        if opcode == MESSAGE:
            if length >= MESSAGE_HEADER:
                messages += 1
            else:
                short += 1
        elif opcode in (SCHEMA, CHANNEL):
            definitions += 1
        at += FRAME + length
    return messages, definitions, short, int(at)


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
    stream: NDArray[np.int32],
    times: NDArray[np.int64],
    extent: NDArray[np.int64],
) -> tuple[int, bool]:
    """Write the wanted messages of whole records ``data[begin:end]`` -> (how many, whether in time order).

    ``wanted`` (65536,) by channel; ``counts`` (65536,) grows by every message, wanted or not.
    ``times`` (3, n): log, publish, sequence. ``extent`` (2, n): start and length of the payload.
    """
    at, n, ordered, last = begin, 0, True, np.int64(-1)
    while at + FRAME <= end:
        length = read_u64(data, at + 1)
        if data[at] == MESSAGE and length >= MESSAGE_HEADER:
            channel = np.int32(data[at + 9]) | np.int32(data[at + 10]) << 8
            counts[channel] += 1
            if wanted[channel]:
                log_time = read_time(data, at + 15)
                ordered &= log_time >= last
                last = log_time
                stream[n] = channel
                times[0, n] = log_time
                times[1, n] = read_time(data, at + 23)
                times[2, n] = read_u64(data, at + 11) & 0xFFFFFFFF
                extent[0, n] = at + FRAME + MESSAGE_HEADER
                extent[1, n] = length - MESSAGE_HEADER
                n += 1
        at += FRAME + length
    return n, bool(ordered)


@inline
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
