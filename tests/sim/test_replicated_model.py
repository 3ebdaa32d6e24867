# SPDX-License-Identifier: Apache-2.0
"""Replicated model: has what Newton's own loop over all shapes finds, array by array."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.sim import replicated_model
from stripe_newton.sim.replicated_model import finalize_replicated, is_repeated, missing_names
from stripe_newton.sim.replication import replicate

ORIGINS = np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 0.0], [4.0, 1.0, 0.5], [0.0, 0.0, 0.0], [-3.0, 7.0, 0.2]])


def new_builder():
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    return builder


def ground():
    builder = new_builder()
    builder.add_ground_plane()
    heights = np.linspace(0.0, 0.3, 30, dtype=np.float32).reshape(5, 6)
    builder.add_shape_heightfield(heightfield=newton.Heightfield(data=heights, nrow=5, ncol=6, hx=2.0, hy=2.0))
    return builder


def robot():
    """A body of several shapes with a hinged one, a wall that stands in the world, and a mesh."""
    builder = new_builder()
    wall = newton.ModelBuilder.ShapeConfig(mu=0.3, collision_group=2)
    builder.add_shape_box(-1, xform=wp.transform((1.0, 0.0, 0.5), wp.quat_identity()), hx=0.1, cfg=wall)
    trunk, leg = builder.add_link(label="trunk"), builder.add_link(label="leg")
    builder.add_shape_box(trunk, hx=0.2, hy=0.1, hz=0.1)
    builder.add_shape_sphere(trunk, radius=0.1, custom_attributes={"mujoco:geom_priority": 2})
    hull = newton.Mesh.create_box(0.1, 0.2, 0.3)
    builder.add_shape_convex_hull(leg, mesh=hull)
    builder.add_shape_mesh(leg, mesh=newton.Mesh.create_sphere(0.1), scale=(1.0, 2.0, 1.0))
    builder.add_shape_capsule(leg, radius=0.05, half_height=0.2, cfg=newton.ModelBuilder.ShapeConfig(density=0.0))
    joints = [builder.add_joint_free(trunk), builder.add_joint_revolute(trunk, leg, axis=(0.0, 1.0, 0.0))]
    builder.add_articulation(joints, label="robot")
    builder.add_shape_collision_filter_pair(1, 3)
    return builder


def worlds(template=None, static=None):
    return replicate(new_builder(), template or robot(), static or ground(), ORIGINS, gravity=None)


def contents(model):
    """Everything in a model by name, with the attributes of its solvers."""
    found = dict(vars(model))
    for name, value in vars(model).items():
        if isinstance(value, newton.Model.AttributeNamespace):
            found |= {f"{name}.{key}": part for key, part in vars(value).items()}
    return found


OWN = ("bvh_shapes", "particle_grid", "shape_source", "_mesh_keep_alive", "heightfield_meshes", "mujoco")
"""What two models have each of their own; the attributes of ``mujoco`` are compared by themselves."""


def plain(value):
    """A value as numpy arrays, texts, numbers and containers of them, which can be compared."""
    if isinstance(value, wp.array):
        return (str(value.dtype), value.shape, value.numpy().tobytes())
    if isinstance(value, np.ndarray):
        return (str(value.dtype), value.shape, value.tobytes())
    if isinstance(value, dict):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if callable(value):  # what reads an old name of an attribute
        return getattr(value, "__qualname__", "")
    if type(value).__module__.startswith("newton"):
        return plain(vars(value)) if hasattr(value, "__dict__") else type(value).__name__
    return repr(value)


def groups(pointers):
    """Which shapes share a mesh, as each model makes its own."""
    seen = list(dict.fromkeys(pointers.numpy().tolist()))
    return [seen.index(pointer) for pointer in pointers.numpy().tolist()]


@pytest.mark.parametrize("static", [ground, new_builder])
def test_every_array_is_the_one_that_newton_makes(static, device):
    shared = static().shape_count
    ours = contents(finalize_replicated(worlds(static=static()), shared, device))
    theirs = contents(worlds(static=static()).finalize(device=device))
    assert ours.keys() == theirs.keys()
    assert sum(isinstance(value, wp.array) for value in theirs.values()) > 100
    assert groups(ours.pop("shape_source_ptr")) == groups(theirs.pop("shape_source_ptr"))
    different = [name for name in theirs if name not in OWN and plain(ours[name]) != plain(theirs[name])]
    assert not different, different


def test_the_builder_stays_as_it_is():
    builder, kept = worlds(), worlds()
    finalize_replicated(builder, 2, "cpu")
    assert builder.shape_count == kept.shape_count
    assert builder.shape_label == kept.shape_label
    assert list(builder.shape_collision_filter_pairs) == list(kept.shape_collision_filter_pairs)
    assert np.array_equal(builder.shape_body, kept.shape_body)
    assert builder.finalize(device="cpu").shape_count == kept.shape_count


def test_worlds_that_differ_are_left_to_newton(monkeypatch):
    builder = worlds()
    assert is_repeated(builder, 2)
    builder.shape_material_mu[-1] = 0.123
    assert not is_repeated(builder, 2)
    monkeypatch.setattr(replicated_model, "_grow", None)  # which is not called then
    assert finalize_replicated(builder, 2, "cpu").shape_material_mu.numpy()[-1] == np.float32(0.123)


def test_an_attribute_of_a_solver_may_differ():
    builder = worlds()
    priority = builder.custom_attributes["mujoco:geom_priority"].values
    priority[builder.shape_count - 1] = 5
    model = finalize_replicated(builder, 2, "cpu")
    assert model.mujoco.geom_priority.numpy().tolist() == [priority.get(i, 0) for i in range(model.shape_count)]


def test_private_names_of_newton(monkeypatch):
    assert missing_names() == [], (
        f"Newton {newton.__version__} has changed: scenes of many environments are built slowly"
    )
    monkeypatch.setattr(replicated_model, "_OF_MODEL", ("_moved",))
    monkeypatch.setattr(replicated_model, "_grow", None)  # which is not called then
    missing_names.cache_clear()
    try:
        assert missing_names() == ["Model._moved"]
        assert finalize_replicated(worlds(), 2, "cpu").shape_count == worlds().shape_count
    finally:
        missing_names.cache_clear()
