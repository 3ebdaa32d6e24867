# SPDX-License-Identifier: Apache-2.0
"""Randomisation terms on a quadruped, against references in float64; they leave everything else alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stripe_kernels import mdp
from stripe_newton.managers import EventTermCfg, SceneEntityCfg
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers.randomization_world import RandomizedWorld, all_arrays
from tests.helpers.term_reference_random import Stream

SEED, N = 5, 4


def term(func: Any, bodies: str | None = None, joints: str | None = None, **params: Any) -> EventTermCfg:
    cfg = SceneEntityCfg("robot", body_names=bodies, joint_names=joints)
    return EventTermCfg(func=func, mode="reset", params={"asset_cfg": cfg, **params})


POSES = {"x": (-0.02, 0.02), "z": (0.0, 0.01), "roll": (-0.3, 0.3), "yaw": (-0.5, 0.5)}
AXES = ("x", "y", "z", "roll", "pitch", "yaw")
COM = {"x": (-0.02, 0.03), "y": (-0.01, 0.01)}
PSEUDO = {"alpha": (-0.1, 0.1), "d1": (-0.1, 0.2), "s12": (-0.05, 0.05), "s23": (-0.1, 0.0), "t1": (-0.02, 0.02)}
GRAVITY = ([0.0, -0.5, -1.0], [0.0, 0.5, 1.0])
EVENTS = {
    "mass": term(mdp.randomize_rigid_body_mass, ".*_thigh", mass_distribution_params=(0.5, 2.0), operation="scale",
                 distribution="log_uniform"),
    "added": term(mdp.randomize_rigid_body_mass, "F._foot", mass_distribution_params=(-1.0, 0.5), operation="add",
                  recompute_inertia=False, min_mass=0.02),
    "inertia": term(mdp.randomize_rigid_body_inertia, ".*_calf", inertia_distribution_params=(0.8, 1.2),
                    operation="scale", diagonal_only=False),
    "com": term(mdp.randomize_rigid_body_com, ".*_hip", com_range=COM),
    "pseudo": term(mdp.randomize_pseudo_inertia, "base", **{f"{k}_range": v for k, v in PSEUDO.items()}),
    "gains": term(mdp.randomize_actuator_gains, joints=".*_hip_joint", stiffness_distribution_params=(1.0, 0.1),
                  damping_distribution_params=(0.9, 0.2), operation="scale", distribution="gaussian"),
    "pd": term(mdp.randomize_pd_gains, joints=".*_calf_joint", kp_range=(0.9, 1.1), kd_range=(0.8, 1.3)),
    "effort": term(mdp.randomize_effort_limits, joints=".*_thigh_joint", effort_limit_range=(0.5, 1.0)),
    "joints": term(mdp.randomize_joint_parameters, joints="F.*", friction_distribution_params=(0.0, 0.2),
                   armature_distribution_params=(0.001, 0.01), lower_limit_distribution_params=(-0.3, 0.3),
                   upper_limit_distribution_params=(-0.3, 0.3), stiffness_distribution_params=(0.0, 1.0),
                   damping_distribution_params=(0.0, 0.1), operation="add"),
    "crossed": term(mdp.randomize_joint_parameters, joints="RL_hip_joint", lower_limit_distribution_params=(0.5, 0.6),
                    upper_limit_distribution_params=(0.1, 0.2)),
    "default_pos": term(mdp.randomize_joint_default_pos, joints=".*_calf_joint", ranges=(-0.1, 0.1)),
    "material": term(mdp.randomize_rigid_body_material, "F._foot", static_friction_range=(0.3, 1.2),
                     dynamic_friction_range=(0.2, 0.9), restitution_range=(0.0, 0.0), num_buckets=64),
    "friction": term(mdp.randomize_geom_friction, "R._foot", ranges=(0.5, 1.5), torsional_range=(0.001, 0.02),
                     operation="abs"),
    "offsets": term(mdp.randomize_rigid_body_collider_offsets, ".*_foot",
                    contact_offset_distribution_params=(0.001, 0.01)),
    "pose": term(mdp.randomize_geom_pose, "base", pose_range=POSES, shape_names="trunk"),
    "site": term(mdp.randomize_site_pose, "base", pose_range=POSES),
    "size": term(mdp.randomize_geom_size, ".*_thigh|FL_foot", ranges=(0.8, 1.2)),
    "alike": term(mdp.randomize_geom_size, ".*_calf", ranges=(0.8, 1.2), shared_random=True),
    "color": term(mdp.randomize_visual_color, "base", colors={"r": (0.1, 0.3), "g": (0.0, 1.0), "b": (0.5, 0.5)}),
    "encoder": term(mdp.randomize_encoder_bias, joints="FL.*", bias_range=(-0.05, 0.05)),
    "gravity": term(mdp.randomize_physics_scene_gravity, gravity_distribution_params=GRAVITY, operation="add"),
}  # fmt: skip


class Reference:
    """Expected content of all arrays of Newton's model, in float64."""

    def __init__(self, world: RandomizedWorld):
        self.world, self.stream = world, Stream(SEED, world.context.num_envs)
        self.arrays = {n: world.default(n).astype(float) for n in world.scene.controller.randomized}
        self.default_pos = world.robot.data.default_joint_pos.numpy().astype(float)
        self.bias = np.zeros_like(self.default_pos)

    def bodies(self, names: str) -> list[int]:
        return self.world.robot.find_bodies(names)[0]

    def joints(self, names: str) -> tuple[list[int], list[int]]:
        ids = self.world.robot.find_joints(names)[0]
        return ids, [self.world.robot.layout.dofs[i] for i in ids]

    def shapes(self, bodies: str, names: str = "", flag: int = 2) -> list[int]:
        template, wanted = self.world.sim.template, self.bodies(bodies)
        ids = [i for i, b in enumerate(template.shape_body) if b in wanted and template.shape_flags[i] & flag]
        return [i for i in ids if names in template.shape_label[i]]

    def run(self) -> None:
        a, s, u = self.arrays, self.stream, self.stream.uniform
        for b in self.bodies(".*_thigh"):
            factor = np.exp(u(np.log(0.5), np.log(2.0)))
            a["body_mass"][:, b] *= factor
            a["body_inertia"][:, b] *= factor[:, None, None]
        for b in self.bodies("F._foot"):
            a["body_mass"][:, b] = np.maximum(a["body_mass"][:, b] + u(-1.0, 0.5), 0.02)
        for b in self.bodies(".*_calf"):
            a["body_inertia"][:, b] *= u(0.8, 1.2)[:, None, None]
        offset = s.rows([COM.get(k, (0.0, 0.0)) for k in AXES[:3]])
        a["body_com"][:, self.bodies(".*_hip")] += offset[:, None]
        self._pseudo(self.bodies("base")[0])
        for d in self.joints(".*_hip_joint")[1]:
            a["joint_target_ke"][:, d] = np.maximum(a["joint_target_ke"][:, d] * (1.0 + 0.1 * s.normal()), 0.0)
            a["joint_target_kd"][:, d] = np.maximum(a["joint_target_kd"][:, d] * (0.9 + 0.2 * s.normal()), 0.0)
        for d in self.joints(".*_calf_joint")[1]:
            a["joint_target_ke"][:, d] *= u(0.9, 1.1)
            a["joint_target_kd"][:, d] *= u(0.8, 1.3)
        for d in self.joints(".*_thigh_joint")[1]:
            a["joint_effort_limit"][:, d] *= u(0.5, 1.0)
        for d in self.joints("F.*")[1]:
            for name, bounds in (
                ("joint_friction", (0.0, 0.2)), ("joint_armature", (0.001, 0.01)), ("joint_limit_lower", (-0.3, 0.3)),
                ("joint_limit_upper", (-0.3, 0.3)), ("joint_stiffness", (0.0, 1.0)), ("joint_damping", (0.0, 0.1)),
            ):  # fmt: skip
                a[name][:, d] += u(*bounds)
        middle = 0.5 * (u(0.5, 0.6) + u(0.1, 0.2))
        for end in ("lower", "upper"):
            a[f"joint_limit_{end}"][:, self.joints("RL_hip_joint")[1][0]] = middle
        for j in self.joints(".*_calf_joint")[0]:
            self.default_pos[:, j] += u(-0.1, 0.1)
        for g in self.shapes("F._foot"):
            a["shape_material_mu"][:, g] = u(0.3, 1.2)
            a["shape_material_restitution"][:, g] = u(0.0, 0.0)
        for g in self.shapes("R._foot"):
            a["shape_material_mu"][:, g] = u(0.5, 1.5)
            a["shape_material_mu_torsional"][:, g] = u(0.001, 0.02)
        for g in self.shapes(".*_foot"):
            a["shape_gap"][:, g] = u(0.001, 0.01) - a["shape_margin"][:, g]
        self._move(self.shapes("base", "trunk"))
        self._move(self.shapes("base", flag=8))
        for g in self.shapes(".*_thigh|FL_foot"):
            self._resize(g, [u(0.8, 1.2) for _ in range(2 if self.is_capsule(g) else 1)])
        for g in self.shapes(".*_calf"):
            self._resize(g, [u(0.8, 1.2)] * 2)
        for g in self.shapes("base", flag=1):
            a["shape_color"][:, g] = s.rows([(0.1, 0.3), (0.0, 1.0), (0.5, 0.5)])
        for j in self.joints("FL.*")[0]:
            self.bias[:, j] = u(-0.05, 0.05)
        a["gravity"][:, 0] += s.rows(np.transpose(GRAVITY))

    def is_capsule(self, shape: int) -> bool:
        return self.world.sim.template.shape_type[shape].name == "CAPSULE"

    def _resize(self, shape: int, factors: list[np.ndarray]) -> None:
        for k, factor in enumerate(factors):
            self.arrays["shape_scale"][:, shape, k] *= factor
        size = self.arrays["shape_scale"][:, shape]
        self.arrays["shape_collision_radius"][:, shape] = size[:, : len(factors)].sum(axis=1)

    def _move(self, shapes: list[int]) -> None:
        for shape in shapes:
            pose = self.arrays["shape_transform"][:, shape]
            drawn = self.stream.rows([POSES.get(k, (0.0, 0.0)) for k in AXES])
            turned = Rotation.from_quat(pose[:, 3:]) * Rotation.from_euler("xyz", drawn[:, 3:])
            self.arrays["shape_transform"][:, shape] = np.hstack((pose[:, :3] + drawn[:, :3], turned.as_quat()))

    def _pseudo(self, body: int) -> None:
        """By the definition: the pseudo-inertia matrix about the body's origin, transformed."""
        order = ("alpha", "d1", "d2", "d3", "s12", "s13", "s23", "t1", "t2", "t3")
        drawn = {k: self.stream.uniform(*PSEUDO.get(k, (0.0, 0.0))) for k in order}
        mass, com, inertia = (self.arrays[f"body_{n}"] for n in ("mass", "com", "inertia"))
        for env in range(len(mass)):
            alpha, d1, d2, d3, s12, s13, s23, t1, t2, t3 = (drawn[k][env] for k in order)
            m, c, i = mass[env, body], com[env, body], inertia[env, body]
            about_origin = 0.5 * np.trace(i) * np.eye(3) - i + m * np.outer(c, c)
            pseudo = np.block([[about_origin, m * c[:, None]], [m * c[None], np.array([[m]])]])
            u = np.array([[np.exp(d1), s12, s13, t1], [0.0, np.exp(d2), s23, t2], [0.0, 0.0, np.exp(d3), t3],
                          [0.0, 0.0, 0.0, 1.0]]) * np.exp(alpha)  # fmt: skip
            new = u @ pseudo @ u.T
            mass[env, body] = new[3, 3]
            com[env, body] = new[:3, 3] / new[3, 3]
            second = new[:3, :3] - new[3, 3] * np.outer(com[env, body], com[env, body])
            inertia[env, body] = np.trace(second) * np.eye(3) - second

    def check(self) -> None:
        world, a = self.world, self.arrays
        there = a["body_mass"] > 0.0
        a["body_inv_mass"][there] = 1.0 / a["body_mass"][there]
        a["body_inv_inertia"][there] = np.linalg.inv(a["body_inertia"][there])
        for name, expected in a.items():
            now, same = world.model(name), expected == world.default(name)
            np.testing.assert_allclose(now, expected, rtol=2e-6, atol=2e-6 * np.abs(expected[~same]).max(initial=0.0))
            if not name.startswith("body_inv"):
                np.testing.assert_array_equal(now[same], world.default(name)[same], err_msg=name)
        np.testing.assert_allclose(world.robot.data.default_joint_pos.numpy(), self.default_pos, atol=1e-6)
        calves, data = self.joints(".*_calf_joint")[0], world.robot.data
        np.testing.assert_array_equal(data.joint_pos_target.numpy()[:, calves], data.default_joint_pos[:, calves])
        np.testing.assert_allclose(all_arrays(world)["encoder"], self.bias, atol=1e-7)


