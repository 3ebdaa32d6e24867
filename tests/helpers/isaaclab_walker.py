# SPDX-License-Identifier: Apache-2.0
"""A walker with two legs as a manager-based task in a file that is written for Isaac Lab 2.3."""

from __future__ import annotations

import importlib
import itertools
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

import stripe_newton.isaaclab as dialect

__all__ = ["WALKER", "dialect_file", "put", "walker_task"]

_NUMBERS = itertools.count()


def _link(name: str, size: str, mass: float, z: float) -> str:
    inertia = mass * 0.01
    return f"""<link name="{name}">
    <inertial><origin xyz="0.01 0 {z}"/><mass value="{mass}"/>
    <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 {z}"/><geometry><box size="{size}"/></geometry></collision></link>"""


def _joint(name: str, parent: str, child: str, origin: str, axis: str, limits: str) -> str:
    return f"""<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
    <origin xyz="{origin}"/><axis xyz="{axis}"/><limit {limits} effort="20" velocity="10"/></joint>"""


def _leg(side: str, y: float) -> str:
    return "".join(
        (
            _link(f"{side}_thigh", "0.05 0.05 0.2", 1.0, -0.1),
            _link(f"{side}_shin", "0.04 0.04 0.2", 0.5, -0.1),
            _joint(f"{side}_hip", "base", f"{side}_thigh", f"0 {y} -0.05", "0 1 0", 'lower="-1" upper="1"'),
            _joint(f"{side}_knee", f"{side}_thigh", f"{side}_shin", "0 0 -0.2", "0 1 0", 'lower="-1.5" upper="0.2"'),
        )
    )


WALKER = (
    f'<robot name="walker">{_link("base", "0.3 0.2 0.1", 5.0, 0.0)}{_leg("left", 0.1)}{_leg("right", -0.1)}</robot>'
)
"""URDF of the walker: a base and two legs, each with a hip and a knee."""

