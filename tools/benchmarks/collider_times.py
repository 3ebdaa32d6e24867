# SPDX-License-Identifier: Apache-2.0
"""Collider times: ``python tools/benchmarks/collider_times.py FILE.xml ...``.

It prints the processor time of a physics step of robots that fall onto a plane with all their colliders, on the CPU:
once with all contacts found in the step's kernel, once with those of cylinders and ellipsoids found by MuJoCo Warp.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import newton
import warp as wp

from stripe_newton.solvers import SolverFused, contact_pairs

DT = 0.002
"""Time step [s]."""


def solver_of(file: Path, num_worlds: int) -> SolverFused:
    """A solver of worlds with the robot of a file on a plane."""
    one, builder = newton.ModelBuilder(), newton.ModelBuilder()
    for made in (one, builder):
        SolverFused.register_custom_attributes(made)
    one.rigid_gap = 0.0
    one.add_mjcf(str(file))
    one.add_ground_plane()
    builder.replicate(one, num_worlds)
    model = builder.finalize(device="cpu")
    return SolverFused(model, njmax=300, nconmax=100, kinematic_switchable_roots=False)


def step_ms(solver: SolverFused, steps: int) -> float:
    """Processor time of a step of all worlds [ms], after as many steps."""
    state, control = solver.model.state(), solver.model.control()
    for _ in range(2):
        start = time.process_time()
        solver.step_many(state, state, control, DT, steps)
    return 1e3 * (time.process_time() - start) / steps


def times(file: Path, num_worlds: int, steps: int) -> tuple[float, float]:
    """Times of a step with and without routines for curved geoms [ms]."""
    all_kinds = contact_pairs.KINDS
    found = step_ms(solver_of(file, num_worlds), steps)
    try:
        contact_pairs.KINDS = {k: v for k, v in all_kinds.items() if not contact_pairs.is_curved(v)}
        return found, step_ms(solver_of(file, num_worlds), steps)
    finally:
        contact_pairs.KINDS = all_kinds


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--num-worlds", type=int, default=64)
    parser.add_argument("--steps", type=int, default=200)
    args = parser.parse_args(argv)
    wp.config.log_level = wp.LOG_WARNING
    print("| file | all contacts in the kernel [ms] | some by MuJoCo Warp [ms] |\n|---|---:|---:|")
    for file in args.files:
        found, others = times(file, args.num_worlds, args.steps)
        print(f"| `{file.parent.name}/{file.name}` | {found:.2f} | {others:.2f} |", flush=True)


if __name__ == "__main__":
    main()
