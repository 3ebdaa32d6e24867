# SPDX-License-Identifier: Apache-2.0
"""Tasks of published robots: drives by their motors, physics in one kernel, terms, and what is said without a file."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.assets import robot_library
from stripe_newton.cli import main
from stripe_newton.configclass import resolve_name
from stripe_tasks import published_robots
from tests.helpers.motion_files import write_motion
from tests.helpers.robot_files import robot_file
from tests.helpers.small_tasks import small_cfg

N = 4
WALKERS = {
    "Go1": ("go1", "trunk"),
    "Go2": ("go2", "base_link"),
    "AnymalC": ("anymal_c", "base"),
    "G1": ("g1", "torso_link"),
}
"""Name of the robot, and the body that differs."""
ONE_LAUNCH = "all physics steps of a step in one launch"


def config(task: str, **changes: Any) -> Any:
    cfg = small_cfg(task, N, seed=4)
    for name, value in changes.items():
        setattr(cfg, name, value)
    return cfg


def steps(env: Any, count: int, scale: float = 0.3) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Random steps, of which observations and rewards must be finite."""
    generator = torch.Generator().manual_seed(0)
    for _ in range(count):
        action = scale * torch.randn(N, env.single_action_space.shape[0], generator=generator)
        obs, reward, *_ = env.step(action)
        assert all(torch.isfinite(group).all() for group in obs.values())
        assert torch.isfinite(reward).all()
    return obs, reward


# -- drives


def test_gains_of_motors_are_those_that_mjlab_computes():
    """Numbers that mjlab 1.6 prints for its Go1 and G1: reflected inertia, stiffness, damping, scale of actions."""
    drives, scales = published_robots.G1_DRIVES, published_robots.action_scale(published_robots.G1_DRIVES)
    for group, inertia, stiffness in (
        ("hips", 0.010177520, 40.179238), ("knees", 0.025101925, 99.098427), ("arms", 0.003609725, 14.250623),
        ("wrists", 0.004250000, 16.778327), ("ankles", 0.007219450, 28.501246),
    ):  # fmt: skip
        assert drives[group].inertia == pytest.approx(inertia, rel=1e-5)
        assert drives[group].stiffness == pytest.approx(stiffness, rel=1e-5)
        assert drives[group].damping == pytest.approx(4.0 * stiffness / (20.0 * np.pi), rel=1e-5)
    assert scales[".*_hip_(pitch|yaw)_joint"] == pytest.approx(0.25 * 88.0 / 40.179238, rel=1e-5)
    hips = published_robots.GO1_DRIVES["hips"]
    assert (hips.stiffness, hips.damping) == (pytest.approx(15.8951, rel=1e-4), pytest.approx(1.01191, rel=1e-4))


# -- walking


@pytest.mark.parametrize("robot", ["Go2", "G1", *(pytest.param(r, marks=pytest.mark.slow) for r in ("Go1", "AnymalC"))])
def test_walker_runs_in_one_kernel_with_robots_that_differ(robot):
    name, base = WALKERS[robot]
    robot_file(name)
    env = gymnasium.make_vec(f"Stripe-Velocity-Flat-{robot}-v0", cfg=config(f"Stripe-Velocity-Flat-{robot}-v0"))
    assert ONE_LAUNCH in env.describe()
    assert ("of a hub with 4 limbs" in env.describe()) == (name == "go2")
    env.reset(seed=1)
    data, trunk = env.scene["robot"].data, env.scene["robot"].find_bodies(base)[0][0]
    assert (data.body_com_pos_b[:, trunk].std(dim=0) > 1e-3).all(), "centres of mass differ"
    obs, _ = steps(env, 10)
    joints = 29 if robot == "G1" else 12
    assert {k: tuple(v.shape) for k, v in obs.items()} == dict.fromkeys(("policy", "critic"), (N, 12 + 3 * joints))
    assert (data.projected_gravity_b[:, 2] < -0.8).all()
    env.close()


