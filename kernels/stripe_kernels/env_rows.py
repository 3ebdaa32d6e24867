# SPDX-License-Identifier: Apache-2.0
"""Environment rows: lists of the environments in a mask, and copies of what arrays hold of some environments."""

import warp as wp

__all__ = ["BLOCK", "count_masked", "list_masked_first", "move_rows"]


BLOCK = wp.constant(64)
"""Environments that a thread of :func:`count_masked` counts."""


@wp.kernel(enable_backward=False)
def count_masked(mask: wp.array[wp.bool], counts: wp.array[int]):
    """Count the environments in a mask, block by block.

    Args:
        mask: The mask, shape ``(num_envs,)``.
        counts: Output, for each block of ``BLOCK`` environments, shape ``(num_envs / BLOCK,)``, rounded up.
    """
    block = wp.tid()
    count = wp.int32(0)
    for env in range(block * BLOCK, wp.min((block + 1) * BLOCK, mask.shape[0])):
        count += int(mask[env])
    counts[block] = count


@wp.kernel(enable_backward=False)
def list_masked_first(
    mask: wp.array[wp.bool],
    counts: wp.array[int],
    order: wp.array[wp.int64],
    count: wp.array[int],
    lists: wp.array[int],
    report: wp.array[wp.int64],
):
    """List the environments in a mask, in ascending order, and behind them all others.

    No atomics: an order that varies would give other random numbers to an environment in each run.

    Args:
        mask: The mask, shape ``(num_envs,)``.
        counts: Of :func:`count_masked`.
        order: Output, the list, shape ``(num_envs,)``.
        count: Output, number of environments in the mask, shape ``(1,)``.
        lists: How often the list was made, one more from launch to launch, shape ``(1,)``.
        report: Output for the host, which waits for it: the number of environments in the mask in the lower half, and
            ``lists`` above it, shape ``(1,)``.
    """
    env = wp.tid()
    block = env // BLOCK
    before, total = wp.int32(0), wp.int32(0)
    for k in range(counts.shape[0]):
        if k < block:
            before += counts[k]
        total += counts[k]
    for other in range(block * BLOCK, env):
        before += int(mask[other])
    place = before
    if not mask[env]:
        place = total + env - before
    order[place] = wp.int64(env)
    if env == 0:
        count[0] = total
        lists[0] += 1
        report[0] = (wp.int64(lists[0]) << wp.int64(32)) + wp.int64(total)


@wp.func_native("""
void* there = (void*)address;
unsigned* here = (unsigned*)kept.data + slot;
if (size == 4 && restores) *(unsigned*)there = *here;
else if (size == 4) *here = *(const unsigned*)there;
else if (restores) *(unsigned char*)there = (unsigned char)*here;
else *here = *(const unsigned char*)there;
""")
def _move(address: wp.uint64, size: int, kept: wp.array[wp.uint32], slot: int, restores: bool): ...


@wp.kernel(enable_backward=False)
def move_rows(
    order: wp.array[wp.int64],
    count: wp.array[int],
    address: wp.array[wp.uint64],
    stride: wp.array[int],
    size: wp.array[int],
    kept: wp.array[wp.uint32],
    restores: bool,
):
    """Keep what arrays hold of some environments, or bring it back; a thread for an environment and a piece.

    The environments are those of the list but for the first ``count``.

    Args:
        order: List of environments, shape ``(places,)`` or longer.
        count: Number of environments that are left out, shape ``(1,)``.
        address: Address of a piece of environment 0, shape ``(pieces,)``.
        stride: Bytes from one environment to the next, shape ``(pieces,)``.
        size: Bytes of a piece, 1 or 4, shape ``(pieces,)``.
        kept: The pieces, place by place, shape ``(places * pieces,)``.
        restores: Whether they are brought back.
    """
    place, piece = wp.tid()
    if place >= count[0]:
        there = address[piece] + wp.uint64(order[place]) * wp.uint64(stride[piece])
        _move(there, size[piece], kept, place * address.shape[0] + piece, restores)
