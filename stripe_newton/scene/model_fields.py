# SPDX-License-Identifier: Apache-2.0
"""Model fields: the arrays of Newton's model behind the structs that randomising events take."""

from __future__ import annotations

from stripe_kernels.model_data import BodyModelData, JointModelData, SceneModelData, ShapeModelData
from stripe_newton.fusion.warp_types import Struct

__all__ = ["MODEL_FIELDS"]

MODEL_FIELDS: dict[Struct, dict[str, str]] = {
    BodyModelData: {
        "mass": "body_mass",
        "inv_mass": "body_inv_mass",
        "inertia": "body_inertia",
        "inv_inertia": "body_inv_inertia",
        "com": "body_com",
    },
    JointModelData: {
        "stiffness": "joint_target_ke",
        "damping": "joint_target_kd",
        "effort_limit": "joint_effort_limit",
        "friction": "joint_friction",
        "armature": "joint_armature",
        "passive_stiffness": "joint_stiffness",
        "passive_damping": "joint_damping",
        "lower": "joint_limit_lower",
        "upper": "joint_limit_upper",
    },
    ShapeModelData: {
        "friction": "shape_material_mu",
        "torsional_friction": "shape_material_mu_torsional",
        "rolling_friction": "shape_material_mu_rolling",
        "restitution": "shape_material_restitution",
        "margin": "shape_margin",
        "gap": "shape_gap",
        "pose": "shape_transform",
        "size": "shape_scale",
        "radius": "shape_collision_radius",
        "color": "shape_color",
    },
    SceneModelData: {"gravity": "gravity"},
}
"""Arrays of ``newton.Model`` behind the fields of each struct."""
