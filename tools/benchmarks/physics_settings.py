# SPDX-License-Identifier: Apache-2.0
"""Physics settings: time and accuracy of a walking task's physics by ground and by solver setting.

    python tools/benchmarks/physics_settings.py OUT [--num-envs 4096] [--steps 160] [--device cuda:0] [--only NAME ...]

Each row is the task with one thing changed. Milliseconds are those of an environment step's physics alone, under random
actions, after episodes have spread. The error is the root mean square difference of joint velocities [rad/s] after one
environment step, from states of such a run, to those of a solver that iterates until nothing changes. Results go to
OUT/physics.json.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.envs.measure import benchmark
from stripe_newton.terrains import MeshPlaneTerrainCfg
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg, QuadrupedRoughEnvCfg

Cfg = QuadrupedFlatEnvCfg | QuadrupedRoughEnvCfg
Setting = bool | float | int | str

EXACT = {"iterations": 100, "ls_iterations": 50, "tolerance": 1e-10, "ls_tolerance": 1e-4}


def flat(**solver: Setting) -> Callable[[], Cfg]:
    """The task on a plane, with fields of its solver changed."""
    return lambda: _with_solver(QuadrupedFlatEnvCfg(), solver)


def field(level: bool, **solver: Setting) -> Callable[[], Cfg]:
    """The task on a height field, level or rough."""

    def make() -> Cfg:
        cfg = QuadrupedRoughEnvCfg()
        if level:
            cfg.scene.terrain.terrain_generator.sub_terrains = {"plane": MeshPlaneTerrainCfg()}
        return _with_solver(cfg, solver)

    return make


def _with_solver(cfg: Cfg, solver: dict[str, Setting]) -> Cfg:
    """Change fields of a config's solver."""
    for name, value in solver.items():
        setattr(cfg.sim.solver, name, value)
    return cfg


VARIANTS: dict[str, Callable[[], Cfg]] = {
    "plane": flat(),
    "level field, triangles": field(True),
    "level field, general routine": field(True, triangle_contacts=False, nconmax=100, njmax=400),
    "rough field, triangles": field(False),
    "rough field, general routine": field(False, triangle_contacts=False, nconmax=100, njmax=400),
    "plane, 5 iterations": flat(iterations=5),
    "plane, 3 iterations": flat(iterations=3),
    "plane, 1 iteration": flat(iterations=1),
    "plane, 10 line search steps": flat(ls_iterations=10),
    "plane, 5 iterations, 10 line search steps": flat(iterations=5, ls_iterations=10),
    "plane, tolerance 1e-5": flat(tolerance=1e-5),
    "plane, elliptic cone": flat(cone="elliptic"),
    "plane, elliptic cone, impratio 10": flat(cone="elliptic", impratio=10.0),
    "plane, conjugate gradients": flat(solver="cg"),
    "plane, dense jacobian": flat(jacobian="dense"),
    "plane, sparse jacobian": flat(jacobian="sparse"),
    "plane, room for 60 constraints": flat(njmax=60),
    "plane, room for 12 contacts": flat(nconmax=12),
    "plane, euler": flat(integrator="euler"),
}


def build(make: Callable[[], Cfg], num_envs: int, device: str) -> ManagerBasedRLEnv:
    """The environment of a variant."""
    cfg = make()
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = num_envs, device, 1
    return ManagerBasedRLEnv(cfg)


def velocities_after(env: ManagerBasedRLEnv, states: list[tuple[torch.Tensor, ...]]) -> torch.Tensor:
    """Joint velocities after an environment step's physics from each of some states, each without warm start."""
    found = []
    data = env.scene["robot"].data
    for joint_pos, joint_vel, pose, vel, target in states:
        data.joint_pos[:], data.joint_vel[:] = joint_pos, joint_vel
        env.scene["robot"].write_root_pose_to_sim(pose)
        env.scene["robot"].write_root_velocity_to_sim(vel)
        data.joint_pos_target[:] = target
        env.sim.forward()
        env.sim.solver.mjw_data.qacc_warmstart.zero_()
        env.sim.step(env.cfg.decimation)
        found.append(data.joint_vel.clone())
    return torch.stack(found)


def record(num_envs: int, device: str) -> list[tuple[torch.Tensor, ...]]:
    """States of a run on the plane under random actions."""
    env = build(flat(), num_envs, device)
    env.reset(seed=0)
    generator, states = torch.Generator(device=device).manual_seed(0), []
    data = env.scene["robot"].data
    for index in range(100):
        env.step(0.5 * torch.randn(num_envs, 12, generator=generator, device=device))
        if index % 10 == 9:
            found = data.joint_pos, data.joint_vel, data.root_pose_w, data.root_vel_w, data.joint_pos_target
            states.append(tuple(x.clone() for x in found))
    env.close()
    return states


def table(rows: list[dict[str, Any]]) -> str:
    """The results in Markdown."""
    plane = next((r["physics_ms"] for r in rows if r["name"] == "plane" and "physics_ms" in r), None)
    lines = ["| | physics [ms] | times the plane | whole step [ms] | error [rad/s] |", "|---|---:|---:|---:|---:|"]
    for row in rows:
        if "problem" in row:
            lines.append(f"| {row['name']} | {row['problem']} | | | |")
            continue
        times = f"{row['physics_ms'] / plane:.2f}" if plane else ""
        error = f"{row['error']:.2g}" if "error" in row else ""
        lines.append(f"| {row['name']} | {row['physics_ms']:.3f} | {times} | {row['env_ms']:.3f} | {error} |")
    return "\n".join(lines)


def main() -> None:
    """Measure the variants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=160)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--only", nargs="*", help="parts of the names of the variants")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    sample = min(args.num_envs, 512)
    states = record(sample, args.device)
    env = build(flat(**EXACT), sample, args.device)
    exact = velocities_after(env, states)
    env.close()
    rows = []
    for name, make in VARIANTS.items():
        if args.only and not any(part in name for part in args.only):
            continue
        row: dict[str, Any] = {"name": name}
        try:
            row |= benchmark(lambda make=make: build(make, args.num_envs, args.device), args.steps)
            if name.startswith("plane"):
                env = build(make, sample, args.device)
                off = velocities_after(env, states) - exact
                row["error"] = float(off.square().mean().sqrt())
                env.close()
        except Exception as error:  # the others go on
            row["problem"] = f"{type(error).__name__}: {str(error).splitlines()[0]}"
        rows.append(row)
        # after each variant: a run takes long, and may be stopped
        (args.out / "physics.json").write_text(json.dumps(rows, indent=2) + "\n")
    print(f"\n{args.num_envs} environments on {rows[0].get('device_name') or args.device}\n")
    print(table(rows))


if __name__ == "__main__":
    main()
