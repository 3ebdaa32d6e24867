# SPDX-License-Identifier: Apache-2.0
"""Kernels around a physics step: external wrenches, velocity limits, overflow of the solver's buffers."""

import warp as wp

__all__ = ["apply_external_wrench", "clamp_velocity", "note_not_finite", "note_overflow", "repeat_mask"]


@wp.kernel(enable_backward=False)
def apply_external_wrench(
    body_q: wp.array[wp.transform],
    wrench: wp.array[wp.spatial_vector],
    in_world: wp.array[wp.bool],
    body_f: wp.array[wp.spatial_vector],
):
    """Write the external wrench of each body, about its centre of mass, in the world frame; one thread a body.

    Args:
        body_q: Body poses in the world frame [m, rad].
        wrench: Force and torque about the centre of mass [N, N m], in the world's or the body's frame.
        in_world: Whether the wrench of a body is given in the world frame; otherwise it is in the body's.
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
    # wp.clamp turns a NaN into a bound, which would hide a diverged world from the checks that look for it.
    if not wp.isnan(joint_qd[dof]):
        joint_qd[dof] = wp.clamp(joint_qd[dof], -limit[dof], limit[dof])


@wp.kernel(enable_backward=False)
def note_not_finite(values: wp.array[float], seen: wp.array[wp.int32], reported: wp.array[wp.int32]):
    """Report to the host once that a value is not finite; one thread a value.

    Args:
        values: Positions or velocities of the joints.
        seen: 1 once it was reported, shape ``(1,)``, in the device's memory.
        reported: 1 for the host, shape ``(1,)``, in pinned memory of the host.
    """
    if not wp.isfinite(values[wp.tid()]) and wp.atomic_or(seen, 0, 1) == 0:
        wp.atomic_or(reported, 0, 1)


@wp.kernel(enable_backward=False)
def note_overflow(overflow: wp.array[wp.int32], seen: wp.array[wp.int32], reported: wp.array[wp.int32]):
    """Collect the solver's overflow bits over all worlds, and report new ones to the host; one thread a world.

    Args:
        overflow: Overflow bits of the last physics step, shape ``(num_envs,)``.
        seen: Bits of all steps so far, shape ``(1,)``, in the device's memory.
        reported: Bits for the host, shape ``(1,)``, in pinned memory of the host.
    """
    bits = overflow[wp.tid()]
    if bits != 0:
        # A write to the host's memory is slow: of thousands of worlds that overflow only the first one that sees a
        # new bit writes there. atomic_or returns the value before, so that exactly one thread finds a bit new.
        before = wp.atomic_or(seen, 0, bits)
        if (bits & ~before) != 0:
            wp.atomic_or(reported, 0, bits)


@wp.kernel(enable_backward=False)
def repeat_mask(mask: wp.array[wp.bool], count: int, repeated: wp.array[wp.bool]):
    """Repeat each entry of ``mask`` ``count`` times: a mask of environments as a mask of their bodies, say."""
    i = wp.tid()
    repeated[i] = mask[i // count]
