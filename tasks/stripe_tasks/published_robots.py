# SPDX-License-Identifier: Apache-2.0
"""Published robots as articulation configs: file, pose and drives that tasks train them with.

Their files are not part of this package. Each function looks for the file by the robot's name
(:func:`stripe_newton.assets.find_robot`), and its error says how to get it. Drives of the Go1 and the G1 are mjlab's,
those of the Go2 are Isaac Lab's, those of ANYmal C legged_gym's, those of the Panda its file's, or as soft as Isaac
Lab's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from stripe_newton.actuators import ActuatorCfg, DCMotorCfg, ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, RobotNotFoundError, robot_cfg
from stripe_newton.sim import MjcfFileCfg

__all__ = [
    "G1_DRIVES",
    "GO1_DRIVES",
    "MotorDrive",
    "action_scale",
    "allegro_cfg",
    "anymal_c_cfg",
    "g1_cfg",
    "go1_cfg",
    "go2_cfg",
    "panda_cfg",
    "soft_panda_cfg",
]

_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class MotorDrive:
    """Position drive whose gains follow from the reflected inertia of its motor.

    ``stiffness = I w^2`` and ``damping = 2 zeta I w``, ``w`` ten turns a second, ``zeta`` 2: a drive as fast as that,
    and overdamped, for the motor alone.
    """

    joints: str
    """Expression for the joints' names."""
    inertia: float
    """Rotor inertia times the gear ratio squared [kg m^2]."""
    effort: float
    """Largest torque [N m]."""
    speed: float
    """Rated speed [rad/s]."""

    @property
    def stiffness(self) -> float:
        """Position gain [N m/rad]."""
        return self.inertia * (10.0 * _TURN) ** 2

    @property
    def damping(self) -> float:
        """Velocity gain [N m s/rad]."""
        return 2.0 * 2.0 * self.inertia * 10.0 * _TURN

    def actuator(self) -> ImplicitActuatorCfg:
        """Its config."""
        return ImplicitActuatorCfg(
            joint_names_expr=[self.joints],
            stiffness=self.stiffness,
            damping=self.damping,
            effort_limit=self.effort,
            velocity_limit=self.speed,
            armature=self.inertia,
        )


def action_scale(drives: dict[str, MotorDrive]) -> dict[str, float]:
    """Scale of position actions by joint expression [rad]: a quarter of what the largest torque deflects a drive."""
    return {drive.joints: 0.25 * drive.effort / drive.stiffness for drive in drives.values()}


# -- quadrupeds

_GO1_ROTOR = 0.000111842
"""Rotor inertia of the Go1's motors [kg m^2], of Unitree's description."""
GO1_DRIVES = {
    "hips": MotorDrive(".*_(hip|thigh)_joint", _GO1_ROTOR * 6.0**2, 23.7, 30.1),
    "knees": MotorDrive(".*_calf_joint", _GO1_ROTOR * 9.0**2, 35.55, 20.06),
}
"""Drives of the Go1, geared 6 and 9 to 1."""


def _of_mjcf(
    name: str, self_collision: bool = True, actuators: bool = True, condim: int | None = None
) -> ArticulationCfg:
    """Config of a robot by its name, of which tasks know the joints and bodies of the MJCF file.

    Args:
        name: Its name, as for ``find_robot``.
        self_collision: Whether its bodies collide with each other.
        actuators: Whether the actuators of the file are read.
        condim: Dimension of its contacts; None as the file has it.

    Raises:
        RobotNotFoundError: its file is not to be had, or only another one.
    """
    cfg = robot_cfg(name)
    if not isinstance(cfg.spawn, MjcfFileCfg):
        raise RobotNotFoundError(
            f"robot '{name}': the file that was found is no MJCF file, whose names the tasks have; set MENAGERIE_ROOT "
            "to a checkout of github.com/google-deepmind/mujoco_menagerie"
        )
    cfg.spawn.self_collision, cfg.spawn.actuators, cfg.spawn.condim = self_collision, actuators, condim
    return cfg


def _standing(
    cfg: ArticulationCfg, height: float, joint_pos: dict[str, float], actuators: dict[str, ActuatorCfg], limits: float
) -> ArticulationCfg:
    """A robot that stands: height of its root [m], pose [rad], drives, and soft limits."""
    return cfg.replace(
        init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, height), rot=None, joint_pos=joint_pos),
        actuators=actuators,
        soft_joint_pos_limit_factor=limits,
    )


