# SPDX-License-Identifier: Apache-2.0
"""Model update: hands changed properties of the model to the solver, in some worlds and within a CUDA graph."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

import newton
import warp as wp

from stripe_kernels.mujoco_model import MuJoCoJoints, write_bodies, write_gravity, write_joints, write_shapes

from .mass_constants import MassConstants

if TYPE_CHECKING:
    from .simulation import Simulation

__all__ = ["ModelUpdate", "model_flags"]

_POSES = {"shape_transform", "shape_scale"}
"""Arrays whose changes move or resize geoms, which needs Newton's own update."""
_JOINTS = (
    "joint_friction", "joint_damping", "joint_armature", "joint_stiffness", "joint_limit_lower", "joint_limit_upper",
    "joint_effort_limit", "joint_target_ke", "joint_target_kd", "joint_target_mode",
)  # fmt: skip
_TARGETS = (
    "jnt_type", "jnt_qposadr", "qpos0", "dof_frictionloss", "dof_damping", "dof_armature", "jnt_stiffness", "jnt_range",
    "jnt_actfrcrange", "actuator_gainprm", "actuator_biasprm",
)  # fmt: skip


def model_flags(names: Iterable[str]) -> newton.ModelFlags:
    """Flags for :meth:`Simulation.notify` after arrays of ``newton.Model`` were changed.

    Args:
        names: Names of the arrays.
    """
    flags, found = newton.ModelFlags, []
    for name in names:
        if name.startswith("body_"):
            found.append(flags.BODY_INERTIAL_PROPERTIES)
        elif name == "joint_armature":
            found.append(flags.JOINT_DOF_INERTIAL_PROPERTIES)
        elif name.startswith("joint_"):
            found.append(flags.JOINT_DOF_FORCE_PROPERTIES)
        elif name.startswith("shape_"):
            found.append(flags.SHAPE_PROPERTIES)
        else:
            found.append(flags.MODEL_PROPERTIES)
    return reduce(or_, found)


