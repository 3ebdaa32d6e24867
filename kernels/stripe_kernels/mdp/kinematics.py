# SPDX-License-Identifier: Apache-2.0
"""How joints move a body: the Jacobian, from body poses and joint frames.

It is that of the chosen joints and of one body alone, column by column. ``newton.eval_jacobian`` computes the same, and
allocates it for all links and degrees of freedom of all articulations.
"""

import warp as wp

from ..data import ArticulationData

__all__ = ["KinematicChain", "gram", "jacobian_column"]


@wp.struct
class KinematicChain:
    """The joints of an action on their way to a body; one entry each where nothing else is said."""

    carries: wp.array[wp.bool]
    """Whether the body moves with it."""
    parent: wp.array[int]
    """Body of the asset that its joint's frame is fixed to, -1 for the world."""
    joint: wp.array[int]
    """Column of ``frame`` of its joint."""
    first: wp.array[int]
    """The first degree of freedom of its joint, as an index of the asset's."""
    linear: wp.array[int]
    """How many of those of its joint are linear; they come first."""
    frame: wp.array2d[wp.transform]
    """Frames of all joints of the asset in their parents [m], shape ``(num_envs, n)``."""
    axis: wp.array[wp.vec3]
    """Axes of all degrees of freedom of the asset in the frames of their joints, shape ``(num_joints,)``."""


@wp.func
def jacobian_column(
    env: int, robot: ArticulationData, joint_ids: wp.array[int], chain: KinematicChain, index: int, point: wp.vec3
) -> wp.spatial_vector:
    """Velocity of a point of the body, and angular velocity, in the world for a unit speed of one joint.

    ``(a, 0)`` for a linear degree of freedom, ``(a x (point - pivot), a)`` for an angular one. In a joint with several,
    the linear ones shift the pivot and each angular one turns the axes of those after it, as in Newton's D6 joint.

    Args:
        env: Environment.
        robot: State.
        joint_ids: The joints.
        chain: How they carry the body.
        index: Which of ``joint_ids``.
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
    if dof < angular:
        return wp.spatial_vector(wp.quat_rotate(turn, chain.axis[dof]), wp.vec3())
    shift = wp.vec3()
    for k in range(first, angular):
        shift += chain.axis[k] * robot.joint_pos[env, k]
    for k in range(angular, dof):
        turn = turn * wp.quat_from_axis_angle(chain.axis[k], robot.joint_pos[env, k])
    axis = wp.quat_rotate(turn, chain.axis[dof])
    return wp.spatial_vector(wp.cross(axis, point - wp.transform_point(frame, shift)), axis)


@wp.func
def gram(
    env: int, robot: ArticulationData, joint_ids: wp.array[int], chain: KinematicChain, point: wp.vec3, rows: int
) -> wp.spatial_matrixd:
    """``J J^T`` of the first ``rows`` rows of the Jacobian; the rest is zero."""
    out = wp.spatial_matrixd()
    for i in range(joint_ids.shape[0]):
        column = jacobian_column(env, robot, joint_ids, chain, i, point)
        for a in range(rows):
            for b in range(rows):
                out[a, b] += wp.float64(column[a]) * wp.float64(column[b])
    return out
