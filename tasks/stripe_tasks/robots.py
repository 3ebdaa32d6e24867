# SPDX-License-Identifier: Apache-2.0
"""Robots of the tasks as articulation configs: some from the installed Newton, and a quadruped of this package."""

from __future__ import annotations

from pathlib import Path

from newton.examples import get_asset

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.sim import ArticulationRootPropertiesCfg, MassPropertiesCfg, UsdFileCfg

__all__ = ["ANT_CFG", "CARTPOLE_CFG", "CART_DOUBLE_POLE_CFG", "HUMANOID_CFG", "HUMANOID_POSITION_CFG", "QUADRUPED_CFG"]

_ASSETS = Path(__file__).parent / "assets"

_NO_SELF_COLLISION = ArticulationRootPropertiesCfg(enabled_self_collisions=False)

CARTPOLE_CFG = ArticulationCfg(
    spawn=UsdFileCfg(usd_path=get_asset("cartpole_single_pendulum.usda"), articulation_props=_NO_SELF_COLLISION),
    init_state=ArticulationCfg.InitialStateCfg(
        pos=(0.0, 0.0, 2.0), joint_pos={"slider_to_cart": 0.0, "cart_to_pole": 0.0}
    ),
    actuators={
        "cart": ImplicitActuatorCfg(
            joint_names_expr=["slider_to_cart"], effort_limit_sim=400.0, stiffness=0.0, damping=10.0
        ),
        "pole": ImplicitActuatorCfg(
            joint_names_expr=["cart_to_pole"], effort_limit_sim=400.0, stiffness=0.0, damping=0.0
        ),
    },
)
"""A cart on an 8 m rail with one pole, 1 kg each."""

CART_DOUBLE_POLE_CFG = ArticulationCfg(
    spawn=UsdFileCfg(usd_path=get_asset("cartpole.usda"), articulation_props=_NO_SELF_COLLISION),
    init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 2.0)),
    actuators={
        "cart": ImplicitActuatorCfg(
            joint_names_expr=["railCartJoint"], effort_limit_sim=400.0, stiffness=0.0, damping=10.0
        ),
        "poles": ImplicitActuatorCfg(
            joint_names_expr=[".*PoleJoint"], effort_limit_sim=400.0, stiffness=0.0, damping=0.0, viscous_friction=0.01
        ),
    },
)
"""A cart on an 8 m rail with two poles of 0.25 kg and 1 m, one on the other."""

ANT_CFG = ArticulationCfg(
    spawn=UsdFileCfg(
        usd_path=get_asset("ant.usda"),
        articulation_props=_NO_SELF_COLLISION,
        mass_props=MassPropertiesCfg(density=5.0),  # the stage says 1 kg/m^3, the ant's MJCF file 5
    ),
    init_state=ArticulationCfg.InitialStateCfg(
        pos=(0.0, 0.0, 0.5),
        joint_pos={
            ".*_leg": 0.0,
            "front_left_foot": 0.785398,
            "front_right_foot": -0.785398,
            "left_back_foot": -0.785398,
            "right_back_foot": 0.785398,
        },
    ),
    actuators={
        "body": ImplicitActuatorCfg(
            joint_names_expr=[".*"], stiffness=0.0, damping=0.0, viscous_friction=0.1, armature=0.01
        )
    },
)
"""A quadruped of 0.9 kg with eight torque-driven joints."""

HUMANOID_CFG = ArticulationCfg(
    spawn=UsdFileCfg(usd_path=get_asset("humanoid.usda"), articulation_props=_NO_SELF_COLLISION),
    init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 1.34)),
    actuators={
        "body": ImplicitActuatorCfg(
            joint_names_expr=[".*"],
            stiffness={
                "lower_waist:.": 20.0,
                ".*_upper_arm:.": 10.0,
                "abdomen_x": 10.0,
                ".*_elbow": 2.0,
                ".*_thigh:[02]": 10.0,
                ".*_thigh:1": 20.0,
                ".*_knee": 5.0,
                ".*_foot:.": 2.0,
            },
            damping={
                "lower_waist:.": 5.0,
                ".*_upper_arm:.": 5.0,
                "abdomen_x": 5.0,
                ".*_elbow": 1.0,
                ".*_thigh:.": 5.0,
                ".*_knee": 0.1,
                ".*_foot:.": 1.0,
            },
            armature=0.02,
        )
    },
)
"""A humanoid of 41 kg with 21 degrees of freedom, on weak springs about its standing pose."""

