# SPDX-License-Identifier: Apache-2.0
"""Real packages of Isaac Lab, ``isaaclab_tasks`` and ``isaaclab_assets``: where their files are."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import os
import sys
from pathlib import Path

__all__ = ["REAL_PACKAGES", "SOURCE_VARIABLE", "find_real_package"]

REAL_PACKAGES = ("isaaclab_tasks", "isaaclab_assets")
"""Packages whose files are imported as they are."""

SOURCE_VARIABLE = "ISAACLAB_SOURCE"
"""Environment variable: the folder ``source`` of Isaac Lab, which holds one folder for each package."""


def find_real_package(name: str) -> importlib.machinery.ModuleSpec | None:
    """The spec of a package of :data:`REAL_PACKAGES`, where Python would not find it by itself.

    It is looked for where ``ISAACLAB_SOURCE`` points, then below ``isaaclab/source`` of the installed wheel.
    """
    if name not in REAL_PACKAGES or importlib.machinery.PathFinder.find_spec(name) is not None:
        return None
    for source in _sources():
        file = source / name / name / "__init__.py"
        if file.is_file():
            return importlib.util.spec_from_file_location(name, file, submodule_search_locations=[str(file.parent)])
    return None


def _sources() -> list[Path]:
    given = os.environ.get(SOURCE_VARIABLE)
    sources = [Path(given)] if given else []
    return sources + [Path(folder) / "isaaclab" / "source" for folder in sys.path]
