# SPDX-License-Identifier: Apache-2.0
"""Robot files that other projects ship in their packages."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import mujoco
import pytest

ROBOTS = {
    "go1": ("mjlab", "asset_zoo/robots/unitree_go1/xmls/go1.xml"),
    "g1": ("mjlab", "asset_zoo/robots/unitree_g1/xmls/g1.xml"),
    "yam": ("mjlab", "asset_zoo/robots/i2rt_yam/xmls/yam.xml"),
    "ant": ("gymnasium", "envs/mujoco/assets/ant.xml"),
    "humanoid": ("gymnasium", "envs/mujoco/assets/humanoid.xml"),
    "quadruped": ("newton", "examples/assets/quadruped.urdf"),
}
"""Package and path of each file."""


def robot_file(name: str) -> Path:
    """A file of an installed package, which is not imported; the test is skipped where there is none."""
    package, path = ROBOTS[name]
    spec = importlib.util.find_spec(package)
    if spec is None:
        pytest.skip(f"{package} is not installed: pip install {package} --no-deps")
    return Path(spec.origin).parent / path


def plain_model(path: Path) -> mujoco.MjModel:
    """Model that MuJoCo's C library reads; the root of a URDF file stays a body."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    return spec.compile()
