# SPDX-License-Identifier: Apache-2.0
"""Robot files that other projects ship in their packages."""

from __future__ import annotations

import importlib.util
import os
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

MENAGERIE = {
    "go2": "unitree_go2/go2.xml",
    "anymal_c": "anybotics_anymal_c/anymal_c.xml",
    "panda": "franka_emika_panda/panda.xml",
    "allegro": "wonik_allegro/right_hand.xml",
    "shadow_hand": "shadow_hand/right_hand.xml",
}
"""Path of each file in a checkout of MuJoCo Menagerie."""


def robot_file(name: str) -> Path:
    """A file of an installed package, which is not imported, or of Menagerie. Without it the test is skipped."""
    if name in MENAGERIE:
        return _menagerie_file(MENAGERIE[name])
    package, path = ROBOTS[name]
    spec = importlib.util.find_spec(package)
    if spec is None:
        pytest.skip(f"{package} is not installed: pip install {package} --no-deps")
    return Path(spec.origin).parent / path


def _menagerie_file(path: str) -> Path:
    root = os.environ.get("MENAGERIE_ROOT")
    if root is None:
        pytest.skip("set MENAGERIE_ROOT to a checkout of github.com/google-deepmind/mujoco_menagerie")
    found = Path(root) / path
    if not found.is_file():
        pytest.skip(f"MENAGERIE_ROOT has no file '{path}'")
    return found


def plain_model(path: Path) -> mujoco.MjModel:
    """Model that MuJoCo's C library reads; the root of a URDF file stays a body."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    return spec.compile()