TASK = """
import torch

import isaaclab.envs.mdp as mdp
import isaaclab.sim as sim_utils
from isaaclab.actuators import ImplicitActuatorCfg
from isaaclab.assets import ArticulationCfg, AssetBaseCfg
from isaaclab.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg
from isaaclab.managers import ActionTerm, ActionTermCfg, CommandTerm, CommandTermCfg
from isaaclab.managers import CurriculumTermCfg as CurrTerm
from isaaclab.managers import EventTermCfg as EventTerm
from isaaclab.managers import ManagerTermBase, SceneEntityCfg
from isaaclab.managers import ObservationGroupCfg as ObsGroup
from isaaclab.managers import ObservationTermCfg as ObsTerm
from isaaclab.managers import RewardTermCfg as RewTerm
from isaaclab.managers import TerminationTermCfg as DoneTerm
from isaaclab.scene import InteractiveSceneCfg
from isaaclab.sensors import ContactSensorCfg, ImuCfg, RayCasterCfg, patterns
from isaaclab.utils import configclass
from isaaclab.utils.noise import AdditiveUniformNoiseCfg as Unoise


def knees(env, asset_cfg):
    return mdp.joint_pos_rel(env, asset_cfg) * 2.0


class Covered(ManagerTermBase):
    def __init__(self, cfg, env):
        super().__init__(cfg, env)
        self.start = torch.zeros(self.num_envs, 3, device=self.device)
        self.asset = env.scene[cfg.params["asset_cfg"].name]

    def reset(self, env_ids=None):
        self.start[env_ids] = self.asset.data.root_pos_w[env_ids]

    def __call__(self, env, asset_cfg, axis):
        return (self.asset.data.root_pos_w - self.start)[:, axis].abs()


class Mirrored(ActionTerm):
    def __init__(self, cfg, env):
        super().__init__(cfg, env)
        self._left, _ = self._asset.find_joints("left_.*")
        self._right, _ = self._asset.find_joints("right_.*")
        self._raw = torch.zeros(self.num_envs, 2, device=self.device)
        self._processed = torch.zeros_like(self._raw)

    @property
    def action_dim(self):
        return 2

    @property
    def raw_actions(self):
        return self._raw

    @property
    def processed_actions(self):
        return self._processed

    def process_actions(self, actions):
        self._raw[:] = actions
        self._processed[:] = actions * self.cfg.scale + self._asset.data.default_joint_pos[:, self._left]

    def apply_actions(self):
        self._asset.set_joint_position_target(self._processed, joint_ids=self._left)
        self._asset.set_joint_position_target(self._processed, joint_ids=self._right)

    def reset(self, env_ids=None):
        self._raw[env_ids] = 0.0


@configclass
class MirroredCfg(ActionTermCfg):
    class_type: type[ActionTerm] = Mirrored
    scale: float = 0.5


class SlowVelocity(mdp.UniformVelocityCommand):
    def _resample_command(self, env_ids):
        super()._resample_command(env_ids)
        self.vel_command_b[env_ids, :2] *= 0.5


@configclass
class SlowVelocityCfg(mdp.UniformVelocityCommandCfg):
    class_type: type = SlowVelocity


def widen(env, env_ids, step):
    ranges = env.command_manager.get_term("pose").cfg.ranges
    ranges.pos_x = (ranges.pos_x[0], ranges.pos_x[1] + step)
    return ranges.pos_x[1]


def halve(env, env_ids, term):
    cfg = env.reward_manager.get_term_cfg(term)
    cfg.weight = 0.5 * cfg.weight
    env.reward_manager.set_term_cfg(term, cfg)
    return cfg.weight


def set_later(env, env_ids, old_value, to):
    return to if env.common_step_counter > 4 else mdp.modify_term_cfg.NO_CHANGE


@configclass
class WalkerSceneCfg(InteractiveSceneCfg):
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=sim_utils.GroundPlaneCfg())
    robot: ArticulationCfg = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot",
        spawn=sim_utils.UrdfFileCfg(asset_path="URDF", fix_base=False, activate_contact_sensors=True),
        init_state=ArticulationCfg.InitialStateCfg(
            pos=(0.0, 0.0, 0.5), rot=(0.8, 0.0, 0.6, 0.0), joint_pos={".*_hip": 0.2, ".*_knee": -0.4}
        ),
        actuators={"legs": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=30.0, damping=1.0)},
    )
    contacts = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", history_length=2, track_air_time=True)
    scanner = RayCasterCfg(
        prim_path="{ENV_REGEX_NS}/Robot/base",
        offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 5.0)),
        ray_alignment="yaw",
        pattern_cfg=patterns.GridPatternCfg(resolution=0.2, size=(0.4, 0.2)),
        mesh_prim_paths=["/World/ground"],
    )
    imu = ImuCfg(prim_path="{ENV_REGEX_NS}/Robot/base", offset=ImuCfg.OffsetCfg(rot=(0.6, 0.8, 0.0, 0.0)))


@configclass
class ActionsCfg:
    legs = MirroredCfg(asset_name="robot")


@configclass
class CommandsCfg:
    velocity = SlowVelocityCfg(
        asset_name="robot",
        resampling_time_range=(0.1, 0.2),
        heading_command=True,
        rel_standing_envs=0.3,
        rel_heading_envs=0.5,
        ranges=SlowVelocityCfg.Ranges(
            lin_vel_x=(1.0, 2.0), lin_vel_y=(-2.0, 2.0), ang_vel_z=(-1.0, 1.0), heading=(-3.0, 3.0)
        ),
    )
    pose = mdp.UniformPoseCommandCfg(
        asset_name="robot",
        body_name="left_shin",
        resampling_time_range=(10.0, 10.0),
        ranges=mdp.UniformPoseCommandCfg.Ranges(
            pos_x=(0.1, 0.2), pos_y=(0.3, 0.4), pos_z=(0.5, 0.6), roll=(0.4, 0.6), pitch=(0.0, 0.0), yaw=(0.0, 0.0)
        ),
    )


@configclass
class ObservationsCfg:
    @configclass
    class PolicyCfg(ObsGroup):
        joint_pos = ObsTerm(func=mdp.joint_pos_rel, noise=Unoise(n_min=-0.01, n_max=0.01))
        knees = ObsTerm(func=knees, params={"asset_cfg": SceneEntityCfg("robot", joint_names=".*_knee")})
        turn = ObsTerm(func=mdp.root_quat_w)
        commands = ObsTerm(func=mdp.generated_commands, params={"command_name": "pose"})
        actions = ObsTerm(func=mdp.last_action)

        def __post_init__(self):
            self.enable_corruption = False
            self.concatenate_terms = True

    @configclass
    class FlagsCfg(ObsGroup):
        stands = ObsTerm(func=lambda env: env.scene["robot"].data.root_pos_w[:, 2] > 0.2)

        def __post_init__(self):
            self.concatenate_terms = False

    policy: PolicyCfg = PolicyCfg()
    flags: FlagsCfg = FlagsCfg()


@configclass
class EventCfg:
    mass = EventTerm(
        func=mdp.randomize_rigid_body_mass,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", body_names="base"),
            "mass_distribution_params": (1.0, 2.0),
            "operation": "add",
        },
    )
    reset_base = EventTerm(
        func=mdp.reset_root_state_uniform,
        mode="reset",
        params={"pose_range": {"yaw": (-3.0, 3.0)}, "velocity_range": {"x": (0.1, 0.2)}},
    )
    reset_joints = EventTerm(
        func=mdp.reset_joints_by_scale,
        mode="reset",
        params={"position_range": (0.5, 1.5), "velocity_range": (0.0, 0.0)},
    )


@configclass
class RewardsCfg:
    tracks = RewTerm(func=mdp.track_lin_vel_xy_exp, weight=1.0, params={"command_name": "velocity", "std": 0.5})
    covered = RewTerm(func=Covered, weight=2.0, params={"asset_cfg": SceneEntityCfg("robot"), "axis": 0})
    alive = RewTerm(func=mdp.is_alive, weight=1.0)


@configclass
class TerminationsCfg:
    time_out = DoneTerm(func=mdp.time_out, time_out=True)
    fell = DoneTerm(
        func=mdp.illegal_contact, params={"sensor_cfg": SceneEntityCfg("contacts", body_names="base"), "threshold": 1.0}
    )


@configclass
class CurriculumCfg:
    widen = CurrTerm(func=widen, params={"step": 0.1})
    halve = CurrTerm(func=halve, params={"term": "covered"})
    later = CurrTerm(
        func=mdp.modify_reward_weight, params={"term_name": "alive", "weight": 3.0, "num_steps": 4}
    )
    std = CurrTerm(
        func=mdp.modify_term_cfg,
        params={
            "address": "rewards.tracks.params['std']",
            "modify_fn": set_later,
            "modify_params": {"to": 0.9},
        },
    )


@configclass
class WalkerEnvCfg(ManagerBasedRLEnvCfg):
    scene: WalkerSceneCfg = WalkerSceneCfg(num_envs=6, env_spacing=3.0)
    observations: ObservationsCfg = ObservationsCfg()
    actions: ActionsCfg = ActionsCfg()
    commands: CommandsCfg = CommandsCfg()
    rewards: RewardsCfg = RewardsCfg()
    terminations: TerminationsCfg = TerminationsCfg()
    events: EventCfg = EventCfg()
    curriculum: CurriculumCfg = CurriculumCfg()

    def __post_init__(self):
        self.decimation = 2
        self.episode_length_s = 0.5
        self.sim.dt = 0.01
        self.sim.device = "cpu"
        self.sim.render_interval = self.decimation
"""


