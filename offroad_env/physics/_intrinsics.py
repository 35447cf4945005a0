"""What the kernels need of the compiler itself: the bits of a float, and scratch in a caller's own frame."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

__all__ = ["BLOCK_ROWS", "LANES", "ROWS", "bits_of_float", "float_of_bits", "stacked_block", "stacked_rows"]

#: Loops over nodes and waves run in blocks of this many: a fixed count becomes vector instructions
#: without a remainder, on any register width up to 512 bits.
LANES = 8
#: Rows of scratch for one loop, and for a few loops at a time.
ROWS, BLOCK_ROWS = 8, 32


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def bits_of_float(_context: Any, _x: Any) -> Any:
    """The 64 bits of a float as an int."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: tuple[Any, ...]) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(types.int64))

    return types.int64(types.float64), generate


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def float_of_bits(_context: Any, _i: Any) -> Any:
    """The float that these 64 bits are."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: tuple[Any, ...]) -> Any:
        return builder.bitcast(arguments[0], context.get_value_type(types.float64))

    return types.float64(types.int64), generate


def _stacked(rows: int) -> Any:
    """(``rows``, LANES) of scratch in the caller's own frame."""
    kind = types.Array(types.float64, 2, "C")

    def generate(context: Any, builder: Any, _signature: Any, _arguments: tuple[Any, ...]) -> Any:
        room = cgutils.alloca_once(builder, context.get_value_type(types.float64), size=LANES * rows)
        room.align = 64
        scratch = context.make_array(kind)(context, builder)
        shape, strides = ((rows, LANES), (8 * LANES, 8))
        populate_array(
            scratch,
            data=room,
            shape=[context.get_constant(types.intp, count) for count in shape],
            strides=[context.get_constant(types.intp, count) for count in strides],
            itemsize=context.get_constant(types.intp, 8),
            meminfo=None,
        )
        return scratch._getvalue()

    return kind(), generate


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def stacked_rows(_context: Any) -> Any:
    """`numerics.lane_rows` in the caller's own frame."""
    return _stacked(ROWS)


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def stacked_block(_context: Any) -> Any:
    """`numerics.lane_block` in the caller's own frame."""
    return _stacked(BLOCK_ROWS)
