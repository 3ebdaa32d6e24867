# SPDX-License-Identifier: Apache-2.0
"""Quadrupeds of others in the velocity task: a robot and the names of its bodies, in a few lines."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, file_spawner
from stripe_newton.configclass import ConfigError
from stripe_newton.managers import SceneEntityCfg
from stripe_tasks.velocity.humanoid import HumanoidFlatEnvCfg
from stripe_tasks.velocity.manager_based import VelocityEnvCfg, VelocitySceneCfg
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg, QuadrupedRoughEnvCfg

LEG = """<body name="{name}_upper" pos="{x} {y} 0"><joint name="{name}_hip" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 -.08 0 -.14" size=".015" mass=".5"/>
<body name="{name}_shank" pos="-.08 0 -.14"><joint name="{name}_knee" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .08 0 -.14" size=".012" mass=".2"/></body></body>"""


def foreign(folder: Path) -> ArticulationCfg:
    """A robot of eight joints whose bodies have names of their own."""
    corners = {"a": (0.2, 0.1), "b": (0.2, -0.1), "c": (-0.2, 0.1), "d": (-0.2, -0.1)}
    legs = "".join(LEG.format(name=name, x=x, y=y) for name, (x, y) in corners.items())
    trunk = f'<freejoint/><geom type="box" size=".22 .08 .05" mass="8"/>{legs}'
    path = folder / "robot.xml"
    path.write_text(f'<mujoco><worldbody><body name="hull" pos="0 0 .3">{trunk}</body></worldbody></mujoco>')
    return ArticulationCfg(
        spawn=file_spawner(path),
        init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 0.3)),
        actuators={"legs": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=40.0, damping=1.0)},
    )


def small(cfg):
    cfg.scene.num_envs, cfg.sim.device = 2, "cpu"
    return cfg


def names(term) -> list[str]:
    cfg = term.params.get("asset_cfg") or term.params["sensor_cfg"]
    return cfg.body_names


def test_a_foreign_quadruped_walks_in_a_few_lines(tmp_path):
    cfg = QuadrupedFlatEnvCfg(robot=foreign(tmp_path), base="hull", feet=".*_shank", thighs=".*_upper")
    env = gymnasium.make_vec("Stripe-Velocity-Flat-Quadruped-v0", cfg=small(cfg))
    observations, _ = env.reset()
    assert observations["policy"].shape == (2, 36)  # 12 of base and command, three for each of eight joints
    for _ in range(25):
        env.step(torch.zeros(2, 8))
    assert float(env.unwrapped.scene["robot"].data.root_pos_w[0, 2]) > 0.2  # it stands
    env.close()


def test_the_fields_set_the_bodies_of_all_terms(tmp_path):
    cfg = QuadrupedFlatEnvCfg(robot=foreign(tmp_path), base="hull", feet=[".*_shank"], thighs=".*_upper")
    assert names(cfg.events.payload) == names(cfg.events.centre_of_mass) == ["hull"]
    assert names(cfg.events.soles) == names(cfg.rewards.feet_air_time) == [".*_shank"]
    assert names(cfg.rewards.undesired_contacts) == [".*_upper"]
    assert names(cfg.terminations.base_contact) == ["hull"]
    assert cfg.scene.robot.prim_path == "{ENV_REGEX_NS}/Robot"
    rough = QuadrupedRoughEnvCfg(robot=foreign(tmp_path), base="hull", feet=".*_shank", falls_on=["hull", ".*_upper"])
    assert rough.scene.height_scanner.prim_path == "{ENV_REGEX_NS}/Robot/hull"
    assert names(rough.terminations.base_contact) == ["hull", ".*_upper"]
    biped = HumanoidFlatEnvCfg(feet=".*_shank")
    assert names(biped.rewards.feet_slide) == names(biped.rewards.feet_air_time) == [".*_shank"]


def test_fields_that_are_set_later_count_and_terms_that_name_bodies_stay():
    cfg = QuadrupedFlatEnvCfg()
    cfg.rewards.undesired_contacts.params["sensor_cfg"] = SceneEntityCfg("contact_forces", body_names=["trunk"])
    cfg = cfg.copy()
    cfg.feet, cfg.thighs = ".*_calf", []
    cfg.complete()
    assert names(cfg.events.soles) == names(cfg.rewards.feet_air_time) == [".*_calf"]
    assert names(cfg.rewards.undesired_contacts) == ["trunk"]
    assert QuadrupedFlatEnvCfg(thighs=[]).rewards.undesired_contacts is None


def test_what_is_missing_is_said():
    cfg = VelocityEnvCfg(scene=VelocitySceneCfg(num_envs=2, env_spacing=2.0))
    with pytest.raises(ConfigError) as error:
        cfg.validate()
    text = str(error.value)
    assert all(f"  {name}: is missing" in text for name in ("base", "feet", "scene.robot"))
