# SPDX-License-Identifier: Apache-2.0
"""Velocity tasks of published quadrupeds: ``Stripe-Velocity-{Flat,Rough}-{Go1,Go2,AnymalC}-v0``.

Each config looks for the robot's file when it is made. Rewards are those of the quadruped of this package, with Isaac
Lab's weights for each robot. Randomisation, pushes and noise of the Go1 are mjlab's, those of the Go2 and ANYmal C
Isaac Lab's.
"""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import EventTermCfg
from stripe_newton.rl import RslRlMLPModelCfg
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_tasks.published_robots import GO1_DRIVES, action_scale, anymal_c_cfg, go1_cfg, go2_cfg

from .manager_based import (
    ROBOT_PATH,
    BodyNames,
    RoughSceneCfg,
    VelocityEnvCfg,
    VelocityPPORunnerCfg,
    VelocityRoughEnvCfg,
    VelocityRoughPPORunnerCfg,
    VelocitySceneCfg,
)
from .manager_terms import noise

__all__ = [
    "AnymalCFlatEnvCfg",
    "AnymalCFlatPPORunnerCfg",
    "AnymalCRoughEnvCfg",
    "AnymalCRoughPPORunnerCfg",
    "Go1FlatEnvCfg",
    "Go1FlatPPORunnerCfg",
    "Go1RoughEnvCfg",
    "Go1RoughPPORunnerCfg",
    "Go2FlatEnvCfg",
    "Go2FlatPPORunnerCfg",
    "Go2RoughEnvCfg",
    "Go2RoughPPORunnerCfg",
    "start_gently",
    "use_mjlab_events",
]

PUSH = {
    "x": (-0.5, 0.5),
    "y": (-0.5, 0.5),
    "z": (-0.4, 0.4),
    "roll": (-0.52, 0.52),
    "pitch": (-0.52, 0.52),
    "yaw": (-0.78, 0.78),
}
"""Changes of the root's velocity by a push [m/s, rad/s]."""


def use_mjlab_events(cfg: VelocityEnvCfg, friction: tuple[float, float]) -> None:
    """Use mjlab's randomisation, pushes and noise of walking robots.

    Args:
        cfg: Config of a velocity task.
        friction: Bounds of the friction of the feet.
    """
    events = cfg.events
    centre, soles, push = events.centre_of_mass, events.soles, events.push_robot
    if centre is None or soles is None or push is None:
        raise ValueError("the task has no centre_of_mass, soles or push_robot among its events")
    events.payload = None
    centre.params["com_range"] = {"x": (-0.025, 0.025), "y": (-0.025, 0.025), "z": (-0.03, 0.03)}
    soles.params["static_friction_range"] = friction
    push.interval_range_s, push.params = (1.0, 3.0), {"velocity_range": PUSH}
    events.reset_robot_joints.params["position_range"] = (1.0, 1.0)
    events.encoder_bias = EventTermCfg(
        func=mdp.randomize_encoder_bias, mode="startup", params={"bias_range": (-0.015, 0.015)}
    )
    # Encoders err by the bias in what the policy sees and in what the drives do; the critic sees the true positions.
    cfg.actions.joint_pos.apply = mdp.apply_joint_position_biased
    cfg.observations.policy.joint_pos.func = mdp.joint_pos_rel_biased
    cfg.observations.policy.base_lin_vel.noise = noise(0.5)
    ground = cfg.sim.physics_material
    ground.static_friction = ground.dynamic_friction = friction[0]  # the larger friction of two shapes counts


def use_isaac_lab_events(cfg: VelocityEnvCfg, payload: tuple[float, float]) -> None:
    """Use Isaac Lab's randomisation of published quadrupeds.

    Args:
        cfg: Config of a velocity task.
        payload: Bounds of the mass that the base carries [kg].
    """
    events = cfg.events
    if events.payload is not None:
        events.payload.params["mass_distribution_params"] = payload
    events.reset_robot_joints.params["position_range"] = (1.0, 1.0)


