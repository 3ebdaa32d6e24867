# SPDX-License-Identifier: Apache-2.0
"""Models of generated scenes: prototypes read once equal what Newton's importer reads prim by prim."""

from __future__ import annotations

import newton
import numpy as np
import pytest
from newton.examples import get_asset
from pxr import Gf, Usd, UsdGeom
from scipy.spatial.transform import Rotation

from stripe_newton.scene import InteractiveScene
from stripe_newton.scene.scenery import SCENERY_KEY, add_scenery, read_scenery
from stripe_newton.sim import DomeLightCfg, MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_newton.specifications import (
    AssetSpec,
    BoxMesh,
    CapsuleMesh,
    CylinderMesh,
    SceneCfgFactory,
    SceneSpec,
    SphereMesh,
    TerrainInstance,
    instancable,
)
from stripe_newton.terrains import Ground
from stripe_tasks.robots import ANT_CFG


class Mixed(AssetSpec):
    """Primitives of each kind, anywhere, turned and scaled."""

    def __init__(self, name, boxes=True):
        super().__init__(name)
        self.boxes = boxes

    def generate(self, terrain, rng):
        meshes = [
            BoxMesh("box", (0.3, 0.2, 0.1), color=(0.5, 0.1, 0.1)) if self.boxes else SphereMesh("stone", (0.1,)),
            SphereMesh("ball", (0.2,)),
            CapsuleMesh("pill", (0.1, 0.3)),
            CylinderMesh("can", (0.15, 0.2)),
        ]
        for index in range(12):
            turn = Rotation.random(random_state=int(rng.integers(1 << 31))).as_quat()
            place = [*rng.uniform(-4.0, 4.0, 2), rng.uniform(0.2, 1.0)]
            yield self.create_instance(f"m{index}", meshes[index % 4], place, turn, rng.uniform(0.5, 2.0))


class Field(SceneSpec):
    def generate(self, rng):
        return TerrainInstance(Ground(rng.uniform(0.0, 0.1, (21, 21)), (-5.0, -5.0), (0.5, 0.5)))


@pytest.fixture(scope="module")
def scene():
    return Field((10.0, 10.0), [Mixed("mixed")], dome_light=DomeLightCfg()).create(2)


def rows(labels, *columns):
    """Columns by label."""
    return {label: [np.array(c[i], dtype=float) for c in columns] for i, label in enumerate(labels)}


def triangles(builder: newton.ModelBuilder, shape: int) -> np.ndarray:
    """Corners of each triangle [m]."""
    mesh = builder.shape_source[shape]
    return np.array(mesh.vertices)[np.array(mesh.indices)] * np.array(builder.shape_scale[shape])


def test_prototypes_give_the_shapes_that_newton_reads(scene, tmp_path):
    path, ours, theirs = str(scene.export(tmp_path / "s.usdc")), newton.ModelBuilder(), newton.ModelBuilder()
    theirs.add_usd(path, ignore_paths=["/World/ground"])
    add_scenery(ours, read_scenery(Usd.Stage.Open(path)))
    assert ours.shape_count == theirs.shape_count == 24
    solid = int(newton.ShapeFlags.COLLIDE_SHAPES)
    for index, label in enumerate(theirs.shape_label):
        own = ours.shape_label.index(label.replace("/surface", "/part_0"))
        assert ours.shape_type[own] == theirs.shape_type[index]
        assert (ours.shape_flags[own] & solid) == (theirs.shape_flags[index] & solid)
        a, b = (np.array(x.shape_transform[i]) for x, i in ((ours, own), (theirs, index)))
        np.testing.assert_allclose(a[:3], b[:3], atol=1e-5)
        assert abs(a[3:] @ b[3:]) == pytest.approx(1.0, abs=1e-5)
        if ours.shape_type[own] == newton.GeoType.MESH:
            a, b = (triangles(x, i) for x, i in ((ours, own), (theirs, index)))
            np.testing.assert_allclose(a, b, atol=1e-5)
            np.testing.assert_allclose(ours.shape_color[own], theirs.shape_color[index], atol=1e-3)
        else:
            np.testing.assert_allclose(ours.shape_scale[own], theirs.shape_scale[index], atol=1e-5)


