# SPDX-License-Identifier: Apache-2.0
"""Manager-based velocity tasks: the configs that quadruped and humanoid, flat and rough ground share.

A command is a forward velocity, a sideways velocity and a yaw rate. New ones are drawn every few seconds, and the robot
is rewarded for following them. Terms have the names that Isaac Lab and mjlab give them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
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
from stripe_newton.managers.manager_base import terms_of
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
ROBOT_PATH = "{ENV_REGEX_NS}/Robot"

BodyNames = str | list[str]
"""Bodies by one expression, or by several."""


def names_of(names: BodyNames) -> list[str]:
    """Several expressions, also of one."""
    return [names] if isinstance(names, str) else list(names)


def contacts(*bodies: str) -> SceneEntityCfg:
    """Bodies of the contact sensor, by expression."""
    return SceneEntityCfg("contact_forces", body_names=list(bodies))


def bodies(*names: str) -> SceneEntityCfg:
    """Bodies of the robot, by expression."""
    return SceneEntityCfg("robot", body_names=list(names))


def joints(*names: str) -> SceneEntityCfg:
    """Joints of the robot, by expression."""
    return SceneEntityCfg("robot", joint_names=list(names))


def noise(bound: float) -> UniformNoiseCfg:
    """Uniform noise between ``-bound`` and ``bound``."""
    return UniformNoiseCfg(n_min=-bound, n_max=bound)


@configclass
class VelocitySceneCfg(RobotSceneCfg):
    """Flat scene: a robot with a contact sensor, on a plane."""

    contact_forces: ContactSensorCfg = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", track_air_time=True)


@configclass
class RoughSceneCfg(VelocitySceneCfg):
    """Rough scene: ten levels of stairs, blocks, slopes and random ground, and a height scanner on the robot."""

    ground: AssetBaseCfg | None = None  # the terrain is the ground
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
        # from far above, so that no hill is higher than the origin of a ray
        offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 20.0)),
        ray_alignment="yaw",
        pattern_cfg=GridPatternCfg(resolution=0.1, size=(1.6, 1.0)),
        mesh_prim_paths=["/World/ground"],
    )


@configclass
class CommandsCfg:
    """Command: velocity of the base, with a heading to turn to."""

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
    """Actions: positions of the joints, relative to the default pose."""

    joint_pos: mdp.JointPositionActionCfg = mdp.JointPositionActionCfg(
        asset_name="robot", joint_names=[".*"], scale=0.25, use_default_offset=True
    )


@configclass
class ProprioceptionCfg(ObservationGroupCfg):
    """Proprioception: the robot's own state and command, with the noise of its sensors."""

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
    """Observations: with noise for the policy, without noise for the critic."""

    policy: ProprioceptionCfg = ProprioceptionCfg()
    critic: ProprioceptionCfg = ProprioceptionCfg(enable_corruption=False)


@configclass
class ScanningCfg(ProprioceptionCfg):
    """Proprioception and a scan of the ground around the robot."""

    height_scan: ObservationTermCfg = ObservationTermCfg(
        func=mdp.height_scan,
        params={"sensor_cfg": SceneEntityCfg("height_scanner")},
        noise=noise(0.1),
        clip=(-1.0, 1.0),
    )


@configclass
class RoughObservationsCfg(ObservationsCfg):
    """Observations with a height scan: with noise for the policy, without noise for the critic."""

    policy: ScanningCfg = ScanningCfg()
    critic: ScanningCfg = ScanningCfg(enable_corruption=False)


