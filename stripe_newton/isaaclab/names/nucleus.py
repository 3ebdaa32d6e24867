# SPDX-License-Identifier: Apache-2.0
"""Nucleus assets: tables of the robots and props that replace those of NVIDIA's server, and of those with none.

Paths are relative to ``ISAAC_NUCLEUS_DIR``, whose folder ``IsaacLab`` is ``ISAACLAB_NUCLEUS_DIR``. A robot's file from
elsewhere has other names for its joints and bodies than NVIDIA's: tasks find those of NVIDIA's file, by the tables of
each entry. New names are by expression for the names of the file, and refer to groups as ``\\1``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["ABSENT", "ACTUATOR_NETS", "POINTERS", "PROPS", "ROBOTS", "Pointer", "Prop", "Robot"]

Size = tuple[float, float, float]


@dataclass(frozen=True)
class Robot:
    """A robot that stands for one of NVIDIA's."""

    paths: tuple[str, ...]
    """Paths of NVIDIA's files."""
    name: str = ""
    """Its name for :func:`stripe_newton.assets.find_robot`."""
    asset: str = ""
    """Or the file in Newton's own examples."""
    file: str = ""
    """Or a file in the folder ``models`` of the dialect; with a name, where that one's file is not on this machine."""
    cfg: str = ""
    """Or a spawner config class, as ``"module:Class"``."""
    drives: bool = False
    """Whether drives of the other file stand for those of NVIDIA's; else there are those of the config alone."""
    fixed_base: bool | None = None
    """Whether NVIDIA's file holds the base in the world; None for what the other file says."""
    joints: Mapping[str, str] = field(default_factory=dict)
    """NVIDIA's names of joints."""
    bodies: Mapping[str, str] = field(default_factory=dict)
    """NVIDIA's names of bodies."""
    links: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """NVIDIA's bodies that are shapes in the other file: name and expression for the shapes, by that for the body."""
    order: tuple[str, ...] = ()
    """NVIDIA's order of the joints where it is not by depth in the tree and by name."""
    root: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    """Pose of the other file's root body in the frame of NVIDIA's file: position [m], quaternion (x, y, z, w)."""
    absent: tuple[str, ...] = ()
    """NVIDIA's joints that the other file lacks. What a config says of these alone is left out."""
    present: tuple[str, ...] = ()
    """NVIDIA's other joints, where some are absent."""
    driven_like: Mapping[str, str] = field(default_factory=dict)
    """Joints that NVIDIA's file lacks, by expression: they are driven like this joint of NVIDIA's."""
    tendons: Mapping[str, tuple[Mapping[str, float], tuple[float, float]]] = field(default_factory=dict)
    """Fixed tendons of NVIDIA's file: coefficients by the other file's joints, and limits of the length."""
    density: float | None = None
    """Density [kg/m^3] in place of the file's."""
    note: str = ""
    """Differences to NVIDIA's file, in one line."""


@dataclass(frozen=True)
class Pointer:
    """A pointer of the package that stands for one of NVIDIA's."""

    paths: tuple[str, ...]
    """Paths of NVIDIA's files."""
    kind: str
    """``"arrow"`` or ``"frame"``."""


@dataclass(frozen=True)
class Prop:
    """A primitive that stands for a prop of NVIDIA's."""

    paths: tuple[str, ...]
    """Paths of NVIDIA's files."""
    size: Size
    """Edges of the box [m]."""
    center: Size = (0.0, 0.0, 0.0)
    """Its centre in the prop's frame [m]."""
    color: Size = (0.6, 0.6, 0.6)
    """Colour, linear RGB."""
    movable: bool = True
    """Whether it is a rigid body; else it is a static collider."""
    note: str = ""
    """Where the size is from, in one line."""


