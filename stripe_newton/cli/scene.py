# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton scene``: makes a scene of a specification, as pictures or as a USD file, or simulates it."""

from __future__ import annotations

import difflib
import functools
import importlib.util
import inspect
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from stripe_newton.registration import scene_class, scene_names

from .progress import Progress
from .tasks import import_target, load_entry_points
from .user_error import UserError, check_count
from .written_places import try_place

if TYPE_CHECKING:
    from stripe_newton.specifications import Scene, SceneSpec

__all__ = ["ACTIONS", "BuildArgs", "PreviewArgs", "SimulateArgs", "run"]

_SUFFIXES = (".usd", ".usda", ".usdc")
_OPTIONS = ("size", "density", "count")
"""Options that are passed to the spec's class."""


@dataclass(kw_only=True)
class SceneArgs:
    """The scene to make."""

    spec: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="SPEC")]]
    """A registered scene, or module:Class of a SceneSpec."""
    seed: int = 0
    """The same seed gives the same scene."""
    size: tuple[float, float] | None = None
    """Extent in x and y [m]."""
    density: float | None = None
    """Assets of the main kind, such as trees, per hectare."""
    count: int | None = None
    """Assets of the main kind in all."""


@dataclass(kw_only=True)
class PreviewArgs(SceneArgs):
    """Make a scene and draw it: birds_eye.png, eye_level.png, maps.png."""

    out: Path | None = None
    """Folder of the pictures; scene_SPEC_seedS by default."""
    resolution: tuple[int, int] = (960, 540)
    """Width and height of the pictures [px]."""


@dataclass(kw_only=True)
class BuildArgs(SceneArgs):
    """Make a scene and write it to a USD file."""

    out: Path
    """The file: .usd, .usda or .usdc."""


@dataclass(kw_only=True)
class SimulateArgs(SceneArgs):
    """Simulate a scene: walk through it at eye level, while things fall into it."""

    drop: int = 8
    """Places at which a box, a ball and a rod are dropped."""
    seconds: float | None = None
    """Simulated time; 10 by default, and with viser until Ctrl-C."""
    viewer: Literal["viser", "video", "none"] | None = None
    """A live view in the browser, a video, or only numbers; by default viser where it is installed, else video."""
    out: Path | None = None
    """The video; scene_SPEC_seedS.mp4 by default."""
    resolution: tuple[int, int] = (960, 540)
    """Width and height of the video [px]."""
    host: str = "127.0.0.1"
    """Address that the live view listens on; 0.0.0.0 for other machines too, which then need the printed token."""
    port: int = 8080
    """Port of the live view; the next free one if it is in use."""
    device: str | None = None
    """cpu or cuda:N; by default the first GPU where there is one."""


ACTIONS: dict[str, type[PreviewArgs] | type[BuildArgs] | type[SimulateArgs]] = {
    "preview": PreviewArgs,
    "build": BuildArgs,
    "simulate": SimulateArgs,
}
"""Options of each action."""


def run(argv: list[str]) -> int:
    """Run the command."""
    if not argv or argv[0] in ("-h", "--help"):
        load_entry_points()
        print(_usage())
        return 0 if argv else 2
    if argv[0] not in ACTIONS:
        near = difflib.get_close_matches(argv[0], ACTIONS, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(ACTIONS)}"
        raise UserError(f"scene: no action '{argv[0]}'; {hint}")
    args = tyro.cli(ACTIONS[argv[0]], args=argv[1:], prog=f"stripe-newton scene {argv[0]}")
    if isinstance(args, BuildArgs):
        _build(args)
    elif isinstance(args, SimulateArgs):
        _simulate(args)
    else:
        _preview(args)
    return 0


def _usage() -> str:
    return "\n".join(
        [
            "usage: stripe-newton scene preview SPEC [--seed S] [--size X Y] [--density D | --count N] [--out DIR]",
            "       stripe-newton scene build SPEC [the same options] --out FILE.usd",
            "       stripe-newton scene simulate SPEC [the same options] [--drop N] [--seconds T] [--viewer V]",
            "",
            f"SPEC is module:Class of a SceneSpec, or one of: {', '.join(scene_names()) or 'none is registered'}",
        ]
    )


