# SPDX-License-Identifier: Apache-2.0
"""Small scenes with robots of few links, and their physical constants."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from stripe_newton.assets import ArticulationCfg
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import MjcfFileCfg, MuJoCoSolverCfg, Simulation, SimulationCfg

MASS = 2.0
"""Mass of each slider [kg]."""
DT = 0.002
G = 9.81

COM = (0.1, -0.2, 0.3)
"""Centre of mass of the lopsided body [m]."""
INERTIA = (0.05, 0.08, 0.11)

LOPSIDED = f"""<mujoco><worldbody><body name="block"><freejoint/>
<inertial pos="{COM[0]} {COM[1]} {COM[2]}" mass="1.5" diaginertia="{INERTIA[0]} {INERTIA[1]} {INERTIA[2]}"/>
</body></worldbody></mujoco>"""
"""A free body whose centre of mass is off its origin."""

ARM = """<mujoco><worldbody><body name="base">
<inertial pos="0.05 0.02 0.1" mass="3" diaginertia=".05 .06 .07"/>
<body name="upper" pos="0.2 0 0.1"><joint name="shoulder" axis="0 1 0" range="-90 90" limited="true"/>
<inertial pos="0.1 0.03 -0.2" mass="1" diaginertia=".01 .012 .013"/>
<body name="lower" pos="0.1 0 -0.4"><joint name="elbow" axis="1 0 0" range="-120 60" limited="true"/>
<inertial pos="0 0 -0.15" mass="0.5" diaginertia=".004 .005 .003"/>
<body name="hand" pos="0 0 -0.3"><joint name="grip" type="slide" axis="0 0 1" range="-0.1 0.3" limited="true"/>
<inertial pos="0 0 0" mass="0.2" diaginertia=".001 .001 .001"/>
</body></body></body></body></worldbody></mujoco>"""
"""Three joints on a base whose centre of mass is off its origin."""

PENDULUM = """<mujoco><worldbody><body name="base">
<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
<body name="bob"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.7" mass="2" diaginertia=".03 .03 .01"/></body>
</body></worldbody></mujoco>"""
PENDULUM_LENGTH = 0.7
PENDULUM_INERTIA = 0.03 + 2.0 * 0.7**2


def sliders(axes: dict[str, str]) -> str:
    """MJCF of bodies that slide independently on a base."""
    bodies = "".join(
        f'<body name="{name}"><joint name="{name}" type="slide" axis="{axis}"/>'
        f'<inertial pos="0 0 0" mass="{MASS}" diaginertia=".1 .1 .1"/></body>'
        for name, axis in axes.items()
    )
    base = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'
    return f'<mujoco><worldbody><body name="base">{base}{bodies}</body></worldbody></mujoco>'


def mjcf_robot(folder: Path, text: str, fix_base: bool | None = True, **changes: Any) -> ArticulationCfg:
    """An articulation from MJCF text."""
    path = folder / f"{abs(hash(text))}.xml"
    path.write_text(text)
    spawn = MjcfFileCfg(asset_path=str(path), fix_base=fix_base)
    return ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn).replace(**changes)


def sim_cfg(**changes: Any) -> SimulationCfg:
    """A fine time step on the CPU without contacts."""
    return SimulationCfg(device="cpu", dt=DT, solver=MuJoCoSolverCfg(disable_contacts=True)).replace(**changes)


def make_scene(
    assets: dict[str, Any],
    num_envs: int = 2,
    spacing: float = 3.0,
    sim: SimulationCfg | None = None,
    author: Callable[[InteractiveScene], None] | None = None,
) -> InteractiveScene:
    """A built scene of named asset configs; ``author`` adds to it by hand."""
    cfg = InteractiveSceneCfg(num_envs=num_envs, env_spacing=spacing)
    scene = InteractiveScene(cfg, Simulation(sim or sim_cfg()))
    for name, asset in assets.items():
        if isinstance(asset, ArticulationCfg):
            scene.builder.build_robot(name, asset)
        else:
            scene.builder.build_objects({name: asset})
    if author is not None:
        with scene.construction():
            author(scene)
    scene.clone_environments(copy_from_source=False)
    scene.build()
    return scene


def numpy(tensor: torch.Tensor) -> np.ndarray:
    """A float64 copy."""
    return tensor.detach().cpu().numpy().astype(np.float64)
