# SPDX-License-Identifier: Apache-2.0
"""Randomisation events with configs that do not fit: one clear error each, before anything runs."""

from __future__ import annotations

from typing import Any

import pytest

from stripe_kernels import mdp
from stripe_newton.assets import RigidObjectCfg
from stripe_newton.managers import EventManager, EventTermCfg, ManagerContext, SceneEntityCfg
from stripe_newton.sim import CollisionPropertiesCfg, CuboidCfg, MassPropertiesCfg, RigidBodyPropertiesCfg
from tests.helpers.manager_world import manager_context

MASS: dict[str, Any] = {"mass_distribution_params": (0.5, 2.0), "operation": "scale"}
BOX = RigidObjectCfg(
    prim_path="{ENV_REGEX_NS}/Box",
    spawn=CuboidCfg(
        size=(0.2, 0.2, 0.2),
        rigid_props=RigidBodyPropertiesCfg(),
        mass_props=MassPropertiesCfg(mass=2.0),
        collision_props=CollisionPropertiesCfg(),
    ),
)


@pytest.fixture(scope="module")
def context() -> ManagerContext:
    return manager_context(2, "cartpole", objects={"box": BOX})


def problems_of(context: ManagerContext, func: Any, **params: Any) -> list[str]:
    """Error of an event manager about one term."""
    context.problems = []
    EventManager({"term": EventTermCfg(func=func, mode="reset", params=params)}, context).reset_items()
    return [p.removeprefix("events.term.") for p in context.problems]


CART = SceneEntityCfg("robot", joint_names="slider_to_cart")
POLE = SceneEntityCfg("robot", joint_names="cart_to_pole")
WRONG: list[tuple[Any, dict[str, Any], list[str]]] = [
    (mdp.randomize_rigid_body_mass, MASS | {"asset_cfg": SceneEntityCfg("robot", body_names="wheel")},
     ["params.asset_cfg", "wheel", "pole"]),
    (mdp.randomize_rigid_body_mass, MASS | {"asset_cfg": POLE}, ["about bodies of 'robot'", "not joint_names"]),
    (mdp.randomize_actuator_gains, {"asset_cfg": SceneEntityCfg("robot", body_names="pole"),
                                    "damping_distribution_params": (1.0, 2.0)}, ["about joints", "not body_names"]),
    (mdp.randomize_geom_friction, {"asset_cfg": POLE, "ranges": (0.5, 1.0)}, ["bodies of 'robot'", "by body_names"]),
    (mdp.randomize_rigid_body_mass, MASS | {"asset_cfg": SceneEntityCfg("tank")}, ["no asset", "tank", "robot, box"]),
    (mdp.randomize_rigid_body_mass, MASS | {"operation": "double"}, ["operation", "double", "add, scale, abs"]),
    (mdp.randomize_rigid_body_mass, MASS | {"distribution": "normal"}, ["distribution", "uniform, log_uniform, gaus"]),
    (mdp.randomize_rigid_body_mass, {"mass_distribution_params": (0.5, 2.0)}, ["params.operation", "missing"]),
    (mdp.randomize_rigid_body_mass, {"operation": "scale"}, ["mass_distribution_params", "missing"]),
    (mdp.randomize_rigid_body_mass, MASS | {"mass_distribution_params": (2.0, 0.5)}, ["(2.0, 0.5)", "low <= high"]),
    (mdp.randomize_rigid_body_mass, MASS | {"mass_distribution_params": (0.0, 0.5)}, ["must be positive"]),
    (mdp.randomize_rigid_body_mass, MASS | {"mass_distribution_params": 2.0}, ["two numbers"]),
    (mdp.randomize_rigid_body_mass, MASS | {"mass_distribution_params": (0.5, float("inf"))}, ["must be finite"]),
    (mdp.randomize_rigid_body_mass, MASS | {"mass": (0.5, 2.0)}, ["no such argument"]),
    (mdp.randomize_rigid_body_mass, MASS | {"distribution": "gaussian", "mass_distribution_params": (1.0, -0.1)},
     ["standard deviation"]),
    (mdp.randomize_geom_friction, {"ranges": (0.0, 1.0), "distribution": "log_uniform"}, ["positive", "log_uniform"]),
    (mdp.randomize_actuator_gains, {"asset_cfg": POLE, "stiffness_distribution_params": (1.0, 2.0)},
     ["stiffness_distribution_params", "has a drive"]),
    (mdp.randomize_actuator_gains, {"asset_cfg": CART, "stiffness_distribution_params": (1.0, 2.0),
                                    "operation": "scale"}, ["'stiffness', which is 0", "'add' or 'abs'"]),
    (mdp.randomize_joint_parameters, {"asset_cfg": SceneEntityCfg("box"), "friction_distribution_params": (0.0, 1.0)},
     ["'box'", "no joints"]),
    (mdp.randomize_joint_parameters, {"asset_cfg": POLE, "upper_limit_distribution_params": (1.0, 2.0)},
     ["none of these joints has limits"]),
    (mdp.randomize_rigid_body_material, {"static_friction_range": (0.5, 1.0), "restitution_range": (0.0, 0.5)},
     ["restitution_range", "SolverMuJoCo ignores restitution", "(0.0, 0.0)"]),
    (mdp.randomize_rigid_body_material, {"static_friction_range": (-0.5, 1.0)}, ["not negative"]),
    (mdp.randomize_rigid_body_collider_offsets, {"asset_cfg": SceneEntityCfg("box"),
                                                 "rest_offset_distribution_params": (0.0, 0.01)}, ["ignores margins"]),
    (mdp.randomize_geom_pose, {"asset_cfg": SceneEntityCfg("box"), "pose_range": {"height": (0.0, 1.0)}},
     ["'height'", "x, y, z"]),
    (mdp.randomize_geom_pose, {"asset_cfg": SceneEntityCfg("box"), "pose_range": {}, "shape_names": "handle"},
     ["handle"]),
    (mdp.randomize_site_pose, {"pose_range": {}}, ["no sites"]),
    (mdp.randomize_visual_color, {"colors": {"r": (0.0, 1.0), "green": (0.0, 1.0)}}, ["'b', 'g', 'green'"]),
    (mdp.randomize_encoder_bias, {"asset_cfg": SceneEntityCfg("box"), "bias_range": (0.0, 0.1)}, ["no joint encoders"]),
]  # fmt: skip


