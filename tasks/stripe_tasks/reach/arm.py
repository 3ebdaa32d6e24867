# SPDX-License-Identifier: Apache-2.0
"""Arm of the reach task: six joints, similar to Universal Robots' UR5e.

``tools/authoring/author_arm.py`` writes its file.
"""

from __future__ import annotations

from pathlib import Path

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.sim import ArticulationRootPropertiesCfg, UsdFileCfg

__all__ = ["ARM_CFG"]

ARM_CFG = ArticulationCfg(
    spawn=UsdFileCfg(
        usd_path=str(Path(__file__).parents[1] / "assets" / "arm.usda"),
        articulation_props=ArticulationRootPropertiesCfg(enabled_self_collisions=False),
    ),
    init_state=ArticulationCfg.InitialStateCfg(
        joint_pos={
            "shoulder_pan_joint": -0.3,
            "shoulder_lift_joint": -1.7,
            "elbow_joint": 2.0,
            "wrist_1_joint": -1.87,
            "wrist_2_joint": -1.5708,
            "wrist_3_joint": 0.0,
        }
    ),
    actuators={
        "arm": ImplicitActuatorCfg(
            joint_names_expr=["shoulder_.*", "elbow_joint"],
            stiffness=1500.0,
            damping=120.0,
            effort_limit=150.0,
            velocity_limit=3.14,
        ),
        "wrist": ImplicitActuatorCfg(
            joint_names_expr=["wrist_.*"], stiffness=300.0, damping=15.0, effort_limit=28.0, velocity_limit=3.14
        ),
    },
)
"""An arm of 18 kg with a reach of 0.85 m, fixed to the ground. In its default pose the flange faces down."""
