# SPDX-License-Identifier: Apache-2.0
"""Cases of ``solver_scaling.py``: models by size, built for one of both solvers, and timed.

``python solver_scaling_cases.py REQUEST`` builds the cases of a request, writes ``READY``, waits for a line on its
input, measures them, and writes after each the results so far.
"""

from __future__ import annotations

import dataclasses
import gc
import itertools
import json
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from statistics import mean, median
from typing import Any

import newton
import numpy as np
import torch
import warp as wp

from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.envs.measure import random_actions, timed_start
from stripe_newton.envs.step_times import LEAD, Clock, measure_step
from stripe_newton.sim.capture import capture_graph
from stripe_newton.solvers import SolverFused
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg

__all__ = ["JOINTS", "Case", "Options", "build", "robot_mjcf"]

Entry = dict[str, Any]
"""Measurement of a case, as it is written to JSON."""

STEPS, DT = 4, 0.005
"""Physics steps of a control step, and their length [s]: those of the walking tasks."""
SETTINGS = {"iterations": 10, "ls_iterations": 20, "njmax": 120, "nconmax": 30, "kinematic_switchable_roots": False}
"""Arguments of both solvers for the models of this file: those of the walking tasks."""
JOINTS = 3
"""Hinges of a limb."""
MOST_SPHERES = 24
"""Spheres below the base where the number of constraint rows is varied."""
SETTLE = 16
"""Control steps of a block before those that are timed."""
WARMUP, WARMUP_SECONDS = 128, 0.3
"""Steps of the task before those that are timed, and time for which a GPU is kept busy first, to raise its clock."""


@dataclasses.dataclass(frozen=True)
class Case:
    """Case of the measurement: a solver on a model of some size."""

    part: str
    """``"worlds"``, ``"dofs"`` or ``"rows"``."""
    solver: str
    """``"fused"`` or ``"mujoco_warp"``."""
    size: int
    """Worlds, limbs of the robot, or its spheres on the ground."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the measurement."""

    device: str
    worlds: int
    """Worlds of the parts in which their number does not vary."""
    steps: int
    """Control steps in a block."""
    blocks: int


# -- robots of different sizes


def robot_mjcf(limbs: int, spheres: int, touching: int) -> str:
    """A robot on a plane as MJCF: a base on spheres, and limbs of three hinges, which touch nothing.

    Args:
        limbs: Number of limbs; the robot has 6 + 3 * limbs degrees of freedom.
        spheres: Number of spheres below the base, a multiple of 4.
        touching: How many of them are on the ground: each is a contact, of four rows with a pyramidal cone. The others
            are 5 cm above it. They have no mass, so that one kernel serves any number of them.
    """
    grid = itertools.product((0.3, 0.18, 0.06), (0.2, 0.066))
    places = [(x * i, y * j) for x, y in grid for i in (1, -1) for j in (1, -1)][:spheres]
    feet = [
        f'<geom type="sphere" size="0.03" mass="0" pos="{x} {y} {-0.1 if k < touching else -0.05}"/>'
        for k, (x, y) in enumerate(places)
    ]
    parts, servos = [], []
    for limb in range(limbs):
        angle = 2.0 * np.pi * limb / limbs
        x, y = 0.25 * np.cos(angle), 0.15 * np.sin(angle)
        for joint, axis in enumerate(("1 0 0", "0 1 0", "0 1 0")):
            name, place = f"limb_{limb}_{joint}", f"{x:.4f} {y:.4f} 0.05" if joint == 0 else "0 0 0.15"
            parts.append(
                f'<body pos="{place}"><joint name="{name}" axis="{axis}" armature="0.01"/><geom type="capsule" '
                'size="0.02" fromto="0 0 0 0 0 0.15" mass="0.2" contype="0" conaffinity="0"/>'
            )
            servos.append(f'<position joint="{name}" kp="20" kv="0.5"/>')
        parts.append("</body>" * JOINTS)
    base = '<geom type="box" size="0.3 0.2 0.05" mass="20" contype="0" conaffinity="0"/>'
    return (
        '<mujoco><worldbody><geom type="plane" size="0 0 1"/><body pos="0 0 0.13"><freejoint/>'
        f"{base}{''.join(feet)}{''.join(parts)}</body></worldbody><actuator>{''.join(servos)}</actuator></mujoco>"
    )