_UNITREE_FEET = {r"([FR][LR])_calf": (r"\1_foot", r"\1(_foot_collision|_calf_geom_2)?")}
_GO2_FEET = {r"([FR][LR])_calf": (r"\1_foot", r"\1")}
_ANYMAL_B_FEET = {r"([LR][FH])_SHANK": (r"\1_FOOT", r"\1_SHANK_geom_2")}
_ANYMAL_C_FEET = {r"([LR][FH])_SHANK": (r"\1_FOOT", r"\1_SHANK_geom_3")}
_SPOT_FEET = {f"{leg}_lleg": (f"{leg}_foot", leg.upper()) for leg in ("fl", "fr", "hl", "hr")}
_SIDES = ("left", "right")
_G1_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow_pitch", "elbow_roll")
_G1_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_G1_FINGERS = ("zero", "one", "two", "three", "four", "five", "six")
_FINGERS = {"ff": "index", "mf": "middle", "rf": "ring", "th": "thumb"}
_PHALANGES = {"base": "0", "proximal": "1", "medial": "2", "distal": "3"}

ROBOTS = (
    # -- of Newton's own examples
    Robot(
        ("IsaacLab/Robots/Classic/Cartpole/cartpole.usd",),
        asset="cartpole_single_pendulum.usda",
        note="Newton's cart-pole, cart and pole of 1 kg",
    ),
    Robot(
        ("IsaacLab/Robots/Classic/CartDoublePendulum/cart_double_pendulum.usd",),
        asset="cartpole.usda",
        joints={
            "railCartJoint": "slider_to_cart",
            "cartPoleJoint": "cart_to_pole",
            "polePoleJoint": "pole_to_pendulum",
        },
        bodies={"rail": "slider", "pole1": "pole", "pole2": "pendulum"},
        note="Newton's cart with two poles of 0.25 kg",
    ),
    Robot(
        ("Robots/IsaacSim/Ant/ant_instanceable.usd",),
        asset="ant.usda",
        density=5.0,
        note="Newton's ant with the density of its MJCF file, 5 kg/m^3",
    ),
    Robot(
        ("Robots/IsaacSim/Humanoid/humanoid_instanceable.usd",),
        asset="humanoid.usda",
        joints={
            "abdomen_x": "pelvis",
            "(left|right)_elbow": r"\1_lower_arm",
            "(left|right)_knee": r"\1_shin",
        },
        # Isaac Lab's task lists the gears of the joints in this order.
        order=(
            "lower_waist",
            "right_upper_arm",
            "left_upper_arm",
            "pelvis",
            "right_lower_arm",
            "left_lower_arm",
            "right_thigh",
            "left_thigh",
            "right_shin",
            "left_shin",
            "right_foot",
            "left_foot",
        ),
        note="Newton's humanoid",
    ),
    # -- of the dialect
    Robot(
        ("Robots/NVIDIA/Jetbot/jetbot.usd", "Robots/Jetbot/jetbot.usd"),
        file="jetbot.xml",
        drives=True,
        note="a drawing of its own: wheels of 30 mm radius, 112.5 mm apart, 0.9 kg",
    ),
    Robot(
        ("IsaacLab/Robots/Classic/Humanoid28/humanoid_28.usd",),
        file="humanoid_28.xml",
        drives=True,
        note="a humanoid with AMP's published sizes and gains; it has three hinges in a row where NVIDIA's joints take"
        " rotation vectors, as the motion files do: joints of these differ by up to 7 (run), 20 (walk) and 51 degrees"
        " (dance)",
    ),
    Robot(
        ("Props/Sektion_Cabinet/sektion_cabinet_instanceable.usd",),
        "sektion_cabinet",
        file="sektion_cabinet.xml",
        fixed_base=True,
        note="where its file is not on this machine, boards with the sizes, joints and handles of NVIDIA's",
    ),
    # -- quadrupeds
    Robot(("IsaacLab/Robots/Unitree/A1/a1.usd",), "a1", links=_UNITREE_FEET),
    Robot(("IsaacLab/Robots/Unitree/Go1/go1.usd",), "go1", links=_UNITREE_FEET),
    Robot(
        ("IsaacLab/Robots/Unitree/Go2/go2.usd",),
        "go2",
        bodies={"base(_link)?": "base"},
        links=_GO2_FEET,
    ),
    Robot(
        (
            "IsaacLab/Robots/ANYbotics/ANYmal-C/anymal_c.usd",
            "Robots/ANYbotics/anymal_c/anymal_c.usd",
            "Robots/ANYbotics/anymal_instanceable.usd",
        ),
        "anymal_c",
        links=_ANYMAL_C_FEET,
    ),
    Robot(("IsaacLab/Robots/ANYbotics/ANYmal-B/anymal_b.usd",), "anymal_b", links=_ANYMAL_B_FEET),
    Robot(
        (
            "IsaacLab/Robots/ANYbotics/ANYmal-D/anymal_d.usd",
            "IsaacLab/Robots/ANYbotics/ANYmal-D/anymal_d_minimal.usd",
        ),
        "anymal_d",
        fixed_base=False,
    ),
    Robot(("Robots/BostonDynamics/spot/spot.usd",), "spot", links=_SPOT_FEET),
    # -- robots with two legs
    Robot(("IsaacLab/Robots/Unitree/H1/h1.usd", "IsaacLab/Robots/Unitree/H1/h1_minimal.usd"), "h1"),
    Robot(
        ("IsaacLab/Robots/Unitree/G1/g1.usd", "IsaacLab/Robots/Unitree/G1/g1_minimal.usd", "Robots/Unitree/G1/g1.usd"),
        "g1",
        joints={
            "waist_yaw_joint": "torso_joint",
            "(left|right)_elbow_joint": r"\1_elbow_pitch_joint",
            "(left|right)_wrist_roll_joint": r"\1_elbow_roll_joint",
        },
        bodies={
            "(left|right)_elbow_link": r"\1_elbow_pitch_link",
            "(left|right)_wrist_roll_link": r"\1_elbow_roll_link",
        },
        absent=tuple(f"{side}_{finger}_joint" for side in _SIDES for finger in _G1_FINGERS),
        present=("torso_joint", *(f"{side}_{part}_joint" for side in _SIDES for part in (*_G1_LEG, *_G1_ARM))),
        driven_like={
            "waist_(roll|pitch)_joint": "torso_joint",
            "left_wrist_(pitch|yaw)_joint": "left_elbow_roll_joint",
            "right_wrist_(pitch|yaw)_joint": "right_elbow_roll_joint",
        },
        note="a G1 with 29 joints: three in the waist and in each wrist, no fingers; NVIDIA's has 37, with fingers",
    ),
    Robot(("Robots/Agility/Digit/digit_v4.usd",), "digit"),
    # -- arms
    Robot(
        (
            "IsaacLab/Robots/FrankaEmika/panda_instanceable.usd",
            "IsaacLab/Robots/FrankaEmika/panda2_instanceable.usd",
            "Robots/Franka/franka.usd",
        ),
        "panda",
        fixed_base=True,
        joints={r"joint(\d)": r"panda_joint\1", r"finger_joint(\d)": r"panda_finger_joint\1"},
        bodies={r"link(\d)": r"panda_link\1", "hand": "panda_hand", r"(left|right)_finger": r"panda_\1finger"},
    ),
    Robot(
        ("Robots/UniversalRobots/ur10e/ur10e.usd",),
        "ur10e",
        fixed_base=True,
        bodies={"base": "base_link"},
    ),
    Robot(("IsaacLab/Robots/UniversalRobots/UR10/ur10_instanceable.usd",), "ur10", fixed_base=True),
    # -- hands
    Robot(
        ("Robots/WonikRobotics/AllegroHand/allegro_hand_instanceable.usd",),
        "allegro",
        fixed_base=True,
        joints={rf"{old}j(\d)": rf"{new}_joint_\1" for old, new in _FINGERS.items()},
        bodies={"palm": "palm_link"}
        | {f"{f}_{p}": f"{new}_link_{k}" for f, new in _FINGERS.items() for p, k in _PHALANGES.items()},
        # NVIDIA's file begins at the mount below the palm, as the description of Kuka's arm with this hand.
        root=(-0.0053, -0.0076, 0.1339, 0.0, 0.0, -0.9238795, 0.3826834),
    ),
    Robot(
        ("Robots/ShadowRobot/ShadowHand/shadow_hand_instanceable.usd",),
        "shadow_hand",
        fixed_base=True,
        # Shadow's names count joints from 1, those of NVIDIA's file from 0.
        joints={rf"rh_(..J){k + 1}": rf"robot0_\g<1>{k}" for k in range(5)},
        bodies={r"rh_(\w+)": r"robot0_\1"},
        # NVIDIA's file has the hand lying on its back, fingers along -y.
        root=(0.0, 0.0, 0.0, 0.0, -0.70710678, 0.70710678, 0.0),
        # The real hand moves the two outer joints of a finger by one tendon; numbers of Shadow's description.
        tendons={
            f"robot0_T_{finger}J1c": ({f"rh_{finger}J1": 0.00705, f"rh_{finger}J2": -0.00805}, (-0.001, 0.001))
            for finger in ("FF", "MF", "RF", "LF")
        },
        note="the joint at the tip of the thumb, THJ0, turns from -0.26 to 1.57 rad, NVIDIA's from -1.57 to 0",
    ),
    # -- wings
    Robot(
        ("Environments/Terrains/rough_plane.usd",),
        cfg="stripe_newton.isaaclab.rough_plane:RoughPlaneCfg",
        note="a square of 20 m of bumpy ground",
    ),
    Robot(
        ("Robots/Bitcraze/Crazyflie/cf2x.usd",),
        cfg="stripe_newton.isaaclab.quadcopter:CrazyflieCfg",
        note="a body of 28 g with the published inertia, and four rotors of 0.3 g",
    ),
)
"""Robots that have a file."""