@pytest.fixture(scope="module")
def world() -> RandomizedWorld:
    return RandomizedWorld(QUADRUPED_CFG, EVENTS, num_envs=N, seed=SEED)


def test_every_term_is_its_formula_after_twenty_resets(world: RandomizedWorld):
    reference = Reference(world)
    for _ in range(20):
        world.reset()
    world.context.seed(SEED)
    world.reset()
    reference.run()
    reference.check()


def test_other_worlds_stay_as_they_are(world: RandomizedWorld):
    before = all_arrays(world)
    world.reset(1, 3)
    after = all_arrays(world)
    changed = {n for n in before if not np.array_equal(before[n][[1, 3]], after[n][[1, 3]])}
    for name, values in before.items():
        np.testing.assert_array_equal(after[name][[0, 2]], values[[0, 2]], err_msg=name)
    wanted = {"body_mass", "body_ipos", "body_iquat", "body_invweight0", "dof_invweight0", "body_subtreemass"}
    wanted |= {"jnt_range", "jnt_actfrcrange", "dof_armature", "dof_frictionloss", "dof_damping", "jnt_stiffness"}
    wanted |= {"actuator_gainprm", "actuator_biasprm", "geom_friction", "geom_gap", "geom_pos", "geom_quat"}
    wanted |= {"geom_size", "geom_rbound", "geom_aabb", "gravity", "encoder", "jnt_solref", "site_pos"}
    assert wanted - changed == set()


