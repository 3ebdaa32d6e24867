# SPDX-License-Identifier: Apache-2.0
"""Walk as commanded: what the velocity tasks have in common.

A robot is told a forward and a sideways velocity and a yaw rate, draws new ones every few seconds, and is rewarded for
following them. The terms carry the names that users of Isaac Lab and mjlab know.
"""

from __future__ import annotations

import math
from typing import Any

from stripe_newton.assets import AssetBaseCfg
from stripe_newton.assets.asset_base import AssetInitialStateCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sensors import ContactSensorCfg, GridPatternCfg, RayCasterCfg
from stripe_newton.sim import (
    DistantLightCfg,
    DomeLightCfg,
    MuJoCoSolverCfg,
    PreviewSurfaceCfg,
    RigidBodyMaterialCfg,
    SimulationCfg,
)
from stripe_newton.terrains import ROUGH_TERRAINS_CFG, TerrainImporterCfg
from stripe_newton.viewers import ViewerCfg
from stripe_tasks.robot_scene import RobotSceneCfg

__all__ = [
    "ActionsCfg",
    "CommandsCfg",
    "CurriculumCfg",
    "EventsCfg",
    "ObservationsCfg",
    "ProprioceptionCfg",
    "RewardsCfg",
    "RoughEventsCfg",
    "RoughObservationsCfg",
    "RoughSceneCfg",
    "RoughTerminationsCfg",
    "ScanningCfg",
    "TerminationsCfg",
    "VelocityEnvCfg",
    "VelocityPPORunnerCfg",
    "VelocityRoughEnvCfg",
    "VelocityRoughPPORunnerCfg",
    "VelocitySceneCfg",
]

TWIST = {"command_name": "base_velocity"}


def contacts(*bodies: str) -> SceneEntityCfg:
    """Bodies as the contact sensor has them."""
    return SceneEntityCfg("contact_forces", body_names=list(bodies))


def bodies(*names: str) -> SceneEntityCfg:
    """Bodies of the robot."""
    return SceneEntityCfg("robot", body_names=list(names))


def joints(*names: str) -> SceneEntityCfg:
    """Joints of the robot."""
    return SceneEntityCfg("robot", joint_names=list(names))


def noise(bound: float) -> UniformNoiseCfg:
    """Uniform noise of either sign."""
    return UniformNoiseCfg(n_min=-bound, n_max=bound)


@configclass
class VelocitySceneCfg(RobotSceneCfg):
    """A robot that feels what it touches, on a plane."""

    contact_forces: ContactSensorCfg = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", track_air_time=True)


@configclass
class RoughSceneCfg(VelocitySceneCfg):
    """Ten levels of stairs, blocks, slopes and random ground, and a scan of the heights around the robot."""

    ground: Any = None
    terrain: TerrainImporterCfg = TerrainImporterCfg(
        prim_path="/World/ground",
        terrain_type="generator",
        terrain_generator=ROUGH_TERRAINS_CFG.replace(curriculum=True, seed=0, border_width=5.0),
        max_init_terrain_level=5,
        visual_material=PreviewSurfaceCfg(diffuse_color=(0.34, 0.33, 0.29)),
    )
    sky: AssetBaseCfg = AssetBaseCfg(prim_path="/World/Light", spawn=DomeLightCfg(intensity=1000.0))
    sun: AssetBaseCfg = AssetBaseCfg(
        prim_path="/World/Sun",
        spawn=DistantLightCfg(intensity=2300.0),
        init_state=AssetInitialStateCfg(rot=(0.20, 0.56, 0.0, 0.80)),
    )
    height_scanner: RayCasterCfg = RayCasterCfg(
        prim_path=MISSING,
        offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 20.0)),
        ray_alignment="yaw",
        pattern_cfg=GridPatternCfg(resolution=0.1, size=(1.6, 1.0)),
        mesh_prim_paths=["/World/ground"],
    )


