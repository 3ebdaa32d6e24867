# SPDX-License-Identifier: Apache-2.0
"""Forest scaling: cost of making a forest, and of a step in it, against the number of trees.

    python tools/benchmarks/forest_scaling.py OUT                               # both parts
    python tools/benchmarks/forest_scaling.py OUT --parts make                  # seconds and memory, a process a size
    python tools/benchmarks/forest_scaling.py OUT --parts step --device cuda:0  # quadrupeds that walk in it
    python tools/benchmarks/forest_scaling.py OUT --parts                       # only the table and the picture

The density stays that of ordinary woods, so the area grows with the number of trees. The bare ground is the same
relief without trees, rocks and collider slots. ``OUT/make.json`` and ``OUT/step.json`` have the numbers,
``OUT/forest_scaling.md`` the tables, ``OUT/forest_scaling.png`` the curves.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

MAKE, STEP = (100, 300, 1000, 3000, 5000, 10_000, 20_000, 50_000), (0, 1000, 10_000, 50_000)
DENSITY = 600.0
"""Stems per hectare."""

Entry = dict[str, Any]
"""Measurement at one number of trees, as it is written to JSON."""


def extent(count: int) -> float:
    """Side of a square for ``count`` trees [m]."""
    return max(24.0, math.sqrt(1.0e4 * count / DENSITY))


def make(count: int, out: Path) -> Entry:
    """Create, author, save, and load a forest of ``count`` trees; 5000 of them stand on 256 m by 256 m."""
    import newton

    from stripe_newton.scene.scenery import add_scenery, read_scenery
    from stripe_newton.usd import open_stage
    from stripe_tasks.forest import ForestSpec

    side = 256.0 if count == 5000 else extent(count)
    result: Entry = {"trees": count, "side_m": side}
    last = time.perf_counter()

    def lap(name: str) -> None:
        nonlocal last
        now = time.perf_counter()
        result[name], last = now - last, now

    scene = ForestSpec((side, side), count=count, resolution=0.25 if side <= 300.0 else 0.5).create(seed=1)
    lap("create_s")
    stage = scene.stage
    lap("author_s")
    file = scene.export(out / f"forest_{count}.usdc")
    lap("export_s")
    result["file_mb"] = file.stat().st_size / 1e6
    del stage
    stage = open_stage(file)
    builder = newton.ModelBuilder()
    scenery = read_scenery(stage)
    add_scenery(builder, scenery, touched=False)
    scenery.capsules()
    from stripe_newton.terrains.ground_usd import ground_prims, read_ground

    builder.add_shape_heightfield(heightfield=read_ground(ground_prims(stage)[0]).source)
    builder.finalize(device="cpu")
    lap("load_s")
    file.unlink()
    result["assets"] = len(scene.instances)
    result["total_s"] = sum(result[f"{n}_s"] for n in ("create", "author", "export", "load"))
    result["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return result


def step(count: int, args: argparse.Namespace) -> Entry:
    """Time the step of the walking task in a forest of ``count`` trees; on bare ground for 0."""
    from stripe_newton.envs import ManagerBasedRLEnv
    from stripe_newton.envs.measure import benchmark
    from stripe_tasks.forest import ForestSpec
    from stripe_tasks.forest.walk import training
    from stripe_tasks.velocity import RoughObservationsCfg

    side = extent(max(count, 1000))
    resolution = 0.25 if side <= 500.0 else 0.5
    if count:
        task = training(ForestSpec((side, side), count=count, resolution=resolution, undergrowth=0.0), curriculum=None)
    else:
        bare = ForestSpec((side, side), density=0.0, clutter=0.0, undergrowth=0.0, resolution=resolution)
        task = training(bare, curriculum=None, obstacles=None, observations=RoughObservationsCfg())
    cfg = task.to_env_cfg(seed=1)
    cfg.scene.num_envs, cfg.sim.device = args.num_envs, args.device
    found = benchmark(lambda: ManagerBasedRLEnv(cfg), steps=args.steps)
    return {"trees": count, "side_m": side, **found}


def plot(out: Path, made: list[Entry], steps: list[Entry]) -> None:
    """Draw seconds and memory of making, and milliseconds of a step, against the number of trees."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12.5, 3.6), layout="constrained")
    for name in ("create", "author", "export", "load", "total"):
        axes[0].loglog([m["trees"] for m in made], [m[f"{name}_s"] for m in made], ".-", label=name)
    axes[0].set(xlabel="trees", ylabel="s", title="seconds, two CPU cores")
    axes[0].legend(frameon=False)
    axes[1].loglog([m["trees"] for m in made], [m["peak_mb"] for m in made], ".-", label="peak memory")
    axes[1].loglog([m["trees"] for m in made], [m["file_mb"] for m in made], ".-", label="file")
    axes[1].set(xlabel="trees", ylabel="MB", title="memory")
    axes[1].legend(frameon=False)
    if steps:
        places = range(len(steps))
        axes[2].bar(places, [s["env_ms"] for s in steps], color="0.75", label="whole step")
        axes[2].bar(places, [s["physics_ms"] for s in steps], color="tab:green", label="physics")
        axes[2].set_xticks(places, ["bare" if not s["trees"] else f"{s['trees']:,}" for s in steps])
        axes[2].set(xlabel="trees", ylabel="ms", title=f"a step of {steps[0]['num_envs']} quadrupeds")
        axes[2].set_ylim(0.0, 1.2 * max(s["env_ms"] for s in steps))
        axes[2].legend(frameon=False, ncols=2)
    for axis in axes[:2]:
        axis.grid(alpha=0.3)
    figure.savefig(out / "forest_scaling.png", dpi=130)


