# SPDX-License-Identifier: Apache-2.0
"""Meshes of trees: sizes, surfaces and colliders of each species."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from stripe_tasks.forest.traits import SPECIES
from stripe_tasks.forest.trees import SPECIES_SHAPES, tree

# height, radius of the trunk, radius of the crown [m]
SIZES = [(1.5, 0.008, 0.35), (2.6, 0.02, 0.6), (6.0, 0.05, 1.2), (11.0, 0.08, 1.6), (18.0, 0.3, 5.5), (27.0, 0.17, 2.6)]


def made(species, size, seed=0):
    return tree("it", species, *size, np.random.default_rng(seed))


def mesh_of(part):
    return trimesh.Trimesh(part.vertices.astype(float), part.faces, process=False)


def stem_of(mesh):
    """The trunk without its branches: the largest of the bodies that reach below the ground."""
    bodies = mesh_of(mesh.parts()[0]).split(only_watertight=False)
    (stem,) = [b for b in bodies if b.bounds[0, 2] < -0.2]
    return stem


def section(stem, height):
    """Centre and radius of the circle of equal area, of a cross-section."""
    path = stem.section(plane_origin=[0, 0, height], plane_normal=[0, 0, 1])
    points = path.discrete[0][:-1, :2]
    x, y = points.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = 0.5 * cross.sum()
    center = ((points + np.roll(points, -1, axis=0)) * cross[:, None]).sum(axis=0) / (6.0 * area)
    return center, np.sqrt(abs(area) / np.pi)


@pytest.fixture(params=sorted(SPECIES))
def species(request):
    return request.param


def test_every_species_has_a_shape():
    assert list(SPECIES_SHAPES) == list(SPECIES)


@pytest.mark.parametrize("size", SIZES)
def test_sizes_are_those_asked_for(species, size):
    height, radius, reach = size
    for seed in range(3):
        mesh = made(species, size, seed)
        points = np.concatenate([mesh_of(p).vertices for p in mesh.parts()])
        assert points[:, 2].max() == pytest.approx(height, rel=0.03)
        assert points[:, 2].min() == pytest.approx(-0.3, abs=0.03)
        crown = np.concatenate([p.vertices for p in mesh.parts() if p.name.startswith("crown")])
        across = np.ptp(crown[:, :2], axis=0)
        assert 0.5 * across.mean() == pytest.approx(reach, rel=0.2)
        assert 0.5 * across.max() == pytest.approx(reach, rel=0.3)
        measured = min(1.3, 0.8 * height)
        assert section(stem_of(mesh), measured)[1] == pytest.approx(radius, rel=0.15)


@pytest.mark.parametrize("size", SIZES)
def test_surfaces(species, size):
    for seed in range(3):
        mesh = made(species, size, seed)
        names = [p.name for p in mesh.parts()]
        assert names[0] == "trunk"
        assert set(names) - {"bark"} == {"trunk", "crown", "crown_light"}
        total = sum(len(p.faces) for p in mesh.parts())
        assert total <= 700
        assert total >= (200 if size[0] > 3.0 else 50)
        trunk = mesh_of(mesh.parts()[0])
        assert trunk.is_watertight
        assert trunk.is_winding_consistent
        for body in trunk.split(only_watertight=False):
            assert body.volume > 0.0
        for part in mesh.parts():
            assert mesh_of(part).area_faces.min() > 0.0
    assert mesh.semantic == "tree"


def test_trunk_has_the_volume_of_its_cross_sections():
    stem = stem_of(made("pine", (20.0, 0.15, 3.0)))
    z = np.linspace(-0.29, 18.5, 300)
    area = np.array([np.pi * section(stem, h)[1] ** 2 for h in z])
    assert stem.volume == pytest.approx(np.trapezoid(area, z), rel=0.03)


def test_foliage_faces_outwards(species):
    for size in SIZES[2:]:
        parts = {p.name: mesh_of(p) for p in made(species, size).parts()}
        closed = parts["crown"].split(only_watertight=True)
        assert len(closed) >= {"spruce": 1, "birch": 0}.get(species, 5)
        assert all(body.volume > 0.0 for body in closed)
        leaves = parts["crown_light"]
        if species == "spruce":  # fronds, which face up
            assert (leaves.face_normals[:, 2] > 0.0).all()
            continue
        middle = leaves.triangles_center.mean(axis=0)
        out = np.einsum("ij,ij->i", leaves.triangles_center - middle, leaves.face_normals)
        assert leaves.area_faces[out > 0].sum() > 0.58 * leaves.area


@pytest.mark.parametrize("species", ["pine", "birch"])
def test_bark_lies_on_the_trunk_and_faces_outwards(species):
    for seed in range(3):
        mesh = made(species, (20.0, 0.15, 3.0), seed)
        (bark,) = (mesh_of(p) for p in mesh.parts() if p.name == "bark")
        stem = stem_of(mesh)
        level = np.linspace(-0.25, 17.5, 60)
        line = np.array([[*section(stem, h)[0], section(stem, h)[1]] for h in level])
        at = bark.triangles_center
        x, y, radius = (np.interp(at[:, 2], level, column) for column in line.T)
        away = at[:, :2] - np.column_stack([x, y])
        assert (np.einsum("ij,ij->i", away, bark.face_normals[:, :2]) > 0.0).all()
        distance = np.linalg.norm(away, axis=1)
        assert (np.abs(distance - radius) < 0.3 * radius + 0.01).all()


def test_grown_trees_show_their_trunk(species):
    mesh = made(species, (24.0, 0.2, 3.0))
    crown = np.concatenate([p.vertices for p in mesh.parts() if p.name.startswith("crown")])
    assert 2.2 < crown[:, 2].min() < 0.65 * 24.0
    young = made(species, (2.5, 0.012, 0.5))
    crown = np.concatenate([p.vertices for p in young.parts() if p.name.startswith("crown")])
    assert crown[:, 2].min() < 0.9


@pytest.mark.parametrize("size", [s for s in SIZES if s[1] >= 0.015])
def test_capsule_follows_the_trunk(species, size):
    for seed in range(3):
        mesh = made(species, size, seed)
        stem = stem_of(mesh)
        (capsule,) = mesh.colliders()
        assert capsule.kind == "capsule"
        radius, half = capsule.size
        axis = Rotation.from_quat(capsule.rot).apply([0.0, 0.0, 1.0])
        ends = np.array(capsule.pos) + np.outer([-half, half], axis)
        assert ends[0, 2] - radius == pytest.approx(-0.3, abs=0.05)
        assert ends[1, 2] + radius == pytest.approx(min(2.5, 0.8 * size[0]), abs=0.05)
        for height in (0.3, 0.8, 1.2):
            center, own = section(stem, height)
            on_line = np.array(capsule.pos) + (height - capsule.pos[2]) / axis[2] * axis
            assert np.linalg.norm(center - on_line[:2]) < 0.5 * radius
            if height < 1.0:
                assert radius == pytest.approx(own, rel=0.35)
        mean = np.mean([section(stem, h)[1] for h in np.linspace(0.05, 1.0, 20)])
        assert radius == pytest.approx(mean, rel=0.1)


def test_thin_trunks_are_not_touched(species):
    assert list(made(species, (3.0, 0.0149, 0.5)).colliders()) == []
    assert len(made(species, (3.0, 0.0151, 0.5)).colliders()) == 1


def test_space_on_the_ground(species):
    mesh = made(species, (20.0, 0.2, 3.0))
    center, radius = section(stem_of(mesh), 0.02)
    assert np.linalg.norm(center) + radius < mesh.radius < 2.2 * radius
    assert mesh.radius > 0.2


def test_same_generator_same_bytes(species):
    def content(seed):
        mesh = made(species, (15.0, 0.12, 2.0), seed)
        surfaces = [(p.name, p.color, p.vertices.tobytes(), p.faces.tobytes()) for p in mesh.parts()]
        return surfaces, [(c.size, c.pos, c.rot) for c in mesh.colliders()], mesh.radius

    assert content(3) == content(3)
    assert content(3) != content(4)


def test_extreme_sizes(species):
    for size in [(0.4, 0.003, 0.1), (1.3, 0.3, 1.0), (45.0, 0.8, 9.0), (25.0, 0.05, 0.5), (4.0, 0.2, 4.0)]:
        mesh = made(species, size)
        points = np.concatenate([p.vertices for p in mesh.parts()])
        assert points[:, 2].max() == pytest.approx(size[0], rel=0.03)
        assert mesh_of(mesh.parts()[0]).is_watertight
        for collider in mesh.colliders():
            assert np.linalg.norm(collider.rot) == pytest.approx(1.0)


def test_bad_input_is_named():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="tree 'a': species is 'palm', must be one of spruce, pine"):
        tree("a", "palm", 10.0, 0.1, 2.0, rng)
    for at, what in enumerate(("height", "trunk_radius", "crown_radius")):
        for bad in (0.0, -1.0, np.nan, np.inf):
            sizes = [10.0, 0.1, 2.0]
            sizes[at] = bad
            with pytest.raises(ValueError, match=f"tree 'a': {what} is"):
                tree("a", "oak", *sizes, rng)
