# SPDX-License-Identifier: Apache-2.0
"""Rules of the source tree: layers, import circles, light imports, licence lines, public names."""

from __future__ import annotations

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.checkout import ROOT

PACKAGES = {
    "stripe_kernels": ROOT / "kernels" / "stripe_kernels",
    "stripe_newton": ROOT / "stripe_newton",
    "stripe_tasks": ROOT / "tasks" / "stripe_tasks",
}
FOLDERS = [*PACKAGES.values(), ROOT / "tests", ROOT / "tools"]


def module_name(path: Path, package: str) -> str:
    parts = path.relative_to(PACKAGES[package].parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    module_name(path, package): path for package, folder in PACKAGES.items() for path in sorted(folder.rglob("*.py"))
}
PUBLIC = [name for name in MODULES if not any(part.startswith("_") for part in name.split("."))]


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")


def imports(name: str, at_import_time: bool = False) -> set[str]:
    """Names that the module ``name`` imports, as written but absolute; ``a.b`` and ``a.b.c`` for ``from a.b import c``.

    ``at_import_time`` leaves out what functions import when called and what only type checkers see.
    """
    is_package = MODULES[name].name == "__init__.py"
    found: set[str] = set()
    nodes: list[ast.AST] = [ast.parse(MODULES[name].read_text())]
    while nodes:
        node = nodes.pop()
        if at_import_time and (isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) or is_type_checking(node)):
            continue
        nodes.extend(ast.iter_child_nodes(node))
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = name.split(".")
                above = above[: len(above) - node.level + is_package]
                base = ".".join([*above, base] if base else above)
            found.update({base, *(f"{base}.{alias.name}" for alias in node.names)})
    return found


def own_imports(name: str) -> set[str]:
    """Modules of this project that must be complete before ``name`` is, packages above them aside."""
    found = set()
    for target in imports(name, at_import_time=True):
        if target in MODULES and not name.startswith(target + "."):
            found.add(target)
    # `from package import submodule` needs the submodule; that the package runs first is said by its own imports
    return found - {name}


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
    above = ("stripe_newton.rl", "stripe_newton.cli", "stripe_newton.specifications.training_spec")
    if name.startswith(("stripe_newton.envs", *above)):
        return
    assert not {target for target in imports(name) if target.startswith("stripe_newton.envs")}


def test_no_import_cycles():
    graph = {name: own_imports(name) for name in MODULES}
    done: set[str] = set()

    def visit(name: str, trail: list[str]) -> None:
        if name in trail:
            pytest.fail("import cycle: " + " -> ".join([*trail[trail.index(name) :], name]))
        if name not in done:
            for target in sorted(graph[name]):
                visit(target, [*trail, name])
            done.add(name)

    for name in graph:
        visit(name, [])


def imported_by(statement: str) -> set[str]:
    code = f"import sys; {statement}; print(*sys.modules)"
    path = [str(folder.parent) for folder in PACKAGES.values()]
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
