# SPDX-License-Identifier: Apache-2.0
"""Solver configs: each makes the Newton solver that it names.

Every field is an argument of that solver unless it says otherwise, and ``None`` leaves Newton's default.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import newton

from stripe_newton.configclass import configclass
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt, PositiveInt

from .mujoco_solver_cfg import MuJoCoSolverCfg
from .solver_cfg_base import SolverCfg

__all__ = [
    "FeatherstoneSolverCfg",
    "KaminoSolverCfg",
    "MuJoCoSolverCfg",
    "SemiImplicitSolverCfg",
    "SolverCfg",
    "XPBDSolverCfg",
]


@configclass
class FeatherstoneSolverCfg(SolverCfg):
    """Featherstone's articulated bodies with penalty contacts, differentiable."""

    solver_class: ClassVar[str] = "SolverFeatherstone"

    angular_damping: NonNegativeFloat | None = None
    """Damping of angular velocity."""
    update_mass_matrix_interval: PositiveInt | None = None
    """Steps between updates of the mass matrix."""
    use_tile_gemm: bool | None = None
    """Use Warp's tile operators (a kernel is compiled for each articulation size)."""
    fuse_cholesky: bool | None = None
    """Fuse the decomposition into the inertia kernel (with ``use_tile_gemm``)."""


@configclass
class XPBDSolverCfg(SolverCfg):
    """Extended position-based dynamics, in maximal coordinates."""

    solver_class: ClassVar[str] = "SolverXPBD"
    reduced_coordinates: ClassVar[bool] = False

    iterations: NonNegativeInt | None = None
    """Constraint iterations a step."""
    joint_linear_relaxation: NonNegativeFloat | None = None
    """Relaxation of linear joint corrections."""
    joint_angular_relaxation: NonNegativeFloat | None = None
    """Relaxation of angular joint corrections."""
    joint_linear_compliance: NonNegativeFloat | None = None
    """Compliance of linear joint constraints [m/N]."""
    joint_angular_compliance: NonNegativeFloat | None = None
    """Compliance of angular joint constraints [rad/(N m)]."""
    rigid_contact_relaxation: NonNegativeFloat | None = None
    """Relaxation of contact corrections."""
    rigid_contact_restitution_iterations: NonNegativeInt | None = None
    """Outer iterations of the restitution solve."""
    rigid_contact_con_weighting: bool | None = None
    """Divide a body's correction by its number of contacts."""
    angular_damping: NonNegativeFloat | None = None
    """Damping of angular velocity [1/s]."""
    enable_restitution: bool | None = None
    """Apply restitution."""


@configclass
class SemiImplicitSolverCfg(SolverCfg):
    """Semi-implicit Euler in maximal coordinates with spring joints and penalty contacts, differentiable."""

    solver_class: ClassVar[str] = "SolverSemiImplicit"
    reduced_coordinates: ClassVar[bool] = False

    angular_damping: NonNegativeFloat | None = None
    """Damping of angular velocity."""
    joint_attach_ke: NonNegativeFloat | None = None
    """Stiffness that holds joints together."""
    joint_attach_kd: NonNegativeFloat | None = None
    """Damping that holds joints together."""
    joint_mimic_ke: NonNegativeFloat | None = None
    """Stiffness of mimic joints."""
    joint_mimic_kd: NonNegativeFloat | None = None
    """Damping of mimic joints."""


@configclass
class KaminoSolverCfg(SolverCfg):
    """Kamino: constrained rigid bodies with kinematic loops, in maximal coordinates."""

    solver_class: ClassVar[str] = "SolverKamino"
    reduced_coordinates: ClassVar[bool] = False

    dynamics_solver: str | None = None
    """``"padmm"`` (default), ``"dvi"`` or ``"lox"``."""
    sparse_jacobian: bool | None = None
    """Sparse Jacobian."""
    sparse_dynamics: bool | None = None
    """Sparse dynamics."""
    use_collision_detector: bool | None = None
    """Kamino's own collision detection."""
    use_fk_solver: bool | None = None
    """Solve forward kinematics for consistent resets of loops."""
    integrator: str | None = None
    """``"euler"`` (default) or ``"moreau"``."""
    rotation_correction: str | None = None
    """``"twopi"`` (default), ``"continuous"`` or ``"none"``."""
    angular_velocity_damping: NonNegativeFloat | None = None
    """Damping of angular velocity."""

    @property
    def finds_contacts(self) -> bool:
        return bool(self.use_collision_detector)

    def create(self, model: newton.Model, observables: Sequence[str] = ()) -> newton.solvers.SolverBase:
        solver = self.newton_class
        return solver(model, config=solver.Config.from_model(model, **self.arguments()))
