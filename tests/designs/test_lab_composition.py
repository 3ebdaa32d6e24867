# SPDX-License-Identifier: Apache-2.0
"""The composition of a lab scene, row by row: terms, the flow of data, configs, execution and extension points.

The task is that of ``walk_task.py``. All tests share one lab scene and one environment of it.
"""

from __future__ import annotations

import inspect

import gymnasium
import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import ConfigError, configclass, is_config
from stripe_newton.envs import LabScene, LabSceneCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationManager,
    ObservationManagerCfg,
    ObservationTermCfg,
    RewardManagerCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.registration import register_task
from stripe_tasks.energy import EnergyManager
from stripe_tasks.robots import ANT_CFG

from .walk_task import WalkCfg, forward_velocity

N = 4
REST = torch.zeros(N, 8)


# -- composition of terms


def test_a_manager_config_has_a_field_for_each_term():
    @configclass
    class Observations(ObservationManagerCfg):
        base_lin_vel = ObservationTermCfg(func=mdp.base_lin_vel, noise=UniformNoiseCfg(n_min=-0.1, n_max=0.1))
        joint_pos = ObservationTermCfg(func=mdp.joint_pos, scale=1.0)

    cfg = WalkCfg()
    cfg.observations = Observations()
    with LabScene(cfg) as lab:
        observations, _ = lab.reset()
        assert observations["policy"].shape == (N, 3 + 8)  # terms without a group are those of the policy
        assert lab.observation_manager.active_terms == {"policy": ["base_lin_vel", "joint_pos"]}


def test_terms_are_independent_of_each_other(lab):
    from tests.helpers.manager_world import ObservationWorld

    alone = ObservationWorld({"policy": ObservationGroupCfg(joint_pos=ObservationTermCfg(func=mdp.joint_pos))})
    alone.step()
    assert alone["policy"].shape == (4, 8)


def test_terms_are_shared_by_tasks():
    from stripe_tasks.cartpole.manager_based import RewardsCfg
    from stripe_tasks.locomotion.manager_based import AntManagerEnvCfg

    assert RewardsCfg().alive.func is AntManagerEnvCfg().rewards.alive.func is mdp.is_alive


def test_terms_are_added_and_removed_by_assignment():
    cfg = WalkCfg()
    cfg.rewards.energy_penalty = None
    cfg.rewards.alive = RewardTermCfg(func=mdp.is_alive, weight=1.0)
    with LabScene(cfg) as lab:
        assert lab.reward_manager.active_terms == ["track", "forward_velocity", "ball_moved", "alive"]
    with pytest.raises(TypeError, match=r"RewardManagerCfg.*'alvie'.*RewardTermCfg"):
        cfg.rewards.alvie = 0.5


def test_a_table_shows_who_does_what(lab):
    assert "energy_penalty" in str(lab.reward_manager)
    assert "base_lin_vel" in str(lab.observation_manager)


# -- data flow


def test_a_reset_runs_events_then_robots_then_commands_then_observations(lab):
    stages = list(dict.fromkeys(row[0] for row in lab.plan.rows()))
    assert stages.index("reset") < stages.index("forward kinematics") < stages.index("observations")
    (reset,) = (stage for stage in lab.plan.stages if stage.name == "reset")
    order = [item.name for item in reset.items]
    assert order.index("reset_to_default") < order.index("events_reset") < order.index("commands_reset")


def test_a_reset_brings_back_what_no_event_resets(lab):
    for _ in range(5):
        lab.step(torch.ones(N, 8))
    lab.reset()  # the events of the task reset the root alone
    robot, crate = lab.scene["robot"].data, lab.scene["crate"].data
    torch.testing.assert_close(robot.joint_pos, robot.default_joint_pos)
    torch.testing.assert_close(crate.root_pos_w - lab.scene.env_origins, torch.tensor([[1.5, 0.0, 0.1]]).repeat(N, 1))


def test_the_config_can_say_that_an_asset_stays():
    cfg = WalkCfg(keep_at_reset=["crate"])
    with LabScene(cfg) as lab:
        lab.reset()
        lab.scene["crate"].write_root_pose_to_sim(
            torch.cat((lab.scene.env_origins + torch.tensor([3.0, 0.0, 0.1]), torch.tensor([[0.0, 0, 0, 1]] * N)), 1)
        )
        lab.reset()
        assert (lab.scene["crate"].data.root_pos_w - lab.scene.env_origins)[:, 0].tolist() == pytest.approx([3.0] * N)


def test_a_step_runs_actions_physics_terminations_rewards_resets_observations(lab):
    stages = list(dict.fromkeys(row[0] for row in lab.plan.rows()))
    wanted = ["actions", "physics", "outcome", "rewards", "reset", "commands", "observations"]
    assert [s for s in stages if s in wanted] == wanted
    # Observations come last, after the resets: a learner that resets within the step needs those of the new episode.