def _drives(motors: dict[str, MotorDrive]) -> dict[str, ActuatorCfg]:
    """Configs of motor drives."""
    return {name: drive.actuator() for name, drive in motors.items()}


def go1_cfg() -> ArticulationCfg:
    """Unitree Go1, knees bent, with the drives of its motors.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    pose = {".*_thigh_joint": 0.9, ".*_calf_joint": -1.8, ".*R_hip_joint": 0.1, ".*L_hip_joint": -0.1}
    return _standing(_of_mjcf("go1"), 0.278, pose, _drives(GO1_DRIVES), 0.9)


def go2_cfg() -> ArticulationCfg:
    """Unitree Go2 with the gains that Isaac Lab trains it with; the legs do not collide with each other.

    Contacts have sliding friction only, as in Isaac Lab. The file has torsional and rolling friction too, which makes
    ten rows of a point.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    pose = {
        ".L_hip_joint": 0.1,
        ".R_hip_joint": -0.1,
        "F._thigh_joint": 0.8,
        "R._thigh_joint": 1.0,
        ".*_calf_joint": -1.5,
    }
    legs = ImplicitActuatorCfg(
        joint_names_expr=[".*"], stiffness=25.0, damping=0.5, effort_limit=23.5, velocity_limit=30.0, armature=0.01
    )
    return _standing(_of_mjcf("go2", self_collision=False, condim=3), 0.33, pose, {"legs": legs}, 0.9)


def anymal_c_cfg() -> ArticulationCfg:
    """ANYbotics ANYmal C with DC motors in place of a network of its drives; its parts do not collide with each other.

    Limits of the motors are Isaac Lab's, gains those of Rudin et al. 2022 (legged_gym): with Isaac Lab's 40 N m/rad for
    simple drives, which no task of it trains, the knees give way by 0.4 rad. Contacts have sliding friction only.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    pose = {".*HAA": 0.0, ".*F_HFE": 0.4, ".*H_HFE": -0.4, ".*F_KFE": -0.8, ".*H_KFE": 0.8}
    legs = DCMotorCfg(
        joint_names_expr=[".*"],
        saturation_effort=120.0,
        effort_limit=80.0,
        velocity_limit=7.5,
        stiffness=80.0,
        damping=2.0,
    )
    return _standing(_of_mjcf("anymal_c", self_collision=False, condim=3), 0.6, pose, {"legs": legs}, 0.95)


# -- humanoids

_ROTORS = {
    "5020": (0.139e-4, 0.017e-4, 0.169e-4),
    "7520_14": (0.489e-4, 0.098e-4, 0.533e-4),
    "7520_22": (0.489e-4, 0.109e-4, 0.738e-4),
    "4010": (0.068e-4, 0.0, 0.0),
}
"""Inertias of the rotor and of the two planet carriers of Unitree's motors, by their kind [kg m^2]."""
_GEARS = {
    "5020": (1.0 + 46.0 / 18.0, 1.0 + 56.0 / 16.0),
    "7520_14": (4.5, 1.0 + 48.0 / 22.0),
    "7520_22": (4.5, 5.0),
    "4010": (5.0, 5.0),
}
"""Ratios of their two planetary stages."""


def _reflected(kind: str) -> float:
    """Inertia of a motor at its output [kg m^2]: each part times the square of the ratio from there on."""
    (rotor, first, second), (one, two) = _ROTORS[kind], _GEARS[kind]
    return rotor * (one * two) ** 2 + first * two**2 + second


G1_DRIVES = {
    "hips": MotorDrive(".*_hip_(pitch|yaw)_joint", _reflected("7520_14"), 88.0, 32.0),
    "knees": MotorDrive(".*_(hip_roll|knee)_joint", _reflected("7520_22"), 139.0, 20.0),
    "ankles": MotorDrive(".*_ankle_.*_joint", 2.0 * _reflected("5020"), 50.0, 37.0),
    "waist": MotorDrive("waist_yaw_joint", _reflected("7520_14"), 88.0, 32.0),
    "waist_tilt": MotorDrive("waist_(roll|pitch)_joint", 2.0 * _reflected("5020"), 50.0, 37.0),
    "arms": MotorDrive(".*_(shoulder_.*|elbow|wrist_roll)_joint", _reflected("5020"), 25.0, 37.0),
    "wrists": MotorDrive(".*_wrist_(pitch|yaw)_joint", _reflected("4010"), 5.0, 22.0),
}
"""Drives of the G1. Ankles and the tilt of the waist have two motors each, taken for one of twice the inertia."""


