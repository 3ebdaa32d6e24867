# SPDX-License-Identifier: Apache-2.0
"""Comparison with mjlab on its own task: the Go1 follows velocity commands on a plane, in both frameworks.

    python tools/comparison/compare_mjlab.py --mjlab-python PYTHON [--device cuda:0] [--num-envs 4096] [--steps 300]
        [--train-iterations 100] [--parts step train walk] [--fused both] [--task TASK] [--no-tf32]
        [--cone pyramidal] [--njmax 300] [--json FILE] [--plot FILE]

mjlab needs other versions of MuJoCo than this package, so it runs under an interpreter of its own (``--mjlab-python``),
or under this one with its folder first on the path (``--mjlab-path``). Both sides run in fresh processes, one after the
other, and are measured by the same functions (``compare_mjlab_measure.py``). The table has a column for each side;
``docs/comparison.md`` lists what is the same and where the two differ. ``--fused both`` adds a column for this side
with MuJoCo Warp instead of the fused solver, ``--task`` one for a task of this package, with its own robot and
settings.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch
    from compare_mjlab_measure import Side


TOOLS = Path(__file__).parent
Json = dict[str, Any]
"""Requests, facts and results, which go from process to process as JSON."""
SIDES = ("stripe-newton", "mjlab")
UNFUSED = "with MuJoCo Warp"
"""Column of this side with ``fused=False``, beside the fused solver."""
ROWS = (
    ("start: build and first reset [s]", "build_s", ".1f", -1),
    ("whole step [ms]", "step_ms", ".3f", -1),
    ("physics alone [ms]", "physics_ms", ".3f", -1),
    ("whole step over physics alone", "overhead", ".2f", -1),
    ("environment steps a second", "env_steps_per_s", ",.0f", 1),
    ("graph launches a step", "graph_launches_per_step", ".1f", -1),
    ("kernel launches a step, outside graphs", "kernel_launches_per_step", ".1f", -1),
    ("copies and fills a step, outside graphs", "copies_per_step", ".1f", -1),
    ("waits of the host a step", "host_syncs_per_step", ".1f", -1),
    ("kernels on the GPU a step", "kernels_per_step", ".1f", -1),
    ("device memory [MiB]", "memory_mb", ",.0f", -1),
    ("training: samples a second", "samples_per_s", ",.0f", 1),
    ("training: collection, an iteration [s]", "collect_s", ".3f", -1),
    ("training: learning, an iteration [s]", "learn_s", ".3f", -1),
    ("training: device memory [MiB]", "train_memory_mb", ",.0f", -1),
    ("from the command to the first iteration [s]", "start_s", ".1f", -1),
    ("from the command to a robot that walks [s]", "walk_s", ".1f", -1),
    ("samples until then", "walk_samples", ",.0f", -1),
)
"""Label, key, format, and whether more (1) or less (-1) is better."""


class Peer:
    """mjlab in a process of its own."""

    def __init__(self, python: str | None, path: str | None):
        """Take an interpreter, or a folder that goes first on the path of this one, or both.

        Raises:
            SystemExit: If the folder has no mjlab; another one of the same interpreter would be taken instead.
        """
        if path and not (Path(path) / "mjlab").is_dir():
            raise SystemExit(f"--mjlab-path {path}: has no folder 'mjlab', as 'pip install --target' makes it")
        # Nothing is drawn, and mjlab would otherwise fail to import where EGL is missing.
        self._python, env = python or sys.executable, {"MUJOCO_GL": "disabled", **os.environ}
        inherited = [] if python else [env["PYTHONPATH"]] if env.get("PYTHONPATH") else []
        found = os.pathsep.join([*([path] if path else []), *inherited])
        self._env = {k: v for k, v in env.items() if k != "PYTHONPATH"} | ({"PYTHONPATH": found} if found else {})

    def ask(self, what: str, request: Json, out: Path) -> Path:
        """Run ``compare_mjlab_peer.py`` and return the file of its answer.

        Raises:
            SystemExit: If it failed; the message ends with its last output.
        """
        return _run([self._python, str(TOOLS / "compare_mjlab_peer.py"), what], request, out, self._env)


def _run(command: list[str], request: Json, out: Path, env: dict[str, str]) -> Path:
    """Run a program that takes a request and writes its answer to ``out``."""
    asked, log = out.with_suffix(".request"), out.with_suffix(".log")
    asked.write_text(json.dumps({**request, "out": str(out), "asked": time.time()}))
    with log.open("w") as file:
        try:
            status = subprocess.run([*command, str(asked)], env=env, stdout=file, stderr=subprocess.STDOUT).returncode
        except OSError as error:
            raise SystemExit(f"cannot run {command[0]}: {error.strerror}; expected a Python interpreter") from None
    if status or not out.exists():
        tail = "\n".join(log.read_text(errors="replace").splitlines()[-30:])
        raise SystemExit(f"{' '.join(command)} failed with status {status}:\n{tail}")
    return out


# -- our side


def make_side(request: Json) -> Side:
    """Build our environment; see ``compare_mjlab_measure.Side``."""
    # only in the process that measures our side: the other ones need not load it
    import warp as wp
    from compare_mjlab_env import Go1Env, make_agent_cfg, make_env_cfg
    from compare_mjlab_measure import Side

    from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper

    if request["task"]:
        import stripe_tasks  # noqa: F401  (registers the tasks)
        from stripe_newton.cli.run_configs import load_configs
        from stripe_newton.cli.tasks import make_env

        configs = load_configs(request["task"], None)
        configs.env.sim.device, configs.env.scene.num_envs = request["device"], request["num_envs"]
        configs.env.sim.solver.fused = request["fused"]
        agent, configs.env.seed, configs.agent.seed = configs.agent, request["seed"], request["seed"]
        env = make_env(request["task"], configs.env)
    else:
        facts = json.loads(Path(request["facts"]).read_text())
        agent = make_agent_cfg(facts, request)
        env = Go1Env(make_env_cfg(facts, Path(request["facts"]).with_name("robot.xml"), request))
    agent.matmul_precision = "high" if request["tf32"] else "highest"
    env.reset(seed=request["seed"])
    sim, state = env.sim, env.sim.state
    start = (state.joint_q, state.joint_qd, state.body_q, state.body_qd, sim.solver.mjw_data.qacc_warmstart)

    def spread(lengths: torch.Tensor) -> None:
        env.episode_length_buf = lengths

    def velocity_error() -> torch.Tensor:
        velocity = env.scene["robot"].data.root_link_lin_vel_b[:, :2]
        return (env.command_manager.get_command(env.command_manager.active_terms[0])[:, :2] - velocity).norm(dim=1)

    return Side(
        device=request["device"],
        num_envs=env.num_envs,
        num_actions=env.action_manager.total_action_dim,
        step=env.step,
        physics=lambda: sim.step(env.cfg.decimation),
        state=[wp.to_torch(array) for array in start],
        targets=[wp.to_torch(sim.control.joint_target_q)],
        spread=spread,
        max_episode_length=env.max_episode_length,
        make_runner=lambda folder: OnPolicyRunner(RslRlVecEnvWrapper(env, agent.clip_actions), agent, folder),
        velocity_error=velocity_error,
        physics_by=sim.describe_solver(),
    )


# -- both sides


def compare(arguments: argparse.Namespace, folder: Path) -> Json:
    """Measure both sides.

    Args:
        arguments: Arguments of the command line.
        folder: Folder for files.

    Returns:
        Results by side, and for ``--task`` by its name, the request, and the result of :func:`returns`.
    """
    request = {
        "device": arguments.device,
        "num_envs": arguments.num_envs,
        "steps": arguments.steps,
        "train_iterations": arguments.train_iterations,
        "parts": arguments.parts,
        "seed": arguments.seed,
        "tf32": arguments.tf32,
        "cone": arguments.cone,
        "njmax": arguments.njmax,
        "randomize": True,
        "task": None,
        "fused": False if arguments.fused == "false" else None,
    }
    peer = Peer(arguments.mjlab_python, arguments.mjlab_path)
    print("reading the task of mjlab ...", flush=True)
    facts = peer.ask("describe", {**request, "num_envs": 2, "device": "cpu"}, folder / "facts.json")
    task = json.loads(facts.read_text())
    _check(task, arguments)
    physics = {"decimation": task["env"]["decimation"], "dt": task["env"]["sim"]["mujoco"]["timestep"]}
    others = [*([UNFUSED] if arguments.fused == "both" else []), *([arguments.task] if arguments.task else [])]
    found: Json = {"request": {**request, "task": arguments.task}, "others": others, **physics}
    print("measuring mjlab ...", flush=True)
    answer = peer.ask("measure", request, folder / "mjlab.json")
    found["mjlab"] = json.loads(answer.read_text())
    _keep(found, arguments.json)
    own = [sys.executable, str(Path(__file__).resolve()), "--request"]
    for side in ("stripe-newton", *others):
        print(f"measuring {side} ...", flush=True)
        asked = {**request, "facts": str(facts), "task": side if side == arguments.task else None}
        asked |= {"fused": False} if side == UNFUSED else {}
        file = folder / f"{side.replace(' ', '_')}.json"
        found[side] = json.loads(_run(own, asked, file, dict(os.environ)).read_text())
        _keep(found, arguments.json)
    for side in (*SIDES, *others):
        if "step_ms" in found.get(side, {}):
            found[side]["overhead"] = found[side]["step_ms"] / found[side]["physics_ms"]
    if "train" in arguments.parts:
        found["returns"] = returns(*(found[side]["curve"] for side in SIDES))
    return found


def _keep(found: Json, path: Path | None) -> None:
    """Write the results so far, as each side takes minutes."""
    if path:
        path.write_text(json.dumps(found, indent=1))


def _check(facts: Json, arguments: argparse.Namespace) -> None:
    """Refuse a run so long that mjlab widens its commands, which our side does not."""
    stages = facts["env"]["curriculum"].get("command_vel", {}).get("params", {}).get("velocity_stages", [])
    later = [stage["step"] for stage in stages if stage["step"] > 0]
    most = min(later, default=sys.maxsize) // facts["agent"]["num_steps_per_env"]
    if "train" in arguments.parts and arguments.train_iterations > most:
        raise SystemExit(
            f"--train-iterations: is {arguments.train_iterations}, must be at most {most}, where mjlab "
            "widens its commands"
        )


def returns(ours: list[Json], theirs: list[Json]) -> Json:
    """Mean returns of both curves after the same number of samples, and after the same time.

    The number of samples is the smaller one of both sides, the time that of the faster side.

    Returns:
        ``samples``, ``after_samples`` (a pair, ours first), ``seconds``, ``after_seconds`` (a pair); None where no
        episode had ended.
    """
    curves = (ours, theirs)
    samples, seconds = (min(curve[-1][key] for curve in curves) for key in ("samples", "seconds"))
    pairs = [
        [next((row["return"] for row in reversed(curve) if row[key] <= most), None) for curve in curves]
        for key, most in (("samples", samples), ("seconds", seconds))
    ]
    return {"samples": samples, "after_samples": pairs[0], "seconds": seconds, "after_seconds": pairs[1]}


def table(found: Json) -> str:
    """All sides as text; ``better by`` is the factor by which the column before it is better than mjlab."""
    others = found["others"]
    head = ("", *SIDES, "better by", *(word for side in others for word in (side, "better by")))
    lines = _aligned([head, *_figures(found), *_returns(found)])
    lines.insert(1, "-" * len(lines[0]))
    versions = [f"{side}: {found[side]['physics_by']}" for side in (*SIDES, *others) if found[side].get("physics_by")]
    for side in SIDES:
        packages = {k: v for k, v in found[side]["versions"].items() if k == side or k not in SIDES}
        versions.append(f"{side}: {', '.join(f'{k} {v}' for k, v in packages.items())}")
    where = found["mjlab"]["device_name"] or found["request"]["device"]
    title = f"{where}, {found['request']['num_envs']} environments"
    title += f", {found['decimation']} physics steps of {1e3 * found['dt']:g} ms a step"
    return "\n".join([title, *lines, "", *versions])


def _figures(found: Json) -> list[tuple[str, ...]]:
    """Rows of the figures that were measured."""
    rows: list[tuple[str, ...]] = []
    for label, key, form, sign in ROWS:
        if not any(key in found[side] for side in SIDES):
            continue
        ours, theirs, *others = (found[side].get(key) for side in (*SIDES, *found["others"]))
        row = (label, _text(ours, form), _text(theirs, form), _factor([ours, theirs], sign))
        rows.append(row + tuple(word for v in others for word in (_text(v, form), _factor([v, theirs], sign))))
    return rows


def _returns(found: Json) -> list[tuple[str, ...]]:
    """Rows of the returns after the same samples and after the same time."""
    if "returns" not in found:
        return []
    pairs = found["returns"]
    at = {"after_samples": f"{pairs['samples']:,} samples", "after_seconds": f"{pairs['seconds']:.1f} s"}
    blank = ("", *(" " for _ in range(2 * len(found["others"]))))
    return [
        (f"return after {when}", *(_text(value, ".2f") for value in pairs[key]), *blank) for key, when in at.items()
    ]


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    """Lines with the first column to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        row[0].ljust(widths[0]) + "".join(f"  {cell:>{n}}" for cell, n in zip(row[1:], widths[1:], strict=True))
        for row in rows
    ]


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _factor(values: list[float | None], sign: int) -> str:
    """Factor by which the first of two values is better, as text; below 1 if it is worse."""
    better, worse = values if sign > 0 else reversed(values)
    return "" if better is None or not worse else f"{better / worse:.2f}"


