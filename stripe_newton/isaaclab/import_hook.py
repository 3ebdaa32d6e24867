# SPDX-License-Identifier: Apache-2.0
"""Import hook of the Isaac Lab dialect: answers for the modules of the tables in ``names``."""

from __future__ import annotations

import difflib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import Any

from .names import ALIASES, MODULES, NAMES, PACKAGES
from .names.ignored_fields import IGNORED_FIELDS
from .real_packages import find_real_package
from .stand_ins import stand_in, with_ignored_fields

__all__ = ["install", "is_installed", "uninstall"]


def install() -> None:
    """Answer imports of Isaac Lab's and Isaac Sim's packages, in this process, until :func:`uninstall`.

    Call it before the first import of a file that needs them. Files of tasks and robots that are installed
    (``isaaclab_tasks`` and ``isaaclab_assets``, alone or in the wheel of ``isaaclab``) are the real ones.

    Raises:
        RuntimeError: if Isaac Sim is installed, which the dialect is not meant to replace.
    """
    if is_installed():
        return
    if "isaacsim" in sys.modules or importlib.util.find_spec("isaacsim") is not None:
        raise RuntimeError("Isaac Sim is installed here; the dialect replaces it only where it is not")
    for name in [m for m in sys.modules if m.partition(".")[0] in PACKAGES]:
        del sys.modules[name]  # a half-imported launcher of the wheel
    sys.meta_path.insert(0, _Finder())
    from .cuda_calls import ignore_cuda_calls  # here, as torch takes seconds to import

    ignore_cuda_calls()


def uninstall() -> None:
    """Stop answering, and forget the modules that were imported through the dialect."""
    sys.meta_path[:] = [finder for finder in sys.meta_path if not isinstance(finder, _Finder)]
    for name in [m for m in sys.modules if m.partition(".")[0] in PACKAGES]:
        del sys.modules[name]
    from .cuda_calls import restore_cuda_calls  # as in `install`

    restore_cuda_calls()


def is_installed() -> bool:
    """Whether the dialect is answering in this process."""
    return any(isinstance(finder, _Finder) for finder in sys.meta_path)


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finder and loader of the modules in the tables.

    It is the first finder: the wheel of ``isaaclab`` has a top-level module of that name which starts Isaac Sim.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname not in MODULES:
            return find_real_package(fullname)
        return importlib.machinery.ModuleSpec(fullname, self, is_package=True)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        return _DialectModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        if not isinstance(module, _DialectModule):
            return
        # A star import takes what the table names, each resolved then.
        module.__dict__["__all__"] = module.names()


class _DialectModule(ModuleType):
    """A module whose attributes are looked up in the tables when they are first asked for."""

    def names(self) -> list[str]:
        """Names that the module offers."""
        alias, found = ALIASES.get(self.__name__), set(NAMES.get(_table_of(self.__name__), {}))
        if alias is not None:
            target = importlib.import_module(alias)
            found |= set(getattr(target, "__all__", [n for n in vars(target) if not n.startswith("_")]))
        return sorted(found)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.names()]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = self._find(name)
        setattr(self, name, value)
        return value

    def _find(self, name: str) -> Any:
        alias = ALIASES.get(self.__name__)
        if alias is not None:
            target = importlib.import_module(alias)
            if hasattr(target, name):
                return getattr(target, name)
        entry = NAMES.get(_table_of(self.__name__), {}).get(name)
        if entry is not None:
            return _resolve(entry, name)
        if f"{self.__name__}.{name}" in MODULES:
            return importlib.import_module(f"{self.__name__}.{name}")
        near = difflib.get_close_matches(name, self.names(), n=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise AttributeError(
            f"the Isaac Lab dialect of stripe_newton has no '{name}' in '{self.__name__}'{hint} "
            "(docs/isaac_lab.md lists what it has)"
        )


def _table_of(module: str) -> str:
    """Nearest module at or above ``module`` that has a table: submodules offer what their package offers."""
    while module not in NAMES and "." in module:
        module = module.rpartition(".")[0]
    return module


def _resolve(entry: str, name: str) -> Any:
    """The object that an entry of a table stands for."""
    kind, _, reason = entry.partition(" ")
    if kind in ("inert", "refused"):
        return stand_in(name, kind, reason)
    module, _, attribute = entry.partition(":")
    target = importlib.import_module(module)
    found = getattr(target, attribute) if attribute else target
    fields = IGNORED_FIELDS.get(name)
    return found if fields is None else with_ignored_fields(found, tuple(fields.items()))
