# SPDX-License-Identifier: Apache-2.0
"""The direct workflow, row by row: each test shows one promise of that design as a user writes it.

All tests share one environment: a cart that drives under its pole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import gymnasium
import pytest
import torch

import stripe_newton.sim as sim_utils
from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import ConfigError, configclass, is_config
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import GroundPlaneCfg, MuJoCoSolverCfg, SimulationCfg, spawn_ground_plane
from stripe_tasks.robots import ANT_CFG, CARTPOLE_CFG

N = 8


@configclass
class PoleEnvCfg(DirectRLEnvCfg):
    # fields that a user thinks of
    decimation = 2
    episode_length_s = 1.0
    action_space = 1
    observation_space = 4
    state_space = 0
    push = 80.0  # N
    start_angle = 0.3  # rad
    # simulation
    sim: SimulationCfg = SimulationCfg(dt=1 / 120, render_interval=2, device="cpu")
    # robot
    robot_cfg: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="/World/envs/env_.*/Robot")
    # scene
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=N, env_spacing=3.0, replicate_physics=True)


class PoleEnv(DirectRLEnv):
    cfg: PoleEnvCfg

    def __init__(self, cfg: PoleEnvCfg, render_mode: str | None = None, **kwargs):
        self.calls: list[str] = []
        super().__init__(cfg, render_mode, **kwargs)
        self.cart, self.pole = (self.robot.find_joints(n)[0][0] for n in ("slider_to_cart", "cart_to_pole"))

    def _setup_scene(self):
        self.calls.append("_setup_scene")
        assert not self.scene.articulations  # no robot before it is made here
        self.robot = Articulation(self.cfg.robot_cfg)
        assert self.scene.stage.GetPrimAtPath("/World/envs/env_0/Robot").IsValid()
        spawn_ground_plane(prim_path="/World/ground", cfg=GroundPlaneCfg())
        self.scene.articulations["robot"] = self.robot
        self.scene.clone_environments(copy_from_source=False)
        light_cfg = sim_utils.DomeLightCfg(intensity=1500.0, color=(0.8, 0.8, 0.8))
        light_cfg.func("/World/Light", light_cfg)

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self.calls.append("_pre_physics_step")
        self.forces = self.cfg.push * actions

    def _apply_action(self) -> None:
        self.calls.append("_apply_action")
        self.robot.set_joint_effort_target(self.forces, joint_ids=[self.cart])

    def _get_observations(self) -> dict:
        self.calls.append("_get_observations")
        return {"policy": torch.cat((self.robot.data.joint_pos, self.robot.data.joint_vel), dim=-1)}

    def _get_rewards(self) -> torch.Tensor:
        self.calls.append("_get_rewards")
        return compute_rewards(self.robot.data.joint_pos[:, self.pole], self.reset_terminated)

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        self.calls.append("_get_dones")
        out_of_time = self.episode_length_buf >= self.max_episode_length
        return self.robot.data.joint_pos[:, self.pole].abs() > 0.5 * math.pi, out_of_time

    def _reset_idx(self, env_ids: Sequence[int] | None):
        self.calls.append("_reset_idx")
        super()._reset_idx(env_ids)
        joint_pos = self.robot.data.default_joint_pos[env_ids]
        joint_pos[:, self.pole] += self.cfg.start_angle * (2.0 * torch.rand(len(joint_pos)) - 1.0)
        self.robot.write_joint_state_to_sim(joint_pos, torch.zeros_like(joint_pos), env_ids=env_ids)


@torch.jit.script
def compute_rewards(pole_angle: torch.Tensor, fallen: torch.Tensor):
    return (1.0 - pole_angle.square()) * (1.0 - fallen.float()) - 2.0 * fallen.float()


@pytest.fixture(scope="module")
def env():
    made = PoleEnv(PoleEnvCfg(), render_mode="rgb_array")
    made.reset(seed=1)
    yield made
    made.close()


# -- classes and configs


def test_a_config_is_a_configclass_derived_from_that_of_the_workflow():
    assert is_config(PoleEnvCfg())
    assert issubclass(PoleEnvCfg, DirectRLEnvCfg)


def test_any_field_may_be_added():
    assert PoleEnvCfg(push=10.0).push == 10.0
    assert "start_angle" in PoleEnvCfg().to_dict()


def test_configs_are_composed_of_configs():
    cfg = PoleEnvCfg()
    assert is_config(cfg.sim)
    assert is_config(cfg.scene)
    assert is_config(cfg.robot_cfg)
    assert cfg.robot_cfg.actuators["cart"].damping == 10.0


def test_instances_of_a_config_share_nothing():
    one, other = PoleEnvCfg(), PoleEnvCfg()
    one.scene.num_envs = 3
    one.robot_cfg.actuators["cart"].damping = 0.0
    assert other.scene.num_envs == N
    assert other.robot_cfg.actuators["cart"].damping == CARTPOLE_CFG.actuators["cart"].damping == 10.0


def test_the_simulation_has_a_default():
    assert isinstance(DirectRLEnvCfg().sim, SimulationCfg)


def test_the_scene_has_no_default_and_must_be_given():
    @configclass
    class NoScene(DirectRLEnvCfg):
        decimation, episode_length_s, action_space, observation_space = 1, 1.0, 1, 1

    with pytest.raises(ConfigError, match="scene: is missing"):
        NoScene().validate()


def test_the_simulation_config_sets_the_time_step_gravity_and_physics(env):
    cfg = SimulationCfg(dt=0.002, gravity=(0.0, 0.0, -1.6), solver=MuJoCoSolverCfg(iterations=4))
    assert (cfg.dt, cfg.gravity[2], cfg.solver.iterations) == (0.002, -1.6, 4)
    assert env.physics_dt == pytest.approx(1 / 120)
    assert env.step_dt == pytest.approx(2 / 120)


def test_the_render_interval_is_in_physics_steps():
    assert PoleEnvCfg().sim.render_interval == 2


def test_the_scene_config_sets_number_and_distance_of_the_copies(env):
    assert env.num_envs == N
    origins = env.scene.env_origins
    apart = torch.cdist(origins, origins) + 1e9 * torch.eye(N)
    assert apart.min() == pytest.approx(3.0)


def test_a_robot_config_is_aimed_by_its_prim_path():
    assert PoleEnvCfg().robot_cfg.prim_path == "/World/envs/env_.*/Robot"
    assert CARTPOLE_CFG.prim_path != PoleEnvCfg().robot_cfg.prim_path


def test_every_copy_of_the_scene_has_the_robot(env):
    labels = [label for label in env.sim.model.articulation_label if "Robot" in label]
    assert len(labels) == N


def test_an_environment_may_have_several_articulations():
    class Two(PoleEnv):
        def _setup_scene(self):
            super()._setup_scene()

    @configclass
    class TwoSceneCfg(InteractiveSceneCfg):
        ant: ArticulationCfg = ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Ant")

    class Both(PoleEnv):
        def _setup_scene(self):
            self.robot = Articulation(self.cfg.robot_cfg)
            self.scene.articulations["robot"] = self.robot
            self.scene.clone_environments()

    both = Both(PoleEnvCfg(scene=TwoSceneCfg(num_envs=2, env_spacing=4.0)))
    assert list(both.scene.articulations) == ["ant", "robot"]
    both.reset()
    both.step(torch.zeros(2, 1))
    both.close()


def test_what_is_wrong_in_a_config_is_said_at_once():
    cfg = PoleEnvCfg(decimation=0, episode_length_s=-1.0)
    cfg.scene.env_spacing = -2.0
    with pytest.raises(ConfigError) as caught:
        cfg.validate()
    assert len(caught.value.problems) == 3
    with pytest.raises(TypeError, match="PoleEnvCfg has no field 'decimaton'; did you mean 'decimation'"):
        PoleEnvCfg(decimaton=2)


# -- the environment


def test_the_environment_takes_its_config_and_keeps_a_copy(env):
    cfg = PoleEnvCfg()
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert isinstance(env.cfg, PoleEnvCfg)
    assert env.cfg is not cfg


def test_the_constructor_of_the_base_sets_up_the_scene(env):
    assert env.calls[0] == "_setup_scene"


def test_the_robot_exists_on_the_stage_once_it_is_made(env):
    assert env.scene.stage.GetPrimAtPath("/World/envs/env_0/Robot").IsValid()


def test_cloning_copies_the_first_environment(env):
    bodies = env.sim.model.body_count // N
    assert bodies > 0
    assert env.sim.model.world_count == N


def test_the_scene_keeps_its_articulations_by_name(env):
    assert env.scene.articulations["robot"] is env.robot
    assert env.scene["robot"] is env.robot


def test_ground_and_lights_are_spawned(env):
    assert env.scene.stage.GetPrimAtPath("/World/ground").IsValid()
    assert [light.kind for light in env.sim.lights] == ["dome"]


def test_the_hooks_run_in_order(env):
    env.calls.clear()
    env.step(torch.zeros(N, 1))
    order = list(dict.fromkeys(env.calls))
    wanted = ["_pre_physics_step", "_apply_action", "_get_dones", "_get_rewards", "_get_observations"]
    assert [name for name in order if name in wanted] == wanted


def test_pre_physics_step_gets_the_actions(env):
    env.step(torch.full((N, 1), 0.5))
    torch.testing.assert_close(env.forces, torch.full((N, 1), 40.0))


def test_apply_action_sets_drive_commands_before_the_physics(env):
    env.step(torch.full((N, 1), 0.5))
    torch.testing.assert_close(env.robot.data.joint_effort_target[:, env.cart], torch.full((N,), 40.0))


def test_observations_are_a_dict_by_group(env):
    observations = env.step(torch.zeros(N, 1))[0]
    assert observations["policy"].shape == (N, 4)


def test_rewards_are_a_tensor_by_environment(env):
    env.reset()
    observations, reward, *_ = env.step(torch.zeros(N, 1))
    torch.testing.assert_close(reward, 1.0 - observations["policy"][:, env.pole].square())


def test_rewards_may_be_a_scripted_function():
    assert isinstance(compute_rewards, torch.jit.ScriptFunction)


def test_dones_tell_failure_from_running_out_of_time(env):
    env.reset()
    env.episode_length_buf[0] = env.max_episode_length - 1
    joint_pos = env.robot.data.joint_pos.clone()
    joint_pos[1, env.pole] = 3.0
    env.robot.write_joint_state_to_sim(joint_pos, torch.zeros_like(joint_pos))
    _, _, terminated, truncated, _ = env.step(torch.zeros(N, 1))
    assert truncated.nonzero().flatten().tolist() == [0]
    assert terminated.nonzero().flatten().tolist() == [1]


def test_only_the_environments_that_are_done_are_reset(env):
    env.reset()
    for _ in range(3):
        env.step(torch.full((N, 1), 0.3))
    env.episode_length_buf[2] = env.max_episode_length - 1
    env.step(torch.full((N, 1), 0.3))
    assert env.episode_length_buf.tolist() == [4, 4, 0, 4, 4, 4, 4, 4]
    assert env.robot.data.joint_pos[2, env.cart] == 0.0
    assert (env.robot.data.joint_pos[[0, 1, 3], env.cart] > 0.0).all()


@pytest.mark.parametrize("env_ids", [[1, 3], None, torch.tensor([0])])
def test_reset_idx_takes_indices_a_tensor_or_none(env, env_ids):
    env.reset()
    env.step(torch.full((N, 1), 0.5))
    DirectRLEnv._reset_idx(env, env_ids)
    ids = list(range(N)) if env_ids is None else [int(i) for i in env_ids]
    assert [i for i in range(N) if env.episode_length_buf[i] == 0] == ids


def test_targets_and_resets_never_change_during_the_physics(env):
    """The step is a list of stages: actions, physics, outcome, reset, observations."""
    text = env.describe()
    assert text.index("_pre_physics_step") < text.index("_apply_action") < text.index("_get_dones")
    assert text.index("_get_dones") < text.index("_reset_idx") < text.index("_get_observations")


def test_it_renders(env):
    picture = env.render()
    assert picture.ndim == 3
    assert picture.std() > 1.0


def test_rl_libraries_use_that_interface(env):
    from stripe_newton.rl import RslRlVecEnvWrapper

    wrapped = RslRlVecEnvWrapper(env)
    observations, rewards, dones, extras = wrapped.step(torch.zeros(N, 1))
    assert observations["policy"].shape == (N, 4)
    assert rewards.shape == dones.shape == (N,)
    assert "time_outs" in extras


def test_unknown_arguments_of_the_environment_are_refused():
    with pytest.raises(TypeError, match="unexpected arguments: speed"):
        PoleEnv(PoleEnvCfg(), speed=2)