@contextmanager
def dialect_file(folder: Path, text: str) -> Iterator[ModuleType]:
    """A file for Isaac Lab, imported under the dialect, which is gone afterwards."""
    name = f"file_for_isaac_lab_{next(_NUMBERS)}"
    (folder / f"{name}.py").write_text(text)
    sys.path.insert(0, str(folder))
    dialect.install()
    try:
        yield importlib.import_module(name)
    finally:
        dialect.uninstall()
        sys.path.remove(str(folder))
        sys.modules.pop(name, None)


@contextmanager
def walker_task(folder: Path) -> Iterator[ModuleType]:
    """The module of the walker's task."""
    urdf = folder / "walker.urdf"
    urdf.write_text(WALKER)
    with dialect_file(folder, TASK.replace("URDF", str(urdf))) as task:
        yield task


def put(env: Any, seed: int = 0) -> None:
    """Bring the robots in random states."""
    random = torch.Generator().manual_seed(seed)
    robot, count = env.scene["robot"], env.num_envs

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(count, *shape, generator=random)

    turn = draw(4)
    pose = torch.cat((env.scene.env_origins + 0.3 * draw(3), turn / turn.norm(dim=-1, keepdim=True)), dim=-1)
    robot.write_root_pose_to_sim(pose)
    robot.write_root_velocity_to_sim(draw(6))
    robot.write_joint_state_to_sim(draw(robot.num_joints), 5.0 * draw(robot.num_joints))
    env.sim.forward()