HUMANOID_POSITION_CFG = HUMANOID_CFG.replace(
    init_state=ArticulationCfg.InitialStateCfg(
        pos=(0.0, 0.0, 1.256),
        joint_pos={
            ".*_thigh:1": -0.245,
            ".*_knee": -0.6,
            ".*_foot:0": -0.345,
            ".*_upper_arm:0": 0.7,  # the arms hang down
            ".*_upper_arm:1": -0.6,
            ".*_elbow": -1.3,
        },
    ),
    soft_joint_pos_limit_factor=0.9,
    actuators={
        "legs": ImplicitActuatorCfg(
            joint_names_expr=[".*_thigh:.", ".*_knee"],
            stiffness={".*_thigh:[02]": 200.0, ".*_thigh:1": 300.0, ".*_knee": 300.0},
            damping=10.0,
            effort_limit={".*_thigh:[02]": 45.0, ".*_thigh:1": 135.0, ".*_knee": 90.0},
            velocity_limit=20.0,
            armature=0.02,
        ),
        "feet": ImplicitActuatorCfg(
            joint_names_expr=[".*_foot:."],
            stiffness=300.0,
            damping=10.0,
            effort_limit=45.0,
            velocity_limit=20.0,
            armature=0.04,
        ),
        "waist": ImplicitActuatorCfg(
            joint_names_expr=["lower_waist:.", "abdomen_x"],
            stiffness=300.0,
            damping=8.0,
            effort_limit=67.5,
            velocity_limit=20.0,
            armature=0.02,
        ),
        "arms": ImplicitActuatorCfg(
            joint_names_expr=[".*_upper_arm:.", ".*_elbow"],
            stiffness=40.0,
            damping=2.0,
            effort_limit={".*_upper_arm:.": 67.5, ".*_elbow": 45.0},
            velocity_limit=20.0,
            armature=0.02,
        ),
    },
)
"""The humanoid under position control, for velocity commands: its default pose is standing, knees bent. Effort limits
are the gears of Newton's ``nv_humanoid.xml``, twice that at the ankles."""

QUADRUPED_CFG = ArticulationCfg(
    spawn=UsdFileCfg(usd_path=str(_ASSETS / "quadruped.usda"), articulation_props=_NO_SELF_COLLISION),
    init_state=ArticulationCfg.InitialStateCfg(
        pos=(0.0, 0.0, 0.34),
        joint_pos={
            ".L_hip_joint": 0.1,
            ".R_hip_joint": -0.1,
            "F._thigh_joint": 0.8,
            "R._thigh_joint": 1.0,
            ".*_calf_joint": -1.5,
        },
    ),
    soft_joint_pos_limit_factor=0.9,
    actuators={
        "hips": ImplicitActuatorCfg(
            joint_names_expr=[".*_hip_joint", ".*_thigh_joint"],
            stiffness=25.0,
            damping=0.6,
            effort_limit=23.7,
            velocity_limit=30.1,
            armature=0.00448,
        ),
        "knees": ImplicitActuatorCfg(
            joint_names_expr=[".*_calf_joint"],
            stiffness=25.0,
            damping=0.6,
            effort_limit=45.43,
            velocity_limit=15.7,
            armature=0.01647,
        ),
    },
)
"""A quadruped of 15 kg with twelve joints, of the class of Unitree's Go2. ``tools/authoring/author_quadruped.py``
writes its file."""
