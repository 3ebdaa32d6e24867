# SPDX-License-Identifier: Apache-2.0
"""Removed tables of terms: dictionaries by function name, built from the terms' decorators on demand, with a warning.

Modules of terms had tables such as ``OBSERVATION_SIZES``. The decorators of :mod:`stripe_kernels.term_info` replace
them. The old names work for one more release::

    if not TYPE_CHECKING:  # a type checker takes every name of a module that has a __getattr__ for defined
        __getattr__ = forward_tables(__name__, sizes={"OBSERVATION_SIZES": __name__})
"""

import sys
import warnings
from collections.abc import Callable, Mapping

import warp as wp

from .term_info import ObservationSize, observation_size, randomization_of

__all__ = ["forward_tables"]


def forward_tables(
    module: str, *, sizes: Mapping[str, str] | None = None, randomizations: Mapping[str, str] | None = None
) -> Callable[[str], dict[str, object]]:
    """Make the ``__getattr__`` of a module that had tables of terms.

    Args:
        module: Name of the module.
        sizes: Names of its tables of observation sizes, with the names of the modules that hold the terms.
        randomizations: Names of its tables of randomising events, likewise.

    Returns:
        A function that builds the table of a name, with a ``DeprecationWarning`` that names the replacement.
    """

    def module_getattr(name: str) -> dict[str, object]:
        if sizes and name in sizes:
            _warn(module, name, "observation_size(function)")
            found = {term: observation_size(function) for term, function in _terms(sizes[name])}
            return {term: _of_counts(size) for term, size in found.items() if size is not None}
        if randomizations and name in randomizations:
            _warn(module, name, "randomization_of(function)")
            found_terms = _terms(randomizations[name])
            return {term: randomization_of(function) for term, function in found_terms if term.startswith("randomize_")}
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return module_getattr


def _terms(module: str) -> list[tuple[str, wp.Function]]:
    """Public terms of a module, by name."""
    values = vars(sys.modules[module])
    return [(name, values[name]) for name in values["__all__"] if isinstance(values[name], wp.Function)]


def _of_counts(size: ObservationSize) -> Callable[[Mapping[str, int]], int]:
    """Size as a function of the counts: the tables had no plain numbers."""
    return (lambda counts: size) if isinstance(size, int) else size


def _warn(module: str, name: str, replacement: str) -> None:
    warnings.warn(
        f"{module}.{name} has been removed: use {replacement} of stripe_kernels.term_info; the old name goes with the "
        "next release",
        DeprecationWarning,
        stacklevel=3,  # the line that reads the name
    )
