# SPDX-License-Identifier: Apache-2.0
"""Delay of camera pictures, by rings of 32-bit words of any type, and replacement of missing depths."""

import warp as wp

from ..mdp.random import uniform
from .corruption import next_count

__all__ = ["begin_episodes", "count_pictures", "delay_words", "fill_missing"]


@wp.kernel(enable_backward=False)
def delay_words(
    due: wp.array[wp.bool],
    count: wp.array[int],
    lag: wp.array[int],
    taken: wp.array2d[int],
    ring: wp.array3d[int],
    out: wp.array2d[int],
):
    """Store a picture and output the one ``lag`` before; threads (environment, word).

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        count: Pictures taken before this one in the episode, shape ``(num_envs,)``.
        lag: Age of the pictures that are handed out, in pictures, below ``depth``, shape ``(num_envs,)``.
        taken: The picture, shape ``(num_envs, size)``.
        ring: The last ``depth`` pictures, shape ``(num_envs, depth, size)``.
        out: Output, the delayed picture, shape ``(num_envs, size)``.
    """
    env, i = wp.tid()
    if not due[env]:
        return
    depth, n = ring.shape[1], count[env]
    ring[env, n % depth, i] = taken[env, i]
    # The first picture of an episode stands for those before it.
    out[env, i] = ring[env, (n - wp.min(lag[env], n)) % depth, i]


@wp.kernel(enable_backward=False)
def count_pictures(due: wp.array[wp.bool], depth: int, count: wp.array[int]):
    """Count the pictures of environments that took one; a launch of its own, since ``delay_words`` reads the count."""
    env = wp.tid()
    if due[env]:
        count[env] = next_count(count[env], depth)


@wp.kernel(enable_backward=False)
def begin_episodes(
    mask: wp.array[wp.bool], least: int, most: int, rng: wp.array[wp.uint32], count: wp.array[int], lag: wp.array[int]
):
    """Forget the pictures of the environments of ``mask``, which start an episode, and draw their delays.

    Args:
        mask: Environments, shape ``(num_envs,)``.
        least: Least delay, in pictures.
        most: Largest delay, in pictures; where it equals ``least``, nothing is drawn.
        rng: Random streams, advanced, shape ``(num_envs,)``.
        count: Output, pictures in the episode, shape ``(num_envs,)``.
        lag: Output, delays, shape ``(num_envs,)``.
    """
    env = wp.tid()
    if not mask[env]:
        return
    count[env] = 0
    drawn = least
    if most > least:
        drawn = least + int(uniform(env, rng) * float(most - least + 1))
    lag[env] = wp.min(drawn, most)


@wp.kernel(enable_backward=False)
def fill_missing(due: wp.array[wp.bool], missing: float, noisy: wp.array2d[float], depth: wp.array2d[float]):
    """Write depths of at least 0 [m], with ``missing`` for infinite ones; threads (environment, pixel)."""
    env, i = wp.tid()
    if due[env]:
        depth[env, i] = wp.where(wp.isinf(noisy[env, i]), missing, wp.max(noisy[env, i], 0.0))
