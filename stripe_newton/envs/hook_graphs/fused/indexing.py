# SPDX-License-Identifier: Apache-2.0
"""Indexing operations of chains: rows of some environments, columns by a list of indices, elements by a mask."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from .call import Call
from .memory import Access, Indexed
from .plan import Operand, Plan
from .rows import Frame, Unsupported
from .source import Source, Value

__all__ = ["INDEXING"]


@dataclass(frozen=True)
class _Subscript:
    """Dimensions of ``x[indices]``.

    Attributes:
        shape: Shape of the result.
        at: First dimension of the result that the indices have made.
        made: Number of such dimensions.
        kept: For each dimension of the result the dimension of ``x`` that it is; None for those that indices have made.
    """

    shape: tuple[int, ...]
    at: int
    made: int
    kept: tuple[int | None, ...]


def _subscript(x: torch.Tensor, indices: Sequence[torch.Tensor | None]) -> _Subscript:
    indexed = [dim for dim, index in enumerate(indices) if index is not None]
    made = torch.broadcast_shapes(*(index.shape for index in indices if index is not None))
    adjacent = indexed == list(range(indexed[0], indexed[-1] + 1))
    at = indexed[0] if adjacent else 0
    kept: list[int | None] = [dim for dim in range(x.dim()) if dim not in indexed]
    kept[at:at] = [None] * len(made)
    sizes = iter(made)
    shape = tuple(x.shape[dim] if dim is not None else next(sizes) for dim in kept)
    return _Subscript(shape, at, len(made), tuple(kept))


def _indices(call: Call, x: torch.Tensor) -> list[torch.Tensor | None]:
    indices: list[torch.Tensor | None] = list(call.named["indices"])  # type: ignore[call-overload]
    given = [index for index in indices if index is not None]
    if not given or any(index.dtype not in (torch.int64, torch.int32) for index in given):
        raise Unsupported("selects elements by a mask")
    return indices + [None] * (x.dim() - len(indices))


def _index_accesses(frame: Frame, subscript: _Subscript, indices: Sequence[torch.Tensor | None]) -> list[Access]:
    found = []
    after = len(subscript.shape) - subscript.at - subscript.made
    for index in indices:
        if index is not None:
            sizes, strides = (*index.shape, *[1] * after), (*index.stride(), *[0] * after)
            found.append(Access(index, frame.view_of(sizes, strides, index)))
    return found


def _elements(frame: Frame, subscript: _Subscript, x: torch.Tensor, indices: Sequence[torch.Tensor | None]) -> Indexed:
    """The elements of ``x`` that indices select."""
    sizes = [x.shape[dim] if dim is not None else 1 for dim in subscript.kept]
    strides = [x.stride(dim) if dim is not None else 0 for dim in subscript.kept]
    given = [dim for dim, index in enumerate(indices) if index is not None]
    steps = tuple((number, x.stride(dim) * x.element_size(), x.shape[dim]) for number, dim in enumerate(given))
    return Indexed(Access(x, frame.view_of(sizes, strides, x)), steps)


def _index(call: Call, rows: int) -> Plan:
    x, like = call.tensor("self"), call.like()
    indices = _indices(call, x)
    subscript = _subscript(x, indices)
    if subscript.shape != tuple(like.shape):
        raise Unsupported("selects elements in another way")
    frame = Frame.of(subscript.shape, rows)
    inputs = _index_accesses(frame, subscript, indices)
    return Plan(frame, inputs, lambda s, read: read[-1], like, gathered=_elements(frame, subscript, x, indices))


def _index_select(call: Call, rows: int) -> Plan:
    x, index = call.tensor("self"), call.tensor("index")
    dim = int(call.number("dim")) % x.dim()
    indices = [index.reshape(-1) if d == dim else None for d in range(x.dim())]
    subscript, like = _subscript(x, indices), call.like()
    frame = Frame.of(subscript.shape, rows)
    inputs = _index_accesses(frame, subscript, indices)
    return Plan(frame, inputs, lambda s, read: read[-1], like, gathered=_elements(frame, subscript, x, indices))


def _index_put(call: Call, rows: int) -> Plan:
    x, values = call.target, call.operand("values")
    if x is None or call.named.get("accumulate"):
        raise Unsupported("adds by indices")
    given = list(call.named["indices"])  # type: ignore[call-overload]
    is_number = not isinstance(values, torch.Tensor) or values.numel() == 1
    if len(given) == 1 and given[0] is not None and given[0].dtype == torch.bool and is_number:
        return _masked(call, rows, x, given[0], values)
    indices = _indices(call, x)
    subscript = _subscript(x, indices)
    frame = Frame.of(subscript.shape, rows)
    inputs = _index_accesses(frame, subscript, indices)
    count, dtype = len(inputs), x.dtype
    if isinstance(values, torch.Tensor):
        inputs.append(Access(values, frame.view(values)))

    def compute(s: Source, read: list[list[Value]]) -> list[Value]:
        if isinstance(values, torch.Tensor):
            return read[count]
        return [s.literal(values, dtype)] * math.prod(frame.inner)

    target = _elements(frame, subscript, x, indices)
    return Plan(frame, inputs, compute, None, target=x, scattered=target)


def _masked(call: Call, rows: int, x: torch.Tensor, mask: torch.Tensor, value: Operand) -> Plan:
    """``x[mask] = number``."""
    frame = Frame.of(x.shape, rows)
    after = x.dim() - mask.dim()
    inputs = [Access(mask, frame.view_of((*mask.shape, *[1] * after), (*mask.stride(), *[0] * after), mask))]
    inputs.append(Access(x, frame.view(x)))
    if isinstance(value, torch.Tensor):
        inputs.append(Access(value, frame.view_of((), (), value)))

    def compute(s: Source, read: list[list[Value]]) -> list[Value]:
        number = read[2][0] if isinstance(value, torch.Tensor) else s.literal(value, x.dtype)
        new = s.cast(number, x.dtype)
        return [s.select(condition, new, old) for condition, old in zip(read[0], read[1], strict=True)]

    return Plan(frame, inputs, compute, None, target=x)


INDEXING: dict[str, Callable[[Call, int], Plan]] = {
    "index": _index,
    "index_select": _index_select,
    "index_put": _index_put,
}
"""Makers of plans of indexing operations."""
