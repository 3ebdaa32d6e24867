# SPDX-License-Identifier: Apache-2.0
"""Articulation dynamics: Jacobians, mass matrices, gravity compensation and joint wrenches of an articulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import newton
import torch
import warp as wp

from stripe_newton.math import combine_frame_transforms, quat_apply_inverse

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .layout import Layout

__all__ = ["ArticulationDynamics"]


class ArticulationDynamics:
    """Dynamics of an articulation in its present state, computed when they are asked for.

    Columns are degrees of freedom in the order of ``joint_names``. Where the root floats, six columns stand before
    them: the linear velocity of its centre of mass and its angular velocity, world frame.
    """

    def __init__(self, sim: Simulation, layout: Layout):
        self._sim, self._layout = sim, layout
        model = sim.model
        per_env = model.articulation_count // sim.num_envs
        own = next(i for i, start in enumerate(sim.template.articulation_start) if start == layout.joints.start)
        self._rows = slice(own, None, per_env)
        self._columns = (6 if layout.floating else 0) + len(layout.dofs)
        mask = torch.zeros(model.articulation_count, dtype=torch.bool, device=sim.device)
        mask[self._rows] = True
        links, dofs = int(model.max_joints_per_articulation), int(model.max_dofs_per_articulation)
        with wp.ScopedDevice(sim.device):
            self._mask = wp.from_torch(mask)
            self._jacobian = wp.zeros((model.articulation_count, 6 * links, dofs), dtype=float)
            self._mass = wp.zeros((model.articulation_count, dofs, dofs), dtype=float)
            self._subspace = wp.zeros(model.joint_dof_count, dtype=wp.spatial_vector)
        # Of several joints that end on one body, as in a loop, the first has its row.
        children = [sim.template.joint_child[j] for j in layout.joints]
        self._links = [children.index(body) for body in layout.bodies]

    def jacobians(self) -> torch.Tensor:
        """Jacobians of all bodies, shape ``(num_envs, num_bodies, 6, columns)``.

        They map joint velocities to the linear velocity of a body's centre of mass and its angular velocity, both in
        the world frame, as :func:`newton.eval_jacobian` gives them.
        """
        sim = self._sim
        newton.eval_jacobian(sim.model, sim.state, self._jacobian, self._subspace, mask=self._mask)
        found = wp.to_torch(self._jacobian)[self._rows, :, : self._columns]
        return found.unflatten(1, (-1, 6))[:, self._links].clone()

    def mass_matrices(self) -> torch.Tensor:
        """Joint-space inertia with armature [kg, kg m or kg m^2], shape ``(num_envs, columns, columns)``."""
        sim = self._sim
        newton.eval_mass_matrix(sim.model, sim.state, self._mass, joint_S_s=self._subspace, mask=self._mask)
        return wp.to_torch(self._mass)[self._rows, : self._columns, : self._columns].clone()

    def gravity_compensation(self) -> torch.Tensor:
        """Joint efforts that hold the bodies against gravity [N or N m], shape ``(num_envs, columns)``."""
        sim = self._sim
        gravity = wp.to_torch(sim.model.gravity)[: sim.num_envs]  # one row a world, or one for all
        masses = sim.per_env(sim.model.body_mass)[:, self._layout.bodies]
        weights = masses.unsqueeze(-1) * gravity.expand(sim.num_envs, 3).unsqueeze(1)
        return -torch.einsum("nbic,nbi->nc", self.jacobians()[:, :, :3], weights)

    def incoming_joint_wrenches(self) -> torch.Tensor:
        """Wrenches that the joints exert on their child bodies, shape ``(num_envs, num_bodies, 6)``.

        Force [N] and torque [N m] at the child's side of the joint, in the joint's frame there.

        Raises:
            RuntimeError: the solver was not asked to report them.
        """
        sim, layout = self._sim, self._layout
        reported = sim.reported("body_parent_f")
        if reported is None:
            raise RuntimeError("joint wrenches are not reported: set sim.observables=('body_parent_f',) in the config")
        wrench = sim.per_env(reported)[:, layout.bodies]  # about the centre of mass, world frame
        joints = [layout.joints[link] for link in self._links]
        anchor = sim.per_env(sim.model.joint_X_c)[:, joints]
        pose, center = (
            sim.per_env(sim.state.body_q)[:, layout.bodies],
            sim.per_env(sim.model.body_com)[:, layout.bodies],
        )
        point, turn = combine_frame_transforms(pose[..., :3], pose[..., 3:], anchor[..., :3], anchor[..., 3:])
        mass_center, _ = combine_frame_transforms(pose[..., :3], pose[..., 3:], center)
        force, torque = wrench[..., :3], wrench[..., 3:]
        moved = torque + torch.linalg.cross(mass_center - point, force)
        return torch.cat((quat_apply_inverse(turn, force), quat_apply_inverse(turn, moved)), dim=-1)
