# SPDX-License-Identifier: Apache-2.0
"""Kinematics: the Jacobian of a body with respect to chosen joints, from body poses and joint frames.

It is computed column by column and never stored. ``newton.eval_jacobian`` computes the same numbers, and allocates them
for all links and degrees of freedom of all articulations.
"""

import warp as wp

from ..data import ArticulationData

__all__ = ["KinematicChain", "gram", "jacobian_column"]


@wp.struct
class KinematicChain:
    """Kinematic chain: the degrees of freedom of an action, and the joints that they belong to.

    Arrays have one entry for each degree of freedom of the action (``joint_ids``) unless a shape says otherwise.
    """

    carries: wp.array[wp.bool]
    """Whether the body moves with the degree of freedom."""
    parent: wp.array[int]
    """Body of the asset that the joint's frame is fixed to, -1 for the world."""
    joint: wp.array[int]
    """Column of the joint in ``frame``."""
    first: wp.array[int]
    """First degree of freedom of the joint, as an index of the asset's."""
    linear: wp.array[int]
    """Number of linear degrees of freedom of the joint; they come before the angular ones."""
    frame: wp.array2d[wp.transform]
    """Frames of all joints of the asset in the frames of their parents [m], shape ``(num_envs, n)``."""
    axis: wp.array[wp.vec3]
    """Axes of all degrees of freedom of the asset in the frames of their joints, shape ``(num_joints,)``."""


@wp.func
def jacobian_column(
    env: int, robot: ArticulationData, joint_ids: wp.array[int], chain: KinematicChain, index: int, point: wp.vec3
) -> wp.spatial_vector:
    """Column of the Jacobian: velocity of a point of the body, and angular velocity, in the world, at unit joint speed.

    ``(a, 0)`` for a linear degree of freedom with axis ``a``, ``(a x (point - pivot), a)`` for an angular one. In a
    joint with several degrees of freedom the linear ones shift the pivot, and each angular one turns the axes of those
    after it, as in Newton's D6 joint.

    Args:
        env: Environment.
        robot: State of the articulation.
        joint_ids: Degrees of freedom of the action.
        chain: Their joints, and whether they carry the body.
        index: Index into ``joint_ids``.
        point: The point in the world [m].
    """
    if not chain.carries[index]:
        return wp.spatial_vector()
    dof = joint_ids[index]
    frame = chain.frame[env, chain.joint[index]]
    if chain.parent[index] >= 0:
        frame = robot.body_pose[env, chain.parent[index]] * frame
    turn = wp.transform_get_rotation(frame)
    first = chain.first[index]
    angular = first + chain.linear[index]
    # Linear axes come first and are fixed in the joint's frame: no degree of freedom of the joint turns them.
    if dof < angular:
        return wp.spatial_vector(wp.quat_rotate(turn, chain.axis[dof]), wp.vec3())
    shift = wp.vec3()
    for k in range(first, angular):
        shift += chain.axis[k] * robot.joint_pos[env, k]
    for k in range(angular, dof):  # only the angular axes before this one turn it
        turn = turn * wp.quat_from_axis_angle(chain.axis[k], robot.joint_pos[env, k])
    axis = wp.quat_rotate(turn, chain.axis[dof])
    return wp.spatial_vector(wp.cross(axis, point - wp.transform_point(frame, shift)), axis)


@wp.func
def gram(
    env: int, robot: ArticulationData, joint_ids: wp.array[int], chain: KinematicChain, point: wp.vec3, rows: int
) -> wp.spatial_matrixd:
    """Gram matrix ``J J^T`` of the first ``rows`` rows of the Jacobian; the rest is zero."""
    # In float64: the product squares the condition number, which would leave float32 without digits near a singularity.
    out = wp.spatial_matrixd()
    for i in range(joint_ids.shape[0]):
        column = jacobian_column(env, robot, joint_ids, chain, i, point)
        for a in range(rows):
            for b in range(rows):
                out[a, b] += wp.float64(column[a]) * wp.float64(column[b])
    return out
