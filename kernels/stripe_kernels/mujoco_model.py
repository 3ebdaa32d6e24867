# SPDX-License-Identifier: Apache-2.0
"""From Newton's model to MuJoCo Warp's, in some worlds: what ``SolverMuJoCo.notify_model_changed`` does in all of them.

Each kernel gets the worlds to update as ``mask``, shape ``(num_envs,)``. Names are those of ``newton.Model`` and, of
what is written, ``mujoco_warp.Model``.
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

__all__ = ["MuJoCoJoints", "copy_limits", "write_bodies", "write_gravity", "write_joints", "write_shapes"]

_POSITION = wp.constant(int(newton.JointTargetMode.POSITION))
_SLIDE = wp.constant(2)
"""The first of MuJoCo's joint types that have one coordinate."""


@wp.struct
class MuJoCoJoints:
    """Joint properties of both models. Arrays of Newton's are flat, those of MuJoCo Warp's lead with the world."""

    dof_map: wp.array2d[int]
    """Newton's degree of freedom for each of MuJoCo's, -1 for none."""
    joint_map: wp.array2d[int]
    """Newton's first degree of freedom for each of MuJoCo's joints, -1 for none."""
    actuator_source: wp.array[int]
    """0 for an actuator that is the drive of a joint."""
    actuator_map: wp.array[int]
    """Newton's degree of freedom in an environment: ``d`` for a position gain, ``-2 - d`` for a velocity gain."""
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
    """Damping that actuators add to MuJoCo's degrees of freedom, or an empty array."""
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
    """Friction, damping, armature, springs, limits and gains; a thread for each degree of freedom, joint and actuator
    of a world, whichever are most."""
    world, i = wp.tid()
    if not mask[world]:
        return
    if i < joints.dof_map.shape[1]:
        dof = joints.dof_map[world, i]
        if dof >= 0:
            joints.dof_frictionloss[world, i] = joints.joint_friction[dof]
            joints.dof_armature[world, i] = joints.joint_armature[dof]
            damping = joints.joint_damping[dof]
            if joints.extra_damping.shape[0] > 0:
                damping += joints.extra_damping[i]
            joints.dof_damping[world, i] = damping
    if i < joints.joint_map.shape[1]:
        dof = joints.joint_map[world, i]
        if dof >= 0:
            joints.jnt_stiffness[world, i] = joints.joint_stiffness[dof]
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
            kp = joints.joint_target_ke[dof]
            joints.actuator_gainprm[world, i][0] = kp
            joints.actuator_biasprm[world, i][1] = -kp
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
    """Limit the forces of drives as the efforts of their joints are; threads (row of the limits, drive)."""
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
    """Masses, centres of mass, and principal moments with their axes; a thread for each body of a world.

    Args:
        mask: Worlds to update.
        body_map: Newton's body for each of MuJoCo's, -1 for none.
        body_mass_from: Masses [kg].
        body_com: Centres of mass [m].
        body_inertia_from: Moments of inertia about them [kg m^2].
        body_mass: Output, masses.
        body_ipos: Output, centres of mass.
        body_inertia: Output, principal moments, falling.
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
    """Friction, gap and margin; a thread for each geom of a world.

    Args:
        mask: Worlds to update.
        shape_map: Newton's shape for each of MuJoCo's geoms, -1 for none.
        has_margin: Whether the solver heeds margins.
        friction: Coefficients of sliding friction.
        torsional: Of torsional friction [m].
        rolling: Of rolling friction [m].
        gap: Gaps [m].
        margin: Margins [m].
        geom_friction: Output, the three coefficients.
        geom_gap: Output.
        geom_margin: Output.
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
def write_gravity(mask: wp.array[wp.bool], gravity_from: wp.array[wp.vec3], gravity: wp.array[wp.vec3]):
    """Gravity [m/s^2]; a thread for each world."""
    world = wp.tid()
    if mask[world]:
        gravity[world] = gravity_from[world]
