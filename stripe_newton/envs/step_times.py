# SPDX-License-Identifier: Apache-2.0
"""Step times: durations of the whole step and of the physics alone.

Both are measured on the same states and actions, alternating, so that a GPU that warms up or a busy machine affects
both alike.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from statistics import mean, median
from typing import TypeAlias

import torch
import warp as wp

from stripe_newton.sim import Simulation

from .env_state import EnvState
from .rl_env import RLEnv

__all__ = ["LEAD", "Clock", "StepTimes", "measure_step"]

Mark: TypeAlias = "wp.Event | float"
"""A point in time: an event of a GPU, or a time of the host [s]."""
LEAD = 4
"""Number of steps before each measured block that are not measured."""


class Clock:
    """Clock of a device.

    On a GPU marks are events of its Warp stream, which torch's default stream waits for; setting one does not wait. On
    the CPU they are times of the host.
    """

    def __init__(self, device: str):
        self.device, self.is_cuda = device, device != "cpu"

    def mark(self) -> Mark:
        """A mark behind all work issued so far."""
        if not self.is_cuda:
            return time.perf_counter()
        event = wp.Event(self.device, enable_timing=True)
        wp.get_stream(self.device).record_event(event)
        return event

    def ms(self, start: Mark, end: Mark) -> float:
        """Milliseconds between two marks. It waits for the second."""
        return wp.get_event_elapsed_time(start, end) if self.is_cuda else 1e3 * (end - start)

    def hold(self, seconds: float) -> None:
        """Keep a GPU busy for about ``seconds``, so that the work issued next waits in its queue."""
        if self.is_cuda:
            with torch.cuda.device(self.device):
                torch.cuda._sleep(int(2e9 * seconds))  # cycles, of which a GPU has about two a nanosecond

    def wait(self) -> None:
        """Wait until a GPU has finished all work."""
        if self.is_cuda:
            torch.cuda.synchronize(self.device)
            wp.synchronize_device(self.device)


@dataclass
class StepTimes:
    """Durations of one step [ms]; lists have an entry for each measured block.

    ``env`` and ``physics`` are times on the device with a full queue. ``env_wall`` are times on the host, which issues
    the steps of a block without waiting and waits at its end.
    """

    env: list[float]
    """Whole step."""
    env_wall: list[float]
    """Whole step, by the clock of the host."""
    physics: list[float]
    """The physics alone, on the states of the whole steps; mean over the steps of a block."""
    physics_ms: float
    """Mean over the steps of a block of the median over the blocks."""
    physics_free: list[float]
    """The physics alone, the steps of a block in sequence, without resets."""
    replay_difference: float
    """Largest difference of a joint coordinate after a step between the whole step and the physics alone, over
    environments whose episodes went on; 0 on the CPU unless events push the robots [m or rad]."""

    def to_dict(self) -> dict[str, float | list[float]]:
        """Medians and ranges, as for :func:`benchmark`."""
        env, wall = median(self.env), median(self.env_wall)
        return {
            "physics_ms": self.physics_ms,
            "env_ms": env,
            "overhead_ratio": env / self.physics_ms - 1.0,
            "env_wall_ms": wall,
            "physics_free_ms": median(self.physics_free),
            "physics_range_ms": [min(self.physics), max(self.physics)],
            "env_range_ms": [min(self.env), max(self.env)],
            "env_wall_range_ms": [min(self.env_wall), max(self.env_wall)],
            "blocks": len(self.env),
            "replay_difference": self.replay_difference,
        }


def measure_step(env: RLEnv, actions: torch.Tensor, blocks: int) -> StepTimes:
    """Time blocks of whole steps and of the physics of the same steps, alternating.

    The state is restored before each block. The physics alone starts each step from the state at the start of the whole
    step, with the targets at its end; restoring both is not timed. Environments that ended have the targets of their
    new episode.

    Args:
        env: An environment that is past its first steps.
        actions: Shape ``(LEAD + n, num_envs, *action_shape)`` for blocks of ``n`` steps.
        blocks: Number of blocks.
    """
    timer = _StepTimer(env, actions)
    times = StepTimes([], [], [], 0.0, [], timer.tape.replay_difference())
    each: list[list[float]] = []
    for _ in range(blocks):
        times.env.append(timer.env_ms())
        if timer.clock.is_cuda:
            times.env_wall.append(timer.env_wall_ms())
        else:  # steps on the CPU end before the host goes on
            times.env_wall.append(times.env[-1])
        each.append(timer.physics_ms())
        times.physics.append(mean(each[-1]))
        times.physics_free.append(timer.physics_free_ms())
    timer.before.restore()
    times.physics_ms = mean(map(median, zip(*each, strict=True)))
    return times


class _StepTimer:
    """Times single blocks of steps, each from the same state on."""

    def __init__(self, env: RLEnv, actions: torch.Tensor):
        self._env, self._sim, self._decimation = env, env.sim, env.cfg.decimation
        self._lead_actions, self._actions = actions[:LEAD], actions[LEAD:]
        self._steps = len(self._actions)
        self.clock, self.before = Clock(self._sim.device), _Snapshot(env)
        self._run(self._lead_actions)
        self.tape = _Tape(env, self._actions)
        self._ahead = self._time_to_issue()

    def _run(self, actions: torch.Tensor) -> None:
        for action in actions:
            self._env.step(action)

    def _time_to_issue(self) -> float:
        """Seconds in which the host issues a block: the device has to wait so long for its queue to stay full."""
        self.before.restore()
        self.clock.wait()
        start = time.perf_counter()
        self._run(self._lead_actions)
        ahead = 1.5 * self._steps / LEAD * (time.perf_counter() - start)
        return min(max(ahead, 0.005), 0.05)

    def env_ms(self) -> float:
        """Duration of a whole step on the device [ms]."""
        self.before.restore()
        self.clock.hold(self._ahead)
        self._run(self._lead_actions)
        start = self.clock.mark()
        self._run(self._actions)
        return self.clock.ms(start, self.clock.mark()) / self._steps

    def env_wall_ms(self) -> float:
        """Duration of a whole step by the clock of the host [ms]."""
        self.before.restore()
        self._run(self._lead_actions)
        self.clock.wait()
        start = time.perf_counter()
        self._run(self._actions)
        self.clock.wait()
        return 1e3 * (time.perf_counter() - start) / self._steps

    def physics_ms(self) -> list[float]:
        """Durations of the physics of each step, from the state at its start [ms]."""
        # Not timed: this step computes the bodies that the last reset has left to the next physics step.
        self._sim.step(self._decimation)
        self.clock.hold(self._ahead)
        marks = []
        for index in range(self._steps):
            self.tape.load(index)
            start = self.clock.mark()
            self._sim.step(self._decimation)
            marks.append((start, self.clock.mark()))
        return [self.clock.ms(*pair) for pair in marks]

    def physics_free_ms(self) -> float:
        """Duration of the physics of a step [ms], the steps of the block in sequence, without resets."""
        self.tape.load(0)
        self.clock.hold(self._ahead)
        start = self.clock.mark()
        for index in range(self._steps):
            self.tape.load_targets(index)
            self._sim.step(self._decimation)
        return self.clock.ms(start, self.clock.mark()) / self._steps


class _Snapshot:
    """State of an environment and of torch's random number generators, to be restored."""

    def __init__(self, env: RLEnv):
        self._env: RLEnv = env
        self._state: EnvState = env.get_state()
        self._cpu = torch.get_rng_state()
        self._cuda = torch.cuda.get_rng_state(env.device) if env.device != "cpu" else None

    def restore(self) -> None:
        self._env.set_state(self._state)
        torch.set_rng_state(self._cpu)
        if self._cuda is not None:
            torch.cuda.set_rng_state(self._cuda, self._env.device)


