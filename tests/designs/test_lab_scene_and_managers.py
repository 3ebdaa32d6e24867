# SPDX-License-Identifier: Apache-2.0
"""The lab scene with its managers, row by row: each test shows one promise of that design as a user writes it.

The task is that of ``walk_task.py``. All tests share one lab scene and one environment of it.
"""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch

from stripe_newton.envs import LabScene, LabSceneCfg, mdp
from stripe_newton.scene import SceneBuilder, SceneController, SceneQuerier
from stripe_newton.sim import SimulationCfg
from stripe_tasks.robots import CARTPOLE_CFG

from .walk_task import WalkCfg

N = 4
REST = torch.zeros(N, 8)


# -- overview: who is there


def test_each_aspect_of_the_problem_has_a_manager_of_its_own(lab):
    names = [type(m).__name__ for m in lab.managers]
    for name in ("Event", "Object", "Action", "Command", "Termination", "Reward", "Observation", "Curriculum"):
        assert f"{name}Manager" in names


def test_the_environment_is_a_gymnasium_vector_environment(env):
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert env.single_action_space.shape == (8,)
    assert set(env.single_observation_space) == {"policy", "critic", "normalized"}


def test_the_environment_is_built_on_the_lab_scene(env):
    assert isinstance(env, LabScene)
    assert env.compute_rewards().shape == (N,)


def test_the_lab_scene_has_builder_controller_and_querier(lab):
    assert isinstance(lab.builder, SceneBuilder)
    assert isinstance(lab.controller, SceneController)
    assert isinstance(lab.querier, SceneQuerier)


def test_the_builder_makes_newtons_model(lab):
    assert type(lab.sim.model).__module__.startswith("newton")
    assert lab.sim.model.world_count == N


def test_observations_have_terms_for_base_and_joints(lab):
    terms = lab.observation_manager.active_terms
    assert terms["critic"] == ["base_pos", "base_lin_vel", "joint_pos", "joint_vel", "balls"]


def test_rewards_have_terms_such_as_forward_velocity_and_energy_penalty(lab):
    assert {"forward_velocity", "energy_penalty"} <= set(lab.reward_manager.active_terms)


# -- the lab scene


def test_the_lab_scene_owns_the_lifecycle_of_the_scene():
    lab = LabScene(LabSceneCfg(num_envs=2, env_spacing=2.0, robot=CARTPOLE_CFG), sim=SimulationCfg(device="cpu"))
    assert lab.scene.built
    lab.reset()
    lab.close()
    assert not hasattr(lab.sim, "model")


def test_a_scene_without_a_task_is_simulated_moved_and_looked_at():
    cfg = LabSceneCfg(num_envs=2, env_spacing=2.0, robot=CARTPOLE_CFG)
    with LabScene(cfg, sim=SimulationCfg(dt=1 / 120, device="cpu"), render_mode="rgb_array") as lab:
        lab.reset()
        lab.controller.apply_actions(torch.tensor([[20.0, 0.0], [-20.0, 0.0]]), kind="effort")
        for _ in range(20):
            lab.step()
        cart = lab.querier.get_robot_state()["joint_position"][:, 0]
        assert cart[0] > 0.01
        assert cart[1] < -0.01
        assert lab.render().std() > 1.0
        lab.reset()
        assert not lab.querier.get_robot_state()["joint_position"].any()


def test_the_lab_scene_coordinates_the_managers_in_one_plan(lab):
    assert "Reward terms" in lab.describe()
    order = list(dict.fromkeys(stage for stage, _, _ in lab.plan.rows()))
    assert order.index("actions") < order.index("physics") < order.index("rewards") < order.index("observations")


def test_reset_gives_observations(lab):
    observations, info = lab.reset()
    assert observations["policy"].shape == (N, 3 + 8 + 3 + 1)
    assert "log" in info


def test_step_gives_observations_rewards_terminated_truncated_and_info(lab):
    observations, rewards, terminated, truncated, info = lab.step(REST)
    assert observations["critic"].shape == (N, 3 + 3 + 8 + 8 + 6)
    assert rewards.dtype == torch.float32
    assert terminated.dtype == truncated.dtype == torch.bool
    assert rewards.shape == terminated.shape == truncated.shape == (N,)
    assert "log" in info


