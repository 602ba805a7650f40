"""Matrix products for the compiled loops, in tiles that stay in the processor's registers.

A product C = A B goes tile by tile: a few rows of C times a strip of two vectors of its columns
are summed in registers, and each number of A is spread over a vector once. A is constant for a
whole search, so that its rows are packed once into panels, in the order in which a tile reads them;
B and C are small enough to stay in the cache. Nothing of a BLAS is needed, with its threads, its
calls for small matrices and its settings.
"""

from __future__ import annotations

import platform

import llvmlite.binding as llvm
import numpy as np
from llvmlite import ir
from numba import config, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from mcpilco.search.fused.arithmetic import PLAIN


def _vector_bytes() -> int:
    """How wide the vectors are that numba compiles for: this processor's, or what it was told.

    Raises:
        ImportError: the processor has no fused multiply-add, which the exponential is made of.
    """
    told = config.CPU_FEATURES
    has = {f[1:]: f[0] == "+" for f in told.split(",")} if told else llvm.get_host_cpu_features()
    if platform.machine().lower() in ("x86_64", "amd64") and not has.get("fma"):
        raise ImportError("this processor has no fused multiply-add (FMA3)")
    return 64 if has.get("avx512f") else 32 if has.get("avx") else 16


_VECTOR_BYTES = _vector_bytes()
_STRIP_VECTORS = 2
STRIP_BYTES = _STRIP_VECTORS * _VECTOR_BYTES
"""width of a tile; the width of every product is a multiple of it"""
TALL, LOW = (6, 2) if _VECTOR_BYTES == 32 else (12, 4)
"""rows of a tile: the sums of a tall one, two vectors each, fill 16 registers, or 32"""
_LOW_COSTS = 1.15
"""time of a row in a low tile, in parts of one in a tall tile: its sums wait for each other"""


def strip(dtype: np.dtype) -> int:
    """How many numbers a tile is wide."""
    return STRIP_BYTES // np.dtype(dtype).itemsize


