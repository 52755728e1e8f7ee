"""CRC 32 of large blocks: by carry-less multiplication where the processor has it, else by zlib, to the same number."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# pyright: reportMissingTypeStubs=false
# Numba passes compiler objects to an intrinsic that have no types to check.

import zlib
from functools import cache
from typing import Any, Final, Protocol, cast

import numpy as np
from llvmlite import binding, ir
from numba import config
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from fuselog.schemas.compiled import kernel

_BLOCK: Final = 64  # bytes folded at a time: four lanes of 128 bits
_LANES: Final = 4
_POLYNOMIAL: Final = 0x104C11DB7
_LEAST: Final = 1 << 12  # bytes; below it zlib is as fast
_START: Final = 0xFFFFFFFF


def crc32(data: NDArray[np.uint8]) -> int:
    """The CRC 32 of ``data`` (n,), as ``zlib.crc32`` gives it.

    Every lane is multiplied by x^512 mod P and added to the lane 64 bytes on (Gopal et al., "Fast CRC computation for
    generic polynomials using PCLMULQDQ", 2009), until 64 bytes with the same remainder are left; zlib does those.
    """
    if len(data) < _LEAST or not _has_carryless_multiplication():
        return zlib.crc32(data.data)
    view = data.view()
    view.flags.writeable = False
    lanes = np.empty(_BLOCK, np.uint8)
    whole = len(data) // _BLOCK * _BLOCK
    fold_blocks(view, lanes.view(np.int64))
    return zlib.crc32(data[whole:].data, zlib.crc32(lanes.data, _START))  # _START: its register begins at zero


@cache
def _has_carryless_multiplication() -> bool:
    """Whether kernels are compiled for a processor that has it; a forced processor may lack it."""
    options = cast(Any, config)
    forced = options.CPU_NAME or options.CPU_FEATURES
    return not forced and binding.get_host_cpu_features().get("pclmul", False)


def _power(exponent: int) -> int:
    """x^exponent mod P, its bits reflected as the data's are, times x."""
    power = 1
    for _ in range(exponent):
        power <<= 1
        power ^= _POLYNOMIAL * (power >> 32)
    return int(f"{power:032b}"[::-1], 2) << 1


_LOW, _HIGH = _power(8 * _BLOCK + 32), _power(8 * _BLOCK - 32)  # of a lane's halves


class _Fold(Protocol):
    def __call__(self, data: NDArray[np.uint8], blocks: int, lanes: NDArray[np.int64], /) -> None: ...


def _fold(_context: Any, data: Any, blocks: Any, lanes: Any) -> Any:  # noqa: ARG001  types only
    vector = ir.VectorType(ir.IntType(64), 2)
    index = ir.IntType(64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, target = (
            builder.bitcast(context.make_array(signature.args[i])(context, builder, arguments[i]).data, to)
            for i, to in ((0, vector.as_pointer()), (2, vector.as_pointer()))
        )
        multiply = builder.module.declare_intrinsic(
            "llvm.x86.pclmulqdq", (), ir.FunctionType(vector, [vector, vector, ir.IntType(8)])
        )
        factors = ir.Constant(vector, [_LOW, _HIGH])

        def lane(at: Any) -> Any:
            return builder.load(builder.gep(source, [at]), align=1)

        first = [lane(index(k)) for k in range(_LANES)]
        first[0] = builder.xor(first[0], ir.Constant(vector, [_START, 0]))
        before = builder.block
        loop, after = builder.append_basic_block("fold"), builder.append_basic_block("folded")
        builder.branch(loop)
        builder.position_at_end(loop)
        at = builder.phi(index)
        folded = [builder.phi(vector) for _ in range(_LANES)]
        at.add_incoming(index(_LANES), before)
        following = [
            builder.xor(
                builder.xor(
                    builder.call(multiply, [one, factors, ir.IntType(8)(0x00)]),
                    builder.call(multiply, [one, factors, ir.IntType(8)(0x11)]),
                ),
                lane(builder.add(at, index(k))),
            )
            for k, one in enumerate(folded)
        ]
        for one, begin, end in zip(folded, first, following, strict=True):
            one.add_incoming(begin, before)
            one.add_incoming(end, loop)
        further = builder.add(at, index(_LANES))
        at.add_incoming(further, loop)
        more = builder.icmp_signed("<", further, builder.mul(arguments[1], index(_LANES)))
        builder.cbranch(more, loop, after)
        builder.position_at_end(after)
        for k, end in enumerate(following):
            builder.store(end, builder.gep(target, [index(k)]), align=1)
        return context.get_dummy_value()

    return types.void(data, types.int64, lanes), generate


fold = cast(_Fold, intrinsic(_fold))


@kernel
def fold_blocks(data: NDArray[np.uint8], lanes: NDArray[np.int64]) -> None:
    """Fold the whole blocks of ``data``, two or more, into ``lanes`` (8,): 64 bytes with the same remainder."""
    fold(data, data.size // _BLOCK, lanes)