@configclass
class RewardsCfg:
    """Rewards for following the command, less costs of unsteady motion."""

    track_lin_vel_xy_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_lin_vel_xy_exp, weight=1.5, params={**TWIST, "std": 0.5}
    )
    track_ang_vel_z_exp: RewardTermCfg | None = RewardTermCfg(
        func=mdp.track_ang_vel_z_exp, weight=0.75, params={**TWIST, "std": 0.5}
    )
    lin_vel_z_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.lin_vel_z_l2, weight=-2.0)
    ang_vel_xy_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.ang_vel_xy_l2, weight=-0.05)
    joint_torques_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.joint_torques_l2, weight=-2.0e-4)
    joint_acc_l2: RewardTermCfg | None = RewardTermCfg(func=mdp.joint_acc_l2, weight=-2.5e-7)
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
    base_contact: TerminationTermCfg | None = TerminationTermCfg(
        func=mdp.illegal_contact, params={"sensor_cfg": MISSING, "threshold": 1.0}
    )
    left_scenery: TerminationTermCfg | None = None
    """In an imported scenery: outside of it, or fallen below it."""


@configclass
class EventsCfg:
    """Events: masses and friction differ between robots, episodes start near the origin in any direction, pushes."""

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
    encoder_bias: EventTermCfg | None = None
    """Errors of the encoders, where the task has them."""


@configclass
class VelocityEnvCfg(ManagerBasedRLEnvCfg):
    """Base of the flat velocity tasks: steps of 20 ms with four physics steps, episodes of 20 s.

    The fields ``robot``, ``base``, ``feet``, ``thighs`` and ``falls_on`` make a task of another robot. They set the
    bodies of all terms that do not name others.
    """

    robot: ArticulationCfg | None = None
    """Robot that takes the place of the one in ``scene``, where it is then found; its ``prim_path`` may be missing."""
    base: str = MISSING
    """Body that carries the payload and the height scanner."""
    feet: BodyNames = MISSING
    """Bodies that touch the ground when the robot walks: their air time is rewarded, their friction differs."""
    thighs: BodyNames = []
    """Bodies whose contacts cost reward."""
    falls_on: BodyNames | None = None
    """Bodies whose contact ends an episode; None: the base."""
    decimation: int = 4
    episode_length_s: float = 20.0
    viewer: ViewerCfg = ViewerCfg(
        origin_type="asset_root",
        asset_name="Robot",
        eye=(1.7, -1.9, 0.8),
        lookat=(0.0, 0.0, -0.08),
        num_shown=6,
    )
    sim: SimulationCfg = SimulationCfg(
        dt=0.005,
        solver=MuJoCoSolverCfg(iterations=10, ls_iterations=20, njmax=120, nconmax=30, drive_limits=True),
        # MuJoCo takes the larger friction of two shapes: little on the ground lets the randomised soles decide.
        physics_material=RigidBodyMaterialCfg(static_friction=0.5, dynamic_friction=0.5),
    )
    scene: VelocitySceneCfg = MISSING
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventsCfg = EventsCfg()

    def __post_init__(self) -> None:
        self.complete()

    def complete(self) -> None:
        """Set the robot of the scene, and the bodies of terms that have none or those of a former call."""
        super().complete()
        if self.scene is not MISSING and self.scene.scenery_file is not None:
            self._fit_scenery()
        if self.robot is not None:
            self.scene.robot, self.robot = self.robot.replace(prim_path=ROBOT_PATH), None
        if MISSING in (self.base, self.feet):
            return  # which validate() reports
        before = getattr(self, "_completed", {})
        self._completed: dict[str, SceneEntityCfg] = {}
        for path, term, key, names in self._body_terms():
            if term is None or term.params.get(key, MISSING) not in (MISSING, before.get(path, MISSING)):
                continue
            term.params[key] = (bodies if key == "asset_cfg" else contacts)(*names)
            self._completed[path] = term.params[key].copy()
        if not self.thighs and "undesired_contacts" in self._completed:
            self.rewards.undesired_contacts = None  # no body is undesired

    def _fit_scenery(self) -> None:
        """Start where the scenery has room for a robot, and end episodes of robots that have left it."""
        events, ends = terms_of(self.events), terms_of(self.terminations)
        reset = events.get("reset_base")
        bounds = reset.params.get("pose_range", {}) if isinstance(reset, EventTermCfg) else {}
        for axis in ("x", "y"):
            if bounds.get(axis) == (-0.5, 0.5):  # the default: half a metre from a clear place there may be a table
                bounds[axis] = (0.0, 0.0)
        if isinstance(self.terminations, TerminationsCfg) and ends.get("out_of_bounds") is None:
            self.terminations.left_scenery = TerminationTermCfg(
                func=mdp.terrain_out_of_bounds, params={"distance_buffer": 0.0}, time_out=True
            )

    def _body_terms(self) -> Iterator[tuple[str, Any, str, list[str]]]:
        """Parameters of terms that are bodies: a name for them, the term, the parameter and the expressions."""
        feet, trunk = names_of(self.feet), [self.base]
        falls = trunk if self.falls_on is None else names_of(self.falls_on)
        # A caller may have replaced the configs of these managers by dicts, or by None.
        events, rewards, ends = (terms_of(cfg) for cfg in (self.events, self.rewards, self.terminations))
        yield "payload", events.get("payload"), "asset_cfg", trunk
        yield "centre_of_mass", events.get("centre_of_mass"), "asset_cfg", trunk
        yield "soles", events.get("soles"), "asset_cfg", feet
        yield "feet_air_time", rewards.get("feet_air_time"), "sensor_cfg", feet
        yield "feet_slide", rewards.get("feet_slide"), "sensor_cfg", feet  # of robots with two feet
        yield "feet_slide.asset", rewards.get("feet_slide"), "asset_cfg", feet
        yield "undesired_contacts", rewards.get("undesired_contacts"), "sensor_cfg", names_of(self.thighs)
        yield "base_contact", ends.get("base_contact"), "sensor_cfg", falls


