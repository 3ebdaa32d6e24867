# SPDX-License-Identifier: Apache-2.0
"""Robot table: robots that people own, where their files are published, and a pose and drives that hold them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["ROBOTS", "Drive", "RobotEntry"]


Pair = tuple[float, float]


@dataclass(frozen=True)
class Drive:
    """Position drives of some joints."""

    joints: str
    """Expression for their names."""
    stiffness: float
    """N m/rad."""
    damping: float
    """N m s/rad."""
    effort: float | None = None
    """Largest torque [N m]; None: that of the file."""
    speed: float | None = None
    """Rated speed [rad/s]; None: that of the file."""


@dataclass(frozen=True)
class RobotEntry:
    """A robot: sources of its file, and what an articulation config of it needs."""

    title: str
    """Name and kind."""
    sources: tuple[tuple[str, str, str | None], ...]
    """Source, name there and file there, the best first; see :func:`stripe_newton.assets.find_robot`."""
    fixed_base: bool
    """Whether the base is held in the world: arms and hands. Robots with legs and wings float."""
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Initial position of the base [m]."""
    joint_pos: Mapping[str, float] = field(default_factory=dict)
    """Initial positions of joints by expression [rad or m]; the others begin as the file says."""
    keyframe: str | None = None
    """Keyframe of the file that is the initial pose, in place of ``joint_pos``."""
    drives: Mapping[str, Drive] = field(default_factory=dict)
    """Drives by the name of their group; joints in none keep those of the file."""
    get: str = ""
    """How to get the file where no source has it."""


def _menagerie(folder: str, file: str, description: str) -> tuple[tuple[str, str, str | None], ...]:
    return ("menagerie", folder, file), ("descriptions", f"{description}_mj_description", None)


def _unitree_legs(efforts: Pair, speeds: Pair, gain: float, rate: float) -> dict[str, Drive]:
    """Drives of the hips and thighs, and of the knees, of a quadruped of Unitree."""
    return {
        "hips": Drive(".*_(hip|thigh)_joint", gain, rate, efforts[0], speeds[0]),
        "knees": Drive(".*_calf_joint", gain, rate, efforts[1], speeds[1]),
    }


_CROUCH = {".*_hip_joint": 0.0, ".*_thigh_joint": 0.9, ".*_calf_joint": -1.8}
"""Standing pose of Unitree's quadrupeds."""
_ANYMAL_STAND = {".*HAA": 0.0, ".*F_HFE": 0.4, ".*H_HFE": -0.4, ".*F_KFE": -0.8, ".*H_KFE": 0.8}
_UR_HOME = {
    "shoulder_pan(_joint)?": -1.5708, "shoulder_lift(_joint)?": -1.5708, "elbow(_joint)?": 1.5708,
    "wrist_(1|2)(_joint)?": -1.5708, "wrist_3(_joint)?": 0.0,
}  # fmt: skip
_FRANKA_HOME = {"1": 0.0, "2": 0.0, "3": 0.0, "4": -1.57079, "5": 0.0, "6": 1.57079, "7": -0.7853}
_HAND = (0.0, 0.0, 0.5)
"""Position of hands: clear of the ground."""
_NO_DIGIT = (
    "no package publishes Digit's file: Agility Robotics gives it to owners of the robot; "
    "robot_cfg('digit', path=FILE) then takes it"
)

