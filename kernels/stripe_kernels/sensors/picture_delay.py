# SPDX-License-Identifier: Apache-2.0
"""Delay of pictures: rings of 32-bit words, whatever those stand for; and what stands for missing depths."""

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
    """Keep a picture and hand out an earlier one; threads (environment, word).

    Args:
        due: Environments whose picture was taken, shape ``(num_envs,)``.
        count: Pictures taken before it in the episode, shape ``(num_envs,)``.
        taken: The picture, shape ``(num_envs, size)``.
        ring: The last ``delay + 1``, filled with the first of an episode, shape ``(num_envs, delay + 1, size)``.
        out: What is handed out, shape ``(num_envs, size)``.
    """
    env, i = wp.tid()
    if not due[env]:
        return
    depth, n = ring.shape[1], count[env]
    if n == 0:
        for k in range(depth):
            ring[env, k, i] = taken[env, i]
    ring[env, n % depth, i] = taken[env, i]
    out[env, i] = ring[env, (n + 1) % depth, i]


@wp.kernel(enable_backward=False)
def count_pictures(due: wp.array[wp.bool], count: wp.array[int]):
    """After the picture of an environment."""
    env = wp.tid()
    if due[env]:
        count[env] = count[env] + 1


@wp.kernel(enable_backward=False)
def forget_pictures(mask: wp.array[wp.bool], count: wp.array[int]):
    """Begin an episode where ``mask`` says so."""
    env = wp.tid()
    if mask[env]:
        count[env] = 0


@wp.kernel(enable_backward=False)
def fill_missing(due: wp.array[wp.bool], missing: float, noisy: wp.array2d[float], depth: wp.array2d[float]):
    """Depths, 0 at least, with ``missing`` for infinite ones; threads (environment, pixel)."""
    env, i = wp.tid()
    if due[env]:
        depth[env, i] = wp.where(wp.isinf(noisy[env, i]), missing, wp.max(noisy[env, i], 0.0))
