# SPDX-License-Identifier: Apache-2.0
"""Removed tables of terms: the old names warn, and give the table that the decorators declare."""

from __future__ import annotations

import importlib

import pytest

from stripe_kernels.mdp import observations
from stripe_kernels.mdp.objects import observations as object_observations
from stripe_kernels.term_info import Randomization

SIZES = [
    ("stripe_kernels.mdp", "OBSERVATION_SIZES", set(observations.__all__)),
    ("stripe_kernels.mdp.observations", "OBSERVATION_SIZES", set(observations.__all__)),
    ("stripe_newton.envs.mdp", "OBSERVATION_SIZES", set(observations.__all__)),
    ("stripe_kernels.mdp.objects", "OBJECT_OBSERVATION_SIZES", set(object_observations.__all__)),
    ("stripe_kernels.mdp.objects.observations", "OBJECT_OBSERVATION_SIZES", set(object_observations.__all__)),
    ("stripe_newton.envs.mdp", "OBJECT_OBSERVATION_SIZES", set(object_observations.__all__)),
    (
        "stripe_kernels.mdp.contact",
        "CONTACT_OBSERVATION_SIZES",
        {"feet_contact", "feet_contact_forces", "feet_current_air_time"},
    ),
    (
        "stripe_kernels.mdp.imu",
        "IMU_OBSERVATION_SIZES",
        {"imu_ang_vel", "imu_lin_acc", "imu_orientation", "imu_projected_gravity"},
    ),
    (
        "stripe_kernels.mdp.obstacles",
        "OBSTACLE_OBSERVATION_SIZES",
        {"height_scan_over", "obstacle_distance", "obstacle_proximity"},
    ),
    ("stripe_kernels.mdp.scan", "SCAN_OBSERVATION_SIZES", {"height_scan"}),
    (
        "stripe_kernels.mdp.randomization_encoder",
        "ENCODER_OBSERVATION_SIZES",
        {"joint_pos_biased", "joint_pos_rel_biased"},
    ),
]
RANDOMIZATIONS = [
    ("randomization_bodies", "BODY_RANDOMIZATIONS", 4),
    ("randomization_encoder", "ENCODER_RANDOMIZATIONS", 1),
    ("randomization_joints", "JOINT_RANDOMIZATIONS", 5),
    ("randomization_scene", "SCENE_RANDOMIZATIONS", 1),
    ("randomization_shapes", "SHAPE_RANDOMIZATIONS", 7),
]


@pytest.mark.parametrize(("module", "name", "terms"), SIZES, ids=[f"{m}.{n}" for m, n, _ in SIZES])
def test_a_removed_table_of_sizes_warns_and_holds_every_observation(module, name, terms):
    with pytest.warns(DeprecationWarning, match=rf"{module}\.{name} has been removed: use observation_size") as record:
        table = getattr(importlib.import_module(module), name)
    assert set(table) == terms
    assert record[0].filename == __file__


def test_sizes_are_functions_of_the_counts():
    with pytest.warns(DeprecationWarning, match="OBSERVATION_SIZES has been removed"):
        from stripe_kernels.mdp import OBSERVATION_SIZES
    assert OBSERVATION_SIZES["body_pose_w"]({"body_ids": 4}) == 28
    assert OBSERVATION_SIZES["base_lin_vel"]({}) == 3


@pytest.mark.parametrize(("module", "name", "count"), RANDOMIZATIONS, ids=[n for _, n, _ in RANDOMIZATIONS])
def test_a_removed_table_of_randomisations_warns_and_holds_every_event(module, name, count):
    with pytest.warns(DeprecationWarning, match=rf"{name} has been removed: use randomization_of"):
        table = getattr(importlib.import_module(f"stripe_kernels.mdp.{module}"), name)
    assert len(table) == count
    assert all(isinstance(value, Randomization) for value in table.values())


def test_the_class_randomization_is_forwarded_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"has moved to stripe_kernels\.term_info\.Randomization"):
        from stripe_kernels.mdp.randomization import Randomization as Old
    assert Old is Randomization


@pytest.mark.parametrize("module", sorted({m for m, _, _ in SIZES} | {"stripe_kernels.mdp.randomization"}))
def test_other_names_are_not_found(module):
    with pytest.raises(AttributeError, match="has no attribute 'OBSERVATION_SIZE'"):
        _ = importlib.import_module(module).OBSERVATION_SIZE
