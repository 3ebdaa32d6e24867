# SPDX-License-Identifier: Apache-2.0
"""Mass constants: what MuJoCo derives from masses and armatures, computed in some worlds and within a CUDA graph."""

from __future__ import annotations

import mujoco
import newton
import numpy as np
import warp as wp
from newton._src.solvers.mujoco.kernels import resolve_actuator_dampratio_invweight_kernel

from stripe_kernels.mujoco_constants import MassTree, assemble_mass_matrix, factor_mass_matrix, write_constants

from .physics_hook import PhysicsHook

__all__ = ["MassConstants"]

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
_MUSCLE = int(mujoco.mjtGain.mjGAIN_MUSCLE)


class MassConstants(PhysicsHook):
    """Inverse weights and subtree masses of a MuJoCo Warp model, as ``mj_setConst`` computes them.

    ``SolverMuJoCo.notify_model_changed`` computes them for all worlds, in some hundred launches. This takes a few, in
    the worlds of a mask. It holds for worlds that differ in masses and armatures but not in geometry, without tendons.

    Attributes:
        touched: Worlds whose constants were computed here, bool, shape ``(num_envs,)``.
    """

    def __init__(self, solver: newton.solvers.SolverMuJoCo, num_envs: int):
        self._solver, self._num_envs = solver, num_envs
        model, target = solver.mj_model, solver.mjw_model
        self._tree = tree = MassTree()
        numbers = {**_rows(model), **_bodies(model)}
        longest = int(numbers["row_count"].max(initial=1))  # degrees of freedom from a leaf to its root
        for name, values in numbers.items():
            setattr(tree, name, wp.array(values, dtype=int))
        # Jacobians at the reference pose: geometry is the same in all worlds, so they are computed once, on the host.
        linear, angular = _velocities(solver)
        tree.linear, tree.angular = wp.array(linear, dtype=wp.vec3), wp.array(angular, dtype=wp.vec3)
        for name in ("body_mass", "body_ipos", "body_inertia", "body_iquat", "dof_armature", "dof_invweight0",
                     "body_invweight0", "body_subtreemass"):  # fmt: skip
            setattr(tree, name, getattr(target, name))
        self._entries = len(numbers["entry_row"])
        tree.matrix = wp.zeros((num_envs, self._entries), dtype=float)
        tree.dof_chain = wp.zeros((num_envs, model.nv, longest), dtype=float)
        tree.body_chain = wp.zeros((num_envs, model.nbody, longest), dtype=wp.spatial_vector)
        tree.touched = self.touched = wp.zeros(num_envs, dtype=wp.bool)
        self._threads = model.nv + model.nbody

    def launch(self, mask: wp.array) -> None:
        """Compute the constants of some worlds, and what depends on them; may be captured.

        Args:
            mask: Worlds, bool, shape ``(num_envs,)``.
        """
        # The mass matrix at the reference pose, its factors in place, then the inverse weights from unit loads.
        inputs = [mask, self._tree]
        wp.launch(assemble_mass_matrix, dim=(self._num_envs, self._entries), inputs=inputs)
        wp.launch(factor_mass_matrix, dim=self._num_envs, inputs=inputs)
        wp.launch(write_constants, dim=(self._num_envs, self._threads), inputs=inputs)
        solver, target = self._solver, self._solver.mjw_model
        # A damping ratio in a file becomes a damping by the inverse weight of its joint: Newton's own kernel does that.
        if solver._dampratio_invweight_ids is not None:
            wp.launch(
                resolve_actuator_dampratio_invweight_kernel,
                dim=(self._num_envs, solver._dampratio_invweight_ids.shape[0]),
                inputs=[solver._dampratio_invweight_ids, solver._dampratio_invweight_dofs,
                        solver._dampratio_invweight_tendons, solver._actuator_dampratio, target.actuator_gainprm,
                        target.actuator_gear, target.dof_invweight0, target.tendon_invweight0],
                outputs=[target.actuator_biasprm],
            )  # fmt: skip
        solver._update_solref_from_invweight0()  # limits are as stiff as the inverse weights say

    def launch_after_notify(self) -> None:
        """Compute the constants again that were computed here.

        The solver has just computed those of all worlds itself, which agree to rounding: without this a notification
        about something else would change their last bits.
        """
        self.launch(self.touched)

    @staticmethod
    def why_unsupported(solver: newton.solvers.SolverMuJoCo) -> str:
        """Reason why the constants of a model cannot be computed here; empty if they can."""
        model = solver.mj_model
        if model.nv == 0:
            return "no degree of freedom"
        if model.ntendon:
            return "tendons"
        # Constants of bodies that are kinematic for a while are those of infinite masses.
        if solver._kinematic_weld_eq is not None:
            return "bodies that may become kinematic"
        if set(solver._dampratio_actuators or ()) - set(solver._dampratio_invweight_actuators or ()):
            return "damping ratios of actuators that are not of one joint"
        if (model.actuator_gaintype == _MUSCLE).any():
            return "muscles"
        if (_ends(model) < 0).any():
            return "bodies out of order"
        return ""


