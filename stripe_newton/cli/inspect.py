# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton inspect``: shows what is in a USD stage, a robot's file or a task, as tables and a picture."""

from __future__ import annotations

import difflib
import json as json_module
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np
import tyro

from stripe_newton.input_files import why_no_file
from stripe_newton.rl.torch_vector_env import rl_env_of
from stripe_newton.value_types import short

from .arguments import parse
from .compile_log import CompileLog
from .device import set_device, set_seeds
from .env_and_policy import build_env
from .kernel_warmup import warm_up
from .live_view import check_installed, open_viewer
from .options import InspectArgs
from .run_configs import Configs, check, load_configs
from .tasks import find_task, task_argument, task_ids
from .user_error import UserError
from .written_places import try_place

if TYPE_CHECKING:
    from stripe_newton.robot_files import ActuatorRow
    from stripe_newton.usd import StageReport

__all__ = ["InspectArgs", "run"]

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz", ".urdf", ".xml", ".mjcf", ".xacro", ".sdf", ".dae", ".stl", ".obj")
"""Suffixes by which a name is that of a file, also where there is none."""


@dataclass
class _Inspection:
    facts: dict[str, object]
    """Rows of the table, by name."""
    reports: list[StageReport]
    """Reports of the files: what was read, and what was not."""
    draw: Callable[[], np.ndarray]
    """Draws the picture, uint8 ``(height, width, 3)``; the tables are there before it."""
    subject: object
    """The environment or the scene, which is there until the inspection ends, and complete once it was drawn."""
    actuators: list[ActuatorRow] = field(default_factory=list)
    """Actuators of an MJCF file."""


def run(argv: list[str]) -> int:
    """Run the command."""
    from stripe_newton.viewers import save_image  # here, as --help needs none of it; the same below

    log = CompileLog.install()
    task = task_argument(argv)
    opened: AbstractContextManager[_Inspection]
    if task in task_ids():  # only a task has options for the fields of its config
        configs = load_configs(task, None, agent=False)
        args = parse(InspectArgs, _with_values(argv), "inspect", env=configs.env)
        is_file = False
        _check(args)
        opened = _inspect_task(args.target, configs)
    else:
        args = tyro.cli(InspectArgs, args=argv, prog="stripe-newton inspect")
        is_file = Path(args.target).suffix.lower() in _SUFFIXES or not why_no_file(args.target)
        _check(args)
        if not is_file:
            _refuse_name(args.target)
        opened = _inspect_file(Path(args.target))
    with opened as found:
        path = args.out / f"{Path(args.target).stem if is_file else args.target}.png"
        if not args.json:  # before the picture, whose kernels take long to compile the first time
            _print_tables(found)
        save_image(path, found.draw())
        log.finish()
        print(f"picture: {path}" if not args.json else _as_json(found, args.target, path))
        if args.viewer == "viser":
            _watch(found.subject, args)
    return 0


def _check(args: InspectArgs) -> None:
    """Check, before anything is built, that the picture can be written and the viewer is there."""
    try_place("--out", args.out, folder=True)
    if args.viewer == "viser":
        check_installed()


def _as_json(found: _Inspection, name: str, path: Path) -> str:
    """One JSON object with all tables, and where the picture is."""
    reports = [report.to_dict() for report in found.reports]
    actuators = [asdict(row) for row in found.actuators]
    content = {"name": name, **found.facts, "picture": str(path), "reports": reports, "actuators": actuators}
    return json_module.dumps(content, indent=2)


def _print_tables(found: _Inspection) -> None:
    """Print the facts, the reports and the actuators."""
    width = max(map(len, found.facts), default=0) + 2
    for name, value in found.facts.items():
        lines = _as_text(value).splitlines()
        print(f"{name:<{width}}" + "\n".join([lines[0], *(f"{'':<{width}}{line}".rstrip() for line in lines[1:])]))
    for report in found.reports:
        print(("\n" if found.facts else "") + report.to_text())
    if found.actuators:
        from stripe_newton.robot_files import actuator_table

        print(actuator_table(found.actuators) + "\n")
    sys.stdout.flush()


def _as_text(fact: object) -> str:
    """A fact as text: numbers with six digits, and sizes by name, such as ``policy 6, critic 3 x 64``."""
    if isinstance(fact, float):
        return f"{fact:.6g}"
    if isinstance(fact, dict):
        return ", ".join(f"{name} {' x '.join(map(str, size))}" for name, size in fact.items())
    return str(fact)


def _watch(subject: object, args: InspectArgs) -> None:
    """Show what was inspected in a browser, until Ctrl-C; nothing moves."""
    with open_viewer(subject, Path(args.target).name, args.host, args.port) as viewer:
        try:
            viewer.hold()
        except KeyboardInterrupt:
            print()


def _with_values(argv: list[str]) -> list[str]:
    """Arguments in which the flag ``--json`` has a value, as flags have among the options of a config."""
    words: list[str] = []
    for word, following in zip(argv, [*argv[1:], ""], strict=True):
        words += [word, "True"] if word == "--json" and following not in ("True", "False") else [word]
    return words


def _inspect_file(path: Path) -> AbstractContextManager[_Inspection]:
    """The report and a picture of a file, by what it is.

    Raises:
        UserError: there is no such file, or it is neither a stage nor a robot; the message says what it is.
    """
    from stripe_newton.robot_files import file_kind

    if problem := why_no_file(path):
        raise UserError(f"{path}: {problem}{_similar_files(path) if problem == 'does not exist' else ''}")
    kind = file_kind(path)
    if kind.name in ("urdf", "mjcf"):
        return _inspect_robot(path, kind.name)
    if kind.name == "usd":
        return _inspect_stage(path)
    raise UserError(f"{path} {kind.description}")