def g1_cfg() -> ArticulationCfg:
    """Unitree G1 with 29 joints, knees bent, with the drives of its motors.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    pose = {
        ".*_hip_pitch_joint": -0.312,
        ".*_knee_joint": 0.669,
        ".*_ankle_pitch_joint": -0.363,
        ".*_elbow_joint": 0.6,
        "left_shoulder_roll_joint": 0.2,
        "right_shoulder_roll_joint": -0.2,
        ".*_shoulder_pitch_joint": 0.2,
    }
    return _standing(_of_mjcf("g1"), 0.76, pose, _drives(G1_DRIVES), 0.9)


# -- arms


def panda_cfg() -> ArticulationCfg:
    """Franka Emika Panda with its gripper, held at its base, the hand facing down in front of it.

    Stiffness and damping of the arm are those of the file. Both fingers have drives of their own, in place of the one
    that the file puts on their tendon.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    cfg = _of_mjcf("panda", self_collision=False, actuators=False)
    gains = {"joint[12]": 4500.0, "joint[34]": 3500.0, "joint[567]": 2000.0}
    arm = ImplicitActuatorCfg(
        joint_names_expr=["joint[1-7]"],
        stiffness=gains,
        damping={joints: 0.1 * gain for joints, gain in gains.items()},
        effort_limit={"joint[1-4]": 87.0, "joint[567]": 12.0},
        velocity_limit={"joint[1-4]": 2.175, "joint[567]": 2.61},
    )
    # About 8 N on a thing of 5 cm: contacts are as soft as what they press on is light, and a cube of 0.1 kg would be
    # squeezed by centimetres with the 70 N that the gripper has.
    fingers = ImplicitActuatorCfg(
        joint_names_expr=["finger_joint[12]"], stiffness=350.0, damping=35.0, effort_limit=20.0, velocity_limit=0.2
    )
    pose = {
        "joint1": 0.0,
        "joint2": -0.569,
        "joint3": 0.0,
        "joint4": -2.81,
        "joint5": 0.0,
        "joint6": 3.037,
        "joint7": 0.741,
        "finger_joint[12]": 0.04,
    }
    return cfg.replace(
        init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 0.0), rot=None, joint_pos=pose),
        actuators={"arm": arm, "fingers": fingers},
    )


def soft_panda_cfg() -> ArticulationCfg:
    """Panda whose arm is as soft as Isaac Lab's, for tasks in which it grasps.

    With the stiffness of the file, the noise of a policy that learns reverses the full torque of each joint from step
    to step. That shakes a cube out of the gripper within a second: holding it is never found to be worth anything.
    Without compensation of gravity the arm sags by 0.2 rad. Damping is four times Isaac Lab's, so that it does not
    swing.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    cfg = panda_cfg()
    arm = cfg.actuators["arm"]
    arm.stiffness, arm.damping = 80.0, 16.0
    return cfg


# -- hands


def allegro_cfg() -> ArticulationCfg:
    """Wonik Allegro right hand, held with its palm up, with the drives that Isaac Lab trains it with.

    Raises:
        RobotNotFoundError: its file is not to be had.
    """
    cfg = _of_mjcf("allegro", actuators=False)
    fingers = ImplicitActuatorCfg(
        joint_names_expr=[".*"], stiffness=3.0, damping=0.1, effort_limit=0.5, friction=0.01, armature=0.001
    )
    pose = {"(ff|mf|rf)j0": 0.0, "(ff|mf|rf)j[123]": 0.4, "thj0": 0.6, "thj[123]": 0.3}
    return cfg.replace(
        init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 0.5), rot=None, joint_pos=pose),
        actuators={"fingers": fingers},
        soft_joint_pos_limit_factor=1.0,
    )