def robots(case: Case, worlds: int, device: str) -> newton.Model:
    """The model of a case with its robots, each in a pose of its own."""
    limbs, spheres, touching = (case.size, 4, 4) if case.part == "dofs" else (4, MOST_SPHERES, case.size)
    one, builder = newton.ModelBuilder(), newton.ModelBuilder()
    for each in (one, builder):
        SolverFused.register_custom_attributes(each)
        each.rigid_gap = 0.0
    one.add_mjcf(robot_mjcf(limbs, spheres, touching))
    builder.replicate(one, worlds)
    model = builder.finalize(device=device)
    start = model.joint_q.numpy().reshape(worlds, -1)
    start[:, 7:] += np.random.default_rng(0).uniform(-0.3, 0.3, (worlds, start.shape[1] - 7))
    if not touching:
        start[:, 2] = 1000.0  # it falls, for a second
    model.joint_q.assign(start.ravel())
    return model


class RobotsCase:
    """Robots under random targets, stepped by a solver that is used alone, on a GPU as a CUDA graph."""

    def __init__(self, case: Case, options: Options):
        self._options, self._clock, used = options, Clock(options.device), memory_mb(options.device)
        start = time.perf_counter()
        self._model = model = robots(case, options.worlds, options.device)
        solver = SolverFused if case.solver == "fused" else newton.solvers.SolverMuJoCo
        self._solver = solver(model, **SETTINGS)
        self._state, self._control, self._start = model.state(), model.control(), model.state()
        newton.eval_fk(model, model.joint_q, model.joint_qd, self._start)
        self._targets = self._random_targets()
        built = self._seconds_since(start)
        start = time.perf_counter()
        self._launch()
        self._step: Callable[[], None] = self._launch
        if self._clock.is_cuda:
            graph = capture_graph(options.device, self._launch)
            self._step = lambda: wp.capture_launch(graph)
        self.entry: Entry = {
            "num_worlds": options.worlds,
            "nv": int(self._solver.mj_model.nv),
            "build_s": built,
            "first_step_s": self._seconds_since(start),
            "memory_mb": None if used is None else memory_mb(options.device) - used,
            "physics": describe(self._solver),
        }

    def _seconds_since(self, start: float) -> float:
        self._clock.wait()
        return time.perf_counter() - start

    def _random_targets(self) -> list[wp.array]:
        """Targets of the hinges for each step of a block, the same for both solvers."""
        worlds, rng = self._options.worlds, np.random.default_rng(1)
        targets = np.zeros((worlds, self._model.joint_coord_count // worlds), dtype=np.float32)
        found = []
        for _ in range(SETTLE + self._options.steps):
            targets[:, 7:] = rng.uniform(-0.5, 0.5, targets[:, 7:].shape)
            found.append(wp.array(targets.ravel(), dtype=float, device=self._options.device))
        return found

    def _launch(self) -> None:
        """The physics of a control step."""
        state, control = self._state, self._control
        if isinstance(self._solver, SolverFused):
            self._solver.step_many(state, state, control, DT, STEPS)
            return
        for _ in range(STEPS):
            self._solver.step(state, state, control, None, DT)

    def _restore(self) -> None:
        """Start again, so that all blocks of both solvers go through the same states."""
        for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
            wp.copy(getattr(self._state, name), getattr(self._start, name))
        self._solver.mjw_data.qacc_warmstart.zero_()

    def measure(self) -> Entry:
        """Time the blocks; then count rows and iterations in the same states."""
        self._clock.hold(WARMUP_SECONDS)
        self._block()
        times = [self._block() for _ in range(self._options.blocks)]
        return self.entry | {
            "ms": mean(map(median, zip(*times, strict=True))),
            "range_ms": [min(map(mean, times)), max(map(mean, times))],
            **self._count(),
        }

    def _block(self) -> list[float]:
        """Milliseconds of each control step of a block."""
        self._restore()
        self._clock.hold(0.01)
        marks = []
        for index, targets in enumerate(self._targets):
            wp.copy(self._control.joint_target_q, targets)
            start = self._clock.mark()
            self._step()
            if index >= SETTLE:
                marks.append((start, self._clock.mark()))
        return [self._clock.ms(*pair) for pair in marks]

    def _count(self) -> Entry:
        """Constraint rows and iterations of the last physics step of each control step, means over the worlds."""
        self._restore()
        counts = []
        for index, targets in enumerate(self._targets):
            wp.copy(self._control.joint_target_q, targets)
            self._step()
            if index >= SETTLE:
                counts.append(counted(self._solver))
        rows, iterations = np.mean(counts, axis=0)
        finite = bool(np.isfinite(self._state.joint_q.numpy()).all())
        return {"rows": float(rows), "iterations": float(iterations), "finite": finite}


class TaskCase:
    """The flat quadruped's task, of which the physics is timed as by ``stripe-newton bench``."""

    def __init__(self, case: Case, options: Options):
        cfg, self._options, used = QuadrupedFlatEnvCfg(), options, memory_mb(options.device)
        cfg.scene.num_envs, cfg.sim.device, cfg.seed = case.size, options.device, 1
        cfg.sim.solver.fused = case.solver == "fused"
        self._env, begun = timed_start(lambda: ManagerBasedRLEnv(cfg))
        solver = self._env.sim.solver
        self.entry: Entry = {
            "num_worlds": case.size,
            "nv": int(solver.mj_model.nv),
            **{name: begun[name] for name in ("build_s", "first_step_s")},
            "memory_mb": None if used is None else memory_mb(options.device) - used,
            "physics": self._env.sim.describe_solver(),
        }

    def measure(self) -> Entry:
        """Time the physics in states of a run under random actions, with episodes spread over their lengths."""
        env, options = self._env, self._options
        actions = random_actions(env, LEAD + options.steps)
        generator = torch.Generator(device=env.device).manual_seed(0)
        most, shape = env.max_episode_length, env.episode_length_buf.shape
        env.episode_length_buf = torch.randint(most, shape, generator=generator, device=env.device)
        Clock(env.device).hold(WARMUP_SECONDS)
        for index in range(WARMUP):
            env.step(actions[index % len(actions)])
        rows, iterations = counted(env.sim.solver)
        times = measure_step(env, actions, options.blocks).to_dict()
        return self.entry | {
            "ms": times["physics_ms"],
            "range_ms": times["physics_range_ms"],
            "step_ms": times["env_ms"],
            "rows": rows,
            "iterations": iterations,
            "finite": bool(np.isfinite(env.sim.state.joint_q.numpy()).all()),
        }


def build(case: Case, options: Options) -> RobotsCase | TaskCase:
    """Build a case and take its first step."""
    return (TaskCase if case.part == "worlds" else RobotsCase)(case, options)


# -- what is read


def counted(solver: newton.solvers.SolverMuJoCo) -> tuple[float, float]:
    """Constraint rows and iterations of the last physics step, means over the worlds."""
    data = solver.mjw_data
    return float(data.nefc.numpy().mean()), float(data.solver_niter.numpy().mean())


def describe(solver: newton.solvers.SolverMuJoCo) -> str:
    """Description of what computes the physics, in a line."""
    return solver.describe() if isinstance(solver, SolverFused) else "MuJoCo Warp"


def memory_mb(device: str) -> float | None:
    """Memory of a GPU that Warp's arrays of this process take [MiB]; None for the CPU."""
    if device == "cpu" or not wp.is_mempool_enabled(device):
        return None
    gc.collect()
    wp.synchronize_device(device)
    return wp.get_mempool_used_mem_current(device) / 2**20


# -- a process that measures some cases


def main() -> None:
    """Build the cases of a request, wait, and measure them."""
    request = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    options, out = Options(**request["options"]), Path(request["out"])
    wp.config.log_level = wp.LOG_WARNING
    wp.set_device(options.device)
    cases = [Case(**case) for case in request["cases"]]
    built: dict[Case, RobotsCase | TaskCase] = {}
    entries: dict[Case, Entry] = {}
    for case in cases:
        attempt(case, entries, lambda case=case: built.update({case: build(case, options)}))
    Path(request["ready"]).write_text(f"{len(built)} of {len(cases)} built\n", encoding="utf-8")
    if not sys.stdin.readline():  # the program that started this one has ended
        return
    for case in cases:
        if case in built:
            attempt(case, entries, lambda case=case: entries.update({case: built[case].measure()}))
        name = None if options.device == "cpu" else wp.get_device(options.device).name
        found = [dataclasses.asdict(c) | {"device": name or "CPU"} | entry for c, entry in entries.items()]
        part = out.with_suffix(".part")
        part.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        part.replace(out)


def attempt(case: Case, entries: dict[Case, Entry], function: Callable[[], object]) -> None:
    """Call a function; a failure is the case's result, and the others go on."""
    try:
        function()
    except Exception as error:
        traceback.print_exc()
        entries[case] = {"error": f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"}


if __name__ == "__main__":
    main()