def _preview(args: PreviewArgs) -> None:
    _check_resolution(args.resolution)
    out = args.out or Path(f"scene_{args.spec.rpartition(':')[2]}_seed{args.seed}")
    try_place("--out", out, folder=True)
    spec = _make_spec(args)
    with Progress() as progress:
        scene = _create(spec, args.seed, progress)
        progress.step("author", "USD stage")
        _ = scene.stage
        _draw(scene, args, out, progress)
    _report(scene, progress, [f"{out / name}.png" for name in ("birds_eye", "eye_level", "maps")])


def _draw(scene: Scene, args: PreviewArgs, out: Path, progress: Progress) -> None:
    import warp as wp  # here, as --help and build need none of these

    from stripe_newton.specifications.scene_maps import draw_maps
    from stripe_newton.specifications.scene_pictures import ScenePictures
    from stripe_newton.viewers import save_image

    from .compile_log import init_warp

    wp.config.log_level = wp.LOG_WARNING
    init_warp()
    out.mkdir(parents=True, exist_ok=True)
    progress.step("maps", "maps")
    draw_maps(scene, out / "maps.png")
    progress.step("model", "model to look at")
    pictures = ScenePictures(scene, args.resolution)
    progress.step("eye_level", "picture at eye level (kernels are compiled the first time)")
    save_image(out / "eye_level.png", pictures.eye_level())
    progress.step("birds_eye", "picture from above")
    save_image(out / "birds_eye.png", pictures.birds_eye())


def _build(args: BuildArgs) -> None:
    if args.out.suffix not in _SUFFIXES:
        raise UserError(f"--out {args.out}: must end in .usd, .usda or .usdc")
    try_place("--out", args.out)
    spec = _make_spec(args)
    with Progress() as progress:
        scene = _create(spec, args.seed, progress)
        progress.step("author", "USD stage")
        _ = scene.stage
        progress.step("export", str(args.out))
        path = scene.export(args.out)
    _report(scene, progress, [str(path)], ("file size", f"{path.stat().st_size / 1.0e6:.1f} MB"))


def _check_resolution(resolution: tuple[int, int]) -> None:
    if min(resolution) < 16 or max(resolution) > 4096:
        raise UserError(f"--resolution {resolution[0]} {resolution[1]}: must be from 16 to 4096 pixels")


def _simulate(args: SimulateArgs) -> None:
    _check_resolution(args.resolution)
    check_count("--drop", args.drop)
    if args.seconds is not None and not 0.0 < args.seconds < math.inf:
        raise UserError(f"--seconds {args.seconds}: must be a positive time")
    spec = _make_spec(args)
    from .scene_simulate import Options, simulate  # here, as it loads the simulation

    viewer = args.viewer or ("viser" if importlib.util.find_spec("viser") else "video")
    seconds = args.seconds or (math.inf if viewer == "viser" else 10.0)
    out = args.out or Path(f"scene_{args.spec.rpartition(':')[2]}_seed{args.seed}.mp4")
    if out.suffix != ".mp4":
        raise UserError(f"--out {out}: must end in .mp4")
    try_place("--out", out if viewer == "video" else None)
    simulate(
        args.spec,
        spec,
        Options(args.seed, args.drop, seconds, viewer, out, args.resolution, args.host, args.port, args.device),
    )


def _create(spec: SceneSpec, seed: int, progress: Progress) -> Scene:
    parts = iter(range(1, len(spec.palette) + 10))
    total = 1 + len(spec.palette)
    try:
        return spec.create(seed, progress=lambda text: progress.step("create", text, next(parts), total))
    except ValueError as error:
        raise UserError(str(error)) from error


def _make_spec(args: SceneArgs) -> SceneSpec:
    """The spec with the options that were given.

    Raises:
        UserError: if its class does not take them, or they have wrong values.
    """
    check_count("--seed", args.seed, least=0)
    if args.density is not None and args.count is not None:
        raise UserError("--density and --count: give one of them")
    kind = _find(args.spec)
    given = {name: getattr(args, name) for name in _OPTIONS if getattr(args, name) is not None}
    _check_arguments(args.spec, kind, list(given))
    try:
        return kind(**given)
    except ValueError as error:
        raise UserError(f"{args.spec}: {error}") from error


