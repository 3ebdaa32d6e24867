# SPDX-License-Identifier: Apache-2.0
"""Delay of camera pictures, by rings of 32-bit words of any type, and replacement of missing depths."""

import warp as wp

__all__ = ["count_pictures", "delay_words", "fill_missing", "forget_pictures"]


@wp.kernel(enable_backward=False)
def delay_words(
    due: wp.array[wp.bool],
    count: wp.array[int],
    taken: wp.array2d[int],
    ring: wp.array3d[int],
    out: wp.array2d[int],
):
    """Store a picture and output the one ``delay`` before; threads (environment, word).

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        count: Pictures taken before this one in the episode, shape ``(num_envs,)``.
        taken: The picture, shape ``(num_envs, size)``.
        ring: The last ``delay + 1`` pictures, shape ``(num_envs, delay + 1, size)``.
        out: Output, the delayed picture, shape ``(num_envs, size)``.
    """
    env, i = wp.tid()
    if not due[env]:
        return
    depth, n = ring.shape[1], count[env]
    if n == 0:  # the first picture of an episode stands for those before it
        for k in range(depth):
            ring[env, k, i] = taken[env, i]
    ring[env, n % depth, i] = taken[env, i]
    out[env, i] = ring[env, (n + 1) % depth, i]


@wp.kernel(enable_backward=False)
def count_pictures(due: wp.array[wp.bool], count: wp.array[int]):
    """Count the pictures of environments that took one; a launch of its own, since ``delay_words`` reads the count."""
    env = wp.tid()
    if due[env]:
        count[env] = count[env] + 1


@wp.kernel(enable_backward=False)
def forget_pictures(mask: wp.array[wp.bool], count: wp.array[int]):
    """Set the count of pictures to 0 in the environments of ``mask``, which start an episode."""
    env = wp.tid()
    if mask[env]:
        count[env] = 0


@wp.kernel(enable_backward=False)
def fill_missing(due: wp.array[wp.bool], missing: float, noisy: wp.array2d[float], depth: wp.array2d[float]):
    """Write depths of at least 0 [m], with ``missing`` for infinite ones; threads (environment, pixel)."""
    env, i = wp.tid()
    if due[env]:
        depth[env, i] = wp.where(wp.isinf(noisy[env, i]), missing, wp.max(noisy[env, i], 0.0))