ROBOTS: dict[str, RobotEntry] = {
    # -- quadrupeds
    "go1": RobotEntry(
        "Unitree Go1, a quadruped",
        (
            ("mjlab", "unitree_go1", "asset_zoo/robots/unitree_go1/xmls/go1.xml"),
            *_menagerie("unitree_go1", "go1.xml", "go1"),
        ),
        fixed_base=False,
        pos=(0.0, 0.0, 0.3),
        joint_pos=_CROUCH,
        drives=_unitree_legs((23.7, 35.55), (30.1, 20.06), 80.0, 2.0),
    ),
    "go2": RobotEntry(
        "Unitree Go2, a quadruped",
        (*_menagerie("unitree_go2", "go2.xml", "go2"), ("newton", "unitree_go2", None)),
        fixed_base=False,
        pos=(0.0, 0.0, 0.3),
        joint_pos=_CROUCH,
        drives=_unitree_legs((23.7, 45.43), (30.1, 15.7), 80.0, 2.0),
    ),
    "a1": RobotEntry(
        "Unitree A1, a quadruped",
        _menagerie("unitree_a1", "a1.xml", "a1"),
        fixed_base=False,
        pos=(0.0, 0.0, 0.29),
        joint_pos=_CROUCH,
        drives=_unitree_legs((33.5, 33.5), (21.0, 21.0), 80.0, 2.0),
    ),
    "b2": RobotEntry(
        "Unitree B2, a quadruped",
        (("descriptions", "b2_description", None),),
        fixed_base=False,
        pos=(0.0, 0.0, 0.5),
        joint_pos=_CROUCH,
        drives=_unitree_legs((200.0, 320.0), (23.0, 14.0), 600.0, 15.0),
    ),
    "spot": RobotEntry(
        "Boston Dynamics Spot, a quadruped",
        _menagerie("boston_dynamics_spot", "spot.xml", "spot"),
        fixed_base=False,
        pos=(0.0, 0.0, 0.48),
        joint_pos={".*_hx": 0.0, ".*_hy": 1.04, ".*_kn": -1.8},
        drives={"legs": Drive(".*_(hx|hy|kn)", 500.0, 40.0)},
    ),
    "anymal_b": RobotEntry(
        "ANYbotics ANYmal B, a quadruped",
        _menagerie("anybotics_anymal_b", "anymal_b.xml", "anymal_b"),
        fixed_base=False,
        pos=(0.0, 0.0, 0.58),
        joint_pos=_ANYMAL_STAND,
        drives={"legs": Drive(".*(HAA|HFE|KFE)", 150.0, 5.0, 40.0, 15.0)},
    ),
    "anymal_c": RobotEntry(
        "ANYbotics ANYmal C, a quadruped",
        (*_menagerie("anybotics_anymal_c", "anymal_c.xml", "anymal_c"), ("newton", "anybotics_anymal_c", None)),
        fixed_base=False,
        pos=(0.0, 0.0, 0.6),
        joint_pos=_ANYMAL_STAND,
        drives={"legs": Drive(".*(HAA|HFE|KFE)", 200.0, 5.0, 80.0, 7.5)},
    ),
    "anymal_d": RobotEntry(
        "ANYbotics ANYmal D, a quadruped",
        (("descriptions", "anymal_d_description", None), ("newton", "anybotics_anymal_d", None)),
        fixed_base=False,
        pos=(0.0, 0.0, 0.62),
        joint_pos=_ANYMAL_STAND,
        drives={"legs": Drive(".*(HAA|HFE|KFE)", 400.0, 10.0, 80.0, 7.5)},
    ),
    "barkour": RobotEntry(
        "Google Barkour vB, a quadruped",
        _menagerie("google_barkour_vb", "barkour_vb.xml", "barkour_vb"),
        fixed_base=False,
        pos=(0.0, 0.0, 0.26),
        joint_pos={"abduction_.*": 0.0, "hip_.*": 0.5, "knee_.*": 1.0},
    ),
    # -- robots with two legs
    "g1": RobotEntry(
        "Unitree G1, a humanoid",
        (
            ("mjlab", "unitree_g1", "asset_zoo/robots/unitree_g1/xmls/g1.xml"),
            *_menagerie("unitree_g1", "g1.xml", "g1"),
        ),
        fixed_base=False,
        pos=(0.0, 0.0, 0.78),
        joint_pos={".*_hip_pitch_joint": -0.2, ".*_knee_joint": 0.42, ".*_ankle_pitch_joint": -0.23},
        drives={
            "hips": Drive(".*_hip_(pitch|yaw)_joint", 400.0, 10.0, 88.0, 32.0),
            "knees": Drive(".*_(hip_roll|knee)_joint", 500.0, 10.0, 139.0, 20.0),
            "ankles": Drive(".*_ankle_.*_joint", 300.0, 6.0, 50.0, 37.0),
            "waist": Drive("waist_yaw_joint", 400.0, 10.0, 88.0, 32.0),
            "waist_tilt": Drive("waist_(roll|pitch)_joint", 400.0, 10.0, 50.0, 37.0),
            "arms": Drive(".*_(shoulder_.*|elbow|wrist_roll)_joint", 80.0, 2.0, 25.0, 37.0),
            "wrists": Drive(".*_wrist_(pitch|yaw)_joint", 40.0, 1.0, 5.0, 22.0),
        },
    ),
    "h1": RobotEntry(
        "Unitree H1, a humanoid",
        (*_menagerie("unitree_h1", "h1.xml", "h1"), ("newton", "unitree_h1", None)),
        fixed_base=False,
        pos=(0.0, 0.0, 1.02),
        joint_pos={".*_hip_pitch(_joint)?": -0.2, ".*_knee(_joint)?": 0.42, ".*_ankle(_joint)?": -0.26},
        drives={
            "hips": Drive(".*_hip_(yaw|roll|pitch)(_joint)?", 600.0, 16.0, 200.0, 23.0),
            "knees": Drive(".*_knee(_joint)?", 800.0, 16.0, 300.0, 14.0),
            "ankles": Drive(".*_ankle(_joint)?", 600.0, 20.0, 40.0, 9.0),
            "torso": Drive("torso(_joint)?", 600.0, 16.0, 200.0, 23.0),
            "shoulders": Drive(".*_shoulder_(pitch|roll)(_joint)?", 200.0, 4.0, 40.0, 9.0),
            "arms": Drive(".*_(shoulder_yaw|elbow)(_joint)?", 100.0, 2.0, 18.0, 20.0),
        },
    ),
    "t1": RobotEntry(
        "Booster T1, a humanoid",
        _menagerie("booster_t1", "t1.xml", "booster_t1"),
        fixed_base=False,
        keyframe="home",
        drives={
            "legs": Drive(".*(Hip|Knee|Ankle).*|Waist", 200.0, 5.0),
            "upper": Drive(".*(Shoulder|Elbow|[Hh]ead).*", 50.0, 2.0),
        },
    ),
    "cassie": RobotEntry(
        "Agility Cassie, a robot with two legs, springs and closed chains",
        _menagerie("agility_cassie", "cassie.xml", "cassie"),
        fixed_base=False,
        keyframe="home",
        drives={
            "hips": Drive(".*_hip_(roll|yaw)", 100.0, 10.0, 112.5, 12.1),
            "thighs": Drive(".*_hip_pitch", 88.0, 8.0, 195.2, 8.5),
            "knees": Drive(".*_knee", 96.0, 9.6, 195.2, 8.5),
            "feet": Drive(".*_foot", 50.0, 5.0, 45.0, 11.5),
        },
    ),
    "op3": RobotEntry(
        "Robotis OP3, a small humanoid",
        _menagerie("robotis_op3", "op3.xml", "op3"),
        fixed_base=False,
        pos=(0.0, 0.0, 0.28),
    ),
    "digit": RobotEntry("Agility Digit, a humanoid with closed chains", (), fixed_base=False, get=_NO_DIGIT),
    # -- arms
    "panda": RobotEntry(
        "Franka Emika Panda, an arm with a gripper",
        (*_menagerie("franka_emika_panda", "panda.xml", "panda"), ("newton", "franka_emika_panda", None)),
        fixed_base=True,
        joint_pos={f"(panda_)?joint{k}": v for k, v in _FRANKA_HOME.items()} | {".*finger_joint.*": 0.04},
    ),
    "fr3": RobotEntry(
        "Franka Research 3, an arm",
        _menagerie("franka_fr3", "fr3.xml", "fr3"),
        fixed_base=True,
        joint_pos={f"fr3_joint{k}": v for k, v in _FRANKA_HOME.items()},
    ),
    "ur5e": RobotEntry(
        "Universal Robots UR5e, an arm",
        _menagerie("universal_robots_ur5e", "ur5e.xml", "ur5e"),
        fixed_base=True,
        joint_pos=_UR_HOME,
    ),
    "ur10e": RobotEntry(
        "Universal Robots UR10e, an arm",
        _menagerie("universal_robots_ur10e", "ur10e.xml", "ur10e"),
        fixed_base=True,
        joint_pos=_UR_HOME,
    ),
    "ur10": RobotEntry(
        "Universal Robots UR10, an arm",
        (
            ("example_robot_data", "ur_description", "urdf/ur10_robot.urdf"),
            ("newton", "universal_robots_ur10", None),
            ("descriptions", "ur10_description", None),
        ),
        fixed_base=True,
        joint_pos=_UR_HOME,
        drives={
            "shoulder": Drive("shoulder_.*_joint", 20000.0, 2000.0, 330.0, 2.09),
            "elbow": Drive("elbow_joint", 20000.0, 2000.0, 150.0, 3.14),
            "wrist": Drive("wrist_.*_joint", 2000.0, 200.0, 54.0, 3.14),
        },
    ),
    "iiwa14": RobotEntry(
        "KUKA LBR iiwa 14, an arm",
        _menagerie("kuka_iiwa_14", "iiwa14.xml", "iiwa14"),
        fixed_base=True,
        joint_pos={"joint2": 0.785398, "joint4": -1.5708, "joint[13567]": 0.0},
    ),
    "gen3": RobotEntry(
        "Kinova Gen3, an arm", _menagerie("kinova_gen3", "gen3.xml", "gen3"), fixed_base=True, keyframe="home"
    ),
    "xarm7": RobotEntry(
        "UFactory xArm 7, an arm with a gripper",
        _menagerie("ufactory_xarm7", "xarm7.xml", "xarm7"),
        fixed_base=True,
        keyframe="home",
    ),
    "sawyer": RobotEntry(
        "Rethink Robotics Sawyer, an arm",
        _menagerie("rethink_robotics_sawyer", "sawyer.xml", "sawyer"),
        fixed_base=True,
        keyframe="home",
    ),
    "so_arm100": RobotEntry(
        "SO-ARM100, a small arm with a gripper",
        _menagerie("trs_so_arm100", "so_arm100.xml", "so_arm100"),
        fixed_base=True,
        keyframe="home",
    ),
    # -- hands
    "robotiq_2f85": RobotEntry(
        "Robotiq 2F-85, a gripper", _menagerie("robotiq_2f85", "2f85.xml", "robotiq_2f85"), fixed_base=True, pos=_HAND
    ),
    "allegro": RobotEntry(
        "Wonik Allegro, a right hand",
        (*_menagerie("wonik_allegro", "right_hand.xml", "allegro_hand"), ("newton", "wonik_allegro", None)),
        fixed_base=True,
        pos=_HAND,
        joint_pos={"thj0": 0.8},  # 0 is outside of its range
    ),
    "shadow_hand": RobotEntry(
        "Shadow Hand E3M5, a right hand",
        _menagerie("shadow_hand", "right_hand.xml", "shadow_hand"),
        fixed_base=True,
        pos=_HAND,
    ),
    "leap_hand": RobotEntry(
        "LEAP, a right hand", _menagerie("leap_hand", "right_hand.xml", "leap_hand"), fixed_base=True, pos=_HAND
    ),
    # -- furniture
    "sektion_cabinet": RobotEntry(
        "IKEA Sektion, a cabinet with two drawers and two doors",
        (("isaacgymenvs", "sektion_cabinet_model", "urdf/sektion_cabinet_2.urdf"),),
        fixed_base=True,
        pos=(0.0, 0.0, 0.4),
        joint_pos={"(door|drawer)_.*": 0.0},
        drives={
            "drawers": Drive("drawer_.*_joint", 10.0, 1.0),
            "doors": Drive("door_.*_joint", 10.0, 2.5),
        },
    ),
    # -- wings
    "crazyflie": RobotEntry(
        "Bitcraze Crazyflie 2, a quadcopter",
        _menagerie("bitcraze_crazyflie_2", "cf2.xml", "cf2"),
        fixed_base=False,
        pos=(0.0, 0.0, 0.1),
    ),
}
"""The robots by their short names."""
