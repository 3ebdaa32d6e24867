# SPDX-License-Identifier: Apache-2.0
"""MuJoCo model updates: copy changed properties of Newton's model to MuJoCo Warp's, in the worlds of a mask.

``SolverMuJoCo.notify_model_changed`` does the same in all worlds. Each kernel takes the worlds to update as ``mask``,
shape ``(num_envs,)``. Inputs have the names of ``newton.Model``, outputs those of ``mujoco_warp.Model``.
"""

import newton
import warp as wp
from mujoco_warp._src.types import vec10
from newton._src.solvers.mujoco.kernels import (
    _eig_inertia,
    _ensure_proper_rotation,
    _sort_eigenpairs_descending,
    quat_xyzw_to_wxyz,
)

__all__ = [
    "ABSENT_MARGIN",
    "MuJoCoJoints",
    "copy_limits",
    "mark_absent_geoms",
    "write_bodies",
    "write_gravity",
    "write_joints",
    "write_shapes",
]

ABSENT_MARGIN = wp.constant(-1.0e30)
"""Margin of a geom that a world does not have [m]."""


_POSITION = wp.constant(int(newton.JointTargetMode.POSITION))
_SLIDE = wp.constant(2)
"""MuJoCo's joint type slide; it and the one after it, hinge, have one coordinate."""


@wp.struct
class MuJoCoJoints:
    """Joint properties of both models. Newton's arrays are flat, those of MuJoCo Warp lead with the world."""

    dof_map: wp.array2d[int]
    """Newton's degree of freedom for each of MuJoCo's, -1 for none, shape ``(num_envs, nv)``."""
    joint_map: wp.array2d[int]
    """Newton's first degree of freedom for each of MuJoCo's joints, -1 for none, shape ``(num_envs, njnt)``."""
    actuator_source: wp.array[int]
    """Origin of each actuator: 0 for the drive of a joint, shape ``(nu,)``."""
    actuator_map: wp.array[int]
    """Newton's degree of freedom in an environment: ``d`` for a position gain, ``-2 - d`` for a velocity gain, shape
    ``(nu,)``."""
    dofs_per_world: int
    joint_friction: wp.array[float]
    joint_damping: wp.array[float]
    joint_armature: wp.array[float]
    joint_stiffness: wp.array[float]
    joint_limit_lower: wp.array[float]
    joint_limit_upper: wp.array[float]
    joint_effort_limit: wp.array[float]
    joint_target_ke: wp.array[float]
    joint_target_kd: wp.array[float]
    joint_target_mode: wp.array[int]
    extra_damping: wp.array[float]
    """Damping that actuators add to MuJoCo's degrees of freedom, shape ``(nv,)``, or an empty array."""
    jnt_type: wp.array[int]
    jnt_qposadr: wp.array[int]
    qpos0: wp.array2d[float]
    dof_frictionloss: wp.array2d[float]
    dof_damping: wp.array2d[float]
    dof_armature: wp.array2d[float]
    jnt_stiffness: wp.array2d[float]
    jnt_range: wp.array2d[wp.vec2]
    jnt_actfrcrange: wp.array2d[wp.vec2]
    actuator_gainprm: wp.array2d[vec10]
    actuator_biasprm: wp.array2d[vec10]


@wp.kernel(enable_backward=False)
def write_joints(mask: wp.array[wp.bool], joints: MuJoCoJoints):
    """Write friction, damping, armature, springs, limits and gains of joints and their drives.

    Threads are (world, index): the index counts degrees of freedom, joints and actuators at once, up to the largest of
    the three numbers.
    """
    world, i = wp.tid()
    if not mask[world]:
        return
    if i < joints.dof_map.shape[1]:
        dof = joints.dof_map[world, i]
        if dof >= 0:
            joints.dof_frictionloss[world, i] = joints.joint_friction[dof]
            joints.dof_armature[world, i] = joints.joint_armature[dof]
            damping = joints.joint_damping[dof]
            # An actuator's damping and the joint's own share one field in MuJoCo.
            if joints.extra_damping.shape[0] > 0:
                damping += joints.extra_damping[i]
            joints.dof_damping[world, i] = damping
    if i < joints.joint_map.shape[1]:
        dof = joints.joint_map[world, i]
        if dof >= 0:
            joints.jnt_stiffness[world, i] = joints.joint_stiffness[dof]
            # Newton's limits count from the reference pose, MuJoCo's from the zero of its own coordinate.
            rest = wp.float32(0.0)
            if joints.jnt_type[i] >= _SLIDE:
                rest = joints.qpos0[world, joints.jnt_qposadr[i]]
            lower = joints.joint_limit_lower[dof] + rest
            joints.jnt_range[world, i] = wp.vec2(lower, joints.joint_limit_upper[dof] + rest)
            limit = joints.joint_effort_limit[dof]
            joints.jnt_actfrcrange[world, i] = wp.vec2(-limit, limit)
    if i < joints.actuator_map.shape[0] and joints.actuator_source[i] == 0:
        code = joints.actuator_map[i]
        if code >= 0:
            dof = world * joints.dofs_per_world + code
            # MuJoCo's affine actuator: force = gainprm[0] ctrl + biasprm[1] length + biasprm[2] velocity.
            kp = joints.joint_target_ke[dof]
            joints.actuator_gainprm[world, i][0] = kp
            joints.actuator_biasprm[world, i][1] = -kp
            # Damping belongs here only if no velocity actuator of the same joint has it.
            if joints.joint_target_mode[code] == _POSITION:
                joints.actuator_biasprm[world, i][2] = -joints.joint_target_kd[dof]
        elif code <= -2:
            kd = joints.joint_target_kd[world * joints.dofs_per_world - 2 - code]
            joints.actuator_gainprm[world, i][0] = kd
            joints.actuator_biasprm[world, i][2] = -kd


