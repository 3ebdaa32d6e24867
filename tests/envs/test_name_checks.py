# SPDX-License-Identifier: Apache-2.0
"""Name checks: what terms name and the scene lacks is found before the model is made, with names that are near."""

from __future__ import annotations

import gymnasium
import pytest

import stripe_tasks  # noqa: F401
from stripe_newton.configclass import ConfigError, resolve_name
from stripe_newton.managers import SceneEntityCfg
from stripe_newton.matching import match_names, near_matches
from stripe_newton.sim import Simulation

TASK = "Stripe-Velocity-Flat-Quadruped-v0"


def velocity_cfg():
    cfg = resolve_name(gymnasium.spec(TASK).kwargs["env_cfg_entry_point"])()
    cfg.sim.device, cfg.scene.num_envs = "cpu", 1
    return cfg


def foot(cfg):
    cfg.feet = ".*_feet"


def sensor(cfg):
    cfg.rewards.feet_air_time.params["sensor_cfg"] = SceneEntityCfg("contact_force", body_names=".*_foot")


def joint(cfg):
    cfg.actions.joint_pos.joint_names = [".*_hips_joint", ".*_thigh_joint"]


def asset(cfg):
    cfg.actions.joint_pos.asset_name = "robots"


def command(cfg):
    cfg.rewards.track_lin_vel_xy_exp.params["command_name"] = "base_velocities"


CASES = {
    foot: (
        r"rewards\.feet_air_time\.params\['sensor_cfg'\]: body of 'contact_forces' expression '\.\*_feet' matches "
        r"nothing; did you mean FL_foot, FR_foot, RL_foot\?",
        r"events\.soles\.params\['asset_cfg'\]: body of 'robot'",
    ),
    sensor: (
        r"rewards\.feet_air_time\.params\['sensor_cfg'\]: there is no asset or sensor 'contact_force'; "
        r"did you mean contact_forces\?",
    ),
    joint: (
        r"actions\.joint_pos\.joint_names: joint of 'robot' expression '\.\*_hips_joint' matches nothing; "
        r"did you mean FL_hip_joint",
    ),
    asset: (r"actions\.joint_pos\.asset_name: there is no asset or sensor 'robots'; did you mean robot\?",),
    command: (
        r"rewards\.track_lin_vel_xy_exp\.params\['command_name'\]: there is no command 'base_velocities'; "
        r"did you mean base_velocity\?",
    ),
}


@pytest.mark.parametrize("wrong", CASES, ids=lambda f: f.__name__)
def test_a_name_that_is_not_there_is_found_before_the_model_is_made(monkeypatch, wrong):
    monkeypatch.setattr(Simulation, "build", lambda *args: pytest.fail("the model was made"))
    cfg = velocity_cfg()
    wrong(cfg)
    with pytest.raises(ConfigError) as error:
        gymnasium.make_vec(TASK, cfg=cfg)
    for message in CASES[wrong]:
        with pytest.raises(ValueError, match=message):
            raise error.value


def test_all_names_are_said_at_once():
    cfg = velocity_cfg()
    for wrong in (foot, joint, command):
        wrong(cfg)
    with pytest.raises(ConfigError) as error:
        gymnasium.make_vec(TASK, cfg=cfg)
    assert len(error.value.problems) == 4  # two terms are about feet


def test_near_matches_of_expressions():
    names = ["FL_foot", "FR_foot", "FL_thigh", "trunk"]
    assert near_matches(".*_feet", names) == ["FL_foot", "FR_foot"]
    assert near_matches("trnk", names) == ["trunk"]
    assert near_matches("wheel", names) == []
    with pytest.raises(ValueError, match=r"'trnk' matches nothing; did you mean trunk\? there is: FL_foot"):
        match_names("trnk", names)
