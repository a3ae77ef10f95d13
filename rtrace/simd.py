"""Four float64 side by side in one register, as a Numba type with the few operations that the box test needs.

LLVM's own vectorisers find nothing in the BVH kernel. Without these it takes 1.15 to 1.23 times the time (`make bench`) for
the same bits, on processors without such registers too. Where nothing is compiled, lanes are tuples.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.extending import register_model

from nptrace_base.jit import instructions

_FOUR_DOUBLES = ir.VectorType(ir.DoubleType(), 4)
_FOUR_FLOATS = ir.VectorType(ir.FloatType(), 4)


class LanesType(types.Type):
    """The type of four float64; values exist inside kernels only."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


LANES = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: LanesType) -> None:
        super().__init__(manager, type_, _FOUR_DOUBLES)


def _index(i: int) -> ir.Constant:
    return ir.Constant(ir.IntType(32), i)


@instructions(lambda x, y, z: (x, y, z, z))
def pack(typing, x, y, z):
    """Return three float64 as lanes; the fourth is that of ``z``."""

    def generate(context, builder, signature, args):
        lanes = ir.Constant(_FOUR_DOUBLES, ir.Undefined)
        for i, value in enumerate((*args, args[2])):
            lanes = builder.insert_element(lanes, value, _index(i))
        return lanes

    return LANES(types.float64, types.float64, types.float64), generate


@instructions(lambda a, b: (a, a, b, b))
def pack_halves(typing, a, b):
    """Return two float64 as lanes: the first two are ``a``, the others ``b``."""

    def generate(context, builder, signature, args):
        lanes = ir.Constant(_FOUR_DOUBLES, ir.Undefined)
        for i in range(4):
            lanes = builder.insert_element(lanes, args[i // 2], _index(i))
        return lanes

    return LANES(types.float64, types.float64), generate


@instructions(lambda array, start: tuple(array[start : start + np.uint64(4)].astype(np.float64)))
def load(typing, array, start):
    """Return four float32 of a flat array, from ``start`` on, as lanes. The bounds are not checked."""

    def generate(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        first = builder.gep(data, [args[1]])
        return builder.fpext(builder.load(builder.bitcast(first, _FOUR_FLOATS.as_pointer()), align=4), _FOUR_DOUBLES)

    return LANES(array, start), generate


@instructions(lambda *lanes: tuple((a - b) * factor for a, b, factor in zip(*lanes, strict=True)))
def scaled_difference(typing, a, b, factor):
    """Return (a - b) * factor."""

    def generate(context, builder, signature, args):
        return builder.fmul(builder.fsub(args[0], args[1]), args[2])

    return LANES(LANES, LANES, LANES), generate


@instructions(lambda *lanes: tuple(a if a < b else b for a, b in zip(*lanes, strict=True)))
def smaller(typing, a, b):
    """Return the smaller of each pair of lanes."""

    def generate(context, builder, signature, args):
        return builder.select(builder.fcmp_ordered("<", *args), *args)

    return LANES(LANES, LANES), generate


@instructions(lambda *lanes: tuple(a if a > b else b for a, b in zip(*lanes, strict=True)))
def larger(typing, a, b):
    """Return the larger of each pair of lanes."""

    def generate(context, builder, signature, args):
        return builder.select(builder.fcmp_ordered(">", *args), *args)

    return LANES(LANES, LANES), generate


@instructions(lambda lanes: lanes[:3])
def unpack(typing, lanes):
    """Return the first three lanes as a tuple of float64."""
    return types.UniTuple(types.float64, 3)(LANES), _unpacked(3)


@instructions(lambda lanes: lanes)
def unpack_all(typing, lanes):
    """Return the lanes as a tuple of float64."""
    return types.UniTuple(types.float64, 4)(LANES), _unpacked(4)


def _unpacked(n: int) -> Any:
    def generate(context, builder, signature, args):
        values = [builder.extract_element(args[0], _index(i)) for i in range(n)]
        return context.make_tuple(builder, signature.return_type, values)

    return generate
