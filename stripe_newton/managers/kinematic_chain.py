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
    builder, names = sim.template, layout.joint_names
    if len(layout.coords) != len(layout.dofs):
        raise ValueError("there is a ball joint in the asset; inverse kinematics wants hinges and slides")
    owners = {
        dof: joint
        for joint in layout.joints
        for dof in range(
            builder.joint_qd_start[joint], builder.joint_qd_start[joint] + sum(builder.joint_dof_dim[joint])
        )
    }
    above, at = set(), layout.bodies[body]
    parents = {builder.joint_child[j]: j for j in layout.joints}
    while at in parents:
        above.add(parents[at])
        at = builder.joint_parent[parents[at]]
    joints = [owners[layout.dofs[i]] for i in joint_ids]
    for i, joint in zip(joint_ids, joints, strict=True):
        if builder.joint_type[joint] not in _KNOWN:
            kind = newton.JointType(builder.joint_type[joint]).name.lower()
            raise ValueError(f"'{names[i]}' is a {kind} joint; inverse kinematics wants hinges and slides")
    if not above.intersection(joints):
        own = [n for n, dof in zip(names, layout.dofs, strict=True) if owners[dof] in above]
        raise ValueError(
            f"none of {', '.join(names[i] for i in joint_ids)} carries '{layout.body_names[body]}'; "
            f"these do: {', '.join(own) or 'none'}"
        )
    model, device, first = sim.model, sim.device, layout.joints[0]

    def ints(values: list[int]) -> wp.array:
        return wp.array(values, dtype=int, device=device)

    starts, bodies = builder.joint_qd_start, layout.bodies
    chain = KinematicChain()
    chain.carries = wp.array([j in above for j in joints], dtype=wp.bool, device=device)
    chain.parent = ints([bodies.index(p) if (p := builder.joint_parent[j]) in bodies else -1 for j in joints])
    chain.joint = ints([j - first for j in joints])
    chain.first = ints([starts[j] - layout.dofs.start for j in joints])
    chain.linear = ints([builder.joint_dof_dim[j][0] for j in joints])
    frames = sim.per_env(model.joint_X_p)[:, layout.joints.start : layout.joints.stop]
    chain.frame = wp.from_torch(frames, dtype=wp.transform)
    axes = sim.per_env(model.joint_axis)[0, layout.dofs.start : layout.dofs.stop]
    chain.axis = wp.from_torch(axes, dtype=wp.vec3)
    return chain