def test_what_an_environment_draws_does_not_depend_on_how_many_there_are(world: RandomizedWorld):
    few = RandomizedWorld(QUADRUPED_CFG, EVENTS, num_envs=2, seed=SEED)
    world.context.seed(SEED)
    for some in (world, few):
        some.reset()
        some.reset(1)
    many = all_arrays(world)
    for name, values in all_arrays(few).items():
        np.testing.assert_array_equal(values, many[name][:2], err_msg=name)


def test_a_limit_that_is_kept_stays_where_the_other_one_would_cross_it():
    ranges = {"upper_limit_distribution_params": (-3.0, 0.0)}
    events = {"limits": term(mdp.randomize_joint_parameters, joints="RL_hip_joint", **ranges)}
    world = RandomizedWorld(QUADRUPED_CFG, events, num_envs=N, seed=SEED)
    (joint,) = Reference(world).joints("RL_hip_joint")[1]
    lower, upper = world.default("joint_limit_lower")[:, joint], []
    for _ in range(4):
        world.reset()
        np.testing.assert_array_equal(world.model("joint_limit_lower")[:, joint], lower)
        upper.append(world.model("joint_limit_upper")[:, joint])
    crossed = np.array(upper) == lower
    assert crossed.any()
    assert not crossed.all()
    assert (np.array(upper) >= lower).all()


def test_a_new_seed_draws_anew(world: RandomizedWorld):
    world.context.seed(SEED + 1)
    world.reset()
    before = world.model("body_mass")
    world.reset()
    assert not np.array_equal(world.model("body_mass"), before)
    thighs = world.robot.find_bodies(".*_thigh")[0]
    ratio = (world.model("body_mass") / world.default("body_mass"))[:, thighs]
    assert ((ratio > 0.5) & (ratio < 2.0)).all()
    assert len(np.unique(ratio)) == ratio.size
