# SPDX-License-Identifier: Apache-2.0
"""Calls of ATen operations: their arguments by name, where the result goes, and its shape, without running them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import torch
from torch.utils._pytree import tree_leaves, tree_map

from .rows import Unsupported

__all__ = ["Call", "is_view", "written"]


def is_view(func: torch._ops.OpOverload) -> bool:
    """Whether an operation only returns another view of its argument's memory."""
    if func._schema.name == "aten::_unsafe_view":  # does not say so, as torch lets it follow a copy only
        return True
    return any(r.alias_info is not None and not r.alias_info.is_write for r in func._schema.returns)


def written(func: torch._ops.OpOverload, args: Sequence[object], kwargs: Mapping[str, object]) -> list[torch.Tensor]:
    """Tensors that an operation writes, other than those that it makes."""
    found: list[torch.Tensor] = []
    for name, value in _named(func, args, kwargs).items():
        if name in _written_names(func):
            found += [t for t in tree_leaves(value) if isinstance(t, torch.Tensor)]
    return found


def _written_names(func: torch._ops.OpOverload) -> set[str]:
    return {a.name for a in func._schema.arguments if a.alias_info is not None and a.alias_info.is_write}


def _named(func: torch._ops.OpOverload, args: Sequence[object], kwargs: Mapping[str, object]) -> dict[str, object]:
    named: dict[str, object] = {}
    for index, argument in enumerate(func._schema.arguments):
        if index < len(args):
            named[argument.name] = args[index]
        elif argument.name in kwargs:
            named[argument.name] = kwargs[argument.name]
        elif argument.has_default_value():
            named[argument.name] = argument.default_value
    return named


@dataclass
class Call:
    """A call of an operation.

    Attributes:
        func: The operation.
        args: Arguments by position.
        kwargs: Arguments by keyword.
        device: Device that all tensors must be on.
    """

    func: torch._ops.OpOverload
    args: Sequence[object]
    kwargs: Mapping[str, object]
    device: torch.device

    def __post_init__(self) -> None:
        self.named = _named(self.func, self.args, self.kwargs)
        packet = self.func._schema.name.removeprefix("aten::")
        names = _written_names(self.func)
        if len(names) > 1:
            raise Unsupported("writes several tensors")
        self.target: torch.Tensor | None = None
        for name in names:
            target = self.named[name]
            if not isinstance(target, torch.Tensor):
                raise Unsupported("writes no tensor")
            self.target = target
        # In place, an operation has the name of the one that makes a tensor, and an underscore.
        self.name = packet[:-1] if names and packet.endswith("_") else packet
        numbers = self._take_numbers()
        for tensor in self.tensors():
            if any(tensor is number for number in numbers):
                continue
            if tensor.device != self.device or tensor.layout != torch.strided or tensor.is_complex():
                raise Unsupported(f"has a tensor on {tensor.device}")
            if tensor.requires_grad and torch.is_grad_enabled():
                raise Unsupported("is to be differentiated")

    def _take_numbers(self) -> list[torch.Tensor]:
        """Replace numbers that torch has put into tensors on the host, as for ``x[mask] = 0.0``; returns those."""
        found = []
        if self.name in ("fill", "masked_fill", "index_put", "copy") and self.device.type != "cpu":
            for name in ("value", "values", "src"):
                value = self.named.get(name)
                if isinstance(value, torch.Tensor) and value.dim() == 0 and value.device.type == "cpu":
                    self.named[name] = value.item()
                    found.append(value)
        return found

    def tensors(self) -> Iterator[torch.Tensor]:
        """All tensors among the arguments."""
        return (t for t in tree_leaves((tuple(self.args), dict(self.kwargs))) if isinstance(t, torch.Tensor))

    def tensor(self, name: str) -> torch.Tensor:
        """An argument that must be a tensor."""
        value = self.named[name]
        if not isinstance(value, torch.Tensor):
            raise Unsupported(f"has no tensor '{name}'")
        return value

    def operand(self, name: str) -> torch.Tensor | bool | int | float:
        """An argument that must be a tensor or a number."""
        value = self.named[name]
        if not isinstance(value, (torch.Tensor, bool, int, float)):
            raise Unsupported(f"has '{name}' of type {type(value).__name__}")
        return value

    def number(self, name: str) -> bool | int | float:
        """An argument that must be a number."""
        value = self.named[name]
        if not isinstance(value, (bool, int, float)):
            raise Unsupported(f"has '{name}' of type {type(value).__name__}")
        return value

    def sizes(self, name: str) -> tuple[int, ...]:
        """An argument that is a list of whole numbers."""
        value = self.named[name]
        if not isinstance(value, (list, tuple)):
            raise Unsupported(f"has '{name}' of type {type(value).__name__}")
        return tuple(map(int, value))

    def like(self) -> torch.Tensor:
        """The tensor that the call would make, without memory.

        Raises:
            Unsupported: if it makes none, or several.
        """
        call: Callable[..., object] = self.func
        try:
            args, kwargs = tree_map(_without_memory, (tuple(self.args), dict(self.kwargs)))
            if self.name == "linalg_vector_norm":  # of one column, torch 2.11 keeps the dimension on the meta device
                dim = cast("list[int] | None", self.named["dim"])
                made: object = torch.sum(args[0], dim, keepdim=bool(self.named["keepdim"]))
            else:
                made = call(*args, **kwargs)
        except (NotImplementedError, RuntimeError) as error:
            raise Unsupported(f"cannot be planned: {error}") from error
        if not isinstance(made, torch.Tensor) or made.layout != torch.strided:
            raise Unsupported("makes no tensor")
        return made


_META = torch.device("meta")


def _without_memory(value: object) -> object:
    if isinstance(value, torch.Tensor):
        return torch.empty_strided(value.shape, value.stride(), dtype=value.dtype, device=_META)
    return _META if isinstance(value, torch.device) else value