def test_anymal_stands_as_high_as_in_mujoco():
    """Two seconds in the default pose: with pyramidal cones of ratio 1 its feet creep until it lies."""
    file = robot_file("anymal_c")
    cfg = config("Stripe-Velocity-Flat-AnymalC-v0")
    cfg.events.push_robot = cfg.events.payload = cfg.events.centre_of_mass = None
    cfg.events.soles.params["static_friction_range"] = (0.8, 0.8)
    env = gymnasium.make_vec("Stripe-Velocity-Flat-AnymalC-v0", cfg=cfg)
    env.reset(seed=1)
    for _ in range(100):
        env.step(torch.zeros(N, 12))
    height = env.scene["robot"].data.root_pos_w[:, 2]
    pose = env.scene["robot"].data.default_joint_pos[0].numpy()
    spec = mujoco.MjSpec.from_file(str(file))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], friction=[0.8, 0.0, 0.0])
    for geom in spec.geoms:
        geom.condim = 3
    model = spec.compile()
    model.opt.timestep, model.opt.integrator = 0.005, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.actuator_gainprm[:] = model.actuator_biasprm[:] = 0.0
    assert [model.joint(j).name for j in range(1, model.njnt)] == env.scene["robot"].joint_names
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = 0.6, pose
    for _ in range(400):
        data.qfrc_applied[6:] = 80.0 * (pose - data.qpos[7:]) - 2.0 * data.qvel[6:]
        mujoco.mj_step(model, data)
    assert data.qpos[2] > 0.48
    torch.testing.assert_close(height, torch.full_like(height, float(data.qpos[2])), atol=0.01, rtol=0.0)
    env.close()


def test_first_random_actions_are_no_reason_to_fall():
    """With the spread that training begins with, the first second of the G1 is worth more than none."""
    robot_file("g1")
    env = gymnasium.make_vec("Stripe-Velocity-Flat-G1-v0", cfg=config("Stripe-Velocity-Flat-G1-v0"))
    env.reset(seed=1)
    spread = resolve_name("stripe_tasks.velocity.g1:G1FlatPPORunnerCfg")().actor.distribution_cfg.init_std
    generator, total = torch.Generator().manual_seed(0), torch.zeros(N)
    for _ in range(30):
        _, reward, terminated, *_ = env.step(spread * torch.randn(N, 29, generator=generator))
        assert not terminated.any()
        total += reward
    assert total.mean() > 0.1
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("robot", WALKERS)
def test_walker_runs_on_rough_ground(robot):
    robot_file(WALKERS[robot][0])
    task = f"Stripe-Velocity-Rough-{robot}-v0"
    env = gymnasium.make_vec(task, cfg=config(task))
    assert ONE_LAUNCH in env.describe() or robot in ("Go1", "G1")
    env.reset(seed=1)
    obs, _ = steps(env, 10)
    assert (obs["critic"][:, -187:].abs() <= 1.0).all()
    env.close()


@pytest.mark.slow
def test_a_swaying_g1_is_rewarded_for_turning_as_commanded():
    """On rough ground the reward for turning must not vanish while the robot rolls and pitches, as it does at first."""
    robot_file("g1")
    env = gymnasium.make_vec("Stripe-Velocity-Rough-G1-v0", cfg=config("Stripe-Velocity-Rough-G1-v0"))
    env.reset(seed=1)
    steps(env, 2)
    velocity = torch.zeros(N, 6)
    velocity[:, 3:5] = 1.5
    velocity[:, 5] = env.command_manager.get_command("base_velocity")[:, 2] + torch.tensor([0.0, 1.0, 2.0, 3.0])
    env.scene["robot"].write_root_velocity_to_sim(velocity)
    value = env.reward_manager.compute_terms()[:, env.reward_manager.active_terms.index("track_ang_vel_z_exp")]
    assert value[0] > 1.9
    # Also 1 rad/s off, which is where the training begins, there is a slope to follow.
    assert (value.diff() < -0.01).all()
    assert value[1] > 0.5
    env.close()


