# SPDX-License-Identifier: Apache-2.0
"""Observables: the arrays that the solver reports beyond the state."""

from __future__ import annotations

from collections.abc import Sequence

import newton

__all__ = ["wanted_observables"]

_ALWAYS = {"qfrc_actuator", "overflow"}
"""Observables that assets and the overflow report read, where the solver has them."""


def wanted_observables(
    solver: newton.solvers.SolverBase, names: Sequence[str], contact_forces: bool = False
) -> set[str]:
    """Names of the observables to allocate: those of a config, and those that this package reads itself.

    Args:
        solver: The solver.
        names: ``SimulationCfg.observables``.
        contact_forces: ``SimulationCfg.contact_forces``.

    Raises:
        ValueError: for what the solver does not report; the message lists what it does.
    """
    supported = {str(getattr(o, "value", o)) for o in solver.supported_observables}
    missing = [name for name in names if name not in supported]
    if missing:
        raise ValueError(
            f"observables: {type(solver).__name__} does not report {', '.join(missing)}; "
            f"it has {', '.join(sorted(supported)) or 'none'}"
        )
    if contact_forces and "contact_f" not in supported:
        raise ValueError(f"contact_forces: {type(solver).__name__} does not report them, use MuJoCoSolverCfg")
    return _ALWAYS & supported | set(names) | ({"contact_f"} if contact_forces else set())
