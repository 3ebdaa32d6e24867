# SPDX-License-Identifier: Apache-2.0
"""Robots that the installed Newton packages, as articulation configs."""

from __future__ import annotations

from newton.examples import get_asset

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.sim import ArticulationRootPropertiesCfg, MassPropertiesCfg, UsdFileCfg

__all__ = ["ANT_CFG", "CARTPOLE_CFG", "CART_DOUBLE_POLE_CFG", "HUMANOID_CFG"]

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