_BLOCK = "a cube of 46.8 mm: the height that Isaac Lab's stacking task expects between stacked cubes"

PROPS = (
    Prop(
        ("Props/Blocks/DexCube/dex_cube_instanceable.usd",),
        size=(0.065, 0.065, 0.065),
        color=(0.7, 0.35, 0.1),
        note="a cube of 65 mm in one colour, as Isaac Gym's of the same name",
    ),
    *(
        Prop((f"Props/Blocks/{name}_block.usd",), size=(0.0468, 0.0468, 0.0468), color=color, note=_BLOCK)
        for name, color in (
            ("red", (0.6, 0.05, 0.05)),
            ("green", (0.05, 0.45, 0.1)),
            ("blue", (0.05, 0.1, 0.6)),
            ("yellow", (0.7, 0.6, 0.05)),
        )
    ),
    Prop(
        ("Props/Mounts/SeattleLabTable/table_instanceable.usd",),
        size=(1.0, 1.4, 1.05),
        center=(0.0, 0.0, -0.525),
        color=(0.55, 0.5, 0.45),
        movable=False,
        note="a box with the table's top at z = 0 and its feet at z = -1.05 m, where the tasks put the ground",
    ),
    Prop(
        ("Props/Mounts/Stand/stand_instanceable.usd",),
        size=(0.2, 0.2, 1.0),
        center=(0.0, 0.0, -0.5),
        color=(0.3, 0.3, 0.32),
        movable=False,
        note="a box below z = 0",
    ),
)
"""Props that are primitives."""

