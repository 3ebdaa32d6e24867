# SPDX-License-Identifier: Apache-2.0
"""Robot library: files and configs of robots that MuJoCo Menagerie, mjlab and others publish, by name."""

from __future__ import annotations

import difflib
import importlib
import importlib.metadata
import importlib.util
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import newton

from stripe_newton.actuators import ActuatorCfg, ImplicitActuatorCfg
from stripe_newton.sim import ArticulationRootPropertiesCfg, MjcfFileCfg, UrdfFileCfg, UsdFileCfg

from .articulation import ArticulationCfg
from .robot_table import ROBOTS, RobotEntry

__all__ = ["ROBOTS", "ROBOT_SOURCES", "RobotNotFoundError", "file_spawner", "find_robot", "robot_cfg"]


class RobotNotFoundError(LookupError):
    """A robot that is not in the table, or whose file is not to be had; the message says how to get it."""


ROBOT_SOURCES = ("mjlab", "menagerie", "newton", "descriptions", "example_robot_data", "isaacgymenvs")
"""Sources that :func:`find_robot` knows."""


@dataclass(frozen=True)
class _Repository:
    """A repository of robots, of which the folders that are asked for are fetched."""

    source: str
    """Its name among the sources."""
    title: str
    url: str
    variable: str
    """Environment variable with the path of a checkout."""
    cache: str
    """Folder of the part that is fetched."""

    def checkout(self, folder: str) -> str:
        """How a checkout with a folder is named, for error messages."""
        given = os.environ.get(self.variable)
        why_not = "" if given is None else f" (it is '{given}', which does not have the file in '{folder}')"
        return f"set {self.variable} to a checkout of {self.url.removeprefix('https://')}{why_not}"


_MENAGERIE = _Repository(
    source="menagerie",
    title="MuJoCo Menagerie",
    url="https://github.com/google-deepmind/mujoco_menagerie",
    variable="MENAGERIE_ROOT",
    cache="mujoco_menagerie",
)
_GYM = _Repository(
    source="isaacgymenvs",
    title="IsaacGymEnvs",
    url="https://github.com/isaac-sim/IsaacGymEnvs",
    variable="ISAACGYMENVS_ROOT",
    cache="isaacgymenvs",
)

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz", ".urdf", ".xml")
"""Suffixes of robot files."""

_NEWTON = {
    "anybotics_anymal_c": "usd/anymal_c.usda",
    "anybotics_anymal_d": "usd/anymal_d.usda",
    "franka_emika_panda": "urdf/fr3_franka_hand.urdf",
    "unitree_g1": "usd/g1_isaac.usd",
    "unitree_go2": "usd/go2.usda",
    "unitree_h1": "usd/h1_minimal.usda",
    "universal_robots_ur10": "usd/ur10_instanceable.usda",
    "wonik_allegro": "usd/allegro_left_hand_with_cube.usda",
}
"""Folders of Newton's asset repository, and the file in each that Newton's own examples load."""


def find_robot(name: str, source: str | None = None, file: str | None = None) -> Path:
    """The file of a robot, downloaded on first use and kept.

    Args:
        name: One of :data:`ROBOTS`, whose sources are tried one after the other; or as a source calls it:
            ``"unitree_go1"`` in Menagerie, ``"unitree_g1"`` there and at Newton's, ``"go2_mj_description"`` in
            ``robot_descriptions``.
        source: One of :data:`ROBOT_SOURCES`. Default: Menagerie if the name is known there and ``mujoco-menagerie``
            is installed, else Newton; for names that end in ``_description``, ``robot_descriptions``.
        file: Another file of the same robot: the entry point of Menagerie (``"scene"``), or a path below Newton's
            folder (``"mjcf/h1_with_hand.xml"``).

    Returns:
        Path of a MJCF, URDF or USD file; :func:`file_spawner` makes a spawner of it.

    Raises:
        LookupError: no source has this name; the message lists names that are close.
        ImportError: the package that is needed is not installed; the message says how to install it.
        ConnectionError: the file is not on this machine and cannot be downloaded; the message says what to do.
    """
    if source is not None and source not in ROBOT_SOURCES:
        raise ValueError(f"source: got '{source}', expected one of {', '.join(ROBOT_SOURCES)}, or None")
    if name in ROBOTS and source is None and file is None:
        return _find_listed(name)
    chosen = source or _choose(name)
    path = Path(_finder(chosen)(name, file))
    if not path.is_file():
        raise FileNotFoundError(f"robot '{name}' of {chosen}: no file '{path}'; {_beside(path)}")
    return path