def _rows(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The degrees of freedom as a tree; names are those of ``MassTree``.

    A row of the mass matrix holds the entries of a degree of freedom and of those above it, up to its root.
    """
    chains = []
    for dof in range(model.nv):
        chain = [dof]
        while (parent := int(model.dof_parentid[chain[-1]])) >= 0:
            chain.append(parent)
        chains.append(chain)
    counts = np.array([len(c) for c in chains], dtype=np.int32)
    start, count = np.arange(model.nv), np.ones(model.nv, dtype=int)
    # MuJoCo gives the three degrees of freedom of a translation or a rotation one inverse weight, their mean.
    for kind, first in zip(model.jnt_type, model.jnt_dofadr, strict=True):
        for offset in {_FREE: (0, 3), _BALL: (0,)}.get(int(kind), ()):
            start[first + offset : first + offset + 3], count[first + offset : first + offset + 3] = first + offset, 3
    return {
        "row_start": np.cumsum(counts) - counts,
        "row_count": counts,
        "entry_row": np.repeat(np.arange(model.nv), counts),
        "entry_column": np.concatenate([np.array(c) for c in chains]),
        "dof_body": model.dof_bodyid,
        "group_start": start,
        "group_count": count,
    }


def _bodies(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """The bodies: where the subtree of each ends, and the last degree of freedom that moves it, -1 for none."""
    last = np.full(model.nbody, -1)
    for body in range(1, model.nbody):
        above = body
        while above > 0 and model.body_dofnum[above] == 0:
            above = int(model.body_parentid[above])
        if above > 0:
            last[body] = model.body_dofadr[above] + model.body_dofnum[above] - 1
    return {"body_end": _ends(model), "body_dof": last}


def _ends(model: mujoco.MjModel) -> np.ndarray:
    """Body after the last one that hangs on each, -1 where those do not follow it directly."""
    sizes = np.ones(model.nbody, dtype=int)
    last = np.arange(model.nbody)
    for body in range(model.nbody - 1, 0, -1):
        parent = model.body_parentid[body]
        sizes[parent] += sizes[body]
        last[parent] = max(last[parent], last[body])
    return np.where(last - np.arange(model.nbody) + 1 == sizes, last + 1, -1)


def _velocities(solver: newton.solvers.SolverMuJoCo) -> tuple[np.ndarray, np.ndarray]:
    """Velocities of the bodies' origins and angular velocities, at unit speed of each degree of freedom at the
    reference pose, in the frames of the bodies; shapes ``(nbody, nv, 3)``."""
    model = solver.mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = solver.mjw_model.qpos0.numpy()[0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    linear, angular = np.zeros((2, model.nbody, model.nv, 3))
    jacobian = np.zeros((2, 3, model.nv))
    for body in range(1, model.nbody):
        mujoco.mj_jacBody(model, data, jacobian[0], jacobian[1], body)
        axes = data.xmat[body].reshape(3, 3)
        linear[body], angular[body] = jacobian[0].T @ axes, jacobian[1].T @ axes
    return linear, angular
