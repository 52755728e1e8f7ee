"""Payloads that lie: about their encoding, their counts, and where they are."""

import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

from fuselog.schemas import Columns, Fault, compile_codec

BIG = 4_000_000_000
EMPTIES = "pk/Empty[] items\nfloat64 x\n" + "=" * 80 + "\nMSG: pk/Empty\n"


def decode(schema: str, fields: list[str], *payloads: bytes, stamp: str | None = None) -> Columns:
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="pk/msg/Root",
        schema_text=schema, fields=fields, stamp=stamp,
    )  # fmt: skip
    length = np.array([len(payload) for payload in payloads], np.int64)
    return codec.decode(np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(length) - length, length)


def count(n: int) -> bytes:
    return b"\0\1\0\0" + n.to_bytes(4, "little")


@pytest.mark.parametrize("header", [b"\0\2\0\0", b"\0\3\0\0", b"\1\1\0\0", b"\0\7\0\0", b"\xff\xff\xff\xff"])
def test_other_encapsulations_are_another_schema(header: bytes) -> None:
    assert decode("uint8 a\n", ["a"], header + b"\5").fault.tolist() == [Fault.SCHEMA]


@pytest.mark.parametrize("payload", [b"", b"\0", b"\0\1\0", b"\0\1\0\0"])
def test_nothing_to_read_is_a_size_fault(payload: bytes) -> None:
    assert decode("uint8 a\n", ["a"], payload).fault.tolist() == [Fault.SIZE]


@pytest.mark.parametrize("schema", ["string s", "wstring s", "float64[] s", "string[] s", "uint8[] s", EMPTIES])
def test_absurd_counts_end_at_once(schema: str) -> None:
    started = time.perf_counter()
    columns = decode(schema, [], *[count(n) + bytes(100) for n in (BIG, 2**32 - 1, 2**31, 2**30, 200)])
    assert columns.fault.tolist() == [Fault.SIZE] * 5
    assert time.perf_counter() - started < 5.0  # most of it is the first compilation, if that


def test_a_string_must_end_with_nul_and_may_be_empty_without_one() -> None:
    columns = decode("string s\n", ["s"], count(3) + b"ab\0", count(3) + b"abc", count(1) + b"\0", count(0))
    assert columns.fault.tolist() == [Fault.NONE, Fault.SIZE, Fault.NONE, Fault.NONE]
    assert columns.texts["s"] == ["ab", "", "", ""]


def test_text_that_is_not_utf8_does_not_raise() -> None:
    assert decode("string s\n", ["s"], count(3) + b"\xff\xfe\0").texts["s"] == ["��"]


def test_starts_and_lengths_outside_the_buffer_are_size_faults() -> None:
    codec = compile_codec(
        encoding="cdr", schema_encoding="ros2msg", schema_name="pk/msg/Root",
        schema_text="uint32 a\n", fields=["a"], stamp=None,
    )  # fmt: skip
    data = np.frombuffer(count(7), np.uint8)
    far = 2**63 - 1
    start = np.array([0, 1, -1, 8, 9, far, 0, 0, far, -far, 4])
    length = np.array([8, 8, 8, 0, 4, 8, far, -1, far, far, -far])
    columns = codec.decode(data, start, length)
    assert columns.fault.tolist() == [Fault.NONE] + [Fault.SIZE] * 10
    assert columns["a"][0] == 7.0
    with pytest.raises(ValueError, match="11 starts and 10 lengths"):
        codec.decode(data, start, length[:10])


def test_a_faulty_row_is_blank_though_fields_before_the_fault_were_good() -> None:
    payload = b"\0\1\0\0" + bytes([1, 0, 0, 0, 2, 0, 0, 0]) + b"\2\0\0\0a\0"
    schema = "builtin_interfaces/Time stamp\nstring s\nfloat64 x\n"
    columns = decode(schema, ["stamp.sec", "s", "stamp.sec"], payload, stamp="stamp")
    assert columns.fault.tolist() == [Fault.SIZE]
    assert columns.t_ns.tolist() == [0]
    assert np.isnan(columns.values).all()
    assert columns.texts["s"] == [""]


def test_no_read_beyond_the_buffer() -> None:
    """A page that must not be touched follows the buffer; a read there kills the child."""
    script = """
        import ctypes, mmap
        import numpy as np
        from fuselog.schemas import compile_codec
        page = mmap.PAGESIZE
        memory = mmap.mmap(-1, 2 * page)
        whole = np.frombuffer(memory, np.uint8)
        libc = ctypes.CDLL(None, use_errno=True)
        assert libc.mprotect(ctypes.c_void_p(whole.ctypes.data + page), page, 0) == 0
        lines = ["uint8 a", "float64[] x", "string[] s", "int16[3] h", "builtin_interfaces/Time stamp",
            "float64[2] y", "wstring w"]
        rng = np.random.default_rng(1)
        for first in range(len(lines)):
            codec = compile_codec(encoding="cdr", schema_encoding="ros2msg", schema_name="pk/msg/R",
                schema_text="\\n".join(lines[first:] + lines[:first]), stamp="stamp",
                fields=["a", "x[0]", "x[3]", "s[1]", "h", "y", "w"])
            for trial in range(3000):
                n = trial % 100
                payload = rng.choice(np.array([0] * 12 + [1, 2, 9], np.uint8), n)
                payload[:4] = [0, trial % 2, 0, 0][:n]
                whole[page - n : page] = payload
                codec.decode(whole[:page], np.array([page - n]), np.array([n]))
        print("unharmed", flush=True)
        whole[page]
    """
    ran = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, check=False)
    assert ran.returncode == -11, ran.stderr.decode()  # only the last line touches the page, on purpose
    assert ran.stdout == b"unharmed\n", "died before the end"