def robot_cfg(name: str, path: str | Path | None = None) -> ArticulationCfg:
    """Config of a robot of :data:`ROBOTS`: its file, a pose that it can stand in or hold, and drives that do.

    Robots with legs or wings float, arms and hands are held in the world. Change it by ``replace``.

    Args:
        name: Short name, ``"go2"``.
        path: Its file; by default :func:`find_robot` looks for one. The names of joints must be those of the file that
            it would find.

    Raises:
        RobotNotFoundError: there is no such robot, or its file is not to be had; the message says how to get it.
    """
    entry = _entry(name)
    file = Path(path) if path is not None else find_robot(name)
    suffix, options = file.suffix.lower(), dict[str, Any]()
    if suffix == ".urdf":
        options["fix_base"] = entry.fixed_base
    elif suffix in (".xml", ".mjcf"):
        options |= {"fix_base": entry.fixed_base or None, "keyframe": entry.keyframe}
    else:
        options["articulation_props"] = ArticulationRootPropertiesCfg(fix_root_link=entry.fixed_base)
    pos = None if entry.keyframe else entry.pos
    groups: dict[str, ActuatorCfg] = {
        group: ImplicitActuatorCfg(
            joint_names_expr=[drive.joints],
            stiffness=drive.stiffness,
            damping=drive.damping,
            effort_limit=drive.effort,
            velocity_limit=drive.speed,
        )
        for group, drive in entry.drives.items()
    }
    return ArticulationCfg(
        spawn=file_spawner(file, **options),
        init_state=ArticulationCfg.InitialStateCfg(pos=pos, rot=None, joint_pos=dict(entry.joint_pos) or None),
        actuators=groups,
    )


def _entry(name: str) -> RobotEntry:
    if name not in ROBOTS:
        near = difflib.get_close_matches(name, ROBOTS, n=3, cutoff=0.4)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        raise RobotNotFoundError(f"robot '{name}' is not in the table; {hint}it has {', '.join(ROBOTS)}")
    return ROBOTS[name]


def _find_listed(name: str) -> Path:
    """The file of a robot of the table, from the first of its sources that has it."""
    entry, reasons = ROBOTS[name], list[str]()
    for source, there, file in entry.sources:
        try:
            path = Path(_finder(source)(there, file))
        except (ImportError, LookupError, ConnectionError, ValueError) as error:
            reasons.append(f"{source}: {error}")
            continue
        if path.is_file():
            return path
        reasons.append(f"{source}: no file '{path}'")
    raise RobotNotFoundError(
        "".join([f"robot '{name}' ({entry.title}): no file found", *(f"\n  {r}" for r in reasons)])
        + (f"; {entry.get}" if entry.get else "")
    )


def _finder(source: str) -> Callable[[str, str | None], Path]:
    return {
        "mjlab": _mjlab,
        "menagerie": _menagerie,
        "newton": _newton,
        "descriptions": _descriptions,
        "example_robot_data": _example_robot_data,
        "isaacgymenvs": _isaacgymenvs,
    }[source]