def make_low(cfg: VelocityRoughEnvCfg) -> None:
    """Lower blocks and bumps of the terrain to what robots with legs of 0.4 m climb."""
    generator = cfg.scene.terrain.terrain_generator
    if generator is not None:
        tiles = generator.sub_terrains
        tiles["boxes"].grid_height_range = (0.025, 0.1)
        tiles["random_rough"].noise_range, tiles["random_rough"].noise_step = (0.01, 0.06), 0.01


def make_room(cfg: VelocityEnvCfg) -> MuJoCoSolverCfg:
    """Make room for the contacts of a fallen robot with many shapes. Returns the config of the solver."""
    solver = cfg.sim.solver
    assert isinstance(solver, MuJoCoSolverCfg)
    solver.njmax, solver.nconmax = 240, 60
    return solver


def use_pyramids(cfg: VelocityEnvCfg) -> None:
    """Use pyramids for friction cones, whatever the robot's file has, and make room for their rows."""
    solver = make_room(cfg)
    solver.cone, solver.impratio = "pyramidal", 1.0


def use_firm_cones(cfg: VelocityEnvCfg) -> None:
    """Use elliptic friction cones with the ratio of Menagerie's ANYmal C, and make room for their rows.

    With pyramids and a ratio of 1 the feet of so heavy a robot creep: within two seconds it lies on its thighs.
    """
    solver = make_room(cfg)
    solver.cone, solver.impratio = "elliptic", 100.0


def placed(robot: ArticulationCfg) -> ArticulationCfg:
    """The robot in every environment."""
    return robot.replace(prim_path=ROBOT_PATH)


# -- Go1


@configclass
class Go1Bodies:
    """Bodies of Go1, by their roles in a velocity task."""

    base: str = "trunk"
    feet: BodyNames = ".*_calf"
    thighs: BodyNames = ".*_thigh"


def _set_up_go1(cfg: VelocityEnvCfg) -> None:
    cfg.actions.joint_pos.scale = action_scale(GO1_DRIVES)
    use_mjlab_events(cfg, (0.3, 1.5))
    make_room(cfg)


@configclass
class Go1FlatEnvCfg(Go1Bodies, VelocityEnvCfg):
    """Go1 on a plane: 48 observations, 12 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5)

    def __post_init__(self) -> None:
        self.scene.robot = placed(go1_cfg())
        super().__post_init__()
        _set_up_go1(self)


@configclass
class Go1RoughEnvCfg(Go1Bodies, VelocityRoughEnvCfg):
    """Go1 on rough ground: 235 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5)

    def __post_init__(self) -> None:
        self.scene.robot = placed(go1_cfg())
        super().__post_init__()
        _set_up_go1(self)
        make_low(self)
        self.rewards.flat_orientation_l2 = None  # a body that stays level could not climb slopes


# -- Go2


@configclass
class Go2Bodies:
    """Bodies of Go2, by their roles in a velocity task."""

    base: str = "base_link"
    feet: BodyNames = ".*_calf"
    thighs: BodyNames = ".*_thigh"


@configclass
class Go2FlatEnvCfg(Go2Bodies, VelocityEnvCfg):
    """Go2 on a plane: 48 observations, 12 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5)

    def __post_init__(self) -> None:
        self.scene.robot = placed(go2_cfg())
        super().__post_init__()
        use_isaac_lab_events(self, (-1.0, 3.0))
        use_pyramids(self)


@configclass
class Go2RoughEnvCfg(Go2Bodies, VelocityRoughEnvCfg):
    """Go2 on rough ground: 235 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5)

    def __post_init__(self) -> None:
        self.scene.robot = placed(go2_cfg())
        super().__post_init__()
        use_isaac_lab_events(self, (-1.0, 3.0))
        use_pyramids(self)
        make_low(self)
        self.rewards.flat_orientation_l2 = None