def test_compute_observations_answers_at_any_moment(lab):
    observations, _ = lab.reset()
    for _ in range(3):
        now = lab.compute_observations()
        assert torch.equal(now["critic"], observations["critic"])
        observations = lab.step(REST)[0]
    lab.scene["robot"].write_root_pose_to_sim(torch.tensor([[0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 1.0]]).repeat(N, 1))
    height = lab.compute_observations()["critic"][:, 2] + lab.scene.env_origins[:, 2]
    torch.testing.assert_close(height, torch.full((N,), 3.0))


def test_compute_rewards_is_the_reward_of_the_step(lab):
    lab.reset()
    for _ in range(3):
        rewards = lab.step(REST)[1]
        torch.testing.assert_close(lab.compute_rewards(), rewards, rtol=1e-5, atol=1e-7)


def test_compute_terminations_gives_terminated_and_truncated(lab):
    lab.reset()
    lab.step(REST)
    terminated, truncated = lab.compute_terminations()
    assert not terminated.any()
    assert not truncated.any()
    lab.scene["robot"].write_root_pose_to_sim(lab.scene["robot"].data.root_pose_w * torch.tensor([1, 1, 0, 1, 1, 1, 1]))
    terminated, truncated = lab.compute_terminations()
    assert terminated.all()


def test_answers_outside_the_step_leave_no_trace(lab):
    lab.reset(seed=5)
    lab.step(REST)
    before = {name: array.numpy().copy() for name, array in lab.context.arrays.items()}
    lab.compute_observations(), lab.compute_rewards(), lab.compute_terminations()
    for name, array in lab.context.arrays.items():
        np.testing.assert_array_equal(array.numpy(), before[name], err_msg=name)


# -- builder, controller, querier


def test_the_builder_builds_from_the_config_without_arguments():
    from stripe_newton.scene import InteractiveScene
    from stripe_newton.sim import Simulation

    cfg = WalkCfg().scene
    scene = InteractiveScene(cfg, Simulation(SimulationCfg(device="cpu")), author=False)
    assert scene.keys() == []
    scene.builder.build_terrain()
    assert scene.terrain is not None
    scene.builder.build_robot()
    assert list(scene.articulations) == ["robot"]
    scene.builder.build_objects()
    assert list(scene.rigid_objects) == ["crate"]
    scene.builder.build_sensors()
    assert list(scene.sensors) == ["contacts"]
    scene.build()
    assert scene.sim.model.world_count == N
    scene.close()


def test_the_controller_applies_a_tensor_of_actions(lab):
    lab.reset()
    lab.controller.apply_actions(torch.full((N, 8), 0.25))
    torch.testing.assert_close(lab.scene["robot"].data.joint_effort_target, torch.full((N, 8), 0.5))


def test_the_controller_resets_robots(lab):
    lab.reset()
    for _ in range(5):
        lab.step(torch.ones(N, 8))
    moved = lab.scene["robot"].data.joint_pos.clone()
    lab.controller.reset_robots(torch.tensor([1, 3]))
    robot = lab.scene["robot"].data
    torch.testing.assert_close(robot.joint_pos[[1, 3]], robot.default_joint_pos[[1, 3]])
    assert torch.equal(robot.joint_pos[[0, 2]], moved[[0, 2]])


def test_the_controller_randomizes_dynamics_as_the_events_say(lab):
    lab.controller.randomize_dynamics()
    ratio = lab.scene["robot"].data.body_mass / lab.scene["robot"].data.default_mass
    assert ratio.min() >= 0.8 - 1e-5
    assert ratio.max() <= 1.2 + 1e-5
    assert ratio.std() > 0.01


def test_without_events_randomize_dynamics_says_so():
    with (
        LabScene(LabSceneCfg(num_envs=1, env_spacing=0.0, robot=CARTPOLE_CFG), sim=SimulationCfg(device="cpu")) as lab,
        pytest.raises(ValueError, match="no event"),
    ):
        lab.controller.randomize_dynamics()


def test_the_querier_reads_the_robot(lab):
    state = lab.querier.get_robot_state()
    assert {name: tuple(value.shape) for name, value in state.items()} == {
        "root_pose": (N, 7), "root_velocity": (N, 6), "joint_position": (N, 8), "joint_velocity": (N, 8),
    }  # fmt: skip


def test_the_querier_reads_the_sensors(lab):
    data = lab.querier.get_sensor_data()
    assert data["contacts.net_forces_w"].shape == (N, lab.scene["contacts"].num_bodies, 3)
    assert all(isinstance(value, torch.Tensor) for value in data.values())