class Own(BoxMesh):
    """A box whose prims are each asset's own."""

    instancable = False


@instancable
class Shared(Own):
    """And one that is shared again."""


class Two(AssetSpec):
    def generate(self, terrain, rng):
        for name, mesh in (("own", Own("own", (0.1, 0.1, 0.1))), ("shared", Shared("shared", (0.1, 0.1, 0.1)))):
            for index in range(2):
                yield self.create_instance(f"{name}_{index}", mesh, (float(index), 0.0, 1.0), scale=1.0 + index)


def test_a_mesh_may_be_each_assets_own():
    scene = Field((10.0, 10.0), [Two("two")]).create(2)
    flags = {p.GetName(): p.IsInstance() for p in scene.stage.GetPrimAtPath("/World/two").GetChildren()}
    assert flags == {"own_0": False, "own_1": False, "shared_0": True, "shared_1": True}
    builder = newton.ModelBuilder()
    add_scenery(builder, read_scenery(scene.stage))
    assert builder.shape_count == 8
    boxes = [i for i, kind in enumerate(builder.shape_type) if kind == newton.GeoType.BOX]
    sizes = sorted(float(builder.shape_scale[i][0]) for i in boxes)
    np.testing.assert_allclose(sizes, [0.1, 0.1, 0.2, 0.2], atol=1e-6)


def test_instances_share_their_meshes(scene):
    builder = newton.ModelBuilder()
    add_scenery(builder, read_scenery(scene.stage), touched=False)
    assert builder.shape_count == 12
    assert len({id(source) for source in builder.shape_source}) == 4


def test_capsules_hold_the_colliders(scene):
    with pytest.raises(ValueError, match=r"assets like ./World/mixed/m0.: .* is a box, which no capsule stands for"):
        read_scenery(scene.stage).capsules()
    scenery = read_scenery(Field((10.0, 10.0), [Mixed("mixed", boxes=False)]).create(2).stage)
    found = scenery.capsules()
    pos, rot, radius, half = found.positions, found.rotations, found.radius, found.half_length
    assert len(pos) == 12
    builder = newton.ModelBuilder()
    add_scenery(builder, scenery)
    shapes = [i for i, kind in enumerate(builder.shape_type) if kind != newton.GeoType.MESH]
    rng = np.random.default_rng(0)
    for shape in shapes:
        frame, size = np.array(builder.shape_transform[shape]), np.array(builder.shape_scale[shape])
        nearest = np.argmin(np.linalg.norm(pos - frame[:3], axis=1))
        if builder.shape_type[shape] == newton.GeoType.SPHERE:
            local = Rotation.random(50, random_state=1).apply([size[0], 0.0, 0.0])
        else:
            angle = rng.uniform(-np.pi, np.pi, 50)
            local = np.column_stack(
                [size[0] * np.cos(angle), size[0] * np.sin(angle), rng.uniform(-1, 1, 50) * size[1]]
            )
        points = Rotation.from_quat(frame[3:]).apply(local) + frame[:3]
        own = Rotation.from_quat(rot[nearest]).inv().apply(points - pos[nearest])
        axis = np.clip(own[:, 2], -half[nearest], half[nearest])
        away = np.linalg.norm(own - np.outer(axis, [0.0, 0.0, 1.0]), axis=1)
        assert away.max() <= radius[nearest] + 1e-5