def height_for(rows: int) -> int:
    """The height of tiles that multiplies so many rows the fastest."""
    tall, low = (-(-rows // height) * height for height in (TALL, LOW))
    return TALL if tall <= _LOW_COSTS * low else LOW


def pack(matrix: np.ndarray, height: int | None = None) -> np.ndarray:
    """The panels (*b, panels, K, height) of matrices (*b, M, K), zeros behind the last row."""
    *batch, rows, inner = matrix.shape
    height = height or height_for(rows)
    panels = -(-rows // height)
    padded = np.zeros((*batch, panels * height, inner), dtype=matrix.dtype)
    padded[..., :rows, :] = matrix
    return np.ascontiguousarray(padded.reshape(*batch, panels, height, inner).swapaxes(-1, -2))


def _tile(height: int, accumulate: bool):
    """An intrinsic: C[r, c] = sum_i A[r, i] B[i, c] of one tile, or C[r, c] += the same."""

    @intrinsic
    def tile(typing_context, a, a_at, a_row, a_inner, b, b_at, b_inner, c, c_at, c_row, inner):
        """Each array comes with the place of its first number and the strides of its axes."""
        kinds, bits, place = (a, b, c), a.dtype.bitwidth, types.int64
        lanes, alignment = 8 * _VECTOR_BYTES // bits, bits // 8

        def generate(context, builder, signature, args):
            a, a_at, a_row, a_inner, b, b_at, b_inner, c, c_at, c_row, inner = args
            vector = ir.VectorType(context.get_value_type(kinds[0].dtype), lanes)
            zeros = ir.Constant(vector, [0.0] * lanes)
            nowhere = ir.Constant(vector, ir.Undefined)
            first_lane = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
            a_data, b_data, c_data = (
                context.make_array(kind)(context, builder, array).data
                for kind, array in zip(kinds, (a, b, c), strict=True)
            )

            def step(at, stride, count):
                return builder.add(at, builder.mul(stride, ir.IntType(64)(count)))

            def strip_at(data, at):
                """Where the vectors of a strip are."""
                for v in range(_STRIP_VECTORS):
                    first = builder.gep(data, [step(at, ir.IntType(64)(lanes), v)])
                    yield builder.bitcast(first, vector.as_pointer())

            def spread(number):
                """A vector of one number."""
                return builder.shuffle_vector(
                    builder.insert_element(nowhere, number, ir.IntType(32)(0)), nowhere, first_lane
                )

            tops = [step(c_at, c_row, r) for r in range(height)]
            targets = [target for top in tops for target in strip_at(c_data, top)]
            sums = [cgutils.alloca_once(builder, vector) for _ in targets]
            for total, target in zip(sums, targets, strict=True):
                first = builder.load(target, align=alignment) if accumulate else zeros
                builder.store(first, total)
            with cgutils.for_range(builder, inner) as loop:
                b_now = builder.add(b_at, builder.mul(loop.index, b_inner))
                columns = [builder.load(p, align=alignment) for p in strip_at(b_data, b_now)]
                a_now = builder.add(a_at, builder.mul(loop.index, a_inner))
                for r in range(height):
                    factor = spread(builder.load(builder.gep(a_data, [step(a_now, a_row, r)])))
                    for v, column in enumerate(columns):
                        total = sums[r * _STRIP_VECTORS + v]
                        product = builder.fmul(factor, column, flags=("contract",))
                        more = builder.fadd(product, builder.load(total), flags=("contract",))
                        builder.store(more, total)
            for total, target in zip(sums, targets, strict=True):
                builder.store(builder.load(total), target, align=alignment)
            return context.get_dummy_value()

        places = (place,) * 3, (place,) * 2, (place,) * 3
        return types.void(a, *places[0], b, *places[1], c, *places[2]), generate

    return tile


_tall, _low = _tile(TALL, accumulate=False), _tile(LOW, accumulate=False)
_tall_more = _tile(TALL, accumulate=True)


@intrinsic
def _stay_apart(typing_context):
    """Keeps the function that calls it out of those that call that one: it is compiled once."""

    def generate(context, builder, signature, args):
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate


@njit(**PLAIN)
def _panel(packed, panel, start, stop, right, out):
    """A panel's rows of the product, from the inner indices start to stop."""
    _stay_apart()
    _, inner, height = packed.shape
    width = out.shape[1]
    a, c, n = (panel * inner + start) * height, panel * height * width, stop - start
    for column in range(0, width, STRIP_BYTES // packed.itemsize):
        b = start * width + column
        if height == TALL:
            _tall(packed, a, 1, height, right, b, width, out, c + column, width, n)
        else:
            _low(packed, a, 1, height, right, b, width, out, c + column, width, n)


@njit(**PLAIN)
def multiply(packed, right, out):
    """The product of packed (M, K) with the first K rows of `right`, in the first M of `out`."""
    for panel in range(packed.shape[0]):
        _panel(packed, panel, 0, packed.shape[1], right, out)


@njit(**PLAIN)
def multiply_lower(packed, right, out):
    """The same for a lower triangular matrix."""
    panels, inner, height = packed.shape
    for panel in range(panels):
        _panel(packed, panel, 0, min((panel + 1) * height, inner), right, out)


@njit(**PLAIN)
def multiply_upper(packed, right, out):
    """The same for an upper triangular matrix."""
    panels, inner, height = packed.shape
    for panel in range(panels):
        _panel(packed, panel, panel * height, inner, right, out)


@njit(**PLAIN)
def add_product(left, right, out):
    """Add to `out` (M, C) the product of left (M, K), which is not packed, and right (K, C).

    M is a multiple of TALL.
    """
    inner, width = right.shape
    for first in range(0, out.shape[0], TALL):
        a, c = first * inner, first * width
        for column in range(0, width, STRIP_BYTES // right.itemsize):
            at = c + column
            _tall_more(left, a, inner, 1, right, column, width, out, at, width, inner)
