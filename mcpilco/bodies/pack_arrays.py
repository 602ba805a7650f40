"""Arrays of packs, for compiled callers: the lanes come last, and indexing gives packs."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from numba import types
from numba.core import cgutils, imputils
from numba.extending import intrinsic as numba_intrinsic
from numba.extending import make_attribute_wrapper, models, overload, register_model

from mcpilco.bodies.packs import NUMBERS, PACK, Pack, as_vector, lowered

intrinsic: Callable[..., Any] = numba_intrinsic
"""its hints count the context among the arguments of a call"""


class PacksType(types.Type):
    """numba's type of an array of packs."""

    def __init__(self, data: types.Array) -> None:
        super().__init__(f"Packs({data})")
        self.data = data


@register_model(PacksType)
class _PacksModel(models.StructModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, [("data", kind.data)])


make_attribute_wrapper(PacksType, "data", "data")


@overload(len)
def _len(packs):
    return (lambda packs: packs.data.shape[0]) if isinstance(packs, PacksType) else None


def _wrap(context, builder, kind, array):
    packs = cgutils.create_struct_proxy(kind)(context, builder)
    packs.data = array
    return packs._getvalue()


@intrinsic
def _row(_context, data):
    kind = PacksType(data)

    def generate(context, builder, _signature, args):
        packs = _wrap(context, builder, kind, args[0])
        return imputils.impl_ret_borrowed(context, builder, kind, packs)

    return kind(data), generate


@intrinsic
def as_packs(_context, arrays):
    """A tuple of arrays as one of packs, whose lanes are last; what are no floats stays.

    Tuples in it are changed likewise.
    """

    def changed(kind: Any) -> types.Type:
        if isinstance(kind, types.BaseTuple):
            each: Any = kind
            return types.BaseTuple.from_types([changed(one) for one in each], _class_of(kind))
        floats = isinstance(kind, types.Array) and kind.dtype == types.float64
        return PacksType(kind) if floats else kind

    def emit(context, builder, before, after, value):
        if before == after:
            return value
        if isinstance(after, PacksType):
            return _wrap(context, builder, after, value)
        parts = cgutils.unpack_tuple(builder, value)
        each = zip(before, after, parts, strict=True)
        return context.make_tuple(builder, after, [emit(context, builder, *one) for one in each])

    def generate(context, builder, _signature, args):
        packs = emit(context, builder, arrays, result, args[0])
        return imputils.impl_ret_borrowed(context, builder, result, packs)

    result = changed(arrays)
    return result(arrays), generate


def _class_of(kind: types.BaseTuple) -> type | None:
    """Of a named tuple."""
    return getattr(kind, "instance_class", None)


def _as_tuple(index: Any) -> tuple[Any, ...]:
    """The types of indices, where there is one too."""
    many: Any = index if isinstance(index, types.BaseTuple) else (index,)
    return tuple(many)


def _pointer(context, builder, signature, args):
    """To the numbers of a pack, of an array of packs and indices."""
    packs = cgutils.create_struct_proxy(signature.args[0])(context, builder, args[0])
    array = context.make_array(signature.args[0].data)(context, builder, packs.data)
    tupled = isinstance(signature.args[1], types.BaseTuple)
    values = cgutils.unpack_tuple(builder, args[1]) if tupled else [args[1]]
    pairs = zip(values, _as_tuple(signature.args[1]), strict=True)
    indices = [context.cast(builder, x, kind, types.intp) for x, kind in pairs]
    shape = cgutils.unpack_tuple(builder, array.shape)
    strides = cgutils.unpack_tuple(builder, array.strides)
    indices.append(context.get_constant(types.intp, 0))
    first = cgutils.get_item_pointer2(context, builder, array.data, shape, strides, "C", indices)
    return builder.bitcast(first, NUMBERS.as_pointer())


def _load(context, builder, signature, args):
    return builder.load(_pointer(context, builder, signature, args), align=8)


def _store(context, builder, signature, args):
    x = as_vector(context, builder, signature.args[2], args[2])
    builder.store(x, _pointer(context, builder, signature, args), align=8)
    return context.get_dummy_value()


def _one(packs: Any, index: Any) -> bool:
    """Whether indices are of one pack."""
    return isinstance(packs, PacksType) and len(_as_tuple(index)) == packs.data.ndim - 1


_INDICES = types.Integer, types.BaseTuple
lowered(
    operator.getitem,
    lambda packs, index: PACK if _one(packs, index) else None,
    _load,
    *((PacksType, kind) for kind in _INDICES),
)
lowered(
    operator.setitem,
    lambda packs, index, _x: types.void if _one(packs, index) else None,
    _store,
    *((PacksType, kind, x) for kind in _INDICES for x in (Pack, types.Number)),
)


@overload(operator.getitem)
def _getitem(packs, index):
    """Of fewer indices: the packs behind them."""
    if not isinstance(packs, PacksType) or _one(packs, index):
        return None
    return lambda packs, index: _row(packs.data[index])