def plot(found: Json, path: Path) -> None:
    """Draw the returns over samples and over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4), sharey=True, layout="constrained")
    for axis, key, label in zip(axes, ("samples", "seconds"), ("samples", "time [s]"), strict=True):
        for side in (*SIDES, *(side for side in found["others"] if side == UNFUSED)):
            rows = [row for row in found[side]["curve"] if row["return"] is not None]
            axis.plot([row[key] for row in rows], [row["return"] for row in rows], label=side)
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("mean return of the last 100 episodes")
    axes[0].legend()
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mjlab-python", help="interpreter that has mjlab")
    parser.add_argument("--mjlab-path", help="folder with mjlab and its dependencies, first on PYTHONPATH")
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=300, help="steps to time, in blocks of up to 32")
    parser.add_argument("--train-iterations", type=int, default=100)
    parser.add_argument("--parts", nargs="+", choices=("step", "train", "walk"), default=["step", "train", "walk"])
    parser.add_argument(
        "--fused",
        choices=("auto", "false", "both"),
        default="auto",
        help="physics of this side: the fused solver where it supports the model, MuJoCo Warp, or a column for each",
    )
    parser.add_argument("--task", help="a velocity task of this package, measured too")
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument(
        "--tf32",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="matrix products, as mjlab's training has them",
    )
    parser.add_argument("--cone", choices=("pyramidal", "elliptic"), help="friction cone of both sides; as in mjlab")
    parser.add_argument("--njmax", type=int, help="constraints that both sides have room for, a world; as in mjlab")
    parser.add_argument("--json", type=Path, help="file for all figures and both curves")
    parser.add_argument("--plot", type=Path, help="picture of both curves (PNG)")
    parser.add_argument("--request", type=Path, help=argparse.SUPPRESS)  # measure our side, in a process of its own
    found = parser.parse_args(arguments)
    problem = _problem_of_task(found.task) if found.task else ""
    if problem:
        parser.error(f"--task {found.task}: {problem}")
    if not (found.request or found.mjlab_python or found.mjlab_path):
        parser.error("name mjlab by --mjlab-python or --mjlab-path; 'pip install mjlab' in an environment of its own")
    for name in ("num_envs", "steps", "train_iterations", "njmax"):
        if getattr(found, name) is not None and getattr(found, name) < 1:
            parser.error(f"--{name.replace('_', '-')}: is {getattr(found, name)}, must be 1 or more")
    if "walk" in found.parts and "train" not in found.parts:
        parser.error("--parts: walk is about the training, so add train")
    if found.plot and "train" not in found.parts:
        parser.error("--plot: shows the training, which --parts leaves out")
    return found


def _problem_of_task(task: str) -> str:
    """Reason why a task cannot be measured beside mjlab's; empty if it can."""
    import stripe_tasks  # noqa: F401  (registers the tasks)
    from stripe_newton.cli.tasks import load_cfg
    from stripe_newton.cli.user_error import UserError
    from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp

    try:
        cfg = load_cfg(task, "env")
    except UserError as error:
        return str(error)
    if not isinstance(cfg, ManagerBasedRLEnvCfg):
        return "is not made of managers"
    commands = [value for value in getattr(cfg.commands, "__dict__", cfg.commands or {}).values() if value is not None]
    if not commands or not isinstance(commands[0], mdp.UniformVelocityCommandCfg):
        return "does not follow velocity commands"
    return ""


def main() -> None:
    """Compare both sides; with ``--request`` measure our side alone."""
    arguments = parse()
    if arguments.request:
        from compare_mjlab_measure import measure

        request = json.loads(arguments.request.read_text())
        Path(request["out"]).write_text(json.dumps(measure(lambda: make_side(request), request), indent=1))
        return
    with tempfile.TemporaryDirectory() as folder:
        found = compare(arguments, Path(folder))
    print(table(found))
    _keep(found, arguments.json)
    if arguments.plot:
        plot(found, arguments.plot)


if __name__ == "__main__":
    main()
