# SPDX-License-Identifier: Apache-2.0
"""Model checks: ranges of randomising events that are invalid, or that the solver would ignore."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import newton
import numpy as np

from stripe_kernels.actuators import LAW_MADE
from stripe_kernels.mdp.randomization import DISTRIBUTIONS, OPERATIONS
from stripe_kernels.model_data import JointModelData, ShapeModelData
from stripe_newton.fusion.warp_types import Struct
from stripe_newton.sim import Simulation

__all__ = ["ignores_restitution", "range_problems", "solver_problems"]

_PENALTY = {"friction", "effort_limit"}
_UNREAD: dict[str, dict[Struct, set[str]]] = {
    "mujoco": {ShapeModelData: {"restitution"}},
    "xpbd": {JointModelData: {*_PENALTY, "armature", "passive_stiffness", "passive_damping"}},
    "semiimplicit": {
        JointModelData: {*_PENALTY, "armature"},
        ShapeModelData: {"restitution", "torsional_friction", "rolling_friction"},
    },
    "featherstone": {
        JointModelData: _PENALTY,
        ShapeModelData: {"restitution", "torsional_friction", "rolling_friction"},
    },
}
"""Fields that solvers do not read, according to Newton's documentation, by the kind of solver."""


def range_problems(params: Mapping[str, Any], name: str, bound: str) -> Iterator[str]:
    """Problems of a range.

    Args:
        params: Parameters of the term, with ``operation`` and ``distribution`` as codes.
        name: Name of the parameter that is the range.
        bound: Valid values: ``"positive"``, ``"not negative"`` or ``"any"``.
    """
    pair = params[name]
    try:
        low, high = (float(x) for x in pair)
    except (TypeError, ValueError):
        yield f"is {pair!r}, must be two numbers"
        return
    if math.isnan(low) and math.isnan(high):
        return  # KEEP: the quantity is not changed
    distribution = params.get("distribution", DISTRIBUTIONS["uniform"])
    if not (math.isfinite(low) and math.isfinite(high)):
        yield f"is {pair}, must be finite"
    elif distribution == DISTRIBUTIONS["gaussian"]:
        if high < 0.0:
            yield f"is {pair}, must be (mean, standard deviation), and that not negative"
    elif low > high:
        yield f"is {pair}, must be (low, high) with low <= high"
    elif distribution == DISTRIBUTIONS["log_uniform"] and low <= 0.0:
        yield f"is {pair}, must be positive for distribution 'log_uniform'"
    elif params.get("operation", OPERATIONS["abs"]) == OPERATIONS["add"] or bound == "any":
        return  # the sum must be valid, not the summand; the term clamps it
    elif low < 0.0 or (low == 0.0 and bound == "positive"):
        yield f"is {pair}, must be {bound}"


def ignores_restitution(sim: Simulation) -> bool:
    """Whether the solver does not read restitution. Isaac Lab's tasks often name it, so that it is a warning only."""
    cfg: Any = sim.cfg.solver
    if cfg.kind == "xpbd":
        return not cfg.enable_restitution
    return "restitution" in _UNREAD.get(cfg.kind, {}).get(ShapeModelData, ())


def solver_problems(sim: Simulation, kind: Struct, field: str, dofs: list[int]) -> Iterator[str]:
    """Reasons for which the solver would ignore a field other than restitution.

    Args:
        sim: The simulation.
        kind: Struct of the field.
        field: The field.
        dofs: Degrees of freedom in an environment, for fields of joints.
    """
    cfg: Any = sim.cfg.solver
    solver = sim.solver
    name = cfg.solver_class
    if field == "effort_limit" and sim.actuation.explicit[dofs].any():
        return  # the actuators of the package limit it, whatever the solver does
    if field in _UNREAD.get(cfg.kind, {}).get(kind, ()) and field != "restitution":
        yield f"{name} ignores {field.replace('_', ' ')}"
    if cfg.kind != "mujoco":
        return
    if field == "margin" and solver._use_mujoco_contacts and solver._zero_margins_for_native_ccd:
        yield f"{name} ignores margins of boxes and meshes, set MuJoCoSolverCfg(use_mujoco_contacts=False)"
    if field in ("lower", "upper") and not _limited(solver, dofs):
        yield "none of these joints has limits that the solver could change, give them limits in the file"
    if field in ("stiffness", "damping") and not _driven(sim, dofs):
        yield "none of these joints has a drive with gains, give them actuators in ArticulationCfg"


def _limited(solver: newton.solvers.SolverMuJoCo, dofs: list[int]) -> bool:
    joints = np.isin(solver.mjc_jnt_to_newton_dof.numpy()[0], dofs)
    return bool(solver.mj_model.jnt_limited[joints].any())


def _driven(sim: Simulation, dofs: list[int]) -> bool:
    solver = sim.solver
    law = sim.actuation.drives.law.numpy()[dofs]
    if (sim.actuation.explicit[dofs] & (law != LAW_MADE)).any():
        return True
    if solver.mjc_actuator_ctrl_source is None or solver.mjc_actuator_to_newton_idx is None:
        return False
    codes = solver.mjc_actuator_to_newton_idx.numpy()[solver.mjc_actuator_ctrl_source.numpy() == 0]
    return bool(np.isin(np.where(codes >= 0, codes, -2 - codes), dofs).any())