# -- ANYmal C


@configclass
class AnymalCBodies:
    """Bodies of ANYmal C, by their roles in a velocity task."""

    base: str = "base"
    feet: BodyNames = ".*_SHANK"
    thighs: BodyNames = ".*_THIGH"


def _set_weights(cfg: VelocityEnvCfg, **weights: float) -> None:
    """Set weights of rewards by name, but of those that the task has not."""
    for name, weight in weights.items():
        term = getattr(cfg.rewards, name)
        if term is not None:
            term.weight = weight


def _set_up_anymal_c(cfg: VelocityEnvCfg, torque_weight: float, air_time_weight: float) -> None:
    cfg.actions.joint_pos.scale = 0.5
    use_isaac_lab_events(cfg, (-5.0, 5.0))
    use_firm_cones(cfg)
    centre = cfg.events.centre_of_mass
    if centre is not None:
        centre.params["com_range"] = {"x": (-0.05, 0.05), "y": (-0.05, 0.05), "z": (-0.01, 0.01)}
    _set_weights(
        cfg,
        track_lin_vel_xy_exp=1.0,
        track_ang_vel_z_exp=0.5,
        joint_torques_l2=torque_weight,
        flat_orientation_l2=-5.0,
        feet_air_time=air_time_weight,
    )
    cfg.viewer.eye, cfg.viewer.lookat = (2.6, -2.8, 1.2), (0.0, 0.0, -0.15)


@configclass
class AnymalCFlatEnvCfg(AnymalCBodies, VelocityEnvCfg):
    """ANYmal C on a plane: 48 observations, 12 joint positions."""

    scene: VelocitySceneCfg = VelocitySceneCfg(num_envs=4096, env_spacing=2.5)

    def __post_init__(self) -> None:
        self.scene.robot = placed(anymal_c_cfg())
        super().__post_init__()
        _set_up_anymal_c(self, -2.5e-5, 0.5)


@configclass
class AnymalCRoughEnvCfg(AnymalCBodies, VelocityRoughEnvCfg):
    """ANYmal C on rough ground: 235 observations, 187 of them heights."""

    scene: RoughSceneCfg = RoughSceneCfg(num_envs=4096, env_spacing=2.5)

    def __post_init__(self) -> None:
        self.scene.robot = placed(anymal_c_cfg())
        super().__post_init__()
        self.rewards.flat_orientation_l2 = None
        _set_up_anymal_c(self, -1.0e-5, 0.125)


# -- training


def start_gently(cfg: VelocityPPORunnerCfg, entropy_coef: float) -> None:
    """Begin with actions of half the usual spread.

    With a spread of 1 such robots pay more for rough motion than they can gain by standing, and learn to fall first.
    """
    cfg.algorithm.entropy_coef = entropy_coef
    cfg.actor.distribution_cfg = RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.5)


@configclass
class Go1FlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for the Go1 on a plane."""

    experiment_name: str = "velocity_flat_go1"


@configclass
class Go1RoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for the Go1 on rough ground."""

    experiment_name: str = "velocity_rough_go1"


@configclass
class Go2FlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for the Go2 on a plane."""

    experiment_name: str = "velocity_flat_go2"


@configclass
class Go2RoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for the Go2 on rough ground."""

    experiment_name: str = "velocity_rough_go2"


@configclass
class AnymalCFlatPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for ANYmal C on a plane."""

    experiment_name: str = "velocity_flat_anymal_c"
    max_iterations: int = 450

    def __post_init__(self) -> None:
        start_gently(self, 0.005)


@configclass
class AnymalCRoughPPORunnerCfg(VelocityRoughPPORunnerCfg):
    """PPO for ANYmal C on rough ground."""

    experiment_name: str = "velocity_rough_anymal_c"

    def __post_init__(self) -> None:
        start_gently(self, 0.005)
