"""Lanes: several numbers at once, which the compiler keeps in one vector register.

They are written out because the compiler cannot know that the rows of a result do not overlap its
inputs, and would otherwise process one number at a time. Lanes add, subtract and multiply as
numbers do, with each other and with one number, so that the products of vectors serve them too.
"""

import operator

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from denoc_ros.kernels.jit.compiled import inlined
from denoc_ros.kernels.jit.pointers import unchecked
from denoc_ros.kernels.layout.derivative_layout import LANES

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_INDEX = ir.IntType(32)
_COUNTS = ir.VectorType(ir.IntType(64), LANES)
_MASK = ir.VectorType(ir.IntType(1), LANES)
_FLAGS = ('contract', 'nsz')


class Lanes(types.Type):
    """Numba type of LANES numbers side by side."""

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


def _in_every_lane(builder, number):
    """Return one number in every lane."""
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, _INDEX(0))
    order = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), order)


@intrinsic
def spread(_typing, value):
    """Return one number in every lane."""

    def generate(_context, builder, _signature, args):
        return _in_every_lane(builder, args[0])

    return lanes(value), generate


@intrinsic
def ones_before(_typing, count):
    """Return 1 in the first `count` lanes and 0 in the others; any integer is a count."""

    def generate(_context, builder, _signature, args):
        ones = ir.Constant(_VECTOR, [1.0] * LANES)
        zeros = ir.Constant(_VECTOR, [0.0] * LANES)
        return builder.select(_first(builder, args[0]), ones, zeros)

    return lanes(count), generate


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


@intrinsic
def total(_typing, value):
    """Return the sum over all lanes."""

    def generate(_context, builder, _signature, args):
        parts = [builder.extract_element(args[0], _INDEX(k)) for k in range(LANES)]
        while len(parts) > 1:
            half = len(parts) // 2
            parts = [
                builder.fadd(a, b, flags=_FLAGS)
                for a, b in zip(parts[:half], parts[half:], strict=True)
            ]
        return parts[0]

    return types.float64(value), generate


class _Arithmetic(AbstractTemplate):
    """Lanes with lanes, or with one number, which then stands in every lane."""

    def generic(self, args, _keywords):
        kinds = (Lanes, types.Float)
        if any(isinstance(one, Lanes) for one in args) and all(isinstance(a, kinds) for a in args):
            return signature(lanes, *args)
        return None


def _as_lanes(builder, kind, value):
    return value if isinstance(kind, Lanes) else _in_every_lane(builder, value)


def _declare_operator(function, instruction):
    """Let an operator of two numbers take lanes; instruction names it in the builder."""

    def generate(_context, builder, sig, args):
        pair = [_as_lanes(builder, *one) for one in zip(sig.args, args, strict=True)]
        return getattr(builder, instruction)(*pair, flags=_FLAGS)

    infer_global(function)(type('_Operator', (_Arithmetic,), {}))
    for kinds in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(function, *kinds)(generate)


_declare_operator(operator.add, 'fadd')
_declare_operator(operator.sub, 'fsub')
_declare_operator(operator.mul, 'fmul')


@infer_global(operator.neg)
class _Negative(_Arithmetic):
    """The change of sign of lanes."""


@lower_builtin(operator.neg, Lanes)
def _negative(_context, builder, _signature, args):
    return builder.fsub(ir.Constant(_VECTOR, [-0.0] * LANES), args[0], flags=_FLAGS)


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


@inlined
def take_vector(a, o, step):
    """Return a vector whose elements stand `step` apart, of several columns at once."""
    return take(a, o), take(a, o + step), take(a, o + 2 * step)


@inlined
def take_pair(a, o, step):
    """Return two such vectors, one after the other."""
    return take_vector(a, o, step), take_vector(a, o + 3 * step, step)


@inlined
def put_vector(a, o, step, v):
    """Write a vector whose elements stand `step` apart, of several columns at once."""
    put_all(a, o, v[0])
    put_all(a, o + step, v[1])
    put_all(a, o + 2 * step, v[2])


@inlined
def add_vector(a, o, step, v):
    """Add a vector of lanes to the vector at an offset."""
    put_vector(
        a, o, step, (take(a, o) + v[0], take(a, o + step) + v[1], take(a, o + 2 * step) + v[2])
    )


@inlined
def put_pair(a, o, step, x):
    """Write two such vectors, one after the other."""
    put_vector(a, o, step, x[0])
    put_vector(a, o + 3 * step, step, x[1])


@inlined
def add_pair(a, o, step, x):
    """Add two vectors of lanes to those at an offset."""
    add_vector(a, o, step, x[0])
    add_vector(a, o + 3 * step, step, x[1])