POINTERS = (
    Pointer(("Props/UIElements/arrow_x.usd",), "arrow"),
    Pointer(("Props/UIElements/frame_prim.usd",), "frame"),
)
"""Prototypes of markers: arrows of 1 m."""

ACTUATOR_NETS: dict[str, tuple[float, float]] = {
    "IsaacLab/ActuatorNets/ANYbotics/anydrive_3_lstm_jit.pt": (40.0, 5.0),
    "IsaacLab/ActuatorNets/Unitree/unitree_go1.pt": (25.0, 0.5),
}
"""Stiffness [N m/rad] and damping [N m s/rad] of the PD law that stands for a network: those that Isaac Lab has for the
same drive, and for Unitree's other quadrupeds."""

_SERVER = "only NVIDIA's server has it; give usd_path the path of a file of your own"

ABSENT: dict[str, str] = {
    r".*/Cassie/.*": "the published files of Cassie have closed chains and springs, NVIDIA's is a tree with six driven "
    f"joints a leg: {_SERVER}",
    r".*/ur10/ur10\.usd": f"the UR10 with a gripper: {_SERVER}, or use UR10_CFG",
    r".*Robots/Kinova/.*": f"Kinova's arm: {_SERVER}",
    r".*Robots/RethinkRobotics/.*": f"Sawyer: {_SERVER}",
    r".*Robots/(Agibot|Galbot|FourierIntelligence|OpenArm|NTNU|Clearpath|KukaAllegro)/.*": f"the robot: {_SERVER}",
    r".*": _SERVER,
}
"""Missing things and how to get them, by expression for the path; the first that matches counts."""
