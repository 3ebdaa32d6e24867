# SPDX-License-Identifier: Apache-2.0
"""Rules of the source tree: layers, import circles, light imports, licence lines, public names."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys

import pytest

from tests.helpers.checkout import ROOT
from tools.checks.source_metrics import PACKAGES, circles, read_imports, source_files

FOLDERS = [*(ROOT / folder for folder in PACKAGES), ROOT / "tests", ROOT / "tools"]
MODULES = source_files(ROOT)
IMPORTS = {name: read_imports(name, path, ast.parse(path.read_text())) for name, path in MODULES.items()}
PUBLIC = [name for name in MODULES if not any(part.startswith("_") for part in name.split("."))]


def imports(name: str) -> set[str]:
    """Absolute names that a module imports, at any time and for types; ``from a import b`` gives ``a`` and ``a.b``."""
    found = IMPORTS[name]
    return found.loading | found.calling | found.typing


def test_there_is_something_to_check():
    assert {"stripe_kernels", "stripe_newton", "stripe_tasks", "stripe_newton.configclass"} <= MODULES.keys()


@pytest.mark.parametrize("name", [n for n in MODULES if n.startswith("stripe_kernels")])
def test_kernels_import_warp_alone(name):
    allowed = {"warp", "newton", "mujoco_warp", "numpy", "stripe_kernels", *sys.stdlib_module_names}
    assert {target.split(".")[0] for target in imports(name)} <= allowed


@pytest.mark.parametrize("name", [n for n in MODULES if n.startswith("stripe_newton")])
def test_the_framework_does_not_know_the_tasks(name):
    assert not {target for target in imports(name) if target.split(".")[0] == "stripe_tasks"}


@pytest.mark.parametrize("name", [n for n in MODULES if n.startswith("stripe_newton")])
def test_only_what_is_above_them_imports_envs(name):
    # registration makes environments by name; the dialect translates them
    above = ("rl", "cli", "specifications.training_spec", "registration", "isaaclab")
    if name.startswith(tuple(f"stripe_newton.{module}" for module in ("envs", *above))):
        return
    assert not {target for target in imports(name) if target.startswith("stripe_newton.envs")}


@pytest.mark.parametrize("kinds", [("loading",), ("loading", "calling")])
def test_no_import_circles(kinds):
    """Neither while modules load, nor by imports within functions: such imports are for start-up time alone."""

    def targets(name: str) -> set[str]:
        every = set().union(*(getattr(IMPORTS[name], kind) for kind in kinds))
        # That a package runs before its modules is not a circle.
        return {t for t in every if t in MODULES and not name.startswith(f"{t}.")} - {name}

    assert circles({name: targets(name) for name in MODULES}) == []


def imported_by(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sys.modules)"
    path = [str((ROOT / folder).parent) for folder in PACKAGES]
    out = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {path}; {code}"], capture_output=True, text=True, check=True
    )
    return {name.split(".")[0] for name in out.stdout.split()}


@pytest.mark.parametrize("statement", ["import stripe_newton", "import stripe_newton.configclass"])
def test_import_is_light(statement):
    heavy = {"torch", "warp", "newton", "mujoco", "numpy", "gymnasium", "pxr", "matplotlib", "rsl_rl", "tyro", "scipy"}
    assert not imported_by(statement) & heavy


def test_importing_the_tasks_registers_without_loading_them():
    assert not imported_by("import stripe_tasks") & {"torch", "warp", "newton", "mujoco", "pxr", "rsl_rl"}


@pytest.mark.parametrize("path", [p for f in FOLDERS for p in sorted(f.rglob("*.py"))], ids=lambda p: p.name)
def test_licence_line(path):
    assert path.read_text().startswith("# SPDX-License-Identifier: Apache-2.0\n")


@pytest.mark.parametrize("name", PUBLIC)
def test_public_names_exist_and_are_documented(name):
    module = importlib.import_module(name)
    assert module.__doc__, f"{name} has no docstring"
    names = getattr(module, "__all__", [])
    assert len(set(names)) == len(names)
    missing = [n for n in names if not hasattr(module, n)]
    assert not missing, f"{name}.__all__ names what it does not have"
    bare = []
    for public in names:
        value = getattr(module, public)
        if not (inspect.isclass(value) or inspect.isfunction(value)) or not value.__module__.startswith("stripe_"):
            continue
        if not value.__doc__ or value.__doc__.startswith(f"{public}("):  # a dataclass makes one up: "Name(a: int)"
            bare.append(public)
        if inspect.isclass(value):
            methods = [n for n, m in vars(value).items() if inspect.isfunction(m) and m.__module__ == value.__module__]
            public_methods = [
                n for n in methods if not n.startswith("_") and n != "problems"
            ]  # configclass explains it
            bare += [f"{public}.{n}" for n in public_methods if not inspect.getdoc(getattr(value, n))]
    assert not bare, f"{name}: without a docstring"
