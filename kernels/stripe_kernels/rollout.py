# SPDX-License-Identifier: Apache-2.0
"""Rollout kernels: Gaussian actions, storage of transitions, sums of episodes, and generalised advantage estimation."""

import warp as wp

__all__ = ["BLOCK", "add_up_episodes", "estimate_advantages", "sample_actions", "store_outcome"]

BLOCK = 64
"""Threads of a block for all kernels here: few, so that environments are spread over all multiprocessors."""

_HALF_LOG_2PI = wp.constant(0.9189385332046727)


@wp.kernel(enable_backward=False)
def sample_actions(
    step: wp.array[wp.int64],
    noise: wp.array2d[float],
    mean: wp.array2d[float],
    std: wp.array2d[float],
    bound: float,
    clipped: wp.array2d[float],
    actions: wp.array3d[float],
    means: wp.array3d[float],
    stds: wp.array3d[float],
    log_probs: wp.array2d[float],
):
    """Draw actions from Gaussians and store them with their densities; one thread for each of ``n`` environments.

    Args:
        step: Row of the storage, ``(1,)``.
        noise: Numbers drawn from a standard normal distribution, ``(n, k)``.
        mean: Means of the actions, ``(n, k)``.
        std: Standard deviations of the actions, ``(n, k)``.
        bound: Largest absolute value in ``clipped``.
        clipped: The actions within bounds, for the environment, ``(n, k)``.
        actions: Storage of the actions as drawn, ``(steps, n, k)``.
        means: Storage of ``mean``, ``(steps, n, k)``.
        stds: Storage of ``std``, ``(steps, n, k)``.
        log_probs: Storage of the logarithms of their densities, ``(steps, n)``.
    """
    env = wp.tid()
    row = int(step[0])
    log_prob = wp.float32(0.0)
    for j in range(noise.shape[1]):
        m, s = mean[env, j], std[env, j]
        action = noise[env, j] * s + m
        z = (action - m) / s
        log_prob += -0.5 * z * z - wp.log(s) - _HALF_LOG_2PI
        clipped[env, j] = wp.clamp(action, -bound, bound)
        actions[row, env, j] = action
        means[row, env, j] = m
        stds[row, env, j] = s
    log_probs[row, env] = log_prob


@wp.kernel(enable_backward=False)
def store_outcome(
    step: wp.array[wp.int64],
    reward: wp.array[float],
    terminated: wp.array[wp.bool],
    truncated: wp.array[wp.bool],
    rewards: wp.array2d[float],
    dones: wp.array2d[wp.uint8],
    cut_off: wp.array2d[wp.bool],
):
    """Store what a step of the environments returned; launch one thread for each of ``n`` environments.

    Args:
        step: Row of the storage, ``(1,)``.
        reward: Rewards, ``(n,)``.
        terminated: Whether the episode came to an end of its own, ``(n,)``.
        truncated: Whether it ran out of time, ``(n,)``.
        rewards: Storage of the rewards, ``(steps, n)``.
        dones: Storage of the ends of episodes, ``(steps, n)``.
        cut_off: Storage of those ends that time alone is the cause of, ``(steps, n)``.
    """
    env = wp.tid()
    row = int(step[0])
    rewards[row, env] = reward[env]
    dones[row, env] = wp.where(terminated[env] or truncated[env], wp.uint8(1), wp.uint8(0))
    cut_off[row, env] = truncated[env] and not terminated[env]


@wp.kernel(enable_backward=False)
def add_up_episodes(
    rewards: wp.array2d[float],
    dones: wp.array2d[wp.uint8],
    cut_off: wp.array2d[wp.bool],
    values: wp.array2d[float],
    discount: float,
    return_sum: wp.array[float],
    length_sum: wp.array[float],
    returns: wp.array2d[float],
    lengths: wp.array2d[float],
):
    """Sum returns and lengths of episodes over a rollout; launch one thread for each of ``n`` environments.

    An episode that time alone cut off would have gone on: after it is counted, its last reward takes the discounted
    value for the rest of its return.

    Args:
        rewards: Rewards, ``(steps, n)``; those of steps in ``cut_off`` are changed.
        dones: Ends of episodes, ``(steps, n)``.
        cut_off: Ends by time alone, ``(steps, n)``.
        values: Values of the states before the steps, ``(steps, n)``.
        discount: Discount factor of a step, 0 where the time left is a part of the task.
        return_sum: Returns of the running episodes so far, updated, ``(n,)``.
        length_sum: Lengths of the running episodes so far, updated, ``(n,)``.
        returns: Return of the episode up to each step, ``(steps, n)``.
        lengths: Length of the episode up to each step, ``(steps, n)``.
    """
    env = wp.tid()
    total, length = wp.float32(return_sum[env]), wp.float32(length_sum[env])
    for step in range(rewards.shape[0]):
        total += rewards[step, env]
        length += 1.0
        returns[step, env] = total
        lengths[step, env] = length
        if dones[step, env] != wp.uint8(0):
            total = 0.0
            length = 0.0
        if cut_off[step, env]:
            rewards[step, env] = rewards[step, env] + discount * values[step, env]
    return_sum[env] = total
    length_sum[env] = length


@wp.kernel(enable_backward=False)
def estimate_advantages(
    rewards: wp.array2d[float],
    dones: wp.array2d[wp.uint8],
    values: wp.array2d[float],
    last_values: wp.array[float],
    gamma: float,
    lam: float,
    returns: wp.array2d[float],
    advantages: wp.array2d[float],
):
    """Generalised advantage estimation (Schulman et al., arXiv:1506.02438); one thread for each of ``n`` environments.

    Args:
        rewards: Rewards, ``(steps, n)``.
        dones: Ends of episodes, ``(steps, n)``.
        values: Values of the states before the steps, ``(steps, n)``.
        last_values: Values of the states after the last step, ``(n,)``.
        gamma: Discount factor of a step.
        lam: The estimator's lambda.
        returns: Advantage plus value, ``(steps, n)``.
        advantages: Advantages, ``(steps, n)``.
    """
    env = wp.tid()
    next_value = wp.float32(last_values[env])
    advantage = wp.float32(0.0)
    for back in range(rewards.shape[0]):
        step = rewards.shape[0] - 1 - back
        value = values[step, env]
        goes_on = wp.where(dones[step, env] == wp.uint8(0), 1.0, 0.0)
        # TD error: r_t + gamma V(s_{t+1}) - V(s_t), then A_t = delta_t + gamma lambda A_{t+1}
        delta = rewards[step, env] + goes_on * gamma * next_value - value
        advantage = delta + goes_on * gamma * lam * advantage
        total = advantage + value
        returns[step, env] = total
        # rsl_rl's advantages are the returns less the values, rounded like that.
        advantages[step, env] = total - value
        next_value = value
