# SPDX-License-Identifier: Apache-2.0
"""Fallback table: what computes the physics of each task and robot, the fused solver or MuJoCo Warp, as Markdown.

    python tools/documentation/fallback_table.py                        # all tasks, and the robots of docs/robots.md
    python tools/documentation/fallback_table.py --files FOLDER         # and the robots of MJCF and URDF files there
    python tools/documentation/fallback_table.py --grouped              # equal rows in one, as in docs/solvers.md
    python tools/documentation/fallback_table.py --compile --only Ant   # and seconds to compile the kernel for the CPU

A robot stands on a plane. A scene file (``scene*.xml``) is left out, since it only adds ground to another one. What
cannot be loaded is a row with the reason.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import warp as wp

import stripe_tasks  # noqa: F401  (registers the tasks)
from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, file_spawner
from stripe_newton.cli.tasks import load_cfg, make_env, task_ids
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import GroundPlaneCfg, MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_newton.solvers import SolverFused

ROBOTS = {
    "cart-pole": "stripe_tasks.robots:CARTPOLE_CFG",
    "cart with two poles": "stripe_tasks.robots:CART_DOUBLE_POLE_CFG",
    "ant": "stripe_tasks.robots:ANT_CFG",
    "humanoid with torque control": "stripe_tasks.robots:HUMANOID_CFG",
    "humanoid with position control": "stripe_tasks.robots:HUMANOID_POSITION_CFG",
    "quadruped": "stripe_tasks.robots:QUADRUPED_CFG",
    "arm": "stripe_tasks.reach.arm:ARM_CFG",
    "Crazyflie": "stripe_tasks.quadcopter.crazyflie:CRAZYFLIE_CFG",
}
"""Configs of the robots of this repository."""
SUFFIXES = (".xml", ".urdf")
_compiled: dict[str, float] = {}
"""Seconds of the kernels that have been compiled, by module: models of the same topology share one."""


@dataclasses.dataclass(frozen=True)
class Row:
    """Row of a model."""

    name: str
    nv: int | None
    physics: str
    compile_s: float | None = None


def physics_of(sim: Simulation) -> str:
    """Physics of a simulation in a few words: what computes it, and in how many launches."""
    text = sim.describe_solver().removeprefix("the fused step, ").removeprefix("with ")
    text = re.sub("of a hub with [0-9]+ limbs, ", "", text)
    return text.replace("all physics steps of a step in one launch", "one launch")


def row(name: str, make: Callable[[], Simulation], compiled: bool = False) -> Row:
    """Row of a model, which is built; a model that cannot be built has the reason in its row."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sim = make()
        nv = int(sim.solver.mj_model.nv) if hasattr(sim.solver, "mj_model") else None
        return Row(name, nv, physics_of(sim), compile_seconds(sim) if compiled else None)
    except Exception as error:
        text = (str(error).splitlines() or [""])[0]
        return Row(name, None, f"not loaded: {type(error).__name__}: {text}")


def compile_seconds(sim: Simulation) -> float | None:
    """Seconds to compile the kernel of the step with an empty cache; None where MuJoCo Warp steps the model."""
    if not isinstance(sim.solver, SolverFused) or sim.solver.unsupported:
        return None
    module, cache = sim.solver.fused.kernel.module, wp.config.kernel_cache_dir
    if module.name in _compiled:
        return _compiled[module.name]
    with tempfile.TemporaryDirectory() as folder:
        wp.config.kernel_cache_dir = folder
        try:
            start = time.perf_counter()
            module.load(wp.get_device("cpu"))
            _compiled[module.name] = time.perf_counter() - start
        finally:
            wp.config.kernel_cache_dir = cache
    return _compiled[module.name]


def task_sim(task: str) -> Simulation:
    """Simulation of two environments of a task."""
    cfg = load_cfg(task, "env")
    cfg.scene.num_envs, cfg.sim.device = 2, "cpu"
    return make_env(task, cfg).unwrapped.sim


def robot_sim(robot: ArticulationCfg) -> Simulation:
    """Simulation of a robot on a plane."""
    solver = MuJoCoSolverCfg(njmax=500, nconmax=150)
    sim = Simulation(SimulationCfg(device="cpu", dt=0.005, solver=solver))
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=2.0), sim)
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    scene.builder.build_objects({"ground": ground})
    scene.builder.build_robot("robot", robot.replace(prim_path="{ENV_REGEX_NS}/Robot"))
    scene.build()
    return sim


def own_robot(path: str) -> ArticulationCfg:
    """A robot of this repository by module and name."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)


def robot_of_file(path: Path) -> ArticulationCfg:
    """The robot of a file, with its servos, or with springs in its joints if it has none."""
    return ArticulationCfg(
        prim_path="",
        spawn=file_spawner(path, **({"fix_base": False} if path.suffix == ".urdf" else {})),
        init_state=ArticulationCfg.InitialStateCfg(pos=None, joint_pos=None),
        actuators={"joints": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=None, damping=None)},
    )


def robot_files(folder: Path) -> list[Path]:
    """Files of robots in a folder and those below it."""
    found = sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES)
    return [path for path in found if not path.name.startswith(("scene", "keyframe"))]


def table(rows: list[Row]) -> list[str]:
    """A table with a row for each model."""
    has_times = any(row.compile_s is not None for row in rows)
    lines = ["| model | degrees of freedom | physics |" + (" compile [s] |" if has_times else "")]
    lines += ["|---|---:|---|" + ("---:|" if has_times else "")]
    for row in rows:
        cells = [row.name, "" if row.nv is None else str(row.nv), row.physics.replace("|", "\\|")]
        cells += ["" if row.compile_s is None else f"{row.compile_s:.1f}"] if has_times else []
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def grouped(rows: list[Row]) -> list[str]:
    """A table with a row for each kind of physics, which names its models with their degrees of freedom."""
    groups: dict[str, list[str]] = {}
    for row in rows:
        groups.setdefault(row.physics, []).append(row.name if row.nv is None else f"{row.name} ({row.nv})")
    order = sorted(groups, key=lambda physics: -len(groups[physics]))
    lines = ["| physics | models, with their degrees of freedom |", "|---|---|"]
    return lines + [f"| {physics.replace('|', '/')} | {', '.join(groups[physics])} |" for physics in order]


def parse(arguments: list[str]) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=Path, nargs="*", default=[], help="folders with MJCF or URDF files")
    parser.add_argument("--only", nargs="+", help="parts of the names of the models")
    parser.add_argument("--grouped", action="store_true", help="equal rows in one")
    parser.add_argument("--compile", action="store_true", help="time the compilation of the kernels for the CPU")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> None:
    """Build the models and print the table; progress goes to stderr."""
    args = parse(arguments)
    wp.config.log_level = wp.LOG_WARNING
    models: dict[str, Callable[[], Simulation]] = {}
    for task in task_ids():
        models[f"`{task}`"] = lambda task=task: task_sim(task)
    for name, path in ROBOTS.items():
        models[name] = lambda path=path: robot_sim(own_robot(path))
    for folder in args.files:
        for file in robot_files(folder):
            models[f"`{file.relative_to(folder).as_posix()}`"] = lambda file=file: robot_sim(robot_of_file(file))
    rows = []
    for name, make in models.items():
        if args.only and not any(part in name for part in args.only):
            continue
        rows.append(row(name, make, args.compile))
        print(f"{rows[-1].name}: {rows[-1].physics}", file=sys.stderr, flush=True)
    print("\n".join((grouped if args.grouped else table)(rows)))


if __name__ == "__main__":
    main(sys.argv[1:])