class ModelUpdate:
    """Updates the solver in the worlds of a mask, by launches alone.

    With MuJoCo Warp the arrays of its model are written in those worlds, and the constants that follow from masses and
    armatures are computed again. Models that this does not cover, and other solvers, are updated in all worlds by
    ``solver.notify_model_changed``.

    Attributes:
        flags: Flags for the solver's notification where all worlds are updated.
        why_all_worlds: Why all worlds are updated rather than those of a mask; empty if it is those.
        constants: Computes the constants that follow from masses; None where they stay.
    """

    def __init__(self, sim: Simulation, names: Iterable[str], constants: MassConstants | None = None):
        """Prepare the launches.

        Args:
            sim: The simulation, built.
            names: Arrays of ``newton.Model`` that change.
            constants: The same of another update of this simulation, to share.
        """
        self._sim, self._names = sim, set(names)
        self.flags = model_flags(self._names)
        self.constants: MassConstants | None = None
        self._joints: MuJoCoJoints | None = None
        self.why_all_worlds = self._why_all_worlds()
        sim.expect_changes(self._names)
        if self.why_all_worlds:
            return
        with wp.ScopedDevice(sim.device):
            if self._changes("joint_"):
                self._joints = self._map_joints()
            if self._needs_constants:
                if constants is None:
                    constants = MassConstants(sim.solver, sim.num_envs)
                    sim.add_hook(constants)
                self.constants = constants

    @property
    def _needs_constants(self) -> bool:
        return self._changes("body_") or "joint_armature" in self._names

    def _changes(self, prefix: str) -> bool:
        return any(name.startswith(prefix) for name in self._names)

    def _why_all_worlds(self) -> str:
        sim, solver = self._sim, self._sim.solver
        if sim.cfg.solver.kind != "mujoco":
            return f"{type(solver).__name__} tells no worlds apart"
        if solver.use_mujoco_cpu or solver.mjw_data.nworld != sim.num_envs:
            return "not one MuJoCo Warp world for each environment"
        if solver.enable_sleeping:  # what a change does to them is left to notify_model_changed
            return "bodies may sleep"
        return MassConstants.why_unsupported(solver) if self._needs_constants else ""

    def _map_joints(self) -> MuJoCoJoints:
        # Names with an underscore are Newton's own. It has no update by mask, and pyproject.toml holds Newton to the
        # minor series in which these were checked.
        solver, model, joints = self._sim.solver, self._sim.model, MuJoCoJoints()
        joints.dof_map, joints.joint_map = solver.mjc_dof_to_newton_dof, solver.mjc_jnt_to_newton_dof
        none = wp.empty(0, dtype=int)  # a model without actuators: a kernel cannot take None in a struct
        joints.actuator_source = none if solver.mjc_actuator_ctrl_source is None else solver.mjc_actuator_ctrl_source
        joints.actuator_map = none if solver.mjc_actuator_to_newton_idx is None else solver.mjc_actuator_to_newton_idx
        joints.dofs_per_world = model.joint_dof_count // self._sim.num_envs
        joints.extra_damping = solver._actuator_dof_damping
        for name in _JOINTS:
            setattr(joints, name, getattr(model, name))
        for name in _TARGETS:
            setattr(joints, name, getattr(solver.mjw_model, name))
        return joints

    def launch(self, mask: wp.array) -> None:
        """Update some worlds; may be captured.

        Args:
            mask: Worlds whose properties were changed, bool, shape ``(num_envs,)``.
        """
        sim = self._sim
        if self.why_all_worlds:
            sim.notify(self.flags, expected=True)
            return
        with wp.ScopedDevice(sim.device):
            solver, model, target, worlds = sim.solver, sim.model, sim.solver.mjw_model, sim.num_envs
            # What is given comes before what is computed from it: limits of joints, masses and shapes, then constants.
            if "gravity" in self._names:
                wp.launch(write_gravity, dim=worlds, inputs=[mask, model.gravity], outputs=[target.opt.gravity])
            if self._joints is not None:
                count = max(self._joints.dof_map.shape[1], self._joints.joint_map.shape[1],
                            self._joints.actuator_map.shape[0])  # fmt: skip
                wp.launch(write_joints, dim=(worlds, count), inputs=[mask, self._joints])
                # Limits of the joints' own are written above; the drives' follow them.
                if "joint_effort_limit" in self._names and sim.drive_limits is not None:
                    sim.drive_limits.launch()
            if self._changes("body_"):
                wp.launch(
                    write_bodies,
                    dim=solver.mjc_body_to_newton.shape,
                    inputs=[mask, solver.mjc_body_to_newton, model.body_mass, model.body_com, model.body_inertia],
                    outputs=[target.body_mass, target.body_ipos, target.body_inertia, target.body_iquat],
                )
            if self._changes("shape_"):
                self._write_shapes(mask)
            if self.constants is not None:
                self.constants.launch(mask)  # after masses and armatures, which it reads
            if not solver._use_mujoco_contacts:
                # SolverMuJoCo keeps friction and the like of converted contacts from step to step: they are stale now.
                solver._invalidate_contact_fast_path()

    def _write_shapes(self, mask: wp.array) -> None:
        solver, model, target = self._sim.solver, self._sim.model, self._sim.solver.mjw_model
        if self._names & _POSES:  # Newton's own update, in all worlds: equal numbers where nothing changed
            solver._update_geom_properties()
            solver._update_site_properties()
            solver._sync_worldbody_geom_xposes()
            solver._sync_site_xposes()
            if self._sim.absent_shapes is not None:  # the update has given their geoms a margin
                self._sim.absent_shapes.launch_after_notify()
            return
        heeds_margin = not (solver._use_mujoco_contacts and solver._zero_margins_for_native_ccd)
        wp.launch(
            write_shapes,
            dim=solver.mjc_geom_to_newton_shape.shape,
            inputs=[mask, solver.mjc_geom_to_newton_shape, heeds_margin, model.shape_material_mu,
                    model.shape_material_mu_torsional, model.shape_material_mu_rolling, model.shape_gap,
                    model.shape_margin],
            outputs=[target.geom_friction, target.geom_gap, target.geom_margin],
        )  # fmt: skip
