# SPDX-License-Identifier: Apache-2.0
"""Fusing mode: while active, torch's operations on rows wait, and run as one kernel when something else needs them."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import torch
import warp as wp
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes
from torch.utils._pytree import tree_leaves

from .call import Call, is_view, written
from .chain import Chain, ChainCode
from .chain_kernels import is_compiled, launch_chain
from .memory import Hazard
from .operations import plan
from .plan import Plan
from .rows import Unsupported

__all__ = ["FusingMode", "NotFusible"]


class NotFusible(RuntimeError):
    """A hook does something else than when its chains were compiled."""


class FusingMode(TorchDispatchMode):
    """Collects operations in chains.

    It runs a hook twice. In the first run torch computes as ever, and the chains are only written. In the second one,
    with their kernels compiled, an operation of a chain makes a tensor without values, which the chain's kernel sets.
    Both runs see the same operations and so make the same chains.

    Attributes:
        codes: The chains so far, in order.
        operations: Number of operations of torch that launch something.
        launched: Number of launches so far: kernels of chains, and operations that torch has run.
        alone: Names of operations that torch has run by itself, with reasons.
        for_cuda: Whether the code is for a GPU.
    """

    def __init__(self, device: torch.device, rows: Sequence[int], launches: bool):
        """Prepare.

        Args:
            device: Device of the environment.
            rows: Numbers of rows that chains may have: that of the environments, and of those that are reset.
            launches: Whether the kernels of the chains compute, and not torch.
        """
        super().__init__()
        self._device, self._rows, self._launches = device, tuple(rows), launches
        self.for_cuda = device.type != "cpu"
        self._chain: Chain | None = None
        self.codes: list[ChainCode] = []
        self.operations = self.launched = 0
        self.alone: list[str] = []

    def __enter__(self) -> FusingMode:
        self._warp = contextlib.ExitStack()
        self._warp.enter_context(_before_warp_launches(self.flush))
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._warp.close()
        if error[0] is None:
            self.flush()

    # -- operations

    def __torch_dispatch__(
        self,
        func: torch._ops.OpOverload,
        types: Sequence[type],
        args: Sequence[object] = (),
        kwargs: Mapping[str, object] | None = None,
    ) -> object:
        kwargs = kwargs or {}
        call: Callable[..., object] = func
        if is_view(func):
            return call(*args, **kwargs)
        self.operations += 1
        try:
            # What is asked of torch meanwhile, such as the type of a result, is no part of the hook.
            with _disable_current_modes(), torch._C.DisableTorchFunction():
                return self._add(Call(func, args, kwargs, self._device))
        except Unsupported as reason:
            self.alone.append(f"{func.name().removeprefix('aten::')} {reason}")
        self._flush_for(func, args, kwargs)
        self.launched += 1
        return call(*args, **kwargs)

    def _add(self, call: Call) -> torch.Tensor:
        rows = self._rows_of(call)
        if self._chain is not None and self._chain.rows != rows:
            self.flush()
        made = plan(call, rows)
        try:
            return self._add_planned(call, made, rows)
        except Hazard:
            self.flush()
        try:
            return self._add_planned(call, made, rows)
        except Hazard as error:
            raise Unsupported(str(error)) from error

    def _add_planned(self, call: Call, made: Plan, rows: int) -> torch.Tensor:
        if self._chain is None:
            self._chain = Chain(rows, self.for_cuda)
        return self._chain.add(made, lambda like: self._make(call, like))

    def _rows_of(self, call: Call) -> int:
        """Number of rows of an operation; that of the chain for one that has none."""
        # Of an indexing operation the result has as many rows as there are indices.
        indices = [t for t in tree_leaves(call.named.get("indices")) if isinstance(t, torch.Tensor)]
        sizes = {size for tensor in indices for size in tensor.shape[:1]}
        if not sizes.intersection(self._rows):
            sizes = {size for tensor in call.tensors() for size in tensor.shape[:1]}
        shape = call.named.get("size")
        sizes |= set(shape[:1]) if isinstance(shape, (list, tuple)) else set()
        found = [rows for rows in self._rows if rows in sizes]
        if not found:
            found = [rows for rows in self._rows if any(size and size % rows == 0 for size in sizes)]
        return found[0] if found else self._chain.rows if self._chain is not None else self._rows[0]

    def _make(self, call: Call, like: torch.Tensor | None) -> torch.Tensor:
        """The tensor of a result."""
        if not self._launches:
            run: Callable[..., object] = call.func
            made = run(*call.args, **call.kwargs)
            assert isinstance(made, torch.Tensor)
            if like is not None and (made.shape != like.shape or made.stride() != like.stride()):
                raise NotFusible(f"{call.name} gives strides {made.stride()}, not {like.stride()} as was planned")
            return made
        if like is None:
            assert call.target is not None
            return call.target
        return torch.empty_strided(like.shape, like.stride(), dtype=like.dtype, device=self._device)

    # -- launches

    def _flush_for(self, func: torch._ops.OpOverload, args: Sequence[object], kwargs: Mapping[str, object]) -> None:
        """Launch the chain if an operation that torch runs needs its results, or writes what it has yet to read."""
        if self._chain is None:
            return
        tensors = [t for t in tree_leaves((tuple(args), dict(kwargs))) if isinstance(t, torch.Tensor)]
        try:
            reads, writes = (self._chain.memory.regions_of(t) for t in (tensors, written(func, args, kwargs)))
            if writes or any(region.dirty for region in reads):
                self.flush()
        except Hazard:
            self.flush()

    def flush(self) -> None:
        """Launch the chain."""
        chain, self._chain = self._chain, None
        code = chain.finish() if chain is not None else None
        if code is None:
            return
        self.codes.append(code)
        self.launched += 1
        if self._launches:
            if not is_compiled(code):
                raise NotFusible("its operations are others than in the run before")
            launch_chain(code, str(self._device))


@contextlib.contextmanager
def _before_warp_launches(flush: Callable[[], None]) -> Iterator[None]:
    """Call a function before each call to Warp that may read or write memory on the device."""
    # Warp has no hook for this. Its launches and copies go through these functions, and on a GPU through its library.
    wp.init()
    core, thread = wp._src.context.runtime.core, threading.get_ident()
    places: list[tuple[object, str]] = [(wp, "launch"), (wp.Launch, "launch"), (wp.array, "zero_"), (wp.array, "fill_")]
    places += [(core, name) for name in vars(core) if _may_use_memory(name)]
    originals = [(holder, name, getattr(holder, name)) for holder, name in places]

    def flushed(function: Callable[..., object]) -> Callable[..., object]:
        def call(*args: object, **kwargs: object) -> object:
            if threading.get_ident() == thread:  # and not that of a viewer
                flush()
            return function(*args, **kwargs)

        return call

    try:
        for holder, name, function in originals:
            setattr(holder, name, flushed(function))
        yield
    finally:
        for holder, name, function in originals:
            setattr(holder, name, function)


def _may_use_memory(name: str) -> bool:
    """Whether a function of Warp's library launches something or copies memory, by its name."""
    if name.startswith(("wp_alloc", "wp_free")):
        return False
    launches = ("wp_mem", "wp_cuda_launch_kernel", "wp_cpu_launch_kernel", "wp_cuda_graph_launch", "wp_array")
    return name.startswith(launches) or name.endswith(("_host", "_device"))
