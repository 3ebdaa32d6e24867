# SPDX-License-Identifier: Apache-2.0
"""Robot library: files of robots that MuJoCo Menagerie, Newton or ``robot_descriptions`` publish, by name."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import newton

from stripe_newton.sim import MjcfFileCfg, UrdfFileCfg, UsdFileCfg

__all__ = ["ROBOT_SOURCES", "file_spawner", "find_robot"]

ROBOT_SOURCES = ("menagerie", "newton", "descriptions")
"""Sources that :func:`find_robot` knows."""

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
        name: As the source calls it: ``"unitree_go1"`` in Menagerie, ``"unitree_g1"`` there and at Newton's,
            ``"go2_mj_description"`` in ``robot_descriptions``.
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
    chosen = source or _choose(name)
    finders = {"menagerie": _menagerie, "newton": _newton, "descriptions": _descriptions}
    path = Path(finders[chosen](name, file))
    if not path.is_file():
        raise FileNotFoundError(f"robot '{name}' of {chosen}: no file '{path}'; {_beside(path)}")
    return path


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
    close = difflib.get_close_matches(name, list(dict.fromkeys([*known, *_NEWTON])), n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(close)}?" if close else f"Newton has {', '.join(_NEWTON)}"
    more = "" if known else "; 'pip install mujoco-menagerie' for the robots of MuJoCo Menagerie"
    raise LookupError(f"robot '{name}' is not known; {hint}{more}")


def _menagerie(name: str, file: str | None) -> Path:
    menagerie = _package("mujoco_menagerie", "mujoco-menagerie", name)
    try:
        robot = menagerie.get(name)
    except LookupError as error:
        raise LookupError(f"robot '{name}' of menagerie: {error}") from error
    try:
        return robot.xml(file or robot.default_model)
    except LookupError:
        raise
    except Exception as error:  # the package raises its own errors for a network that is not there, and urllib's
        advice = "or set MENAGERIE_ROOT to a checkout of github.com/google-deepmind/mujoco_menagerie"
        raise _unreachable(name, "MuJoCo Menagerie", error, advice) from error


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