@wp.kernel(enable_backward=False)
def copy_limits(
    drives: wp.array[int],
    joints: wp.array[int],
    jnt_actfrcrange: wp.array2d[wp.vec2],
    actuator_forcerange: wp.array2d[wp.vec2],
):
    """Copy the effort limits of joints to the actuators that drive them; threads (row of the limits, drive)."""
    row, i = wp.tid()
    actuator_forcerange[row, drives[i]] = jnt_actfrcrange[row % jnt_actfrcrange.shape[0], joints[i]]


@wp.kernel(enable_backward=False)
def write_bodies(
    mask: wp.array[wp.bool],
    body_map: wp.array2d[int],
    body_mass_from: wp.array[float],
    body_com: wp.array[wp.vec3],
    body_inertia_from: wp.array[wp.mat33],
    body_mass: wp.array2d[float],
    body_ipos: wp.array2d[wp.vec3],
    body_inertia: wp.array2d[wp.vec3],
    body_iquat: wp.array2d[wp.quat],
):
    """Write masses, centres of mass and principal moments with their axes; a thread for each body of a world.

    Args:
        mask: Worlds to update.
        body_map: Newton's body for each of MuJoCo's, -1 for none.
        body_mass_from: Masses [kg].
        body_com: Centres of mass [m].
        body_inertia_from: Moments of inertia about the centres of mass [kg m^2].
        body_mass: Output, masses [kg].
        body_ipos: Output, centres of mass [m].
        body_inertia: Output, principal moments, largest first [kg m^2].
        body_iquat: Output, principal axes, quaternions (w, x, y, z).
    """
    world, i = wp.tid()
    if not mask[world]:
        return
    body = body_map[world, i]
    if body < 0:
        return
    body_mass[world, i] = body_mass_from[body]
    body_ipos[world, i] = body_com[body]
    # Newton's own steps in Newton's order, so that the result is that of notify_model_changed to the last bit.
    vectors, values = _eig_inertia(body_inertia_from[body])
    values, vectors = _sort_eigenpairs_descending(values, vectors)
    axes = wp.normalize(wp.quat_from_matrix(_ensure_proper_rotation(vectors)))
    body_inertia[world, i] = values
    body_iquat[world, i] = quat_xyzw_to_wxyz(axes)


@wp.kernel(enable_backward=False)
def write_shapes(
    mask: wp.array[wp.bool],
    shape_map: wp.array2d[int],
    has_margin: bool,
    friction: wp.array[float],
    torsional: wp.array[float],
    rolling: wp.array[float],
    gap: wp.array[float],
    margin: wp.array[float],
    geom_friction: wp.array2d[wp.vec3],
    geom_gap: wp.array2d[float],
    geom_margin: wp.array2d[float],
):
    """Write friction, gap and margin; a thread for each geom of a world.

    Args:
        mask: Worlds to update.
        shape_map: Newton's shape for each of MuJoCo's geoms, -1 for none.
        has_margin: Whether the solver uses margins.
        friction: Coefficients of sliding friction.
        torsional: Coefficients of torsional friction [m].
        rolling: Coefficients of rolling friction [m].
        gap: Contact gaps [m].
        margin: Contact margins [m].
        geom_friction: Output, the three coefficients.
        geom_gap: Output, contact gaps [m].
        geom_margin: Output, contact margins [m].
    """
    world, i = wp.tid()
    if not mask[world]:
        return
    shape = shape_map[world, i]
    if shape < 0:
        return
    geom_friction[world, i] = wp.vec3(friction[shape], torsional[shape], rolling[shape])
    geom_gap[world, i] = gap[shape]
    if has_margin:
        geom_margin[world, i] = margin[shape]


@wp.kernel(enable_backward=False)
def mark_absent_geoms(absent: wp.array2d[wp.bool], geom_margin: wp.array2d[float]):
    """Give geoms that a world does not have a margin that nothing is within; a thread for each geom of a world.

    Args:
        absent: Whether the world lacks the geom.
        geom_margin: Output, contact margins [m].
    """
    world, i = wp.tid()
    if absent[world, i]:
        geom_margin[world, i] = ABSENT_MARGIN


@wp.kernel(enable_backward=False)
def write_gravity(mask: wp.array[wp.bool], gravity_from: wp.array[wp.vec3], gravity: wp.array[wp.vec3]):
    """Write gravity [m/s^2]; a thread for each world."""
    world = wp.tid()
    if mask[world]:
        gravity[world] = gravity_from[world]