@pytest.mark.parametrize(("func", "params", "words"), WRONG, ids=[f"{i}-{w[2][0]}" for i, w in enumerate(WRONG)])
def test_a_config_that_does_not_fit_is_one_sentence(context, func, params, words):
    said = problems_of(context, func, **({"asset_cfg": SceneEntityCfg("robot")} | params))
    assert len(said) == 1, said
    assert said[0].startswith("params.")
    assert [w for w in words if w not in said[0]] == [], said[0]


FINE: list[tuple[Any, dict[str, Any]]] = [
    (mdp.randomize_rigid_body_mass, MASS | {"asset_cfg": SceneEntityCfg("box")}),
    (mdp.randomize_rigid_body_mass, MASS | {"mass_distribution_params": (-0.1, 0.1), "operation": "add"}),
    (mdp.randomize_rigid_body_material, {"static_friction_range": (0.5, 1.0), "dynamic_friction_range": (0.4, 0.9),
                                         "restitution_range": (0.0, 0.0), "num_buckets": 250, "make_consistent": True,
                                         "asset_cfg": SceneEntityCfg("box")}),
    (mdp.randomize_actuator_gains, {"asset_cfg": CART, "stiffness_distribution_params": None,
                                    "damping_distribution_params": (0.5, 2.0), "operation": "scale"}),
    (mdp.randomize_joint_parameters, {"asset_cfg": CART, "upper_limit_distribution_params": (-0.5, 0.5),
                                      "operation": "add"}),
    (mdp.randomize_physics_scene_gravity, {"gravity_distribution_params": ([0.0, 0.0, -0.1], [0.0, 0.0, 0.1]),
                                           "operation": "add"}),
]  # fmt: skip


@pytest.mark.parametrize(("func", "params"), FINE, ids=lambda x: getattr(x, "key", "").rpartition(".")[2] or "-")
def test_what_isaac_lab_takes_is_taken(context, func, params):
    assert problems_of(context, func, **params) == []


def test_parameters_without_effect_warn_by_name(context):
    params = {"static_friction_range": (0.5, 1.0), "num_buckets": 250, "asset_cfg": SceneEntityCfg("box")}
    term = EventTermCfg(func=mdp.randomize_rigid_body_material, mode="startup", params=params)
    with pytest.warns(UserWarning, match=r"events\.friction\.params\.num_buckets has no effect: the number of"):
        EventManager({"friction": term}, context).startup_items()