def test_encoders_err_in_what_the_policy_sees_and_the_critic_sees_the_truth():
    robot_file("g1")
    cfg = config("Stripe-Velocity-Flat-G1-v0")
    cfg.observations.policy.enable_corruption = False
    env = gymnasium.make_vec("Stripe-Velocity-Flat-G1-v0", cfg=cfg)
    obs, _ = env.reset(seed=0)
    off = (obs["policy"] - obs["critic"])[:, 12:41]
    assert 0.005 < off.abs().max() <= 0.015 + 1e-6
    obs, *_ = env.step(torch.zeros(N, 29))
    torch.testing.assert_close((obs["policy"] - obs["critic"])[:, 12:41], off, atol=1e-5, rtol=0.0)
    env.close()


# -- tracking and getting up


def test_tracking_begins_on_the_motion(tmp_path):
    """Without noise at the start, all rewards for following are those of a perfect match with the frame begun at."""
    robot_file("g1")
    path = tmp_path / "sway_50hz.csv"
    write_motion(path, [0.05] * 29, seconds=2.0, fps=50.0, seed=3)
    cfg = config("Stripe-Tracking-Flat-G1-Play-v0")
    cfg.commands.motion.motion_file = str(path)
    env = gymnasium.make_vec("Stripe-Tracking-Flat-G1-Play-v0", cfg=cfg)
    assert ONE_LAUNCH in env.describe()
    obs, _ = env.reset(seed=0)
    assert {k: tuple(v.shape) for k, v in obs.items()} == {"policy": (N, 160), "critic": (N, 286)}
    term = env.command_manager.get_term("motion")
    assert (term.start == 0).all()
    torch.testing.assert_close(term.frame, term.start + 1)
    term.frame[:] = term.start  # one frame back: that at which the robot was put down
    names = [n for n in env.reward_manager.active_terms if n.startswith("motion_")]
    values = env.reward_manager.compute_terms()[:, : len(names)]
    weights = torch.tensor([0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0])
    shares = (values / weights).amin(dim=0)
    # Knees and ankles are held to their soft limits, up to 0.2 rad from what these motions want.
    bounds = torch.tensor([0.999, 0.999, 0.99, 0.8, 0.93, 0.99, 0.99])
    assert (shares > bounds).all(), dict(zip(names, shares, strict=True))
    env.reset(seed=0)
    steps(env, 5)
    env.close()


def test_getting_up_begins_in_any_orientation_and_tells_who_stands():
    robot_file("g1")
    env = gymnasium.make_vec("Stripe-Getup-Flat-G1-v0", cfg=config("Stripe-Getup-Flat-G1-v0"))
    env.reset(seed=0)
    robot = env.scene["robot"]
    assert robot.data.projected_gravity_b[:, 2].std() > 0.3
    pose = robot.data.default_root_state[:, :7].clone()
    pose[:, :3] += env.scene.env_origins
    pose[1, 3:] = torch.tensor([0.7071, 0.0, 0.0, 0.7071])  # on its side
    pose[1, 2] = 0.3
    robot.write_root_pose_to_sim(pose)
    robot.write_root_velocity_to_sim(torch.zeros(N, 6))
    robot.write_joint_state_to_sim(robot.data.default_joint_pos, torch.zeros(N, 29))
    env.step(torch.zeros(N, 29))
    assert env.success.tolist() == [True, False, True, True]
    values = dict(zip(env.reward_manager.active_terms, env.reward_manager.compute_terms().T, strict=True))
    assert values["head_height"][0] > 1.9 > 1.0 > values["head_height"][1]
    assert values["posture"][0] > 0.9 > values["posture"][1] == 0.0
    env.close()


# -- without a file


def test_a_robot_whose_file_is_missing_is_said_with_how_to_get_it(monkeypatch, capsys):
    def nothing(name: str, file: str | None) -> str:
        raise ImportError(f"needs a package for {name}")

    monkeypatch.setattr(robot_library, "_finder", lambda source: nothing)
    assert main(["train", "Stripe-Velocity-Flat-Go2-v0", "--device", "cpu"]) == 2
    said = capsys.readouterr().err
    assert "robot 'go2' (Unitree Go2, a quadruped): no file found" in said
    assert "needs a package for unitree_go2" in said
    assert "Traceback" not in said
