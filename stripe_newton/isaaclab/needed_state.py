# SPDX-License-Identifier: Apache-2.0
"""Needed state: quantities that torch code of a user reads, and that the solver computes when it is asked to.

Isaac Lab computes them always. The names in the bytecode of hooks and terms tell which are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import CodeType, FunctionType

from stripe_newton.configclass import is_config

from .stand_ins import StandIn

__all__ = ["needed_observables"]

_OBSERVABLES = {
    "get_link_incoming_joint_force": "body_parent_f",
    "body_incoming_joint_wrench_b": "body_parent_f",
    **dict.fromkeys(("body_acc_w", "body_lin_acc_w", "body_ang_acc_w"), "body_qdd"),
    **dict.fromkeys(("body_com_acc_w", "body_com_lin_acc_w", "body_com_ang_acc_w"), "body_qdd"),
}
"""Arrays of the solver, as ``SimulationCfg.observables`` names them, by the name that a hook or term reads."""


def needed_observables(cls: type, cfg: object) -> set[str]:
    """Observables that the methods of an environment's class read, and the torch terms in its config."""
    names = {*_names_in_class(cls), *_names_in_terms(cfg)}
    return {observable for name, observable in _OBSERVABLES.items() if name in names}


def _names_in_terms(cfg: object) -> Iterator[str]:
    """Names that the functions and classes in a config use, at any depth."""
    if isinstance(cfg, FunctionType):
        yield from _names_in_function(cfg)
    elif isinstance(cfg, type):
        yield from _names_in_class(cfg)
    elif isinstance(cfg, Mapping):
        for value in cfg.values():
            yield from _names_in_terms(value)
    elif is_config(cfg) and not isinstance(cfg, StandIn):
        yield from _names_in_terms(vars(cfg))


def _names_in_class(cls: type) -> Iterator[str]:
    for base in cls.__mro__:
        for value in vars(base).values():
            if isinstance(value, FunctionType):
                yield from _names_in_function(value)


def _names_in_function(function: FunctionType) -> Iterator[str]:
    """Names that a user's function uses; none for one of the package, which reads what there is."""
    if function.__module__.partition(".")[0] != "stripe_newton":
        yield from _names_in_code(function.__code__)


def _names_in_code(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_in_code(constant)