def file_spawner(path: str | Path, **options: Any) -> UsdFileCfg | UrdfFileCfg | MjcfFileCfg:
    """The spawner config for a robot's file: ``UsdFileCfg``, ``UrdfFileCfg`` or ``MjcfFileCfg`` by its suffix.

    Args:
        path: The file.
        options: Further fields of that config.
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".usd", ".usda", ".usdc", ".usdz"):
        return UsdFileCfg(usd_path=str(path), **options)
    if suffix == ".urdf":
        return UrdfFileCfg(asset_path=str(path), **options)
    if suffix in (".xml", ".mjcf"):
        return MjcfFileCfg(asset_path=str(path), **options)
    raise ValueError(f"'{path}': expected a file .usd, .usda, .usdc, .usdz, .urdf or .xml (MJCF)")


def _choose(name: str) -> str:
    if name.endswith("_description"):
        return "descriptions"
    known = importlib.import_module("mujoco_menagerie").names() if _installed("mujoco_menagerie") else []
    if name in known:
        return "menagerie"
    if name in _NEWTON:
        return "newton"
    every = list(dict.fromkeys([*ROBOTS, *known, *_NEWTON]))
    close = difflib.get_close_matches(name, every, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(close)}?" if close else f"Newton has {', '.join(_NEWTON)}"
    more = "" if known else "; 'pip install mujoco-menagerie' for the robots of MuJoCo Menagerie"
    raise LookupError(f"robot '{name}' is not known; {hint}{more}")


def _mjlab(name: str, file: str | None) -> Path:
    """A file of mjlab's wheel, which is not imported."""
    spec = importlib.util.find_spec("mjlab")
    if spec is None or spec.origin is None:
        raise ImportError(f"robot '{name}': 'mjlab' is not installed; run 'pip install mjlab --no-deps'")
    return Path(spec.origin).parent / (file or f"asset_zoo/robots/{name}/xmls/{name.rpartition('_')[2]}.xml")


def _menagerie(name: str, file: str | None) -> Path:
    """A file of Menagerie: of a checkout, of what its package downloads, or of a sparse checkout of its repository."""
    if file is not None and (path := _checked_out(_MENAGERIE, name, _with_suffix(file))) is not None:
        return path
    if not _installed("mujoco_menagerie"):
        advice = f"or run 'pip install mujoco-menagerie', or {_MENAGERIE.checkout(name)}"
        return _cloned(_MENAGERIE, name, _with_suffix(file or f"{name.split('_', 1)[-1]}.xml"), advice)
    menagerie = importlib.import_module("mujoco_menagerie")
    try:
        robot = menagerie.get(name)
    except LookupError as error:
        raise LookupError(f"robot '{name}' of menagerie: {error}") from error
    try:
        return robot.xml((file or robot.default_model).removesuffix(".xml"))
    except LookupError:
        raise
    except Exception as error:  # the package raises its own errors for a network that is not there, and urllib's
        raise _unreachable(name, _MENAGERIE.title, error, f"or {_MENAGERIE.checkout(name)}") from error


def _isaacgymenvs(name: str, file: str | None) -> Path:
    """A file of the assets of IsaacGymEnvs: of a checkout, or of a sparse checkout of its repository."""
    if file is None:
        raise ValueError(f"file: missing; the file inside '{name}' of {_GYM.title}, such as 'urdf/{name}.urdf'")
    folder = f"assets/urdf/{name}"
    found = _checked_out(_GYM, folder, file)
    return _cloned(_GYM, folder, file, f"or {_GYM.checkout(folder)}") if found is None else found


def _with_suffix(file: str) -> str:
    return file if file.endswith(".xml") else f"{file}.xml"


def _checked_out(repository: _Repository, folder: str, file: str) -> Path | None:
    """A file of the user's checkout, if it is there."""
    root = os.environ.get(repository.variable)
    path = None if root is None else Path(root) / folder / file
    return path if path is not None and path.is_file() else None


