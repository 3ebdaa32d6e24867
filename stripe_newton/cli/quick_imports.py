# SPDX-License-Identifier: Apache-2.0
"""Quick imports: leaves out what libraries do while they are imported that a command of this program does not need.

Together that is a quarter of the time that the imports of ``train`` take. Only commands use it, whose process is their
own: a program that imports stripe_newton gets its libraries as they are.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from types import ModuleType
from typing import TypeVar

__all__ = ["defer_dynamo", "import_quickly", "skip_module_references"]

_F = TypeVar("_F", bound=Callable[..., object])
_DYNAMO = "torch._dynamo"


def import_quickly() -> None:
    """Import torch, Warp and Newton, and prepare the first two for quick imports of what builds on them."""
    skip_module_references()
    import newton  # noqa: F401  (before torch, whose libraries may be loading in a thread, see `early_libraries`)

    defer_dynamo()


def defer_dynamo() -> None:
    """Load the front end of torch's compiler, 800 modules, when something first asks for more than its marks.

    TensorDict marks functions for it when it is imported, and torch's optimisers in each step, whether or not anything
    is ever compiled.
    """
    import torch

    if _DYNAMO not in sys.modules:
        sys.modules[_DYNAMO] = torch._dynamo = _DeferredDynamo(_DYNAMO)


class _DeferredDynamo(ModuleType):
    """Stands for ``torch._dynamo`` until it is used: marks functions, as long as nothing is compiled."""

    def graph_break(self, msg: str = "") -> None:
        """Break nothing: nothing is compiled."""

    def assume_constant_result(self, function: _F) -> _F:
        """The function as it is."""
        return function

    def allow_in_graph(self, function: _F) -> _F:
        """The function as it is."""
        return function

    def disable(
        self, function: Callable[..., object], recursive: bool = True, **options: object
    ) -> Callable[..., object]:
        """A function that calls ``function``: by the compiler's own wrapper, from when on that is loaded."""
        wrapped: Callable[..., object] | None = None

        def call(*args: object, **kwargs: object) -> object:
            nonlocal wrapped
            if wrapped is None:
                if sys.modules.get(_DYNAMO) is self:
                    return function(*args, **kwargs)
                wrapped = sys.modules[_DYNAMO].disable(function, recursive, **options)
            return wrapped(*args, **kwargs)

        return call

    def __getattr__(self, name: str) -> object:
        # The import system asks every module that it finds for these.
        if name in ("__spec__", "__file__", "__cached__"):
            raise AttributeError(f"module {_DYNAMO!r} has no attribute {name!r} yet")
        return getattr(_load_dynamo(self), name)


def _load_dynamo(stand_in: ModuleType) -> ModuleType:
    """Replace the module that stands for ``torch._dynamo`` by the real one."""
    import torch

    if sys.modules.get(_DYNAMO) is stand_in:
        del sys.modules[_DYNAMO]
        # While it is imported its own modules ask torch for it.
        if torch.__dict__.get("_dynamo") is stand_in:
            del torch._dynamo
    return importlib.import_module(_DYNAMO)


def skip_module_references() -> None:
    """Let Warp not note which modules a kernel's calls lead to: that tells it what to unload when one is imported anew.

    A command imports each module once. The hashes that name compiled kernels are made of other things.
    """
    import warp as wp

    if hasattr(wp.Module, "_find_references"):
        wp.Module._find_references = lambda self, adj: None
