# SPDX-License-Identifier: Apache-2.0
"""Quaternion order in each of Isaac Lab's own files that hold an orientation: what is written is what is read."""

from __future__ import annotations

import ast
import importlib
import inspect
import logging
import sys
import warnings
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
import warp as wp

import stripe_newton.isaaclab as dialect
from stripe_newton.configclass import MISSING, is_config
from stripe_newton.isaaclab.stand_ins import StandIn
from stripe_newton.scene import SceneryOptionsCfg
from tests.helpers.isaaclab_source import isaaclab_source

EXPECTED = 53
"""Files with an orientation that there are at least: ``rot=``, ``orientation=``, or a name with ``quat`` in it."""
TASKS = "isaaclab_tasks"
PACKAGES = (TASKS, "isaaclab_assets")
OF_MATRICES = ("stripe_newton.math.pose_matrices", "stripe_newton.math.projection")
"""Modules whose functions take and give matrices alone, so that they have no order."""
UNIFORM = ".random_orientation"
"""A function whose results are spread evenly over all rotations, in either order."""
ARGUMENTS = ("rot", "orientation")


def _holds_orientation(node: ast.AST) -> bool:
    if isinstance(node, ast.keyword):
        return node.arg in ARGUMENTS
    name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
    return "quat" in name


@cache
def _files() -> list[tuple[str, str]]:
    """Module and file of each that holds an orientation, without those of agents."""
    found = []
    for package in PACKAGES:
        folder = isaaclab_source() / package / package
        for file in sorted(folder.rglob("*.py")):
            tree = ast.parse(file.read_text())
            if "agents" not in file.parts and any(map(_holds_orientation, ast.walk(tree))):
                parts = file.relative_to(folder.parent).with_suffix("").parts
                found.append((".".join(p for p in parts if p != "__init__"), str(file)))
    return found


def _modules() -> list[str]:
    try:
        return [module for module, _ in _files()]
    except pytest.skip.Exception:
        return []


@pytest.fixture(scope="module", autouse=True)
def installed() -> Iterator[None]:
    source = isaaclab_source()
    kept, registered = list(sys.path), set(gymnasium.registry)
    sys.path[:0] = [str(source / package) for package in PACKAGES]
    dialect.install()
    # The package's own file imports all tasks; each is imported by itself here.
    empty = ModuleType(TASKS)
    empty.__path__ = [str(source / TASKS / TASKS)]
    sys.modules[TASKS] = empty
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        logging.disable(logging.WARNING)
        yield
        logging.disable(logging.NOTSET)
    dialect.uninstall()
    for name in [name for name in sys.modules if name.partition(".")[0] in PACKAGES]:
        del sys.modules[name]
    for task in set(gymnasium.registry) - registered:
        del gymnasium.registry[task]
    sys.path[:] = kept


def _configs(value: object, seen: set[int]) -> Iterator[Any]:
    """All configs in a value, at any depth."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, Mapping):
        parts: list[object] = list(value.values())
    elif isinstance(value, (list, tuple)):
        parts = list(value)
    elif is_config(value):
        yield value
        parts = list(vars(value).values())
    else:
        return
    for part in parts:
        yield from _configs(part, seen)


def _instances(module: ModuleType) -> Iterator[object]:
    """Configs that a module holds, and one of each config class that it defines."""
    for value in vars(module).values():
        if inspect.isclass(value) and getattr(value, "__is_configclass__", False):
            if value.__module__ == module.__name__:
                yield _made(value)
        elif is_config(value) or isinstance(value, (dict, list, tuple)):
            yield value


def _made(cls: type) -> object:
    try:
        return cls()
    except Exception:  # a robot's file that is not on this machine, an argument that the class needs
        return None


def _written(file: str) -> set[tuple[float, ...]]:
    """Quaternions that a file writes as literals after ``rot=``."""
    found = set()
    for node in ast.walk(ast.parse(Path(file).read_text())):
        if isinstance(node, ast.keyword) and node.arg == "rot":
            try:
                found.add(tuple(map(float, ast.literal_eval(node.value))))
            except (ValueError, TypeError):
                continue  # computed
    return found


def test_there_are_files_with_an_orientation():
    assert len(_files()) >= EXPECTED


@pytest.mark.parametrize("name", _modules())
def test_a_file_is_read_in_its_order(name):
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] in ("isaaclab", *PACKAGES):
            raise
        pytest.skip(f"needs the package '{error.name}'")
    # -- configs: each orientation is of a class that knows its order
    seen: set[int] = set()
    read = []
    values = list(_instances(module))  # all at once: they are told apart by their addresses
    for cfg in (c for value in values for c in _configs(value, seen)):
        rot = vars(cfg).get("rot", MISSING)
        if rot is MISSING or rot is None or isinstance(cfg, SceneryOptionsCfg):  # of the package alone
            continue
        read.append(tuple(map(float, rot)))
        if isinstance(cfg, StandIn):  # which is refused, or has no effect
            continue
        assert hasattr(type(cfg), "rot_xyzw"), f"{type(cfg).__module__}.{type(cfg).__name__} has no order"
        unit = np.array(rot, dtype=float) / np.linalg.norm(rot)
        np.testing.assert_allclose(cfg.rot_xyzw, unit[[1, 2, 3, 0]], atol=0.01, err_msg=f"{type(cfg).__name__}: {rot}")
    missed = _written(dict(_files())[name]) - set(read)
    assert not missed, f"no config has {missed}"
    # -- functions: none is the package's own, which takes and gives (x, y, z, w)
    for label, value in _functions(module):
        where = getattr(value, "__module__", "") or ""
        own = where.startswith(("stripe_newton.math", "stripe_newton.sim", "stripe_newton.envs"))
        assert not own or where in OF_MATRICES or label.endswith(UNIFORM), label
        assert not isinstance(value, wp.Function), label


def _functions(module: ModuleType) -> Iterator[tuple[str, object]]:
    """Functions that a module calls with an orientation: by name, and those of modules that it has imported."""
    for name, value in vars(module).items():
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] in ("isaaclab", "isaacsim"):
            for inner in [n for n in dir(value) if _turns(n)]:
                yield f"{name}.{inner}", getattr(value, inner)
        elif _turns(name) and isinstance(value, (FunctionType, wp.Function)):
            yield name, value


def _turns(name: str) -> bool:
    return any(word in name for word in ("quat", "pose", "frame_transforms", "spawn_", "orientation", "compute_rot"))
