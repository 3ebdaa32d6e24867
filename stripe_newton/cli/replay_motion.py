# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton replay-motion``: shows a recorded motion on its robot, live or as a video, without physics."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from .live_view import check_installed, open_viewer
from .user_error import UserError
from .written_places import try_place

if TYPE_CHECKING:
    from stripe_newton.assets import ArticulationCfg
    from stripe_newton.motions import MotionLibrary
    from stripe_newton.scene import InteractiveScene

__all__ = ["ReplayMotionArgs", "run"]


@dataclass
class ReplayMotionArgs:
    """Show recorded motions on their robot, frame by frame."""

    files: tyro.conf.Positional[Annotated[list[str], tyro.conf.arg(metavar="FILE ...")]]
    """CSV or NPZ files, folders of them, or patterns; they are shown one after the other."""
    robot: str = "g1"
    """The robot: a name of the table of robots, or its file."""
    motion_fps: float | None = None
    """Frames a second of the files; by default what the file or its name says."""
    joint_names: tuple[str, ...] | None = None
    """Names of the joints in the files' order; by default the robot's, or those in the file."""
    quaternions: Literal["xyzw", "wxyz"] | None = None
    """Order of quaternions in the files; by default (x, y, z, w) in CSV and (w, x, y, z) in NPZ."""
    viewer: Literal["viser", "video", "none"] | None = None
    """A live view in the browser, a video, or only the table; by default viser where it is installed, else video."""
    fps: float = 30.0
    """Pictures a second."""
    seconds: float | None = None
    """Time to show; by default all of it, and with viser again and again until Ctrl-C."""
    out: Path = Path("motion.mp4")
    """The video."""
    resolution: tuple[int, int] = (960, 540)
    """Width and height of the video [px]."""
    host: str = "127.0.0.1"
    """Address that the live view listens on; 0.0.0.0 for other machines too, which then need the printed token."""
    port: int = 8080
    """Port of the live view; the next free one if it is in use."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(ReplayMotionArgs, args=argv, prog="stripe-newton replay-motion")
    if not args.files:
        raise UserError("replay-motion needs files: stripe-newton replay-motion FILE [FILE ...]")
    if not 0.0 < args.fps <= 240.0:
        raise UserError(f"--fps {args.fps:g}: must be above 0 and at most 240")
    viewer = args.viewer or ("viser" if importlib.util.find_spec("viser") else "video")
    if viewer == "viser":
        check_installed()
    try_place("--out", args.out if viewer == "video" else None)
    scene, library = _load(args)
    print(_table(library))
    if viewer == "video":
        print(_film(scene, library, args))
    elif viewer == "viser":
        _watch(scene, library, args)
    return 0


def _load(args: ReplayMotionArgs) -> tuple[InteractiveScene, MotionLibrary]:
    """The robot on a plane, and the motions at the rate of the pictures.

    Raises:
        UserError: for files that are no motions, or not of this robot.
    """
    # Here, as --help needs none of it.
    from stripe_newton.assets import AssetBaseCfg
    from stripe_newton.motions import MotionError, MotionLibrary, find_motions, read_motion
    from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
    from stripe_newton.sim import DistantLightCfg, DomeLightCfg, GroundPlaneCfg, Simulation, SimulationCfg

    from .compile_log import init_warp

    init_warp()
    try:
        motions = [
            read_motion(file, args.motion_fps, args.joint_names, args.quaternions) for file in find_motions(args.files)
        ]
        scene = InteractiveScene(
            InteractiveSceneCfg(num_envs=1, env_spacing=0.0), Simulation(SimulationCfg(device="cpu"))
        )
        scene.builder.build_robot("robot", _robot(args.robot).replace(prim_path="{ENV_REGEX_NS}/Robot"))
        for name, spawn in (
            ("ground", GroundPlaneCfg()),
            ("sky", DomeLightCfg(intensity=2000.0)),
            ("sun", DistantLightCfg(intensity=2500.0)),
        ):
            scene.builder.build_objects({name: AssetBaseCfg(prim_path=f"/World/{name}", spawn=spawn)})
        scene.build()
        return scene, MotionLibrary.of_robot(motions, scene["robot"], scene.sim, args.fps)
    except MotionError as error:
        raise UserError(str(error)) from None


def _robot(name: str) -> ArticulationCfg:
    """The robot of a name of the table, or of a file.

    Raises:
        UserError: there is none; the message says how to get one.
    """
    from stripe_newton.assets import ArticulationCfg, file_spawner, robot_cfg

    try:
        if not Path(name).is_file():
            return robot_cfg(name)
        spawn = file_spawner(name, **({"fix_base": False} if Path(name).suffix == ".urdf" else {}))
    except (LookupError, ValueError) as error:
        raise UserError(f"--robot {name}: {error.args[0] if error.args else error}") from None
    return ArticulationCfg(spawn=spawn, init_state=ArticulationCfg.InitialStateCfg(pos=None, joint_pos=None))


def _table(library: MotionLibrary) -> str:
    """The motions: duration, height of the lowest body, fastest joint."""
    names = [Path(name).name for name in library.names]
    width = max(len("motion"), *map(len, names))
    lines = [f"{'motion':<{width}}  seconds  lowest body [m]  fastest joint [rad/s]"]
    for name, first, length in zip(names, library.starts, library.lengths, strict=True):
        frames = slice(int(first), int(first) + length)
        low, fast = library.body_pose[frames, :, 2].min(), abs(library.joint_vel[frames]).max()
        lines.append(f"{name:<{width}}  {(length - 1) / library.fps:>7.1f}  {low:>15.3f}  {fast:>21.1f}")
    return "\n".join(lines)


def _poser(scene: InteractiveScene, library: MotionLibrary) -> Callable[[int], None]:
    """A function that puts the robot at a frame, counted over all motions."""
    import torch

    robot = scene["robot"]

    def pose(frame: int) -> None:
        root, joints = (torch.as_tensor(x[frame : frame + 1]) for x in (library.body_pose[:, 0], library.joint_pos))
        robot.write_root_pose_to_sim(root)
        robot.write_joint_state_to_sim(joints, torch.zeros_like(joints))
        scene.sim.forward()

    return pose


def _film(scene: InteractiveScene, library: MotionLibrary, args: ReplayMotionArgs) -> Path:
    from stripe_newton.viewers import SceneRenderer, VideoWriter, ViewerCfg

    count = len(library.joint_pos)
    if args.seconds is not None:
        count = min(count, max(1, round(args.seconds * args.fps)))
    cfg = ViewerCfg(
        origin_type="asset_root", asset_name="Robot", eye=(2.2, -2.4, 0.5), lookat=(0.0, 0.0, -0.05),
        resolution=args.resolution,
    )  # fmt: skip
    renderer, pose = SceneRenderer(scene.sim, cfg), _poser(scene, library)
    try:
        with VideoWriter(args.out, args.fps) as video:
            for frame in range(count):
                pose(frame)
                video.add(renderer.render())
    finally:
        renderer.close()
    return args.out


def _watch(scene: InteractiveScene, library: MotionLibrary, args: ReplayMotionArgs) -> None:
    from stripe_newton.viewers import ViewerCfg
    from stripe_newton.viewers.live.motion_panel import MotionPanel

    count = None if args.seconds is None else max(1, round(args.seconds * args.fps))
    cfg = ViewerCfg(origin_type="asset_root", asset_name="Robot", eye=(2.2, -2.4, 0.5), lookat=(0.0, 0.0, -0.05))
    title = f"replay-motion: {Path(args.robot).name}"
    with open_viewer(scene, title, args.host, args.port, cfg=cfg, step_dt=1.0 / args.fps, fps=args.fps) as viewer:
        panel = MotionPanel(
            viewer.server.gui,
            viewer.inbox,
            [Path(name).name for name in library.names],
            library.lengths,
            args.fps,
            _poser(scene, library),
            viewer.set_status,
            viewer.time.speed.order + 0.5,  # above the tabs, as it is what one looks for
        )
        try:
            for step in viewer.steps(count):
                if step:
                    panel.advance()
        except KeyboardInterrupt:
            print()
