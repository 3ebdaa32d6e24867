# SPDX-License-Identifier: Apache-2.0
"""Task descriptions: the first sentence about a task's config, read from its source without importing it."""

from __future__ import annotations

import ast
import functools
import importlib.util
import inspect
from pathlib import Path

__all__ = ["describe_entry"]


def describe_entry(entry: object) -> str:
    """The first sentence of the docstring of a class or function, or of what ``"module:name"`` names; empty if none.

    Importing what tasks name would load torch, Warp and Newton, which takes seconds.
    """
    if isinstance(entry, str):
        module, _, name = entry.partition(":")
        text = _docstring(module, name)
    else:
        text = inspect.getdoc(entry if inspect.isclass(entry) or inspect.isfunction(entry) else type(entry)) or ""
        text = "" if text.startswith("Makes copies") else text
    line = " ".join(text.strip().partition("\n\n")[0].split())
    sentence = line.partition(". ")[0]
    return sentence.rstrip(".:")


def _docstring(module: str, name: str) -> str:
    """Docstring of a class or function at the top of a module, also one that the module imports from another."""
    for _ in range(5):  # from package to package
        tree = _tree(module)
        if tree is None:
            return ""
        for node in tree.body:
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == name:
                return ast.get_docstring(node) or ""
        found = _imported(tree, module, name)
        if found is None:
            return ""
        module, name = found
    return ""


def _imported(tree: ast.Module, module: str, name: str) -> tuple[str, str] | None:
    """Module and name that a module imports under a name."""
    for node in tree.body:
        if not isinstance(node, ast.ImportFrom):
            continue
        for alias in node.names:
            if (alias.asname or alias.name) == name:
                path = _path(module)
                package = module if path is not None and path.name == "__init__.py" else module.rpartition(".")[0]
                parent = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
                target = ".".join(filter(None, [parent if node.level else "", node.module or ""]))
                return target, alias.name
    return None


@functools.cache
def _tree(module: str) -> ast.Module | None:
    path = _path(module)
    try:
        return None if path is None else ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, SyntaxError):
        return None


def _path(module: str) -> Path | None:
    """File of a module. Only the top package is looked up, as Python imports the packages above a module."""
    top, *rest = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except ValueError:
        return None
    if spec is None:
        return None
    if not rest:
        return Path(spec.origin) if spec.origin else None
    for folder in spec.submodule_search_locations or ():
        base = Path(folder).joinpath(*rest)
        for file in (base.with_suffix(".py"), base / "__init__.py"):
            if file.is_file():
                return file
    return None
