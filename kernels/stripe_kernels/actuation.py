# SPDX-License-Identifier: Apache-2.0
"""Kernels that run before and after each physics step: external wrenches, velocity limits, overflow."""

import warp as wp

__all__ = ["apply_external_wrench", "clamp_velocity", "note_overflow", "repeat_mask"]


@wp.kernel(enable_backward=False)
def apply_external_wrench(
    body_q: wp.array[wp.transform],
    wrench: wp.array[wp.spatial_vector],
    in_world: wp.array[wp.bool],
    body_f: wp.array[wp.spatial_vector],
):
    """Write the external wrench of each body, about its centre of mass, in the world frame.

    Args:
        body_q: Body poses in the world frame [m, rad].
        wrench: Force and torque about the centre of mass [N, N m], in the frame that ``in_world`` says.
        in_world: Whether the wrench is given in the world frame; otherwise in the body's.
        body_f: Output, wrench in the world frame [N, N m].
    """
    body = wp.tid()
    w = wrench[body]
    if in_world[body]:
        body_f[body] = w
    else:
        q = wp.transform_get_rotation(body_q[body])
        body_f[body] = wp.spatial_vector(wp.quat_rotate(q, wp.spatial_top(w)), wp.quat_rotate(q, wp.spatial_bottom(w)))


@wp.kernel(enable_backward=False)
def clamp_velocity(limit: wp.array[float], joint_qd: wp.array[float]):
    """Clamp joint velocities to ``[-limit, limit]`` [m/s or rad/s]; shapes ``(joint_dof_count,)``."""
    dof = wp.tid()
    if not wp.isnan(joint_qd[dof]):
        joint_qd[dof] = wp.clamp(joint_qd[dof], -limit[dof], limit[dof])


@wp.kernel(enable_backward=False)
def note_overflow(overflow: wp.array[wp.int32], seen: wp.array[wp.int32], told: wp.array[wp.int32]):
    """Add the solver's overflow bits of each world, shape ``(num_envs,)``, to those ever seen, shape ``(1,)``.

    Bits that are new are added to ``told`` too, shape ``(1,)``, which the host reads.
    """
    bits = overflow[wp.tid()]
    if bits != 0:
        before = wp.atomic_or(seen, 0, bits)
        if (bits & ~before) != 0:
            wp.atomic_or(told, 0, bits)


@wp.kernel(enable_backward=False)
def repeat_mask(mask: wp.array[wp.bool], count: int, repeated: wp.array[wp.bool]):
    """Repeat each entry of ``mask`` ``count`` times."""
    i = wp.tid()
    repeated[i] = mask[i // count]
