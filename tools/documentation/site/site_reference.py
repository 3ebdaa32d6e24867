# SPDX-License-Identifier: Apache-2.0
"""Reference pages of the docs site: the public names of each package, by their docstrings."""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

__all__ = ["PACKAGES", "write_reference"]

PACKAGES: tuple[tuple[str, str], ...] = (
    ("stripe_newton.configclass", "Configs"),
    ("stripe_newton.sim", "Simulation, solvers' configs and spawners"),
    ("stripe_newton.scene", "Scenes"),
    ("stripe_newton.specifications", "Scenes from specifications"),
    ("stripe_newton.usd", "USD stages"),
    ("stripe_newton.assets", "Robots and objects"),
    ("stripe_newton.actuators", "Actuators"),
    ("stripe_newton.sensors", "Sensors"),
    ("stripe_newton.terrains", "Terrain"),
    ("stripe_newton.envs", "Environments"),
    ("stripe_newton.envs.mdp", "Terms and their configs"),
    ("stripe_newton.managers", "Managers"),
    ("stripe_newton.fusion", "Fusion of terms into kernels"),
    ("stripe_newton.solvers", "Solvers"),
    ("stripe_newton.motions", "Motions"),
    ("stripe_newton.controllers", "Controllers"),
    ("stripe_newton.robot_files", "Robot files"),
    ("stripe_newton.rl", "Training with rsl_rl"),
    ("stripe_newton.rl.wrappers.sb3", "Adapter for Stable-Baselines3"),
    ("stripe_newton.rl.wrappers.skrl", "Adapter for skrl"),
    ("stripe_newton.viewers", "Viewers"),
    ("stripe_newton.registration", "Registration of tasks and scenes"),
    ("stripe_newton.math", "Mathematics"),
    ("stripe_newton.noise", "Noise"),
    ("stripe_newton.isaaclab", "Dialect of Isaac Lab"),
)
"""Packages with a page of their own, and the page's title."""


def write_reference(target: Path) -> None:
    """Write ``reference/*.rst`` into a folder."""
    folder = target / "reference"
    folder.mkdir()
    entries, documented = [], dict[int, str]()
    for package, title in PACKAGES:
        name = package.removeprefix("stripe_newton.").replace(".", "_")
        (folder / f"{name}.rst").write_text(
            _page(importlib.import_module(package), title, documented), encoding="utf-8"
        )
        entries.append(f"   {name}")
    text = [
        *_heading("API reference"),
        "The public names of each package, from their docstrings. A name has one public path:",
        "the package that lists it in ``__all__``. `A page of their own <../terms.html>`__ has the terms' formulas.",
        "",
        ".. toctree::",
        "   :maxdepth: 1",
        "",
        *entries,
        "",
    ]
    (folder / "index.rst").write_text("\n".join(text), encoding="utf-8")


def _page(module: ModuleType, title: str, documented: dict[int, str]) -> str:
    """A page; ``documented`` has the public paths of earlier pages, by the identity of what they lead to."""
    parts = [*_heading(title), f".. py:module:: {module.__name__}", ""]
    parts += [*(inspect.getdoc(module) or "").splitlines(), ""]
    names = sorted(getattr(module, "__all__", ()), key=str.lower)
    kinds: dict[str, list[str]] = {"Classes": [], "Functions": [], "Terms": [], "Values": []}
    for name in names:
        kinds[_kind(getattr(module, name))].append(name)
    for heading, found in kinds.items():
        if found:
            parts += _heading(heading, "-")
            for name in found:
                path = f"{module.__name__}.{name}"
                first = documented.setdefault(id(getattr(module, name)), path)
                parts += _entry(module, name) if first == path else [f"``{name}``: :py:obj:`{first}`.", ""]
    return "\n".join(parts) + "\n"


def _heading(text: str, rule: str = "=") -> list[str]:
    return [text, rule * len(text), ""]


def _kind(value: object) -> str:
    if inspect.isclass(value):
        return "Classes"
    if inspect.isfunction(value):
        return "Functions"
    return "Terms" if _warp_function(value) else "Values"


def _warp_function(value: object) -> object | None:
    """The Python function of a Warp function, which autodoc would take for a value; None for anything else."""
    function = getattr(value, "func", None)
    return function if type(value).__module__.startswith("warp.") and inspect.isfunction(function) else None


def _entry(module: ModuleType, name: str) -> list[str]:
    """The directive of one name."""
    value = getattr(module, name)
    function = _warp_function(value)
    path = f"{module.__name__}.{name}"
    if inspect.isclass(value):
        # Nested classes of others, such as the config of an offset that several configs have.
        others = [key for key, nested in vars(value).items() if inspect.isclass(nested) and not _is_own(nested, value)]
        return [f".. autoclass:: {path}", *([f"   :exclude-members: {', '.join(others)}"] if others else []), ""]
    if inspect.isfunction(value):
        return [f".. autofunction:: {path}", ""]
    if function is not None:
        doc = (inspect.getdoc(function) or "").splitlines()
        return [f".. py:function:: {name}({', '.join(_arguments(function))})", "", *_indented(doc), ""]
    return [f".. py:data:: {name}", "", f"   A value of type ``{type(value).__name__}``.", ""]


def _is_own(nested: type, owner: type) -> bool:
    return nested.__qualname__.startswith(f"{owner.__qualname__}.")


def _arguments(function: typing.Any) -> Iterable[str]:
    """Names of a term's arguments; their types are structs of Warp, which have no short text."""
    return inspect.signature(function).parameters


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"   {line}".rstrip() for line in lines]
