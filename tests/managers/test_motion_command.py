# SPDX-License-Identifier: Apache-2.0
"""Motion commands: frames, resets, probabilities, and every term against float64 references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels.mdp import motion_command
from stripe_kernels.motion import MotionCommandData, accumulate_probabilities, average_failures
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.sim import SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers.motion_files import write_motion

N, DT, STD = 6, 0.02, 0.7
ANCHOR, SOME = "base", ["base", ".*_calf", "FL_foot"]
STANCE = [0.0, 0.8, -1.5] * 4
"""Joint positions about which motions swing [rad]."""
MOTION = {"command_name": "motion"}
BODIES = {**MOTION, "asset_cfg": SceneEntityCfg("robot", body_names=SOME)}
REWARDS = {
    "motion_global_anchor_position_error_exp": MOTION,
    "motion_global_anchor_orientation_error_exp": MOTION,
    "motion_relative_body_position_error_exp": BODIES,
    "motion_relative_body_orientation_error_exp": BODIES,
    "motion_global_body_linear_velocity_error_exp": BODIES,
    "motion_global_body_angular_velocity_error_exp": BODIES,
}
TERMINATIONS = {
    "bad_anchor_pos": (MOTION, 0.35),
    "bad_anchor_pos_z_only": (MOTION, 0.15),
    "bad_anchor_ori": (MOTION, 0.2),
    "bad_motion_body_pos": (BODIES, 0.3),
    "bad_motion_body_pos_z_only": (BODIES, 0.2),
}


@configclass
class Policy(ObservationGroupCfg):
    """Everything that can be observed of a motion."""

    command: ObservationTermCfg = ObservationTermCfg(func=mdp.generated_commands, params=MOTION)
    anchor_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.motion_anchor_pos_b, params=MOTION)
    anchor_ori: ObservationTermCfg = ObservationTermCfg(func=mdp.motion_anchor_ori_b, params=MOTION)
    body_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.robot_body_pos_b, params=BODIES)
    body_ori: ObservationTermCfg = ObservationTermCfg(func=mdp.robot_body_ori_b, params=BODIES)


def config(motions: Any, **command: Any) -> ManagerBasedRLEnvCfg:
    """A quadruped with a motion command and its rewards; episodes end with the motion."""
    rewards = {n: RewardTermCfg(func=getattr(mdp, n), weight=1.0, params={**p, "std": STD}) for n, p in REWARDS.items()}
    ends = {"motion_finished": TerminationTermCfg(func=mdp.motion_finished, params=MOTION, time_out=True)}
    return ManagerBasedRLEnvCfg(
        decimation=4,
        episode_length_s=100.0,
        sim=SimulationCfg(dt=DT / 4, device="cpu"),
        scene=RobotSceneCfg(num_envs=N, env_spacing=3.0, robot=QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")),
        observations={"policy": Policy()},
        actions={"joint_pos": mdp.JointPositionActionCfg(joint_names=[".*"], use_default_offset=True)},
        commands={"motion": mdp.MotionCommandCfg(motion_file=motions, **{"anchor_body_name": ANCHOR} | command)},
        rewards=rewards,
        terminations=ends,
    )


@pytest.fixture(scope="module")
def motions(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("motions")
    names = [str(folder / "one_50hz.csv"), str(folder / "two_100hz.csv")]
    write_motion(Path(names[0]), STANCE, seconds=3.0, fps=50.0, seed=1)
    write_motion(Path(names[1]), STANCE, seconds=2.0, fps=100.0, seed=2)
    return names


@pytest.fixture(scope="module")
def env(motions):
    made = ManagerBasedRLEnv(config(motions))
    yield made
    made.close()


def motion_of(env: ManagerBasedRLEnv) -> MotionCommandData:
    (motion,) = env.context.structs.provided[MotionCommandData].values()
    return motion


# -- the reference in float64


class Reference:
    """Robot and reference of all environments, float64."""

    def __init__(self, env: ManagerBasedRLEnv):
        motion, data = motion_of(env), env.scene["robot"].data
        frame = motion.frame.numpy()
        self.ids = env.scene["robot"].find_bodies(SOME)[0]
        self.pose = data.body_pose_w.numpy().astype(float)
        self.vel = data.body_vel_w.numpy().astype(float)
        self.target = motion.body_pose.numpy().astype(float)[frame]
        self.target[..., :3] += env.scene.env_origins.numpy()[:, None]
        self.target_vel = motion.body_vel.numpy().astype(float)[frame]
        self.command = np.concatenate((motion.joint_pos.numpy()[frame], motion.joint_vel.numpy()[frame]), axis=1)
        self.anchor, self.reference = self.pose[:, 0], self.target[:, 0]

    def relative(self) -> tuple[np.ndarray, list[Rotation]]:
        """Positions and orientations of the relative reference of the bodies."""
        own, other = (Rotation.from_quat(p[:, 3:]) for p in (self.anchor, self.reference))
        x = (own * other.inv()).apply([1.0, 0.0, 0.0])
        turn = Rotation.from_euler("z", np.arctan2(x[:, 1], x[:, 0])[:, None])
        middle = np.concatenate((self.anchor[:, :2], self.reference[:, 2:3]), axis=1)
        pos = [middle + turn.apply(self.target[:, i, :3] - self.reference[:, :3]) for i in self.ids]
        return np.stack(pos, axis=1), [turn * Rotation.from_quat(self.target[:, i, 3:]) for i in self.ids]

    def rewards(self) -> dict[str, np.ndarray]:
        pos, rot = self.relative()
        angles = [(r * Rotation.from_quat(self.pose[:, i, 3:]).inv()).magnitude() for r, i in zip(rot, self.ids)]
        anchors = (Rotation.from_quat(p[:, 3:]) for p in (self.anchor, self.reference))
        turned = (next(anchors) * next(anchors).inv()).magnitude()
        error = self.target_vel[:, self.ids] - self.vel[:, self.ids]
        squares = {
            "motion_global_anchor_position_error_exp": ((self.anchor - self.reference)[:, :3] ** 2).sum(axis=1),
            "motion_global_anchor_orientation_error_exp": turned**2,
            "motion_relative_body_position_error_exp": ((pos - self.pose[:, self.ids, :3]) ** 2).sum(2).mean(1),
            "motion_relative_body_orientation_error_exp": (np.stack(angles, axis=1) ** 2).mean(axis=1),
            "motion_global_body_linear_velocity_error_exp": (error[..., :3] ** 2).sum(axis=2).mean(axis=1),
            "motion_global_body_angular_velocity_error_exp": (error[..., 3:] ** 2).sum(axis=2).mean(axis=1),
        }
        return {name: np.exp(-value / STD**2) for name, value in squares.items()}

    def errors(self) -> dict[str, np.ndarray]:
        """What the terminations compare with their thresholds."""
        pos, _ = self.relative()
        off = pos - self.pose[:, self.ids, :3]
        down = [Rotation.from_quat(p[:, 3:]).inv().apply([0.0, 0.0, -1.0])[:, 2] for p in (self.anchor, self.reference)]
        away = (self.anchor - self.reference)[:, :3]
        return {
            "bad_anchor_pos": np.linalg.norm(away, axis=1),
            "bad_anchor_pos_z_only": np.abs(away[:, 2]),
            "bad_anchor_ori": np.abs(down[0] - down[1]),
            "bad_motion_body_pos": np.linalg.norm(off, axis=2).max(axis=1),
            "bad_motion_body_pos_z_only": np.abs(off[..., 2]).max(axis=1),
        }

    def observation(self) -> np.ndarray:
        own = Rotation.from_quat(self.anchor[:, 3:]).inv()
        other = Rotation.from_quat(self.reference[:, 3:])
        parts = [self.command, own.apply(self.reference[:, :3] - self.anchor[:, :3]), columns(own * other)]
        parts += [own.apply(self.pose[:, i, :3] - self.anchor[:, :3]) for i in self.ids]
        parts += [columns(own * Rotation.from_quat(self.pose[:, i, 3:])) for i in self.ids]
        return np.concatenate(parts, axis=1)


def columns(rotation: Rotation) -> np.ndarray:
    return rotation.as_matrix()[:, :, :2].reshape(len(rotation), 6)


def disturb(env: ManagerBasedRLEnv, seed: int) -> None:
    """Put robots near their reference: some by a little, some by a lot."""
    robot, generator = env.scene["robot"], torch.Generator().manual_seed(seed)
    pose, vel = robot.data.root_pose_w.clone(), robot.data.root_vel_w.clone()
    size = torch.linspace(0.02, 1.0, N)[:, None]
    pose[:, :3] += size * 0.5 * torch.randn(N, 3, generator=generator)
    turn = Rotation.from_rotvec((size * torch.randn(N, 3, generator=generator)).numpy())
    pose[:, 3:] = torch.as_tensor((turn * Rotation.from_quat(pose[:, 3:].numpy())).as_quat(), dtype=torch.float32)
    robot.write_root_pose_to_sim(pose)
    robot.write_root_velocity_to_sim(vel + size * torch.randn(N, 6, generator=generator))
    joints = robot.data.joint_pos + 0.3 * size * torch.randn(N, 12, generator=generator)
    robot.write_joint_state_to_sim(joints, robot.data.joint_vel + size * torch.randn(N, 12, generator=generator))
    env.sim.forward()


# -- terms


@pytest.mark.parametrize("seed", [0, 1])
def test_rewards_and_observations_are_those_of_float64(env, seed):
    env.reset(seed=seed)
    disturb(env, seed)
    expected = Reference(env)
    actual = env.reward_manager.compute_terms().numpy()
    for index, name in enumerate(env.reward_manager.active_terms):
        np.testing.assert_allclose(actual[:, index], expected.rewards()[name], atol=2e-5, err_msg=name)
    assert (
        min(v.min() for v in expected.rewards().values())
        < 0.3
        < 0.9
        < max(v.max() for v in expected.rewards().values())
    )
    observed = env.observation_manager.compute()["policy"].numpy()
    np.testing.assert_allclose(observed, expected.observation(), atol=2e-5)


def test_terminations_compare_the_errors_of_float64(motions):
    cfg = config(motions)
    ends = {
        n: TerminationTermCfg(func=getattr(mdp, n), params={**p, "threshold": t}) for n, (p, t) in TERMINATIONS.items()
    }
    cfg.terminations = ends
    env = ManagerBasedRLEnv(cfg)
    outcomes: dict[str, set[bool]] = {name: set() for name in TERMINATIONS}
    for seed in range(4):
        env.reset(seed=seed)
        disturb(env, seed)
        errors = Reference(env).errors()
        env.compute_terminations()
        with env._outside.computed("ends", env.termination_manager.compute_items, []):
            found = env.context.episode.term_terminated.numpy().copy()
        for index, (name, (_, threshold)) in enumerate(TERMINATIONS.items()):
            clear = np.abs(errors[name] - threshold) > 1e-5
            np.testing.assert_array_equal(found[clear, index], (errors[name] > threshold)[clear], err_msg=name)
            outcomes[name] |= set(found[:, index].tolist())
    assert all(outcome == {True, False} for outcome in outcomes.values()), outcomes
    env.close()


# -- frames


def test_an_episode_begins_at_its_frame_and_goes_on_by_one_a_step(env):
    env.reset(seed=3)
    motion, robot = motion_of(env), env.scene["robot"].data
    start, origins = motion.start.numpy().copy(), env.scene.env_origins.numpy()
    np.testing.assert_array_equal(motion.frame.numpy(), start + 1)
    at = motion.body_pose.numpy()[start, 0]
    np.testing.assert_allclose(robot.root_pos_w.numpy() - origins, at[:, :3], atol=1e-6)
    np.testing.assert_allclose(robot.joint_vel.numpy(), motion.joint_vel.numpy()[start], atol=1e-6)
    # Bodies follow, with the velocities of the reference: nothing but the frame differs.
    np.testing.assert_allclose(robot.body_vel_w.numpy(), motion.body_vel.numpy()[start], atol=1e-4)
    last = motion.last.numpy()[start]
    for step in range(1, 5):
        expected = np.minimum(start + step + 1, last)
        _, _, _, ended, _ = env.step(torch.zeros(N, 12))
        going = ~ended.numpy()
        np.testing.assert_array_equal(motion.frame.numpy()[going], expected[going])
        np.testing.assert_array_equal(ended.numpy(), np.minimum(start + step, last) >= last)
        # An episode that began in this step shows its second frame, too.
        np.testing.assert_array_equal(motion.frame.numpy()[~going], motion.start.numpy()[~going] + 1)


def test_the_end_of_a_motion_ends_the_episode_as_a_time_out(motions):
    env = ManagerBasedRLEnv(config(motions[1], sampling_mode="start"))
    env.reset(seed=0)
    count = motion_of(env).last.shape[0]
    assert count == 101  # 2 s of 100 Hz at 50 Hz
    assert set(motion_of(env).start.numpy()) == {0}
    for step in range(1, count):
        _, _, terminated, truncated, _ = env.step(torch.zeros(N, 12))
        assert not terminated.any()
        assert truncated.all() == (step == count - 1)
    env.close()


def test_noise_at_the_start_is_within_its_bounds(motions):
    pose = {"x": (-0.1, 0.1), "yaw": (-0.4, 0.4)}
    env = ManagerBasedRLEnv(
        config(motions, pose_range=pose, velocity_range={"z": (0.5, 1.0)}, joint_position_range=(-0.05, 0.05))
    )
    env.reset(seed=0)
    motion, robot = motion_of(env), env.scene["robot"].data
    start = motion.start.numpy()
    target = motion.body_pose.numpy().astype(float)[start, 0]
    off = robot.root_pos_w.numpy() - env.scene.env_origins.numpy() - target[:, :3]
    assert (np.abs(off) <= [0.1 + 1e-6, 1e-6, 1e-6]).all()
    assert np.abs(off[:, 0]).max() > 0.02
    turn = (Rotation.from_quat(robot.root_quat_w.numpy()) * Rotation.from_quat(target[:, 3:]).inv()).as_rotvec()
    assert (np.abs(turn) <= [1e-5, 1e-5, 0.4 + 1e-5]).all()
    rise = robot.root_lin_vel_w.numpy() - motion.body_vel.numpy()[start, 0, :3]
    assert ((rise[:, 2] >= 0.5 - 1e-5) & (rise[:, 2] <= 1.0 + 1e-5)).all()
    joints = robot.joint_pos.numpy() - motion.joint_pos.numpy()[start]
    assert np.abs(joints).max() <= 0.05 + 1e-6
    assert np.abs(joints).max() > 0.02
    env.close()


# -- where episodes begin


def test_failures_are_counted_in_their_bins_and_raise_their_probability(motions):
    """Against NumPy, with failures that begin in known bins."""
    cfg = config(motions, adaptive_alpha=0.1, adaptive_uniform_ratio=0.2, adaptive_kernel_size=3)
    cfg.terminations["fell"] = TerminationTermCfg(func=mdp.bad_anchor_pos, params={**MOTION, "threshold": 1.0})
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=0)
    motion = motion_of(env)
    bins = len(motion.failures.numpy())
    assert bins == 5  # 3 s and 2 s
    np.testing.assert_array_equal(motion.bin_motion.numpy(), [0, 0, 0, 1, 1])
    rate = np.zeros(bins)
    for _ in range(3):
        aside = env.scene["robot"].data.root_pose_w.clone()
        aside[::2, :2] += 3.0
        env.scene["robot"].write_root_pose_to_sim(aside)
        failed = motion.bin.numpy()[motion.frame.numpy()[::2]]
        ended = env.step(torch.zeros(N, 12))[2]
        assert ended[::2].all()
        rate = 0.1 * np.bincount(failed, minlength=bins) + 0.9 * rate
        np.testing.assert_allclose(motion.failure_rate.numpy(), rate, atol=1e-6)
        weight = rate + 0.2 / bins
        spread = np.zeros(bins)
        for i in range(bins):
            end = 3 if i < 3 else 5
            spread[i] = sum(0.8**k * weight[min(i + k, end - 1)] for k in range(3)) / sum(0.8**k for k in range(3))
        np.testing.assert_allclose(motion.cumulative.numpy(), np.cumsum(spread), rtol=1e-5)
    env.close()


def test_frames_are_drawn_by_the_weights_of_their_bins():
    """Frequencies of 20,000 draws, each within five of its standard deviations."""
    count, bins = 20000, 4
    motion = MotionCommandData()
    weights = np.array([0.1, 0.0, 0.6, 0.3], np.float32)
    motion.cumulative = wp.array(np.cumsum(weights), dtype=float, device="cpu")
    motion.bin_start = wp.array([0, 10, 20, 30], dtype=int, device="cpu")
    motion.bin_size = wp.array([10, 10, 10, 5], dtype=int, device="cpu")
    drawn = wp.zeros(count, dtype=int, device="cpu")
    rng = wp.array(np.arange(count, dtype=np.uint32), dtype=wp.uint32, device="cpu")
    wp.launch(draw_frames, dim=count, inputs=[motion, rng, drawn], device="cpu")
    frames = drawn.numpy()
    assert frames.max() == 34
    share = np.bincount(np.minimum(frames // 10, 3), minlength=bins) / count
    assert (np.abs(share - weights) <= 5 * np.sqrt(weights * (1 - weights) / count)).all()
    within = np.bincount(frames[frames // 10 == 2] - 20, minlength=10)
    assert (np.abs(within / within.sum() - 0.1) < 5 * np.sqrt(0.09 / within.sum())).all()


@wp.kernel(enable_backward=False)
def draw_frames(motion: MotionCommandData, rng: wp.array[wp.uint32], drawn: wp.array[int]):
    env = wp.tid()
    drawn[env] = motion_command._draw_frame(env, motion, rng, 0)


def test_probabilities_of_many_bins_are_those_of_numpy():
    rng, bins = np.random.default_rng(0), 300
    motion = MotionCommandData()
    failures, rate = rng.poisson(0.3, bins).astype(np.float32), rng.random(bins).astype(np.float32)
    motion.failures, motion.failure_rate = (wp.array(x, dtype=float, device="cpu") for x in (failures, rate))
    motion.cumulative = wp.zeros(bins, dtype=float, device="cpu")
    motion.bin_motion = wp.array(np.arange(bins) // 40, dtype=int, device="cpu")
    wp.launch(average_failures, dim=bins, inputs=[motion, 0.25], device="cpu")
    wp.launch(accumulate_probabilities, dim=bins, inputs=[motion, 0.1, 1, 0.8], device="cpu")
    expected = 0.25 * failures + 0.75 * rate
    np.testing.assert_allclose(motion.failure_rate.numpy(), expected, rtol=1e-6)
    np.testing.assert_allclose(motion.cumulative.numpy(), np.cumsum(expected + 0.1 / bins), rtol=1e-5)
    assert not motion.failures.numpy().any()


# -- mistakes


def test_what_is_wrong_is_said_of_the_field(motions, tmp_path):
    few = tmp_path / "few.csv"
    write_motion(few, [0.0] * 5, seconds=1.0, fps=30.0, seed=0)
    cases = [
        (config(str(few)), "motion_file: .*few.csv: has 5 joints, the robot has 12"),
        (config(str(tmp_path / "none.csv")), "motion_file: .*none.csv: is neither a file"),
        (config(motions, anchor_body_name="nose"), "anchor_body_name: .*'nose' matches nothing"),
        (config(motions, adaptive_kernel_size=0), "adaptive_kernel_size: is 0, must be 1 or more"),
    ]
    for cfg, message in cases:
        with pytest.raises(ConfigError, match=message):
            ManagerBasedRLEnv(cfg)
