# SPDX-License-Identifier: Apache-2.0
"""Motion data: a library of reference motions, the frame that each environment tracks, and where episodes begin.

All motions lie one after the other in arrays of frames at the control rate. A motion is cut into bins of about a
second. Bins in which episodes fail are drawn more often: the failures of a bin are averaged over steps, and its weight
is that average plus a constant. It may count for the bins before it, too, as what makes an episode fail begins earlier.
"""

import warp as wp

__all__ = ["MotionCommandData", "accumulate_probabilities", "average_failures"]


@wp.struct
class MotionCommandData:
    """Reference motions of an articulation, and the frame of each environment."""

    command: wp.array2d[float]
    """Joint positions and velocities of the reference [rad, rad/s or m, m/s], shape ``(num_envs, 2 num_joints)``."""
    frame: wp.array[int]
    """Frame that the environment tracks, an index into all frames, shape ``(num_envs,)``."""
    start: wp.array[int]
    """Frame at which the episode began, shape ``(num_envs,)``."""
    started_at: wp.array[wp.int64]
    """Step of the environment at which it began, shape ``(num_envs,)``."""
    joint_pos: wp.array2d[float]
    """Joint positions [rad or m], shape ``(num_frames, num_joints)``."""
    joint_vel: wp.array2d[float]
    """Joint velocities [rad/s or m/s], shape ``(num_frames, num_joints)``."""
    body_pose: wp.array2d[wp.transform]
    """Poses of the link frames, relative to the environment's origin [m], shape ``(num_frames, num_bodies)``."""
    body_vel: wp.array2d[wp.spatial_vector]
    """Velocities of the bodies' centres of mass [m/s, rad/s], shape ``(num_frames, num_bodies)``."""
    last: wp.array[int]
    """Last frame of the motion that a frame belongs to, shape ``(num_frames,)``."""
    bin: wp.array[int]
    """Bin of a frame, shape ``(num_frames,)``."""
    bin_start: wp.array[int]
    """First frame of a bin, shape ``(num_bins,)``."""
    bin_size: wp.array[int]
    """Frames of a bin at which an episode may begin, shape ``(num_bins,)``."""
    bin_motion: wp.array[int]
    """Motion of a bin, shape ``(num_bins,)``."""
    motion_start: wp.array[int]
    """First frame of a motion, shape ``(num_motions,)``."""
    failures: wp.array[float]
    """Episodes that failed in a bin in this step, shape ``(num_bins,)``."""
    failure_rate: wp.array[float]
    """Their average over steps, shape ``(num_bins,)``."""
    cumulative: wp.array[float]
    """Sums of the bins' weights, each of the bins up to it, shape ``(num_bins,)``."""
    anchor: int
    """Index of the anchor body."""


@wp.kernel(enable_backward=False)
def average_failures(motion: MotionCommandData, rate: float):
    """Update the averaged failures of each bin, and forget those of the step.

    Formula: ``f = rate n + (1 - rate) f``, ``n`` the failures of the step.
    """
    i = wp.tid()
    motion.failure_rate[i] = rate * motion.failures[i] + (1.0 - rate) * motion.failure_rate[i]
    motion.failures[i] = 0.0


@wp.func
def _bin_weight(motion: MotionCommandData, index: int, uniform_share: float, reach: int, decay: float) -> float:
    """Weight of a bin: averaged failures of it and of the bins after it in its motion, and an equal share of all.

    Formula: ``sum_k d^k (f_(i+k) + share / n) / sum_k d^k``, ``k`` from 0 to ``reach - 1``; past the end of the motion
    the last bin counts again.
    """
    count = motion.failure_rate.shape[0]
    total = wp.float32(0.0)
    norm = wp.float32(0.0)
    factor = wp.float32(1.0)
    at = index
    for k in range(reach):
        if k > 0 and at + 1 < count and motion.bin_motion[at + 1] == motion.bin_motion[index]:
            at += 1
        total += factor * (motion.failure_rate[at] + uniform_share / float(count))
        norm += factor
        factor = factor * decay
    return total / norm


@wp.kernel(enable_backward=False)
def accumulate_probabilities(motion: MotionCommandData, uniform_share: float, reach: int, decay: float):
    """Sum the weights of the bins up to each bin."""
    # A thread adds up for itself: some hundred bins, of which a scan would take more launches than it saves.
    i = wp.tid()
    total = wp.float32(0.0)
    for k in range(i + 1):
        total += _bin_weight(motion, k, uniform_share, reach, decay)
    motion.cumulative[i] = total