def test_the_querier_reads_contact_forces_on_demand():
    cfg = WalkCfg().scene  # the scene alone, with its contact sensor
    with LabScene(cfg, sim=WalkCfg().sim) as lab:
        lab.reset()
        for _ in range(40):
            lab.step()
        assert not lab.cfg.sim.contact_forces  # they are not exported in each step
        forces = lab.querier.get_contact_forces()
        assert forces.shape == (N, lab.scene["robot"].num_bodies, 3)
        assert (forces[..., 2].sum(1) > 1.0).all()
        lab.step()
        torch.testing.assert_close(
            lab.querier.get_sensor_data("contacts")["net_forces_w"], forces, atol=1e-3, rtol=1e-3
        )


# -- observation manager


def test_observations_are_computed_from_terms(lab):
    values = lab.observation_manager.compute()
    torch.testing.assert_close(values["critic"][:, 6:14], lab.scene["robot"].data.joint_pos)


def test_the_critic_has_privileged_observations(env):
    observations, _ = env.reset()
    assert observations["critic"].shape[1] > observations["policy"].shape[1]


def test_observations_have_noise_where_it_is_wanted(lab):
    values = lab.observation_manager.compute()
    noise = values["policy"][:, :3] - values["critic"][:, 3:6]
    assert 0.0 < noise.abs().max() <= 0.1
    assert torch.equal(values["policy"][:, 3:11], values["critic"][:, 6:14])


def test_observations_are_normalised_where_it_is_wanted(lab):
    lab.reset()
    for _ in range(4):
        observations = lab.step(REST)[0]
    assert not torch.equal(observations["normalized"], observations["critic"][:, :3])
    assert observations["normalized"].abs().max() < 10.0


# -- action manager


def test_actions_are_processed_scaled_and_clipped(lab):
    processed = lab.action_manager.process(torch.full((N, 8), 0.3))
    torch.testing.assert_close(processed, torch.full((N, 8), 0.6))
    torch.testing.assert_close(lab.action_manager.process(torch.full((N, 8), -9.0)), torch.full((N, 8), -1.0))


def test_actions_become_motor_commands(lab):
    lab.action_manager.process(torch.full((N, 8), 0.3))
    torch.testing.assert_close(lab.scene["robot"].data.joint_effort_target, torch.full((N, 8), 0.6))


def test_actions_can_be_targets_of_pd_drives():
    from tests.helpers.cartpole_manager_env import config

    cfg = config(2, actions={"cart": mdp.JointPositionActionCfg(joint_names=["slider_to_cart"], scale=0.5)})
    cfg.scene.robot.actuators["cart"].stiffness = 100.0
    with LabScene(cfg) as lab:
        lab.reset()
        lab.action_manager.process(torch.ones(2, 1))
        torch.testing.assert_close(lab.scene["robot"].data.joint_pos_target[:, 0], torch.full((2,), 0.5))


# -- reward manager


def test_the_reward_is_the_weighted_sum_of_the_terms(lab):
    lab.reset()
    rewards = lab.step(REST)[1]
    torch.testing.assert_close(lab.reward_manager.step_reward.sum(1) * lab.step_dt, rewards)


def test_each_reward_term_is_logged(lab):
    lab.reset()
    lab.episode_length_buf[:] = lab.max_episode_length - 1
    log = lab.step(REST)[4]["log"]
    assert {"Episode_Reward/track", "Episode_Reward/forward_velocity", "Episode_Reward/energy_penalty"} <= set(log)


def test_rewards_are_scaled_by_the_time_step_and_clipped(lab):
    lab.reset()
    robot = lab.scene["robot"]
    robot.write_root_velocity_to_sim(torch.tensor([[50.0, 0, 0, 0, 0, 0]]).repeat(N, 1))
    lab.reward_manager.compute()
    index = lab.reward_manager.active_terms.index("forward_velocity")
    assert lab.reward_manager.compute_terms()[:, index].tolist() == pytest.approx([0.5] * N)  # weight 0.5, clip 1
    torch.testing.assert_close(lab.reward_manager.compute(), lab.reward_manager.compute_terms().sum(1) * lab.step_dt)


# -- command manager


def test_commands_are_generated_and_resampled_at_a_reset(lab):
    lab.reset()
    first = lab.command_manager.get_command("base_velocity").clone()
    lab.step(REST)
    torch.testing.assert_close(lab.command_manager.get_command("base_velocity"), first)
    lab.command_manager.reset(torch.tensor([0, 1]))
    second = lab.command_manager.get_command("base_velocity")
    assert (second[:2] != first[:2]).any(1).all()
    assert torch.equal(second[2:], first[2:])


