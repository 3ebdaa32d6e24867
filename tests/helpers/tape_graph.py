# SPDX-License-Identifier: Apache-2.0
"""Tape graph: a stand-in for a CUDA graph on the CPU, which repeats torch's and Warp's calls on the same memory.

Like a graph it holds addresses and numbers as they were when it was recorded, and runs no Python of the function again.
Unlike one it runs while it is recorded; the caller restores the state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
import warp as wp
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten

_VIEWS = ("aten::detach", "aten::lift_fresh", "aten::set_")


class TapeGraph:
    """What a function called, for :meth:`replay`."""

    def __init__(self, function: Callable[[], None]):
        self.calls: list[Callable[[], None]] = []
        with pytest.MonkeyPatch.context() as patch:
            for name in ("launch", "copy"):
                patch.setattr(wp, name, self._taped(getattr(wp, name)))
            patch.setattr(wp.Launch, "launch", self._taped(wp.Launch.launch))
            with _Tape(self.calls):
                function()

    def _taped(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            if not kwargs.get("record_cmd"):
                self.calls.append(lambda: function(*args, **kwargs))
            return function(*args, **kwargs)

        return call

    def replay(self) -> None:
        for call in self.calls:
            call()


class _Tape(TorchDispatchMode):
    def __init__(self, calls: list[Callable[[], None]]):
        super().__init__()
        self._calls = calls

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        made = func(*args, **kwargs)
        schema = func._schema
        if any(r.alias_info is not None and not r.alias_info.is_write for r in schema.returns):
            return made  # a view: its memory is that of what it views
        tensors = [t for t in tree_flatten(made)[0] if isinstance(t, torch.Tensor)]
        writes = any(a.alias_info is not None and a.alias_info.is_write for a in schema.arguments)

        def again() -> None:
            values = tree_flatten(func(*args, **kwargs))[0]
            if not writes:  # the new values go to the memory that the recording had for them
                for home, value in zip(tensors, [v for v in values if isinstance(v, torch.Tensor)], strict=True):
                    if home.numel():
                        home.untyped_storage().copy_(value.untyped_storage())

        self._calls.append(again)
        return made