def test_a_step_by_hand_gives_what_a_step_gives(lab):
    actions = torch.linspace(-0.4, 0.4, 8).repeat(N, 1)
    lab.reset(seed=3)
    state = lab.get_state()
    lab.step(actions)
    expected = lab.scene["robot"].data.joint_pos.clone()
    lab.set_state(state)
    lab.action_manager.process(actions)  # 1. actions, which the controller applies
    lab.sim.step(lab.cfg.decimation)  # 2. physics
    torch.testing.assert_close(lab.scene["robot"].data.joint_pos, expected)
    lab.observation_manager.compute()  # 3.
    lab.reward_manager.compute()  # 4.
    lab.termination_manager.compute()  # 5.


# -- configs


def test_every_config_is_a_configclass():
    cfg = WalkCfg()
    assert is_config(cfg)
    assert is_config(cfg.scene)
    assert is_config(cfg.observations.policy.base_lin_vel)


def test_a_task_config_holds_the_scene_and_the_managers():
    cfg = WalkCfg()
    assert isinstance(cfg.scene, LabSceneCfg)
    assert (cfg.scene.num_envs, cfg.scene.env_spacing) == (4, 4.0)
    assert isinstance(cfg.observations, ObservationManagerCfg)
    assert isinstance(cfg.rewards, RewardManagerCfg)


def test_a_subclass_without_configclass_is_refused_by_name():
    class Forgotten(WalkCfg):
        extra: int = 1

    with pytest.raises(TypeError, match=r"'Forgotten'.*@configclass"):
        Forgotten()


def test_a_dataclass_is_refused_by_name():
    import dataclasses

    @dataclasses.dataclass
    class Wrong(WalkCfg):
        extra: int = 1

    with pytest.raises(TypeError, match=r"'Wrong'.*@dataclass.*@configclass"):
        Wrong()


# -- execution flow


def test_gymnasium_resets_and_steps(env):
    observations, info = env.reset(seed=1)
    assert observations["policy"].shape[0] == N
    observations, rewards, _, _, info = env.step(REST)
    assert isinstance(rewards, torch.Tensor)
    assert isinstance(info, dict)


def test_environment_and_lab_scene_compute_the_same(env, lab):
    results = []
    for one in (env, lab):
        one.reset(seed=7)
        results.append([one.step(torch.full((N, 8), 0.3))[1].clone() for _ in range(70)])
    for a, b in zip(*results, strict=True):
        assert torch.equal(a, b)


# -- extension points


def test_a_custom_observation_term():
    @wp.func
    def hip_angle(env: int, robot: ArticulationData, out: wp.array[float]):
        out[0] = robot.joint_pos[env, 0]

    cfg = WalkCfg()
    cfg.observations.critic.hip = ObservationTermCfg(func=hip_angle, size=1)
    with LabScene(cfg) as lab:
        observations, _ = lab.reset()
        torch.testing.assert_close(observations["critic"][:, -1], lab.scene["robot"].data.joint_pos[:, 0])


def test_a_custom_reward_term(lab):
    index = lab.reward_manager.active_terms.index("forward_velocity")
    assert lab.reward_manager.cfg.forward_velocity.func is forward_velocity
    lab.reset()
    lab.step(REST)
    speed = lab.scene["robot"].data.root_lin_vel_w[:, 0]
    torch.testing.assert_close(lab.reward_manager.compute_terms()[:, index], 0.5 * speed.clamp(-1, 1))


def test_a_custom_manager(lab):
    energy = lab.custom_managers["energy"]
    assert isinstance(energy, EnergyManager)
    lab.reset()
    for _ in range(5):
        lab.step(torch.ones(N, 8))
    assert (energy.used > 0.0).all()
    policy = lab.compute_observations()["policy"]
    torch.testing.assert_close(policy[:, -1], 1.0 - energy.used / 50.0)  # a term reads its struct
    lab.episode_length_buf[:] = lab.max_episode_length - 1
    log = lab.step(REST)[4]["log"]
    assert float(log["Energy/used"]) > 0.0
    assert not energy.used.any()  # reset with the episode


def test_a_custom_task_is_made_of_managers():
    register_task("Test-Walk-v0", env="stripe_newton.envs:ManagerBasedRLEnv", env_cfg="tests.designs.walk_task:WalkCfg")
    try:
        env = gymnasium.make_vec("Test-Walk-v0", num_envs=2)
        assert env.reset()[0]["policy"].shape[0] == 2
        env.close()
    finally:
        gymnasium.registry.pop("Test-Walk-v0")


def test_a_custom_robot():
    robot: ArticulationCfg = ANT_CFG.replace(init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 0.8)))
    cfg = WalkCfg()
    cfg.scene.robot = robot
    with LabScene(cfg) as lab:
        lab.reset()
        torch.testing.assert_close(lab.scene["robot"].data.root_pos_w[:, 2], torch.full((N,), 0.8))


def test_a_field_that_nobody_reads_is_refused():
    @configclass
    class Mistaken(WalkCfg):
        reward = RewardManagerCfg(alive=RewardTermCfg(func=mdp.is_alive, weight=1.0))

    with pytest.raises(ConfigError, match=r"reward: .* did you mean 'rewards'"):
        LabScene(Mistaken())


def test_what_emits_kernels_is_named_so():
    assert "list[Item]" in str(inspect.signature(ObservationManager.compute_items).return_annotation)
    assert TerminationTermCfg(func=mdp.time_out).func is mdp.time_out
    assert EventTermCfg(func=mdp.reset_scene_to_default, mode="reset").mode == "reset"
