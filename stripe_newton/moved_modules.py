# SPDX-License-Identifier: Apache-2.0
"""Moved modules: imports of an old module path warn and get the module at its new path, for one release."""

from __future__ import annotations

import importlib
import importlib.machinery
import sys
import warnings
from collections.abc import Mapping, Sequence
from types import ModuleType

TYPE_CHECKING = False
if TYPE_CHECKING:
    from importlib.abc import Loader
else:
    # Python's import system does not ask for the class, whose import, or that of typing, would take longer than all
    # else that this package imports.
    Loader = object

__all__ = ["forward_modules"]

MOVED: dict[str, str] = {}
"""New path by old path. Modules below an old path are forwarded too."""


def forward_modules(moved: Mapping[str, str]) -> None:
    """Forward imports of old module paths to the modules at their new paths, with a ``DeprecationWarning``.

    Both paths then name one module object, so that classes stay the same whichever way they were imported.

    Args:
        moved: New path by old path, such as ``{"stripe_newton.spec": "stripe_newton.specifications"}``.
    """
    MOVED.update(moved)
    if not any(isinstance(finder, _Forwarder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Forwarder())


def _new_path(name: str) -> str | None:
    """New path of a module, by the longest old path that is a part of its own; None if it did not move."""
    fitting = [old for old in MOVED if name == old or name.startswith(f"{old}.")]
    if not fitting:
        return None
    old = max(fitting, key=len)
    return MOVED[old] + name.removeprefix(old)


class _Forwarder(Loader):
    """Import finder and loader for old module paths.

    It must be the first in ``sys.meta_path``. For a submodule of a forwarded package, Python's finder of files would
    look into the folder of the new package and load the file a second time, with classes of its own.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if _new_path(fullname) is None:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        new = _new_path(spec.name)
        assert new is not None  # find_spec has checked it
        warnings.warn(
            f"the module '{spec.name}' has moved to '{new}'; the old path goes with the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        module = importlib.import_module(new)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # the import system has replaced it by the spec of the old path
