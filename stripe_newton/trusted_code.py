# SPDX-License-Identifier: Apache-2.0
"""Trusted code: which modules a name in a saved config may be looked up in.

A run folder or another file with configs may come from anybody, and names classes and functions. Importing a module
runs it, and calling a function of any module may do anything. So a name is resolved only in the packages of this
project, of rsl_rl, and in those that the user has named: by ``--import``, or by :func:`trust`.
"""

from __future__ import annotations

import importlib

__all__ = ["trust", "trusted_packages", "why_not_trusted"]

_packages = {"rsl_rl", "stripe_kernels", "stripe_newton", "stripe_tasks"}


def trust(module: str) -> None:
    """Trust the package of a module: saved configs may name its classes and functions."""
    package = module.partition(".")[0]
    if package not in ("", "__main__", "builtins"):
        _packages.add(package)


def trusted_packages() -> frozenset[str]:
    """Names of the packages that are trusted."""
    return frozenset(_packages)


def why_not_trusted(name: str) -> str:
    """Why what a name stands for is not used; empty if it may be.

    Args:
        name: ``module:Name``, ``module.Name``, or a name without a module, which rsl_rl looks up among its own.
    """
    if name.isidentifier():
        return ""
    module, _, attribute = name.rpartition(":") if ":" in name else name.rpartition(".")
    package = module.partition(".")[0]
    if not package.isidentifier() or not attribute:
        return f"is '{name}', must be a name of rsl_rl's, or 'module:Name'"
    if package not in _packages:
        hint = f"if you trust it, add --import {module}, or call trusted_code.trust('{package}') in Python"
        return f"is '{name}', of a module that is not trusted; {hint}"
    try:
        found: object = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError):
        return f"is '{name}', which is not there"
    # A trusted module may have imported anything under any name.
    origin = str(getattr(found, "__module__", ""))
    if origin.partition(".")[0] not in _packages or not callable(found):
        return f"is '{name}', which is of {origin or 'no module'}, not of '{package}' itself"
    return ""
