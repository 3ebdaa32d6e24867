# SPDX-License-Identifier: Apache-2.0
"""Stage loading: time and memory of opening generated stages of many meshes as a scene.

    python tools/benchmarks/stage_loading.py [--meshes 100 1000] [--moving SHARE [--xpbd]] [--robot] [--profile] ...

Each stage is loaded in a process of its own. Each mesh is another one: a convex collider of 26 points. ``--moving`` is
the share of rigid bodies, such as 0.1, and ``--xpbd`` chooses the XPBD solver. With ``--robot`` the stage is the
scenery of eight quadrupeds. With ``--textures`` each mesh has a picture of its own, of 1024 by 1024 pixels.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from PIL import Image
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import MuJoCoSolverCfg, Simulation, SimulationCfg, XPBDSolverCfg


def write_stage(path: Path, meshes: int, moving: float, textures: str = "") -> None:
    """Write a stage of meshes on a grid of 2 m, each with a picture if ``textures`` names a format."""
    random = np.random.default_rng(0)
    directions = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    faces = _hull(directions)
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdPhysics.Scene.Define(stage, "/World/physics")
    side = int(np.ceil(np.sqrt(meshes)))
    for k in range(meshes):
        mesh = UsdGeom.Mesh.Define(stage, f"/World/rock_{k}")
        points = (directions * random.uniform(0.2, 0.6, 3)).astype(np.float32)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
        mesh.CreateFaceVertexCountsAttr([3] * len(faces))
        mesh.CreateFaceVertexIndicesAttr(faces.reshape(-1).tolist())
        UsdGeom.XformCommonAPI(mesh).SetTranslate(Gf.Vec3d(2.0 * (k % side), 2.0 * (k // side), 1.0))
        UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
        UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr("convexHull")
        if int((k + 1) * moving) > int(k * moving):
            UsdPhysics.RigidBodyAPI.Apply(mesh.GetPrim())
        if textures:
            file = path.parent / f"texture_{k}.{textures}"
            _write_picture(file, random)
            _texture(mesh, file.name)
    stage.GetRootLayer().Export(str(path))


def _write_picture(file: Path, random: np.random.Generator) -> None:
    """Write a picture of 1024 by 1024 pixels with details of all sizes, as a photograph has them."""
    pixels = np.zeros((1024, 1024, 3), np.float32)
    for size in (8, 32, 128, 512):
        coarse = random.integers(0, 255, (size, size, 3), dtype=np.uint8)
        pixels += np.asarray(Image.fromarray(coarse).resize((1024, 1024), Image.Resampling.BILINEAR), np.float32) / 4
    Image.fromarray(pixels.astype(np.uint8)).save(file)


def _texture(mesh: UsdGeom.Mesh, name: str) -> None:
    """Bind a material with a texture to a mesh."""
    stage, path = mesh.GetPrim().GetStage(), mesh.GetPath()
    material = UsdShade.Material.Define(stage, path.AppendChild("look"))
    surface = UsdShade.Shader.Define(stage, path.AppendPath("look/surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    texture = UsdShade.Shader.Define(stage, path.AppendPath("look/texture"))
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(f"./{name}")
    texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(texture.ConnectableAPI(), "rgb")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    places = np.array(mesh.GetPointsAttr().Get())[:, :2] + 0.5
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    primvar.Set(Vt.Vec2fArray.FromNumpy(places.astype(np.float32)))


def _hull(points: np.ndarray) -> np.ndarray:
    """Triangles of the hull of points on a sphere, their normals outwards."""
    from scipy.spatial import ConvexHull

    faces = ConvexHull(points).simplices
    a, b, c = (points[faces[:, k]] for k in range(3))
    inwards = (np.cross(b - a, c - a) * a).sum(axis=1) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    return faces


def load(path: str, xpbd: bool) -> InteractiveScene:
    """Open a stage as a scene."""
    solver = XPBDSolverCfg() if xpbd else MuJoCoSolverCfg()
    return InteractiveScene.from_usd(path, sim_cfg=SimulationCfg(gravity=None, device="cpu", solver=solver))


def load_with_robots(path: str) -> InteractiveScene:
    """A scene of eight quadrupeds in a stage. Its rocks have no floor: that of the task is kept."""
    from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg

    cfg = QuadrupedFlatEnvCfg().scene
    cfg.num_envs, cfg.scenery, cfg.scenery_options.ground = 8, path, "keep"
    scene = InteractiveScene(cfg, Simulation(SimulationCfg(dt=0.005, device="cpu")))
    scene.build()
    return scene


def measure(path: str, robot: bool, xpbd: bool, profile: bool) -> dict[str, float]:
    """Seconds of opening and building, on the clock and of the processor, of a second step, and the peak memory [MB].

    The memory is that above the imports'. The first step compiles kernels that are then cached.
    """
    warnings.simplefilter("ignore")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    profiler = cProfile.Profile()
    if profile:
        profiler.enable()
    start, start_of_work = time.perf_counter(), time.process_time()
    scene = load_with_robots(path) if robot else load(path, xpbd)
    loaded, worked = time.perf_counter(), time.process_time()
    profiler.disable()
    if profile:
        pstats.Stats(profiler, stream=sys.stderr).sort_stats("cumulative").print_stats(45)
    step_s = 0.0
    if scene.sim.model.joint_count:
        scene.sim.step()
        start_of_step = time.perf_counter()
        scene.sim.step()
        step_s = time.perf_counter() - start_of_step
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times = {"load_s": loaded - start, "cpu_s": worked - start_of_work, "step_s": step_s}
    return times | {"memory_mb": (peak - before) / 1024}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--meshes", type=int, nargs="+", default=[100, 1000, 10000], help="numbers of meshes")
    parser.add_argument("--moving", type=float, default=0.0, help="share of the meshes that are rigid bodies")
    parser.add_argument("--xpbd", action="store_true", help="load it with the XPBD solver, for many bodies")
    parser.add_argument("--robot", action="store_true", help="load it as the scenery of eight quadrupeds")
    parser.add_argument("--textures", choices=["jpg", "png"], default="", help="give each mesh a picture of its own")
    parser.add_argument("--profile", action="store_true", help="print where the time of loading goes")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.measure:
        print(json.dumps(measure(args.measure, args.robot, args.xpbd, args.profile)))
        return
    print("| meshes | load s | CPU s | step s | memory MB |\n| ---: | ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as folder:
        for meshes in args.meshes:
            path = Path(folder) / f"{meshes}.usdc"
            write_stage(path, meshes, args.moving, args.textures)
            flags = [f"--{name}" for name in ("robot", "xpbd", "profile") if getattr(args, name)]
            command = [sys.executable, __file__, "--measure", str(path), *flags]
            stderr = None if args.profile else subprocess.DEVNULL
            done = subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, text=True, check=True)
            row = json.loads(done.stdout.strip().splitlines()[-1])
            numbers = [f"{row['load_s']:.1f}", f"{row['cpu_s']:.1f}", f"{row['step_s']:.3f}", f"{row['memory_mb']:.0f}"]
            print(f"| {meshes} | {' | '.join(numbers)} |", flush=True)


if __name__ == "__main__":
    main()