def test_commands_can_be_velocities(lab):
    command = lab.command_manager.get_command("base_velocity")
    assert ((command[:, 0] >= 0.5) & (command[:, 0] <= 1.0)).all()


def test_commands_can_be_pose_targets():
    from stripe_tasks.reach import ReachEnvCfg

    cfg = ReachEnvCfg()
    cfg.scene.num_envs, cfg.sim.device = 2, "cpu"
    with LabScene(cfg) as lab:
        lab.reset()
        (name,) = lab.command_manager.active_terms
        assert lab.command_manager.get_command(name).shape == (2, 7)


# -- termination manager


def test_terminations_check_falls_bounds_and_time(lab):
    assert lab.termination_manager.active_terms == ["time_out", "fallen", "too_low", "lost"]
    terminated, truncated = lab.termination_manager.compute()
    assert terminated.shape == truncated.shape == (N,)


def test_a_time_out_truncates_and_does_not_terminate(lab):
    lab.reset()
    lab.episode_length_buf[:2] = lab.max_episode_length - 1
    _, _, terminated, truncated, _ = lab.step(REST)
    assert truncated.tolist() == [True, True, False, False]
    assert not terminated.any()


def test_a_fall_terminates_and_does_not_truncate(lab):
    lab.reset()
    pose = lab.scene["robot"].data.root_pose_w.clone()
    pose[0, 2:] = torch.tensor([1.0, 1.0, 0.0, 0.0, 0.0])  # on its back
    lab.scene["robot"].write_root_pose_to_sim(pose)
    _, _, terminated, truncated, _ = lab.step(REST)
    assert terminated.tolist() == [True, False, False, False]
    assert not truncated.any()


def test_what_leaves_the_bounds_terminates(lab):
    lab.reset()
    pool = lab.object_manager["balls"]
    pool.spawn([2], 0, pose=torch.tensor([20.0, 20.0, 0.5, 0.0, 0.0, 0.0, 1.0]))
    assert lab.compute_terminations()[0].tolist() == [False, False, True, False]
    assert lab.step(REST)[2].tolist() == [False, False, True, False]


# -- curriculum manager


def test_a_curriculum_raises_the_disturbance(lab):
    lab.reset()
    for _ in range(4):
        lab.step(REST)
    assert lab.context.parameters["events.spin.rate"] == 2.0


def test_a_curriculum_can_move_robots_to_harder_terrain():
    assert {"terrain_levels_vel", "terrain_levels_survival"} <= set(dir(mdp))
    # trained with it: Stripe-Velocity-Rough-Quadruped-v0; tests/terrains/test_terrain_env.py checks the levels


# -- event manager


def test_events_randomise_dynamics_at_a_reset(lab):
    lab.reset(seed=1)
    one = lab.scene["robot"].data.body_mass.clone()
    lab.reset(seed=2)
    assert not torch.equal(one, lab.scene["robot"].data.body_mass)


def test_events_randomise_the_state_of_robots(lab):
    lab.reset()
    quaternions = lab.scene["robot"].data.root_quat_w
    assert quaternions[:, 2].std() > 0.0
    assert quaternions[:, :2].abs().max() < 1e-6


def test_events_can_be_applied_by_hand(lab):
    lab.reset()
    yaw = lab.scene["robot"].data.root_quat_w.clone()
    lab.event_manager.apply("reset", env_ids=torch.tensor([2]))
    changed = (lab.scene["robot"].data.root_quat_w != yaw).any(1)
    assert changed.tolist() == [False, False, True, False]


# -- object manager


def test_objects_are_spawned_and_tracked(lab):
    lab.reset()
    pool = lab.object_manager["balls"]
    assert pool.active.all()
    inside = pool.positions - lab.scene.env_origins[:, None]
    assert ((inside[..., 0] > 0.9) & (inside[..., 0] < 2.1)).all()
    pool.retire([0], 1)
    assert pool.active[0].tolist() == [True, False]


def test_objects_give_rewards(lab):
    index = lab.reward_manager.active_terms.index("ball_moved")
    lab.reset()
    far = lab.reward_manager.compute_terms()[:, index].clone()
    pool = lab.object_manager["balls"]
    pose = pool.target.clone()
    pose[..., :3] += lab.scene.env_origins[:, None]
    pool.spawn(pose=pose)
    near = lab.reward_manager.compute_terms()[:, index]
    assert (near > far).all()
    torch.testing.assert_close(near, torch.full((N,), 0.1))