@configclass
class CommandsCfg:
    """What the robot is told."""

    base_velocity: mdp.UniformVelocityCommandCfg = mdp.UniformVelocityCommandCfg(
        asset_name="robot",
        resampling_time_range=(10.0, 10.0),
        rel_standing_envs=0.05,
        rel_heading_envs=1.0,
        heading_command=True,
        heading_control_stiffness=0.5,
        ranges=mdp.UniformVelocityCommandCfg.Ranges(
            lin_vel_x=(-1.0, 1.0), lin_vel_y=(-1.0, 1.0), ang_vel_z=(-1.0, 1.0), heading=(-math.pi, math.pi)
        ),
    )


@configclass
class ActionsCfg:
    """Positions of the joints, about those of the default pose."""

    joint_pos: mdp.JointPositionActionCfg = mdp.JointPositionActionCfg(
        asset_name="robot", joint_names=[".*"], scale=0.25, use_default_offset=True
    )


@configclass
class ProprioceptionCfg(ObservationGroupCfg):
    """What a robot knows of itself, with the noise of its sensors."""

    base_lin_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_lin_vel, noise=noise(0.1))
    base_ang_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.base_ang_vel, noise=noise(0.2))
    projected_gravity: ObservationTermCfg = ObservationTermCfg(func=mdp.projected_gravity, noise=noise(0.05))
    velocity_commands: ObservationTermCfg | None = ObservationTermCfg(func=mdp.generated_commands, params=TWIST)
    joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel, noise=noise(0.01))
    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel, noise=noise(1.5))
    actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)
    enable_corruption: bool = True


@configclass
class ObservationsCfg:
    """The policy sees noisy sensors, the critic the truth."""

    policy: ProprioceptionCfg = ProprioceptionCfg()
    critic: ProprioceptionCfg = ProprioceptionCfg(enable_corruption=False)


@configclass
class ScanningCfg(ProprioceptionCfg):
    """And of the ground around it."""

    height_scan: ObservationTermCfg = ObservationTermCfg(
        func=mdp.height_scan,
        params={"sensor_cfg": SceneEntityCfg("height_scanner")},
        noise=noise(0.1),
        clip=(-1.0, 1.0),
    )


@configclass
class RoughObservationsCfg(ObservationsCfg):
    """The policy sees noisy sensors, the critic the truth."""

    policy: ScanningCfg = ScanningCfg()
    critic: ScanningCfg = ScanningCfg(enable_corruption=False)


@configclass
class RewardsCfg:
    """Follow the command, calmly."""

    track_lin_vel_xy_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_lin_vel_xy_exp, weight=1.5, params={**TWIST, "std": 0.5}
    )
    track_ang_vel_z_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_ang_vel_z_exp, weight=0.75, params={**TWIST, "std": 0.5}
    )
    lin_vel_z_l2: RewardTermCfg = RewardTermCfg(func=mdp.lin_vel_z_l2, weight=-2.0)
    ang_vel_xy_l2: RewardTermCfg = RewardTermCfg(func=mdp.ang_vel_xy_l2, weight=-0.05)
    joint_torques_l2: RewardTermCfg = RewardTermCfg(func=mdp.joint_torques_l2, weight=-2.0e-4)
    joint_acc_l2: RewardTermCfg = RewardTermCfg(func=mdp.joint_acc_l2, weight=-2.5e-7)
    action_rate_l2: RewardTermCfg = RewardTermCfg(func=mdp.action_rate_l2, weight=-0.01)
    flat_orientation_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.flat_orientation_l2, weight=-2.5)
    joint_pos_limits: RewardTermCfg = RewardTermCfg(func=mdp.joint_pos_limits, weight=-1.0)
    feet_air_time: RewardTermCfg | None = RewardTermCfg(
        func=mdp.feet_air_time, weight=0.25, params={**TWIST, "sensor_cfg": MISSING, "threshold": 0.5}
    )
    undesired_contacts: RewardTermCfg | None = RewardTermCfg(
        func=mdp.undesired_contacts, weight=-1.0, params={"sensor_cfg": MISSING, "threshold": 1.0}
    )


@configclass
class TerminationsCfg:
    """An episode ends when the robot has fallen, or after its full length."""

    time_out: TerminationTermCfg = TerminationTermCfg(func=mdp.time_out, time_out=True)
    base_contact: TerminationTermCfg = TerminationTermCfg(
        func=mdp.illegal_contact, params={"sensor_cfg": MISSING, "threshold": 1.0}
    )


