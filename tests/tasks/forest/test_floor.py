# SPDX-License-Identifier: Apache-2.0
"""Meshes of the forest floor: sizes, closed surfaces, fitting colliders, the same from the same seed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from stripe_tasks.forest.deadwood import branch, fallen_trunk, stump
from stripe_tasks.forest.stones import capsule_between, rock
from stripe_tasks.forest.undergrowth import blueberry, bush, fern, grass

SEEDS = range(6)
MAKERS = {
    "bush": lambda rng: bush("it", 1.1, 0.6, rng),
    "blueberry": lambda rng: blueberry("it", 0.3, 0.35, rng),
    "fern": lambda rng: fern("it", 0.5, rng),
    "grass": lambda rng: grass("it", 0.2, 0.4, rng),
    "rock": lambda rng: rock("it", 0.5, rng),
    "stump": lambda rng: stump("it", 0.2, 0.4, rng),
    "fallen_trunk": lambda rng: fallen_trunk("it", 5.0, 0.2, rng),
    "branch": lambda rng: branch("it", 2.0, 0.03, rng),
}
SIZES = {
    "bush": ("height", "radius"), "blueberry": ("height", "radius"), "fern": ("radius",), "grass": ("radius", "height"),
    "rock": ("radius",), "stump": ("radius", "height"), "fallen_trunk": ("length", "radius"),
    "branch": ("length", "radius"),
}  # fmt: skip
FUNCTIONS = (bush, blueberry, fern, grass, rock, stump, fallen_trunk, branch)


def made(kind, seed=0):
    return MAKERS[kind](np.random.default_rng(seed))


def whole(mesh):
    """All parts as one surface, corners that are the same merged."""
    parts = [trimesh.Trimesh(p.vertices, p.faces, process=False) for p in mesh.parts()]
    joined = trimesh.util.concatenate(parts)
    joined.merge_vertices()
    return joined


def bodies(mesh):
    return whole(mesh).split(only_watertight=False)


def distance(colliders, points):
    """Signed distance of points to the nearest collider, in its own frame."""
    found = []
    for c in colliders:
        local = Rotation.from_quat(c.rot).inv().apply(np.asarray(points) - c.pos)
        half = c.size[1] if c.kind == "capsule" else 0.0
        local[:, 2] -= np.clip(local[:, 2], -half, half)
        found.append(np.linalg.norm(local, axis=1) - c.size[0])
    return np.min(found, axis=0)


def shell(colliders, count=4000):
    """Points on the outer surface of all colliders together."""
    points = []
    for c in colliders:
        if c.kind == "capsule":
            shape = trimesh.creation.capsule(2.0 * c.size[1], c.size[0], count=(24, 24))
            shape.vertices -= shape.bounds.mean(axis=0)
        else:
            shape = trimesh.creation.icosphere(3, c.size[0])
        local = trimesh.sample.sample_surface(shape, count, seed=1)[0]
        points.append(Rotation.from_quat(c.rot).apply(local) + c.pos)
    points = np.concatenate(points)
    return points[distance(colliders, points) > -0.02 * colliders[0].size[0]]


@pytest.mark.parametrize("kind", MAKERS)
def test_the_same_seed_gives_the_same_bytes(kind):
    first, again, other = made(kind), made(kind), made(kind, 1)
    for a, b in zip(first.parts(), again.parts(), strict=True):
        assert a.vertices.tobytes() == b.vertices.tobytes()
        assert a.faces.tobytes() == b.faces.tobytes()
        assert (a.name, a.color) == (b.name, b.color)
    assert first.colliders() == again.colliders()
    assert first.parts()[0].vertices.tobytes() != other.parts()[0].vertices.tobytes()
    names = [p.name for p in first.parts()]
    assert len(set(names)) == len(names)
    assert all(n.isidentifier() for n in names)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("kind", "semantic", "fewest", "most"),
    [
        ("bush", "bush", 60, 200),
        ("blueberry", "bush", 60, 300),
        ("fern", "fern", 60, 150),
        ("grass", "grass", 12, 150),
        ("rock", "rock", 80, 200),
        ("stump", "stump", 100, 400),
        ("fallen_trunk", "log", 100, 600),
        ("branch", "deadwood", 50, 250),
    ],
)
def test_triangles_and_labels(kind, semantic, fewest, most, seed):
    mesh = made(kind, seed)
    assert fewest <= sum(len(p.faces) for p in mesh.parts()) <= most
    assert mesh.semantic == semantic
    area = whole(mesh).area_faces
    assert (area > 0.0).all()
    for part in mesh.parts():
        assert min(part.color) > 0.0
        assert max(part.color) < 0.6


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("kind", "height", "radius"),
    [("bush", 1.1, 0.6), ("blueberry", 0.3, 0.35), ("fern", None, 0.5), ("grass", 0.4, 0.2)],
)
def test_plants_have_the_sizes_that_were_asked_for(kind, height, radius, seed):
    mesh = made(kind, seed)
    points = whole(mesh).vertices
    assert np.hypot(points[:, 0], points[:, 1]).max() == pytest.approx(radius, rel=1e-4)
    assert mesh.radius == radius
    if height is None:
        assert 0.4 * radius < points[:, 2].max() < 1.2 * radius
    else:
        assert points[:, 2].max() == pytest.approx(height, rel=1e-4)
    assert -0.2 < points[:, 2].min() <= 0.0
    assert len(mesh.colliders()) == 0
    assert all(p.double_sided for p in mesh.parts() if p.name not in ("stems", "berries"))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["rock", "stump", "fallen_trunk", "branch"])
def test_solid_things_are_closed_and_face_outwards(kind, seed):
    found = bodies(made(kind, seed))
    assert len(found) >= (2 if kind in ("fallen_trunk", "branch") else 1)
    for body in found:
        assert body.is_watertight
        assert body.is_winding_consistent
        assert body.volume > 0.0


@pytest.mark.parametrize("flatness", [0.35, 0.6, 0.95])
@pytest.mark.parametrize("radius", [0.1, 1.5])
def test_colliders_follow_a_rock(radius, flatness):
    errors, backs = [], []
    for seed in SEEDS:
        mesh = rock("it", radius, np.random.default_rng(seed), flatness)
        surface = whole(mesh)
        low, high = surface.bounds[:, 2]
        assert low == pytest.approx(-0.25 * (high - low), rel=1e-4)
        assert np.hypot(*surface.vertices[:, :2].T).max() == pytest.approx(radius, rel=1e-4)
        assert surface.volume > 0.75 * surface.convex_hull.volume
        assert 1 <= len(mesh.colliders()) <= 2
        assert {c.kind for c in mesh.colliders()} <= {"sphere", "capsule"}
        points = trimesh.sample.sample_surface(surface, 20000, seed=1)[0]
        off = distance(mesh.colliders(), points[points[:, 2] > 0.0])
        errors.append(np.abs(off).mean())
        assert np.abs(off).max() < 0.45 * radius
        held = shell(mesh.colliders())
        backs.append(cKDTree(points).query(held[held[:, 2] > 0.0])[0].mean())
    assert max(errors) < 0.12 * radius
    assert max(backs) < 0.15 * radius
    assert np.mean(errors) < 0.07 * radius


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("radius", "height"), [(0.2, 0.4), (0.35, 0.3), (0.1, 0.8)])
def test_a_stump_and_its_capsule(radius, height, seed):
    mesh = stump("it", radius, height, np.random.default_rng(seed))
    surface = whole(mesh)
    assert surface.bounds[1, 2] == pytest.approx(height, abs=1e-4)
    assert surface.bounds[0, 2] == pytest.approx(-0.15, abs=1e-6)
    assert radius < mesh.radius < 3.0 * radius
    (capsule,) = mesh.colliders()
    top = capsule.pos[2] + capsule.size[1] + capsule.size[0]
    assert height - 1.3 * radius < top <= height + 0.1 * radius
    assert capsule.kind == "capsule"
    assert capsule.pos[2] - capsule.size[1] - capsule.size[0] < 0.0
    points = trimesh.sample.sample_surface(surface, 5000, seed=1)[0]
    trunk = points[(points[:, 2] > 0.4 * height)]
    assert np.abs(distance([capsule], trunk)).mean() < 0.3 * radius


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("length", "radius"), [(1.5, 0.25), (5.0, 0.2), (14.0, 0.25)])
def test_a_fallen_trunk_and_its_capsules(length, radius, seed):
    mesh = fallen_trunk("it", length, radius, np.random.default_rng(seed), root_plate=False)
    trunk = max(bodies(mesh), key=lambda b: b.volume)
    assert np.ptp(trunk.bounds[:, 0]) == pytest.approx(length, rel=0.02)
    assert trunk.bounds[:, 0].mean() == pytest.approx(0.0, abs=0.02 * length)
    assert abs(trunk.center_mass[2]) < 0.15 * radius  # the axis is at z = 0
    assert 1 <= len(mesh.colliders()) <= 2
    held = shell(mesh.colliders())
    assert np.ptp(held[:, 0]) == pytest.approx(length, rel=0.02)
    points = trimesh.sample.sample_surface(trunk, 5000, seed=1)[0]
    points = points[np.abs(points[:, 0]) < 0.5 * length - radius]
    assert np.abs(distance(mesh.colliders(), points)).mean() < 0.25 * radius
    assert mesh.radius >= 0.5 * length - 0.02 * length


def test_a_root_plate_has_a_collider_of_its_own():
    rngs = (np.random.default_rng(3) for _ in range(2))
    bare, rooted = (fallen_trunk("it", 5.0, 0.2, rng, root_plate=p) for rng, p in zip(rngs, (False, True), strict=True))
    assert len(rooted.colliders()) == len(bare.colliders()) + 1
    assert "earth" in {p.name for p in rooted.parts()}
    assert "earth" not in {p.name for p in bare.parts()}
    plate = next(p for p in rooted.parts() if p.name == "earth")
    assert np.ptp(plate.vertices[:, 1]) > 0.7
    assert plate.vertices[:, 0].max() < -2.0
    held = shell(rooted.colliders()[-1:])
    inside = (held > plate.vertices.min(axis=0) - 0.05) & (held < plate.vertices.max(axis=0) + 0.05)
    assert inside.all()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_branch_and_its_capsule(seed):
    mesh = made("branch", seed)
    main = max(bodies(mesh), key=lambda b: np.ptp(b.bounds[:, 0]))
    np.testing.assert_allclose(main.bounds[:, 0], [-1.0, 1.0], atol=1e-4)
    (capsule,) = mesh.colliders()
    assert 0.015 < capsule.size[0] < 0.03
    assert np.ptp(shell([capsule])[:, 0]) == pytest.approx(2.0, rel=0.02)
    points = trimesh.sample.sample_surface(main, 4000, seed=1)[0]
    assert np.abs(distance([capsule], points)).mean() < 0.06  # crooked: twice its thickness at most
    assert len(bodies(mesh)) in (2, 3, 4)


def test_a_capsule_lies_where_its_ends_are():
    rng = np.random.default_rng(0)
    for a, b in [
        *rng.normal(size=(20, 2, 3)),
        np.array([[1.0, 0, 0], [-1, 0, 0]]),
        np.array([[0, 0, 1.0], [0, 0, -1]]),
    ]:
        capsule = capsule_between(a, b, 0.1)
        tips = [Rotation.from_quat(capsule.rot).apply([0, 0, s * capsule.size[1]]) + capsule.pos for s in (-1, 1)]
        order = tips if np.linalg.norm(tips[0] - a) < np.linalg.norm(tips[1] - a) else tips[::-1]
        np.testing.assert_allclose(order, [a, b], atol=1e-9)
    assert capsule_between((1, 2, 3), (1, 2, 3), 0.1).kind == "sphere"


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
@pytest.mark.parametrize("value", [0.0, -0.5, float("nan")])
def test_sizes_must_be_positive(function, value):
    names = SIZES[function.__name__]
    for wrong in names:
        sizes = {n: 5.0 if n == "length" else 0.3 for n in names} | {wrong: value}
        with pytest.raises(ValueError, match=rf"{function.__name__}: {wrong} is .*must be a positive number \[m\]"):
            function("it", **sizes, rng=np.random.default_rng(0))


@pytest.mark.parametrize("function", [fallen_trunk, branch])
def test_a_trunk_is_longer_than_thick(function):
    with pytest.raises(ValueError, match=r"length is 0\.5, must be more than 4 times"):
        function("it", 0.5, 0.2, np.random.default_rng(0))
