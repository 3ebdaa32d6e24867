# SPDX-License-Identifier: Apache-2.0
"""File trial: load a USD, URDF or MJCF file as a scene, step it, export it and open the export again.

Run as a program it is the process behind a ``FileWorker``.
"""

from __future__ import annotations

import sys
import tempfile
import traceback
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from file_worker import answer_each_line
from model_arrays import different_arrays
from mujoco_trajectory import compare_trajectories

from stripe_newton.assets import AssetBaseCfg, file_spawner
from stripe_newton.robot_files import file_kind
from stripe_newton.robot_files.urdf_checks import undecided_root
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_newton.usd import StageError

__all__ = ["SOLVER", "file_scene", "try_file"]

STEPS = 200
DT = 1.0 / 240.0
SOLVER = MuJoCoSolverCfg(fused=False)
"""MuJoCo Warp's kernels are shared by all models; the fused step is compiled for each."""


def try_file(path: str) -> tuple[str, str, dict[str, Any]]:
    """Outcome, its line, and numbers of one file.

    The outcome is ``steps``; ``refused`` with the reason; ``diverges`` or ``overflows``, as a step says; ``differs`` if
    the export is another model; ``traceback`` for any other exception.
    """
    facts: dict[str, Any] = {}
    try:
        found = file_kind(path)
        kind, suffix = found.name, Path(path).suffix.lower()
        facts["kind"] = kind or suffix[1:]
        if not kind and suffix in (".xml", ".mjcf", ".urdf"):
            return "refused", found.description, facts
        scene = file_scene(path, kind)
        try:
            _count(scene, facts)
            if kind == "mjcf" and not facts["static"]:
                facts["mujoco"] = compare_trajectories(scene.sim.solver, path)._asdict()
                if any(what == "convex hull" for _, what, _ in facts["rows"]):
                    facts["mujoco_whole_hulls"] = _compare_with_whole_hulls(path, kind)
            again = _round_trip(scene)
            for _ in range(STEPS // 10):
                scene.sim.step(10)
            scene.sim.begin_step()
            if not all(np.isfinite(a.numpy()).all() for a in (scene.sim.state.joint_q, scene.sim.state.body_q)):
                return "silent", "the state is not finite and no step said so", facts
        finally:
            scene.close()
    except FloatingPointError as error:
        return "diverges", str(error), facts
    except (StageError, ValueError) as error:
        if type(error) not in (StageError, ValueError) and "configclass" not in type(error).__module__:
            return "traceback", traceback.format_exc(), facts
        return "refused", " ".join(str(error).split()), facts
    except RuntimeError as error:
        if "overflow" in str(error):
            return "overflows", str(error), facts
        return "traceback", traceback.format_exc(), facts
    except Exception:
        return "traceback", traceback.format_exc(), facts
    return ("differs", f"after export and import: {', '.join(again)}", facts) if again else ("steps", "", facts)


def _compare_with_whole_hulls(path: str, kind: str) -> dict[str, Any]:
    """The comparison with MuJoCo of an MJCF file whose hulls keep all their corners."""
    scene = file_scene(path, kind, max_hull_vertices=-1)
    try:
        return compare_trajectories(scene.sim.solver, path)._asdict()
    finally:
        scene.close()


def file_scene(path: str, kind: str, max_hull_vertices: int | None = None) -> InteractiveScene:
    """The scene of a file alone, with a step of 1/240 s (an MJCF file: its own) and the file's gravity.

    The root of a URDF file that does not say whether it floats is held in the world.

    Args:
        path: The file.
        kind: ``"urdf"``, ``"mjcf"``, or anything else for USD.
        max_hull_vertices: Corners of the hulls of a robot's meshes at most, as in ``MjcfFileCfg``.
    """
    if kind not in ("urdf", "mjcf"):
        settings = SimulationCfg(gravity=None, device="cpu", dt=DT, solver=SOLVER)
        return InteractiveScene.from_usd(path, sim_cfg=settings)
    settings = SimulationCfg(device="cpu", dt=DT, solver=SOLVER)
    options: dict[str, Any] = {"max_hull_vertices": max_hull_vertices}
    if kind == "urdf":
        options["fix_base"] = True if undecided_root(ElementTree.parse(path).getroot()) else None
    else:
        options["ignore_names"] = ()
        try:
            model = mujoco.MjModel.from_xml_path(path)
            if np.isfinite(model.opt.gravity).all():
                settings.dt, settings.gravity = float(model.opt.timestep), tuple(map(float, model.opt.gravity))
        except ValueError:
            pass  # the importer says why
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=1, env_spacing=0.0), Simulation(settings))
    spawn = file_spawner(Path(path).resolve(), **options)
    scene.builder.build_objects({"file": AssetBaseCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn)})
    scene.builder.adopt = True
    scene.build()
    scene.sim.watch_finite()
    return scene


def _count(scene: InteractiveScene, facts: dict[str, Any]) -> None:
    model, reports = scene.sim.model, scene.builder.reports
    facts["bodies"], facts["joints"], facts["shapes"] = model.body_count, model.joint_count, model.shape_count
    facts["static"] = not model.joint_count
    facts["rows"] = [row for report in reports for row in report.ignored]


def _round_trip(scene: InteractiveScene) -> list[str]:
    """Names of the arrays in which the model of the exported scene differs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.usda"
        scene.export(path)
        # A scene chooses who finds its contacts: the second one is to choose for itself.
        again = InteractiveScene.from_usd(path, sim_cfg=scene.sim.cfg.replace(solver=SOLVER))
        try:
            return different_arrays(scene.sim.model, again.sim.model)
        finally:
            again.close()


if __name__ == "__main__":
    answer_each_line(try_file)