@contextmanager
def _inspect_robot(path: Path, kind: str) -> Iterator[_Inspection]:
    """The report and a picture of a URDF or MJCF file."""
    from stripe_newton.assets import AssetBaseCfg
    from stripe_newton.robot_files import RobotFileError, actuator_rows, compile_mjcf, inspect_robot_file
    from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
    from stripe_newton.sim import MjcfFileCfg, Simulation, SimulationCfg, UrdfFileCfg
    from stripe_newton.viewers import SceneRenderer, ViewerCfg

    try:
        report = inspect_robot_file(path)
    except RobotFileError as error:
        raise UserError(str(error)) from None
    held = any(row.base == "fixed" for row in report.articulations)
    spawn = (
        UrdfFileCfg(asset_path=str(path), fix_base=held)
        if kind == "urdf"
        else MjcfFileCfg(asset_path=str(path), ignore_names=[])
    )
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=0.0), Simulation(SimulationCfg(device="cpu")))

    def draw() -> np.ndarray:
        warm_up("cpu")
        scene.builder.build_objects({"robot": AssetBaseCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn)})
        scene.build()
        return SceneRenderer(scene.sim, ViewerCfg()).render()

    try:
        facts: dict[str, object] = {
            "format": kind.upper(),
            "base": ", ".join(dict.fromkeys(row.base for row in report.articulations)),
            "mass": round(sum(row.mass for row in report.bodies), 6),
        }
        actuators = actuator_rows(compile_mjcf(path)) if kind == "mjcf" else []
        yield _Inspection(facts, [report], draw, scene, actuators)
    finally:
        scene.close()


@contextmanager
def _inspect_stage(path: Path) -> Iterator[_Inspection]:
    """The report and a picture of a stage, which says nothing about a task."""
    from stripe_newton.scene import InteractiveScene
    from stripe_newton.sim import SimulationCfg
    from stripe_newton.usd import inspect_stage
    from stripe_newton.viewers import SceneRenderer, ViewerCfg

    report = inspect_stage(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the report has the rows that it would show
        scene = InteractiveScene.from_usd(path, sim_cfg=SimulationCfg(gravity=None, device="cpu"))
    try:
        yield _Inspection({}, [report], lambda: SceneRenderer(scene.sim, ViewerCfg()).render(), scene)
    finally:
        scene.close()


def _similar_files(path: Path) -> str:
    """A question about files beside a missing one that have similar names, for its message."""
    try:
        near = difflib.get_close_matches(path.name, os.listdir(path.parent), n=3)
    except OSError:  # there is no such folder
        return ""
    return f"; did you mean {' or '.join(str(path.with_name(name)) for name in near)}?" if near else ""


def _refuse_name(name: str) -> NoReturn:
    """Refuse a name that is neither of a task nor of a file.

    Raises:
        UserError: with similar names of tasks.
    """
    problem = why_no_file(name)
    if problem != "does not exist":
        raise UserError(f"{short(name)}: {problem}; give a task, or a file of USD, URDF or MJCF")
    if (path := Path(name)).suffix or os.sep in name:  # no task has a name like that
        raise UserError(f"{name}: does not exist{_similar_files(path)}")
    try:
        find_task(name)
    except UserError as error:
        raise UserError(f"{error}; nor is there a file of that name") from None
    raise UserError(f"{name}: is a task without a config")


@contextmanager
def _inspect_task(task: str, configs: Configs) -> Iterator[_Inspection]:
    """Sizes, rates and stages of a task, the reports of its assets, and a picture of its first environment.

    Raises:
        UserError: if its environment is not one of this package.
    """
    cfg = configs.env
    cfg.scene.num_envs = 1
    set_device(cfg, cfg.sim.device)
    check(configs)
    set_seeds(cfg.seed or 0)
    env = build_env(task, configs, render=True)
    try:
        env.reset()
        inner = rl_env_of(env.unwrapped)
        if inner is None:
            raise UserError(f"{task}: {type(env.unwrapped).__name__} is not an environment of this package")
        facts = {
            "task": task,
            "device": str(env.device),
            "physics": inner.sim.describe_solver(),
            "physics_dt": inner.physics_dt,
            "decimation": cfg.decimation,
            "step_dt": inner.step_dt,
            "max_episode_length": int(env.max_episode_length),
            "observations": {name: list(space.shape) for name, space in env.unwrapped.single_observation_space.items()},
            "actions": env.num_actions,
            **({} if inner.scene.scenery is None else {"scenery": inner.scene.scenery.describe()}),
            "step": inner.describe(),
        }

        def draw() -> np.ndarray:
            picture = inner.render()
            assert picture is not None  # it was built to draw pictures
            return picture

        yield _Inspection(facts, _titled(inner.scene.builder.reports), draw, inner)
    finally:
        env.close()


def _titled(reports: Sequence[StageReport]) -> list[StageReport]:
    """The reports of a task's scene, each with a title that says what it is of; without those of nothing."""
    stage = reports[0].file  # in memory; an imported scenery has a file
    for index, report in enumerate(reports):
        if report.file == stage:
            report.file = "shared by all environments" if index else "one environment"
    return [r for i, r in enumerate(reports) if not i or r.bodies or r.shapes or r.lights or r.ignored]