def _check_arguments(spec: str, kind: type[SceneSpec], given: list[str]) -> None:
    """Check that a class can be made from the options that were given.

    Raises:
        UserError: if it does not take one of them, or needs others.
    """
    parameters = inspect.signature(kind).parameters
    unknown = [f"--{name}" for name in given if name not in parameters]
    if unknown and not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        known = ", ".join(f"--{name}" for name in _OPTIONS if name in parameters) or "none"
        raise UserError(f"{spec}: {kind.__name__} does not take {', '.join(unknown)}; of these it takes {known}")
    missing = [
        name
        for name, p in parameters.items()
        if p.default is p.empty and name not in given and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
    ]
    if missing:
        raise UserError(f"{spec}: {kind.__name__} needs {', '.join(missing)}; give a class with defaults for them")


def _find(name: str) -> type[SceneSpec]:
    """The class that a name or ``module:Class`` stands for.

    Raises:
        UserError: if there is none, or it is no ``SceneSpec``.
    """
    from stripe_newton.specifications import SceneSpec  # here, as --help does not need it

    load_entry_points()
    if name in scene_names():
        found: object = scene_class(name)
    elif ":" in name:
        found = _import(name)
    else:
        near = difflib.get_close_matches(name, scene_names(), n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are: {', '.join(scene_names()) or 'none'}."
        raise UserError(f"no scene '{name}'; {hint} A class of your own is given as module:Class")
    if not (inspect.isclass(found) and issubclass(found, SceneSpec)):
        raise UserError(f"{name}: is {found!r}, must be a subclass of SceneSpec")
    if inspect.isabstract(found):
        raise UserError(f"{name}: {found.__name__} is abstract: it has no generate()")
    return found


def _import(name: str) -> object:
    """The object that ``module:Class`` names.

    Raises:
        UserError: if there is no such module, or it has no such class.
    """
    module, _, path = name.rpartition(":")
    if not path:
        raise UserError(f"{name}: names no class of the module '{module}'")
    try:
        return functools.reduce(getattr, path.split("."), import_target(module, name))
    except AttributeError:
        raise UserError(f"{name}: the module '{module}' has no '{path}'") from None


def _report(scene: Scene, progress: Progress, files: list[str], *more: tuple[str, str]) -> None:
    """Print a table of the scene, durations and memory, and the paths of the files."""
    faces: dict[int, int] = {}
    shown = colliders = 0
    touched: dict[int, int] = {}
    for instance in scene.instances:
        key = id(instance.mesh)  # instances share the meshes of their prototypes
        if key not in faces:
            faces[key] = sum(len(part.faces) for part in instance.mesh.parts())
            touched[key] = len(instance.mesh.colliders())
        shown += faces[key]
        colliders += touched[key]
    rows, columns = scene.terrain.ground.heights.shape
    ground = 2 * (rows - 1) * (columns - 1) + sum(len(part.faces) for part, _ in scene.terrain.parts)
    x, y = scene.terrain.size
    table = [("size", f"{x:g} x {y:g} m, {rows} x {columns} heights"), ("seed", str(scene.seed))]
    table += [(name, f"{len(placed):,}") for name, placed in scene.terrain.placed.items()]
    table += [
        ("instances", f"{len(scene.instances):,}"),
        ("prototypes", f"{len(faces):,}"),
        ("triangles", f"{sum(faces.values()) + ground:,} unique, {shown + ground:,} shown"),
        ("colliders", f"{colliders + 1:,}"),
        *more,
        *((f"seconds: {name}", f"{seconds:.1f}") for name, seconds in progress.seconds.items()),
        ("peak memory", f"{progress.peak_memory() / 1.0e6:,.0f} MB"),
    ]
    width = max(len(name) for name, _ in table) + 2
    print("\n".join(f"{name:<{width}}{value}" for name, value in table))
    print("\n".join(files))