@configclass
class EventsCfg:
    """No two robots are the same; episodes start near the origin in any direction; now and then somebody pushes."""

    payload: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_mass,
        mode="startup",
        params={"asset_cfg": MISSING, "mass_distribution_params": (-1.0, 2.0), "operation": "add"},
    )
    centre_of_mass: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_com,
        mode="startup",
        params={"asset_cfg": MISSING, "com_range": {"x": (-0.02, 0.02), "y": (-0.02, 0.02), "z": (-0.02, 0.02)}},
    )
    soles: EventTermCfg | None = EventTermCfg(
        func=mdp.randomize_rigid_body_material,
        mode="startup",
        params={"asset_cfg": MISSING, "static_friction_range": (0.5, 1.2)},
    )
    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_uniform,
        mode="reset",
        params={
            "pose_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "yaw": (-math.pi, math.pi)},
            "velocity_range": {},
        },
    )
    reset_robot_joints: EventTermCfg = EventTermCfg(
        func=mdp.reset_joints_by_scale,
        mode="reset",
        params={"position_range": (0.9, 1.1), "velocity_range": (0.0, 0.0)},
    )
    push_robot: EventTermCfg | None = EventTermCfg(
        func=mdp.push_by_setting_velocity,
        mode="interval",
        interval_range_s=(10.0, 15.0),
        params={"velocity_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5)}},
    )


def randomize(events: EventsCfg, trunk: str, feet: str) -> None:
    """Name the bodies that carry the payload and those that touch the ground."""
    for term, names in ((events.payload, trunk), (events.centre_of_mass, trunk), (events.soles, feet)):
        if term is not None:
            term.params["asset_cfg"] = bodies(names)


@configclass
class VelocityEnvCfg(ManagerBasedRLEnvCfg):
    """Steps of 20 ms, of four physics steps; episodes of 20 s. A task names the robot.

    MuJoCo takes the larger friction of two, so the ground has little and the soles decide.
    """

    decimation: int = 4
    episode_length_s: float = 20.0
    viewer: ViewerCfg = ViewerCfg(
        origin_type="asset_root",
        asset_name="Robot",
        eye=(1.7, -1.9, 0.8),
        lookat=(0.0, 0.0, -0.08),
        resolution=(960, 540),
    )
    sim: SimulationCfg = SimulationCfg(
        dt=0.005,
        solver=MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=120, nconmax=30, drive_limits=True),
        physics_material=RigidBodyMaterialCfg(static_friction=0.5, dynamic_friction=0.5),
    )
    scene: VelocitySceneCfg = MISSING
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()


@configclass
class RoughTerminationsCfg(TerminationsCfg):
    """An episode also ends where the ground does."""

    out_of_bounds: TerminationTermCfg = TerminationTermCfg(
        func=mdp.terrain_out_of_bounds, params={"distance_buffer": 3.0}, time_out=True
    )


@configclass
class RoughEventsCfg(EventsCfg):
    """Episodes start on the ground, wherever that is."""

    reset_base: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_uniform_on_terrain,
        mode="reset",
        params={
            "pose_range": {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "yaw": (-math.pi, math.pi)},
            "velocity_range": {},
            "footprint": 0.3,
        },
    )


@configclass
class CurriculumCfg:
    """Who gets far goes on to harder ground."""

    terrain_levels: CurriculumTermCfg = CurriculumTermCfg(func=mdp.terrain_levels_vel, params=TWIST)


@configclass
class VelocityRoughEnvCfg(VelocityEnvCfg):
    """The same on rough ground, with a scan of it."""

    scene: RoughSceneCfg = MISSING
    observations: RoughObservationsCfg = RoughObservationsCfg()
    terminations: RoughTerminationsCfg = RoughTerminationsCfg()
    events: RoughEventsCfg = RoughEventsCfg()
    curriculum: CurriculumCfg = CurriculumCfg()


@configclass
class VelocityPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO that makes them walk."""

    num_steps_per_env: int = 24
    max_iterations: int = 300
    save_interval: int = 100
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(512, 256, 128),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(512, 256, 128), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.01, learning_rate=1.0e-3)


@configclass
class VelocityRoughPPORunnerCfg(VelocityPPORunnerCfg):
    """PPO for rough ground."""

    max_iterations: int = 1500
