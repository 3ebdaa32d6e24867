# SPDX-License-Identifier: Apache-2.0
"""Isaac Lab's own files as an oracle: those of a checkout or an unpacked wheel, loaded without Isaac Sim.

The environment variable ``ISAACLAB_SOURCE`` names the folder ``.../isaaclab/source``.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest

__all__ = ["isaaclab_modules", "isaaclab_source"]


def isaaclab_source() -> Path:
    """Folder of Isaac Lab's packages; skips the test where there is none."""
    named = os.environ.get("ISAACLAB_SOURCE")
    if not named or not (Path(named) / "isaaclab/isaaclab/utils/math.py").is_file():
        pytest.skip("ISAACLAB_SOURCE does not name Isaac Lab's folder 'source'")
    return Path(named)


@contextmanager
def isaaclab_modules(*names: str) -> Iterator[list[ModuleType]]:
    """Modules of Isaac Lab by name, such as ``"isaaclab.utils.math"``, read from its files.

    The packages above them are empty, because their own files import Isaac Sim. All are forgotten at the end, so
    that the dialect and these never mix.
    """
    root = isaaclab_source() / "isaaclab"
    present = [name for name in sys.modules if name.partition(".")[0] == "isaaclab"]
    if present:
        raise RuntimeError(f"modules of Isaac Lab or of the dialect are imported already: {present[0]}, ...")
    for name in ("isaaclab", "isaaclab.utils", "isaaclab.controllers"):
        package = ModuleType(name)
        package.__path__ = [str(root / name.replace(".", "/"))]
        sys.modules[name] = package
    try:
        utils = sys.modules["isaaclab.utils"]
        utils.configclass = importlib.import_module("isaaclab.utils.configclass").configclass
        yield [importlib.import_module(name) for name in names]
    finally:
        for name in [name for name in sys.modules if name.partition(".")[0] == "isaaclab"]:
            del sys.modules[name]
