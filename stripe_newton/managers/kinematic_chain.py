# SPDX-License-Identifier: Apache-2.0
"""Kinematic chain: the joints that move a body, and their frames, from which action terms compute a Jacobian."""

from __future__ import annotations

from typing import TYPE_CHECKING

import newton
import warp as wp

from stripe_kernels.mdp.kinematics import KinematicChain

if TYPE_CHECKING:
    from stripe_newton.assets.layout import Layout
    from stripe_newton.sim import Simulation

__all__ = ["kinematic_chain"]

_KNOWN = (newton.JointType.PRISMATIC, newton.JointType.REVOLUTE, newton.JointType.D6)


def kinematic_chain(sim: Simulation, layout: Layout, joint_ids: list[int], body: int) -> KinematicChain:
    """Joints of an asset as the chain that moves one of its bodies.

    Joint frames are views of the model's arrays, so that events which move them are respected.

    Args:
        sim: The simulation, built.
        layout: Indices of the asset in the model.
        joint_ids: The joints, as indices of the asset's degrees of freedom.
        body: The body, as an index of the asset's bodies.

    Raises:
        ValueError: if a joint is neither a hinge nor a slide nor a combination of them, or no joint moves the body.
    """
    builder = sim.template
    if len(layout.coords) != len(layout.dofs):
        raise ValueError("there is a ball joint in the asset; inverse kinematics wants hinges and slides")
    owner, above = _joint_by_dof(builder, layout), _joints_above(builder, layout, body)
    joints = [owner[layout.dofs[i]] for i in joint_ids]
    moving = {i for i, dof in enumerate(layout.dofs) if owner[dof] in above}
    _check_joints(builder, layout, joint_ids, body, moving)
    starts, bodies = builder.joint_qd_start, layout.bodies

    def ints(values: list[int]) -> wp.array:
        return wp.array(values, dtype=int, device=sim.device)

    chain = KinematicChain()
    chain.carries = wp.array([j in above for j in joints], dtype=wp.bool, device=sim.device)
    chain.parent = ints([bodies.index(p) if (p := builder.joint_parent[j]) in bodies else -1 for j in joints])
    chain.joint = ints([j - layout.joints[0] for j in joints])
    chain.first = ints([starts[j] - layout.dofs.start for j in joints])
    chain.linear = ints([builder.joint_dof_dim[j][0] for j in joints])
    frames = sim.per_env(sim.model.joint_X_p)[:, layout.joints.start : layout.joints.stop]
    chain.frame = wp.from_torch(frames, dtype=wp.transform)
    # The axes of the first environment serve all: no event turns an axis.
    axes = sim.per_env(sim.model.joint_axis)[0, layout.dofs.start : layout.dofs.stop]
    chain.axis = wp.from_torch(axes, dtype=wp.vec3)
    return chain


def _joint_by_dof(builder: newton.ModelBuilder, layout: Layout) -> dict[int, int]:
    """Joint of each degree of freedom of an asset, both as indices of the builder."""
    joints: dict[int, int] = {}
    for joint in layout.joints:
        first, count = builder.joint_qd_start[joint], sum(builder.joint_dof_dim[joint])
        joints |= dict.fromkeys(range(first, first + count), joint)
    return joints


def _joints_above(builder: newton.ModelBuilder, layout: Layout, body: int) -> set[int]:
    """Joints between the asset's root and one of its bodies, as indices of the builder."""
    parents = {builder.joint_child[joint]: joint for joint in layout.joints}
    above, at = set[int](), layout.bodies[body]
    while at in parents:
        above.add(parents[at])
        at = builder.joint_parent[parents[at]]
    return above


def _check_joints(
    builder: newton.ModelBuilder, layout: Layout, joint_ids: list[int], body: int, moving: set[int]
) -> None:
    """Refuse joints of other kinds, and joints none of which moves the body.

    Args:
        builder: Builder of one environment.
        layout: Indices of the asset in it.
        joint_ids: The joints, as indices of the asset's degrees of freedom.
        body: The body, as an index of the asset's bodies.
        moving: Degrees of freedom of the asset that move the body.

    Raises:
        ValueError: naming the joint, or the joints that would do.
    """
    names, owner = layout.joint_names, _joint_by_dof(builder, layout)
    for i in joint_ids:
        joint = owner[layout.dofs[i]]
        if builder.joint_type[joint] not in _KNOWN:
            kind = newton.JointType(builder.joint_type[joint]).name.lower()
            raise ValueError(f"'{names[i]}' is a {kind} joint; inverse kinematics wants hinges and slides")
    if moving.isdisjoint(joint_ids):
        raise ValueError(
            f"none of {', '.join(names[i] for i in joint_ids)} carries '{layout.body_names[body]}'; "
            f"these do: {', '.join(names[i] for i in sorted(moving)) or 'none'}"
        )