def tables(made: list[Entry], steps: list[Entry]) -> str:
    """Both tables in Markdown."""
    lines = [
        "| trees | assets | side | create | author | export | load | all | peak memory | file |",
        "|---:" * 10 + "|",
    ]
    for m in made:
        seconds = " | ".join(f"{m[f'{n}_s']:.2f} s" for n in ("create", "author", "export", "load", "total"))
        sizes = f"{m['peak_mb']:.0f} MB | {m['file_mb']:.1f} MB"
        lines.append(f"| {m['trees']:,} | {m['assets']:,} | {m['side_m']:.0f} m | {seconds} | {sizes} |")
    lines += ["", "| trees | side | physics | step | step / physics | step / bare | env-steps/s |", "|---:" * 7 + "|"]
    for s in steps:
        ratio = f"{s['env_ms'] / s['physics_ms']:.3f} | {s['env_ms'] / steps[0]['env_ms']:.3f}"
        cost = f"{s['physics_ms']:.3f} ms | {s['env_ms']:.3f} ms"
        lines.append(f"| {s['trees']:,} | {s['side_m']:.0f} m | {cost} | {ratio} | {s['env_steps_per_s']:,.0f} |")
    return "\n".join(lines)


def main() -> None:
    """Measure the requested parts, then show all results in OUT."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--parts", nargs="*", default=["make", "step"], choices=["make", "step"])
    parser.add_argument("--counts", nargs="*", type=int, default=None, help="numbers of trees")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=320)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    if args.one is not None:
        print(json.dumps(make(args.one, args.out)))
        return
    for part in args.parts:
        found = []
        for count in args.counts if args.counts is not None else MAKE if part == "make" else STEP:
            if part == "make":
                # a process for each size: peak memory is that of a whole process
                command = [sys.executable, __file__, str(args.out), "--one", str(count)]
                text = subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE).stdout
                found.append(json.loads(text.splitlines()[-1]))
            else:
                found.append(step(count, args))
            (args.out / f"{part}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
            print(part, json.dumps(found[-1]), flush=True)
    parts = [args.out / f"{p}.json" for p in ("make", "step")]
    made, steps = (json.loads(p.read_text(encoding="utf-8")) if p.exists() else [] for p in parts)
    (args.out / "forest_scaling.md").write_text(tables(made, steps) + "\n", encoding="utf-8")
    if made:
        plot(args.out, made, steps)
    print(tables(made, steps))


if __name__ == "__main__":
    main()
