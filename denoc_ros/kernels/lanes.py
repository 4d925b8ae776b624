"""Several numbers at once: what the compiler keeps in one vector register.

Written out because the compiler cannot know that the rows of a result lie apart from those that it
is made of, and so would take one number at a time.
"""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

from denoc_ros.kernels.compiled import inlined
from denoc_ros.kernels.derivative_layout import LANES

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INDEX = ir.IntType(32)
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


def _place(builder, start, offset):
    return builder.bitcast(builder.gep(start, [offset]), _VECTOR.as_pointer())


@intrinsic
def take(_typing, start, offset):
    """Return the numbers from an offset of a pointer on."""

    def generate(_context, builder, _signature, args):
        return builder.load(_place(builder, args[0], args[1]), align=8)

    return lanes(start, offset), generate


@intrinsic
def put_all(_typing, start, offset, value):
    """Write the numbers from an offset of a pointer on."""

    def generate(context, builder, _signature, args):
        builder.store(args[2], _place(builder, args[0], args[1]), align=8)
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
def lane(_typing, value, index):
    """Return the number of a lane."""

    def generate(_context, builder, _signature, args):
        return builder.extract_element(args[0], args[1])

    return types.float64(value, index), generate


@intrinsic
def with_lane(_typing, value, index, number):
    """Return a value with another number in one lane."""

    def generate(_context, builder, _signature, args):
        return builder.insert_element(args[0], args[2], args[1])

    return lanes(value, index, number), generate


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
    value = spread(0.0)
    for k in range(count):
        value = with_lane(value, k, start[offset + k])
    return value


@inlined
def put(start, offset, value, count):
    """Write the first `count` numbers, all where there are more."""
    if count >= LANES:
        put_all(start, offset, value)
        return
    for k in range(count):
        start[offset + k] = lane(value, k)