@configclass
class RoughTerminationsCfg(TerminationsCfg):
    """An episode also ends near the edge of the terrain."""

    out_of_bounds: TerminationTermCfg = TerminationTermCfg(
        func=mdp.terrain_out_of_bounds, params={"distance_buffer": 3.0}, time_out=True
    )


@configclass
class RoughEventsCfg(EventsCfg):
    """Events on rough ground: episodes start on the surface of the terrain."""

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
    """Curriculum: robots that get far go on to harder ground."""

    terrain_levels: CurriculumTermCfg = CurriculumTermCfg(func=mdp.terrain_levels_vel, params=TWIST)


@configclass
class VelocityRoughEnvCfg(VelocityEnvCfg):
    """Base of the rough velocity tasks, with a height scan."""

    scene: RoughSceneCfg = MISSING
    observations: RoughObservationsCfg = RoughObservationsCfg()
    terminations: RoughTerminationsCfg = RoughTerminationsCfg()
    events: RoughEventsCfg = RoughEventsCfg()
    curriculum: CurriculumCfg = CurriculumCfg()

    def complete(self) -> None:
        super().complete()
        if self.scene is not MISSING:
            self.scene.height_scanner.prim_path = f"{ROBOT_PATH}/{self.base}"

    def _fit_scenery(self) -> None:
        """As on flat ground; and rays start below the ceiling, and the generated terrain is not made in vain."""
        super()._fit_scenery()
        end = terms_of(self.terminations).get("out_of_bounds")
        if isinstance(end, TerminationTermCfg) and end.params.get("distance_buffer") == 3.0:
            end.params["distance_buffer"] = 0.0  # 3 m from the walls there is no room left
        offset = self.scene.height_scanner.offset
        if offset.pos == (0.0, 0.0, 20.0):
            offset.pos = (0.0, 0.0, 0.3)
        if self.scene.terrain.terrain_type == "generator" and self.scene.scenery_options.ground != "keep":
            self.scene.terrain.terrain_type = "plane"


@configclass
class VelocityPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO for walking on flat ground."""

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
    """PPO for walking on rough ground."""

    max_iterations: int = 1500
