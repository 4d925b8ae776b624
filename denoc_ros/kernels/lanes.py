"""Lanes: several numbers at once, which the compiler keeps in one vector register.

They are written out because the compiler cannot know that the rows of a result do not overlap its
inputs, and would otherwise process one number at a time.
"""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.derivative_layout import LANES
from denoc_ros.kernels.pointers import unchecked

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INDEX = ir.IntType(32)
_COUNTS = ir.VectorType(ir.IntType(64), LANES)
_MASK = ir.VectorType(ir.IntType(1), LANES)
_FLAGS = ('contract', 'nsz')


class Lanes(types.Type):
    """What numba calls LANES numbers side by side."""

    def __init__(self) -> None:
        super().__init__(name='lanes')


lanes = Lanes()


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


def _place(context, builder, sig, args, count):
    """Return the address of so many numbers from args[1] of the pointer args[0] on."""
    start = unchecked(context, builder, sig.args[0], args[0], args[1], count)
    return builder.bitcast(builder.gep(start, [args[1]]), _VECTOR.as_pointer())


def _first(builder, count):
    """Return which lanes come before a count."""
    one = builder.insert_element(ir.Constant(_COUNTS, ir.Undefined), count, _INDEX(0))
    order = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
    every = builder.shuffle_vector(one, ir.Constant(_COUNTS, ir.Undefined), order)
    return builder.icmp_signed('<', ir.Constant(_COUNTS, list(range(LANES))), every)


@intrinsic
def take(_typing, start, offset):
    """Return the numbers from an offset of a pointer on."""

    def generate(context, builder, sig, args):
        count = ir.Constant(ir.IntType(64), LANES)
        return builder.load(_place(context, builder, sig, args, count), align=8)

    return lanes(start, offset), generate


@intrinsic
def put_all(_typing, start, offset, value):
    """Write the numbers from an offset of a pointer on."""

    def generate(context, builder, sig, args):
        count = ir.Constant(ir.IntType(64), LANES)
        builder.store(args[2], _place(context, builder, sig, args, count), align=8)
        return context.get_dummy_value()

    return types.void(start, offset, value), generate


@intrinsic
def spread(_typing, value):
    """Return one number in every lane."""

    def generate(_context, builder, _signature, args):
        one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), args[0], _INDEX(0))
        order = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
        return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), order)

    return lanes(value), generate


@intrinsic
def put_first(_typing, start, offset, value, count):
    """Write the first `count` numbers from an offset of a pointer on."""

    def generate(context, builder, sig, args):
        where = _place(context, builder, sig, args, args[3])
        kind = ir.FunctionType(ir.VoidType(), [_VECTOR, where.type, _INDEX, _MASK])
        name = f'llvm.masked.store.v{LANES}f64.p0'
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        builder.call(function, [args[2], where, _INDEX(8), _first(builder, args[3])])
        return context.get_dummy_value()

    return types.void(start, offset, value, count), generate


@intrinsic
def take_first(_typing, start, offset, count):
    """Return the first `count` numbers from an offset of a pointer on, zeros beyond."""

    def generate(context, builder, sig, args):
        where = _place(context, builder, sig, args, args[2])
        kind = ir.FunctionType(_VECTOR, [where.type, _INDEX, _MASK, _VECTOR])
        name = f'llvm.masked.load.v{LANES}f64.p0'
        function = cgutils.get_or_insert_function(builder.module, kind, name)
        zeros = ir.Constant(_VECTOR, [0.0] * LANES)
        return builder.call(function, [where, _INDEX(8), _first(builder, args[2]), zeros])

    return lanes(start, offset, count), generate


@intrinsic
def plus(_typing, a, b):
    """Return a + b."""

    def generate(_context, builder, _signature, args):
        return builder.fadd(args[0], args[1], flags=_FLAGS)

    return lanes(a, b), generate


@intrinsic
def product(_typing, a, b):
    """Return a b."""

    def generate(_context, builder, _signature, args):
        return builder.fmul(args[0], args[1], flags=_FLAGS)

    return lanes(a, b), generate


@inlined
def plus_product(a, b, c):
    """Return a + b c."""
    return plus(a, product(b, c))


@inlined
def take_some(start, offset, count):
    """Return the first `count` numbers, all where there are more, without reading beyond them."""
    if count >= LANES:
        return take(start, offset)
    return take_first(start, offset, count)


@inlined
def put(start, offset, value, count):
    """Write the first `count` numbers, all where there are more."""
    if count >= LANES:
        put_all(start, offset, value)
    else:
        put_first(start, offset, value, count)