class _Tape:
    """Recording of a block of steps: the state at the start of each step, and the targets that it wrote."""

    def __init__(self, env: RLEnv, actions: torch.Tensor):
        self._sim, self._decimation = env.sim, env.cfg.decimation
        self._state, self._targets = _state(env.sim), _targets(env.sim)
        self._starts: list[list[wp.array]] = []
        self._written: list[list[wp.array]] = []
        self._ended: list[torch.Tensor] = []
        for action in actions:
            self._starts.append([wp.clone(a) for a in self._state])
            env.step(action)
            self._written.append([wp.clone(a) for a in self._targets])
            self._ended.append(env.reset_buf.clone())

    def load(self, index: int) -> None:
        """Restore the state at the start of step ``index``, and its targets."""
        for array, copy in zip(self._state, self._starts[index], strict=True):
            wp.copy(array, copy)
        self.load_targets(index)

    def load_targets(self, index: int) -> None:
        """Restore the targets of step ``index``."""
        for array, copy in zip(self._targets, self._written[index], strict=True):
            wp.copy(array, copy)

    def replay_difference(self) -> float:
        """Largest difference of a joint coordinate between the recording and the physics alone, after each step."""
        largest = 0.0
        for index in range(len(self._starts) - 1):
            self.load(index)
            self._sim.step(self._decimation)
            expected, got = (self._sim.per_env(a) for a in (self._starts[index + 1][0], self._sim.state.joint_q))
            difference = (expected - got)[~self._ended[index]].abs().nan_to_num(0.0)
            largest = max(largest, float(difference.max()) if difference.numel() else 0.0)
        return largest


def _state(sim: Simulation) -> list[wp.array]:
    state, data = sim.state, getattr(sim.solver, "mjw_data", None)
    solver = (data.qacc_warmstart, data.act) if data is not None else ()
    return [
        a for a in (state.joint_q, state.joint_qd, state.body_q, state.body_qd, *solver) if a is not None and a.size
    ]


def _targets(sim: Simulation) -> list[wp.array]:
    control = sim.control
    arrays = (control.joint_act, control.joint_target_q, control.joint_target_qd, sim.external_wrench)
    return [a for a in arrays if a is not None and a.size]
