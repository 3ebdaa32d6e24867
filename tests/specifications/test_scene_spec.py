# SPDX-License-Identifier: Apache-2.0
"""Scene specifications: the same scene from the same seed, valid USD, and the intended model."""

from __future__ import annotations

import newton
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdValidation
from scipy.spatial.transform import Rotation

from stripe_newton.sim import DistantLightCfg, DomeLightCfg
from stripe_newton.specifications import (
    AssetSpec,
    BoxMesh,
    CylinderMesh,
    DebugMesh,
    IdenticalAssetSpec,
    MeshPart,
    SceneSpec,
    SphereMesh,
    TerrainInstance,
)
from stripe_newton.terrains import Ground
from stripe_newton.terrains.ground_usd import ground_prims, read_ground
from stripe_newton.terrains.terrain_importer import found_terrain


class Posts(IdenticalAssetSpec):
    """Posts anywhere on the ground."""

    count = 12

    def find_positions(self, terrain, rng):
        return rng.uniform(-0.45, 0.45, (self.count, 2)) * terrain.size


class Blocks(AssetSpec):
    """Blocks of two kinds, turned and scaled, away from the posts."""

    def generate(self, terrain, rng):
        kinds = [BoxMesh("block", (0.3, 0.2, 0.1), semantic="stone"), SphereMesh("ball", (0.4,))]
        taken = np.array([i.position for i in terrain.placed.get("posts", [])] or [(0.0, 0.0, 0.0)])
        for index in range(6):
            place = rng.uniform(-8.0, 8.0, 3)
            turn = Rotation.random(random_state=rng.integers(1 << 31)).as_quat()
            assert np.isfinite(taken).all()
            yield self.create_instance(f"b{index}", kinds[index % 2], place, turn, 0.5 + 0.25 * index, ["hard"])


class Marks(IdenticalAssetSpec):
    def find_positions(self, terrain, rng):
        return np.zeros((1, 3))


class Yard(SceneSpec):
    def generate(self, rng):
        heights = rng.uniform(0.0, 0.5, (21, 41))
        water = MeshPart("water", np.array([[0, 0, 0.2], [1, 0, 0.2], [0, 1, 0.2]]), np.array([[0, 1, 2]]))
        ground = Ground(heights, (-10.0, -10.0), (0.5, 1.0))
        return TerrainInstance(ground, parts=[(water, ["water"])], static_friction=0.8, color=(0.1, 0.3, 0.1))


def yard(*more: AssetSpec) -> Yard:
    posts = Posts("posts", CylinderMesh("post", (0.1, 0.75), color=(0.3, 0.2, 0.1)))
    return Yard((20.0, 20.0), [posts, Blocks("blocks"), *more], DistantLightCfg(angle=0.5), DomeLightCfg())


@pytest.fixture(scope="module")
def scene():
    return yard().create(seed=4)


def test_the_same_seed_gives_the_same_bytes(tmp_path, scene):
    files = [scene.export(tmp_path / "a.usda"), yard().create(4).export(tmp_path / "b.usda")]
    assert files[0].read_bytes() == files[1].read_bytes()
    crates = [scene.export(tmp_path / "a.usdc"), yard().create(4).export(tmp_path / "b.usdc")]
    assert crates[0].read_bytes() == crates[1].read_bytes()
    assert yard().create(5).export(tmp_path / "c.usda").read_bytes() != files[0].read_bytes()


def test_another_spec_changes_nothing_in_those_before_it(scene):
    more = yard(Posts("stakes", CylinderMesh("stake", (0.05, 0.5)))).create(4)
    assert len(more.instances) == len(scene.instances) + Posts.count
    for a, b in zip(scene.instances, more.instances, strict=False):
        assert (a.name, a.position, a.rotation, a.scale) == (b.name, b.position, b.rotation, b.scale)
    np.testing.assert_array_equal(scene.terrain.ground.raw, more.terrain.ground.raw)


def test_the_stage_passes_all_checks_of_usd(tmp_path, scene):
    stage = Usd.Stage.Open(str(scene.export(tmp_path / "yard.usdc")))
    registry = UsdValidation.ValidationRegistry()
    validators = [registry.GetOrLoadValidatorByName(m.name) for m in registry.GetAllValidatorMetadata()]
    assert len(validators) > 20
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert not [f"{e.GetName()}: {e.GetMessage()}" for e in errors]