def model_of(scene: InteractiveScene):
    """Static shapes by label."""
    model = scene.sim.model
    keep = [i for i, label in enumerate(model.shape_label) if label.startswith(("/World/mixed", "/World/ground"))]
    columns = (model.shape_type, model.shape_flags, model.shape_transform, model.shape_scale, model.shape_color)
    return rows([model.shape_label[i] for i in keep], *(c.numpy()[keep] for c in columns))


def test_the_saved_file_gives_the_model_of_the_spec(scene, tmp_path):
    sim, made = SimulationCfg(device="cpu", dt=1 / 240, solver=MuJoCoSolverCfg(njmax=300, nconmax=60)), []
    ant = ANT_CFG.replace(init_state=ANT_CFG.init_state.replace(pos=(0.0, 0.0, 2.5)))  # above everything
    spec = Field((10.0, 10.0), [Mixed("mixed")], dome_light=DomeLightCfg())
    for factory in (spec.create_instance(2, 1.0, seed=2), SceneCfgFactory(scene.export(tmp_path / "s.usda"), 2, 1.0)):
        cfg = factory.get_scene(ant)
        made.append(InteractiveScene(cfg, Simulation(sim.copy())))
        made[-1].build()
    built, opened = made
    ours, theirs = model_of(built), model_of(opened)
    assert list(ours) == list(theirs)
    assert len(ours) == 25
    for label, values in ours.items():
        for a, b in zip(values, theirs[label], strict=True):
            np.testing.assert_allclose(a, b, atol=1e-6, err_msg=label)
    np.testing.assert_array_equal(built.terrain.ground.heights, opened.terrain.ground.heights)
    built.sim.solver.fill_contacts()
    built.sim.step(360)
    assert np.isfinite(built["robot"].data.root_pos_w.numpy()).all()
    touched = {s for pair in built.sim.solver.mjw_data.contact.geom.numpy() for s in pair}
    assert len(touched) > 2


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda s: UsdGeom.Xform.Define(s, "/World/mixed/loose"), "'/World/mixed/loose': must be a reference"),
        (
            lambda s: s.GetPrimAtPath("/World/mixed/m0").GetAttribute("xformOp:scale").Set(Gf.Vec3f(1, 2, 1)),
            "along all",
        ),
        (lambda s: UsdGeom.Xformable(s.GetPrimAtPath("/World/mixed")).AddTranslateOp().Set((1, 0, 0)), "is moved"),
        (lambda s: s.GetPrimAtPath("/Prototypes/pill/collider_0").GetAttribute("axis").Set("X"), "along Z"),
    ],
)
def test_what_cannot_be_read_is_said(scene, spoil, text, tmp_path):
    stage = Usd.Stage.Open(str(scene.export(tmp_path / "s.usda")))
    assert stage.GetPrimAtPath("/World/mixed").GetAttribute(SCENERY_KEY).Get()
    spoil(stage)
    with pytest.raises(ValueError, match=None) as error:
        read_scenery(stage)
    assert text in str(error.value)


def test_names_of_a_scene_are_given_once():
    factory = Field((10.0, 10.0)).create_instance(1, 1.0)
    factory.add_asset("table", ANT_CFG)
    for name in ("table", "robot"):
        with pytest.raises(ValueError, match=f"has '{name}' already"):
            factory.add_sensor(name, ANT_CFG)
    with pytest.raises(ValueError, match="must be an identifier"):
        factory.add_asset("my table", ANT_CFG)
    assert factory.get_scene(ANT_CFG).scenery.prim_path == "/World/ground"


def test_a_file_that_is_no_scene_is_refused(tmp_path):
    simulation = Simulation(SimulationCfg(device="cpu"))
    for source, error, text in (
        ("nowhere.usda", FileNotFoundError, "'nowhere.usda': does not exist"),
        (get_asset("ant.usda"), ValueError, "is no scene of a spec"),
    ):
        with pytest.raises(error) as raised:
            InteractiveScene(SceneCfgFactory(source, 1, 1.0).get_scene(ANT_CFG), simulation)
        assert text in str(raised.value)
