"""Bare pointers into arrays; with `DENOC_CHECK_BOUNDS=1`, pointers that check every offset.

A bare pointer costs nothing and checks nothing. A checked one knows the number of elements behind
it. Each element that is read or written, and each step to a later element, is compared with that,
and IndexError names the kernel's function that is out of bounds. The names below are the same in
both modes; a bare pointer drops the counts, so that its machine code has none of this.
"""

import operator
import re

from numba import types
from numba.core import cgutils
from numba.core.imputils import lower_constant
from numba.core.typing.builtins import normalize_1d_index
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.experimental import function_type  # noqa: F401 - its constants come before ours
from numba.extending import intrinsic, lower_builtin, models, register_model

from denoc_ros.kernels import CHECKED


class CheckedPointer(types.Type):
    """A pointer to numbers of a type, and how many of them there are."""

    def __init__(self, dtype):
        self.dtype = dtype
        super().__init__(name=f'checked_pointer({dtype})')


@register_model(CheckedPointer)
class _CheckedModel(models.StructModel):
    def __init__(self, manager, kind):
        members = [('data', types.CPointer(kind.dtype)), ('count', types.int64)]
        super().__init__(manager, kind, members)


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args, _keywords):
        start, index = args
        if isinstance(start, CheckedPointer) and isinstance(index, types.Integer):
            return signature(start.dtype, start, normalize_1d_index(index))
        return None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args, _keywords):
        start, index, _ = args
        if isinstance(start, CheckedPointer) and isinstance(index, types.Integer):
            return signature(types.none, start, normalize_1d_index(index), start.dtype)
        return None


def _where(builder):
    """Return the function that is being compiled, as modules and a name."""
    parts = re.match(r'_ZN?((?:\d+\w+?)+)', builder.function.name)
    text, found = (parts.string[3:] if parts else ''), []
    while head := re.match(r'\d+', text):
        size = int(head.group())
        found.append(text[head.end() : head.end() + size])
        text = text[head.end() + size :]
    return '.'.join(found) or 'kernels'


def _refuse_unless(good, context, builder, kind):
    with cgutils.if_unlikely(builder, builder.not_(good)):
        message = f'{_where(builder)}: offset must lie within its array of {kind.dtype}'
        context.call_conv.return_user_exc(builder, IndexError, (message,))


def _element(context, builder, kind, start, index):
    """Return the address of an element that is there."""
    fields = cgutils.create_struct_proxy(kind)(context, builder, start)
    zero = index.type(0)
    good = builder.and_(
        builder.icmp_signed('>=', index, zero), builder.icmp_signed('<', index, fields.count)
    )
    _refuse_unless(good, context, builder, kind)
    return builder.gep(fields.data, [index])


def unchecked(context, builder, kind, start, offset, count):
    """Return a pointer without checks, from whose offset on there are `count` numbers."""
    if not isinstance(kind, CheckedPointer):
        return start
    fields = cgutils.create_struct_proxy(kind)(context, builder, start)
    end = builder.add(offset, count)
    good = builder.and_(
        builder.icmp_signed('>=', offset, offset.type(0)),
        builder.icmp_signed('<=', end, fields.count),
    )
    _refuse_unless(good, context, builder, kind)
    return fields.data


@lower_builtin(operator.getitem, CheckedPointer, types.Integer)
def _load(context, builder, sig, args):
    return builder.load(_element(context, builder, sig.args[0], *args))


@lower_builtin(operator.setitem, CheckedPointer, types.Integer, types.Any)
def _store(context, builder, sig, args):
    start, index, value = args
    builder.store(value, _element(context, builder, sig.args[0], start, index))
    return context.get_dummy_value()


@intrinsic
def pointer(_typing, address, dtype):
    """Return an address as a pointer to numbers of a type, of which nobody knows the count."""
    kind = types.CPointer(dtype.dtype)

    def generate(context, builder, _signature, args):
        return builder.inttoptr(args[0], context.get_value_type(kind))

    return kind(address, dtype), generate


@intrinsic
def bare_span(_typing, address, count, dtype):
    """Return an address as a pointer to `count` numbers of a type."""
    kind = types.CPointer(dtype.dtype)

    def generate(context, builder, _signature, args):
        return builder.inttoptr(args[0], context.get_value_type(kind))

    return kind(address, count, dtype), generate


@intrinsic
def checked_span(_typing, address, count, dtype):
    """Return an address as a pointer to `count` numbers of a type that checks offsets."""
    kind = CheckedPointer(dtype.dtype)

    def generate(context, builder, sig, args):
        made = cgutils.create_struct_proxy(kind)(context, builder)
        made.data = builder.inttoptr(args[0], context.get_value_type(types.CPointer(kind.dtype)))
        made.count = context.cast(builder, args[1], sig.args[1], types.int64)
        return made._getvalue()

    return kind(address, count, dtype), generate


@intrinsic
def bare_beyond(_typing, start, offset):
    """Pointer to `offset` elements after the start of another."""

    def generate(_context, builder, _signature, args):
        return builder.gep(args[0], [args[1]])

    return start(start, offset), generate


@intrinsic
def checked_beyond(_typing, start, offset):
    """Return the same of a pointer that checks offsets; it begins there."""

    def generate(context, builder, sig, args):
        kind = sig.args[0]
        step = context.cast(builder, args[1], sig.args[1], types.int64)
        before = cgutils.create_struct_proxy(kind)(context, builder, args[0])
        good = builder.and_(
            builder.icmp_signed('>=', step, step.type(0)),
            builder.icmp_signed('<=', step, before.count),
        )
        _refuse_unless(good, context, builder, kind)
        made = cgutils.create_struct_proxy(kind)(context, builder)
        made.data = builder.gep(before.data, [step])
        made.count = builder.sub(before.count, step)
        return made._getvalue()

    return start(start, offset), generate


@intrinsic
def bare_part(_typing, start, offset, count):
    """Return the pointer to `count` elements from an offset of another."""

    def generate(_context, builder, _signature, args):
        return builder.gep(args[0], [args[1]])

    return start(start, offset, count), generate


@intrinsic
def checked_part(_typing, start, offset, count):
    """Return the same of a pointer that checks offsets; it ends there too."""

    def generate(context, builder, sig, args):
        kind = sig.args[0]
        step = context.cast(builder, args[1], sig.args[1], types.int64)
        size = context.cast(builder, args[2], sig.args[2], types.int64)
        before = cgutils.create_struct_proxy(kind)(context, builder, args[0])
        good = builder.and_(
            builder.icmp_signed('>=', step, step.type(0)),
            builder.icmp_signed('<=', builder.add(step, size), before.count),
        )
        _refuse_unless(good, context, builder, kind)
        made = cgutils.create_struct_proxy(kind)(context, builder)
        made.data = builder.gep(before.data, [step])
        made.count = size
        return made._getvalue()

    return start(start, offset, count), generate


span = checked_span if CHECKED else bare_span
beyond = checked_beyond if CHECKED else bare_beyond
part = checked_part if CHECKED else bare_part

if CHECKED:

    @lower_constant(types.Dispatcher)
    def _nothing(context, _builder, _kind, _value):
        """Return no address for a function that a kernel calls: it would keep it from the cache.

        The optimizer takes such constants away; checked kernels are not optimized.
        """
        return context.get_dummy_value()