def test_meshes_are_shared_and_labelled(scene):
    stage = scene.stage
    assert stage.GetDefaultPrim().GetPath() == "/World"
    instances = [p for p in stage.Traverse() if p.IsInstance()]
    assert len(instances) == len(scene.instances)
    assert len({str(p.GetPrototype().GetPath()) for p in instances}) == 3
    labels = {str(p.GetPath()): UsdSemantics.LabelsAPI(p, "class").GetLabelsAttr().Get() for p in instances}
    assert list(labels["/World/blocks/b0"]) == ["stone", "hard"]
    assert list(labels["/World/blocks/b1"]) == ["ball", "hard"]
    ground = UsdSemantics.LabelsAPI(stage.GetPrimAtPath("/World/ground"), "class").GetLabelsAttr().Get()
    assert list(ground) == ["terrain"]
    drawn = [p for p in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()) if p.IsA(UsdGeom.Mesh)]
    assert len(drawn) == len(scene.instances) + 2  # the ground and the water
    assert not any(p.HasAPI(UsdPhysics.CollisionAPI) for p in drawn if p.GetName() == "surface")


def test_the_height_field_is_found_again(tmp_path, scene):
    stage = Usd.Stage.Open(str(scene.export(tmp_path / "yard.usdc")))
    ground = read_ground(ground_prims(stage)[0])
    np.testing.assert_array_equal(ground.raw, scene.terrain.ground.raw)
    assert (ground.lower, ground.cell) == (scene.terrain.ground.lower, scene.terrain.ground.cell)
    assert found_terrain(stage).physics_material.static_friction == pytest.approx(0.8)


def test_newton_loads_the_colliders_where_they_are_meant(tmp_path, scene):
    builder = newton.ModelBuilder()
    builder.add_usd(str(scene.export(tmp_path / "yard.usdc")), ignore_paths=["/World/ground"])
    touched = [i for i, flags in enumerate(builder.shape_flags) if flags & newton.ShapeFlags.COLLIDE_SHAPES]
    assert len(touched) == len(scene.instances)
    found = {builder.shape_label[i].split("/collider")[0]: i for i in touched}
    for spec, placed in scene.terrain.placed.items():
        for instance in placed:
            (collider,) = instance.mesh.colliders()
            shape = found[f"/World/{spec}/{instance.name}"]
            turn = Rotation.from_quat(instance.rotation)
            expected = np.array(instance.position) + turn.apply(instance.scale * np.array(collider.pos))
            np.testing.assert_allclose(np.array(builder.shape_transform[shape])[:3], expected, atol=1e-4)
            size = np.array(builder.shape_scale[shape])[: len(collider.size)]
            np.testing.assert_allclose(size, instance.scale * np.array(collider.size), rtol=1e-4)


def test_markers_are_made_only_on_request():
    spec = yard(Marks("marks", DebugMesh("mark")))
    assert not spec.create(1).terrain.placed["marks"]
    assert len(spec.create(1, debug_models=True).terrain.placed["marks"]) == 1


def test_progress_is_told():
    told = []
    yard().create(1, progress=told.append)
    assert told == ["terrain", "posts", "blocks", "survey"]


class Twice(AssetSpec):
    def generate(self, terrain, rng):
        mesh = BoxMesh("cube", (0.1, 0.1, 0.1))
        return [self.create_instance("same", mesh, (0, 0, 0)), self.create_instance("same", mesh, (1, 0, 0))]


class Wrong(AssetSpec):
    def __init__(self, **given):
        super().__init__("wrong")
        self.given = {"name": "a", "mesh": BoxMesh("cube", (0.1, 0.1, 0.1)), "position": (0, 0, 0)} | given

    def generate(self, terrain, rng):
        yield self.create_instance(**self.given)


class Small(Yard):
    def generate(self, rng):
        return TerrainInstance(Ground(np.zeros((3, 3)), (0.0, 0.0), (1.0, 1.0)))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: yard(Blocks("blocks")), "has an asset spec 'blocks' already, a Blocks"),
        (lambda: yard(Twice("t")).create(), "asset 't': two instances are called 'same'"),
        (lambda: Blocks("no name"), "must be an identifier"),
        (lambda: yard(Wrong(name="1")).create(), "asset 'wrong', instance '1'"),
        (lambda: yard(Wrong(position=(0, np.nan, 0))).create(), "must be finite"),
        (lambda: yard(Wrong(rotation=(0, 0, 0, 0))).create(), "must be finite"),
        (lambda: yard(Wrong(scale=0.0)).create(), "scale is 0.0, must be positive"),
        (lambda: yard(Wrong(mesh=SphereMesh("post", (1.0,)))).create().stage, "mesh 'post': two different meshes"),
        (lambda: yard().create(-1), "seed is -1"),
        (lambda: Yard((0.0, 1.0)), "must be two positive lengths"),
        (lambda: Small((20.0, 20.0)).create(), "the terrain is 2 by 2 m, must be 20 by 20 m"),
        (lambda: yard().create(0).export("x.obj"), "must end in .usd"),
    ],
)
def test_what_is_wrong_is_said(make, text):
    with pytest.raises(ValueError) as error:
        make()
    assert text in str(error.value)