def _cloned(repository: _Repository, folder: str, file: str, advice: str) -> Path:
    """A file of a repository, of which the folders that were asked for are fetched and kept."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    cache = home / "stripe-newton" / repository.cache
    path = cache / folder / file
    if path.is_file():
        return path
    try:
        if not (cache / ".git").is_dir():
            cache.parent.mkdir(parents=True, exist_ok=True)
            _git("clone", "--quiet", "--depth", "1", "--filter=blob:none", "--sparse", repository.url, str(cache))
        _git("-C", str(cache), "sparse-checkout", "add", folder)
    except (OSError, subprocess.SubprocessError) as error:
        raise _unreachable(folder, repository.title, error, advice) from error
    if not (cache / folder).is_dir():
        raise LookupError(f"robot '{folder}' of {repository.source}: its repository has no such folder")
    return path


def _example_robot_data(name: str, file: str | None) -> Path:
    """A file of the wheel ``example-robot-data``, whose package needs others and is not imported."""
    if file is None:
        raise ValueError(f"file: missing; the file inside '{name}' of example-robot-data, such as 'urdf/robot.urdf'")
    try:
        wheel = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError as error:
        advice = "run 'pip install example-robot-data --no-deps'"
        raise ImportError(f"robot '{name}': 'example-robot-data' is not installed; {advice}") from error
    return Path(str(wheel.locate_file(f"cmeel.prefix/share/example-robot-data/robots/{name}/{file}")))


def _git(*arguments: str) -> None:
    """Run git, without asking for passwords.

    Raises:
        OSError: git is not there.
        subprocess.SubprocessError: it failed.
    """
    environment = os.environ | {"GIT_TERMINAL_PROMPT": "0"}
    done = subprocess.run(["git", *arguments], capture_output=True, text=True, env=environment, timeout=600.0)
    if done.returncode:
        raise subprocess.SubprocessError((done.stderr.strip().splitlines() or ["git failed"])[-1])


def _newton(name: str, file: str | None) -> Path:
    inside = file or _NEWTON.get(name)
    if inside is None:
        raise LookupError(f"robot '{name}' of newton: give the file inside its folder as well, file='usd/...'")
    _package("git", "GitPython", name)
    try:
        return Path(newton.utils.download_asset(name)) / inside
    except Exception as error:  # Git's, the operating system's and Newton's own
        advice = "or set NEWTON_CACHE_PATH to a cache that was filled elsewhere"
        raise _unreachable(name, "Newton's asset repository", error, advice) from error


def _descriptions(name: str, file: str | None) -> Path:
    _package("robot_descriptions", "robot_descriptions", name)
    if file is not None:
        raise ValueError(f"file: '{file}'; a robot of robot_descriptions has one file, leave it None")
    try:
        module = importlib.import_module(f"robot_descriptions.{name}")
    except ModuleNotFoundError as error:
        raise LookupError(f"robot '{name}' of robot_descriptions: there is no such module") from error
    except Exception as error:  # Git's, on import
        raise _unreachable(name, "robot_descriptions", error, "or set ROBOT_DESCRIPTIONS_CACHE") from error
    return Path(getattr(module, "MJCF_PATH", None) or module.URDF_PATH)


def _installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def _package(module: str, package: str, name: str) -> ModuleType:
    if not _installed(module):
        raise ImportError(f"robot '{name}': '{package}' is not installed; run 'pip install {package}'")
    return importlib.import_module(module)


def _unreachable(name: str, where: str, error: Exception, advice: str) -> ConnectionError:
    reason = (str(error).strip() or type(error).__name__).splitlines()[0]
    return ConnectionError(
        f"robot '{name}' is not on this machine and {where} cannot be reached ({reason}); "
        f"run this once with a network, {advice}; a file you have yourself needs neither: file_spawner(path)"
    )


def _beside(path: Path) -> str:
    """The files beside one that does not exist, for an error message."""
    folder = next((p for p in path.parents if p.is_dir()), None)
    files = sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.suffix in _SUFFIXES) if folder else []
    return f"'{folder}' has {', '.join(files[:12]) or 'no robot files'}"
