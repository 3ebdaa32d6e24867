# SPDX-License-Identifier: Apache-2.0
"""Contacts of the fused step with the triangles of static meshes, against trimesh, MuJoCo's distances and statics."""

import mujoco
import newton
import numpy as np
import pytest
import trimesh
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_newton.sim.contact_capacity import contact_capacity
from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.mesh_grid import MeshGrids, TriangleMesh
from tests.helpers.step_meshes import FRAMES, model_of, random_poses, step_mesh

COUNT = 400
BOXES = [((0.5, 0.5, 1.0), (0.5, 0.5, 1.0)), ((1.5, 0.5, 0.5), (0.5, 0.5, 0.5))]
"""The step as two boxes: centre and half sizes."""


def contacts_of(model: newton.Model, frame: wp.transform) -> list[list[tuple[float, np.ndarray, np.ndarray]]]:
    """Distance, point and normal of the contacts of each world, relative to the mesh."""
    solver = SolverFused(model, nconmax=20, njmax=100, kinematic_switchable_roots=False)
    solver.static_triangles = True
    assert solver.missing_triangle_contacts() == []
    assert solver.one_launch
    solver.fill_contacts()
    state = model.state()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    solver.step(state, state, model.control(), None, 1e-6)
    contact = solver.mjw_data.contact
    found: list[list] = [[] for _ in range(model.world_count)]
    inverse = wp.transform_inverse(frame)
    columns = (getattr(contact, n).numpy() for n in ("geom", "worldid", "dist", "pos", "frame"))
    for geom, world, dist, pos, axes in zip(*columns, strict=True):
        if geom[0] >= 0:
            normal = wp.quat_rotate(wp.transform_get_rotation(inverse), wp.vec3(*map(float, axes[0])))
            point = wp.transform_point(inverse, wp.vec3(*map(float, pos)))
            found[world].append((float(dist), np.array(point), np.array(normal)))
    return found


def near_the_surface(mesh: trimesh.Trimesh, low: float, high: float, rng: np.random.Generator) -> tuple:
    """Points whose distance from the surface, negative inside, is between the bounds, and their distances."""
    points = rng.uniform(mesh.bounds[0] - high, mesh.bounds[1] + high, size=(20 * COUNT, 3))
    inside = np.zeros(len(points), dtype=bool)
    for center, half in BOXES:
        inside |= (np.abs(points - center) < half).all(axis=1)
    surface, distance, _ = trimesh.proximity.closest_point_naive(mesh, points)
    distance = np.where(inside, -distance, distance)
    chosen = np.flatnonzero((distance > low) & (distance < high))[:COUNT]
    assert len(chosen) == COUNT
    return points[chosen], distance[chosen], surface[chosen]


@pytest.mark.parametrize("fineness", [0, 3])
@pytest.mark.parametrize("frame", FRAMES, ids=["in place", "moved"])
def test_spheres_touch_the_nearest_point(frame, fineness):
    rng, radius = np.random.default_rng(0), 0.1
    mesh = step_mesh(fineness)
    points, distance, surface = near_the_surface(step_mesh(), -0.04, 0.15, rng)
    model = model_of(mesh, lambda b, body: b.add_shape_sphere(body, radius=radius), random_poses(rng, points), frame)
    for contacts, point, expected, nearest in zip(contacts_of(model, frame), points, distance, surface, strict=True):
        if expected > radius:
            assert contacts == []
            continue
        dist, pos, normal = min(contacts, key=lambda contact: contact[0])
        assert dist == pytest.approx(expected - radius, abs=3e-6)
        if abs(expected) > 1e-3:
            outward = (point - nearest) / expected
            np.testing.assert_allclose(normal, outward, atol=1e-3)
            np.testing.assert_allclose(pos, nearest + 0.5 * dist * outward, atol=1e-4)
        assert len(contacts) == 1 or expected > 0.0  # from inside one way leads out


def test_a_sphere_in_a_corner_touches_both_faces():
    point = np.array([[1.08, 0.5, 1.09, 0.0, 0.0, 0.0, 1.0]])
    model = model_of(step_mesh(2), lambda b, body: b.add_shape_sphere(body, radius=0.1), point, FRAMES[0])
    touches = sorted((round(d, 5), *np.round(n, 5)) for d, _, n in contacts_of(model, FRAMES[0])[0])
    assert touches == [(-0.02, 1.0, 0.0, 0.0), (-0.01, 0.0, 0.0, 1.0)]


def axis_distance(poses: np.ndarray, half: float) -> np.ndarray:
    """Distance of the axes of capsules from the step: MuJoCo's, of thin capsules from its two boxes."""
    thin = 1e-5
    boxes = "".join(f'<geom type="box" pos="{c[0]} {c[1]} {c[2]}" size="{h[0]} {h[1]} {h[2]}"/>' for c, h in BOXES)
    inertia = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    spec = f'<body><freejoint/>{inertia}<geom type="capsule" size="{thin} {half}"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{boxes}{spec}</worldbody></mujoco>")
    data, found = mujoco.MjData(model), []
    for pose in poses:
        data.qpos[:] = [*pose[:3], pose[6], *pose[3:6]]
        mujoco.mj_kinematics(model, data)
        found.append(thin + min(mujoco.mj_geomDistance(model, data, box, 2, 10.0, None) for box in range(2)))
    return np.array(found)


def test_a_cylinder_is_round_to_a_tenth_of_a_millimetre():
    rng, radius = np.random.default_rng(3), 0.1
    angle, height, out = rng.uniform(0, 7, COUNT), rng.uniform(-0.45, 0.45, COUNT), rng.uniform(0.01, 0.15, COUNT)
    points = np.stack([(0.3 + out) * np.cos(angle), (0.3 + out) * np.sin(angle), height], axis=1)
    model = model_of(
        lambda b, frame: b.add_shape_cylinder(-1, xform=frame, radius=0.3, half_height=0.5),
        lambda b, body: b.add_shape_sphere(body, radius=radius),
        random_poses(rng, points),
        FRAMES[1],
    )
    for contacts, distance in zip(contacts_of(model, FRAMES[1]), out - radius, strict=True):
        if abs(distance) > 1.1e-4:
            assert bool(contacts) == (distance < 0.0)
        if contacts:
            assert -1e-6 <= min(d for d, _, _ in contacts) - distance < 1.1e-4


def axes_enter(poses: np.ndarray, half: float) -> np.ndarray:
    """Whether axes come into the step, where MuJoCo has no distance."""
    turn = np.array([wp.quat_rotate(wp.quat(*q), wp.vec3(0.0, 0.0, half)) for q in poses[:, 3:].tolist()])
    points = poses[:, None, :3] + np.linspace(-1.0, 1.0, 200)[:, None] * turn[:, None]
    inside = [(np.abs(points - np.array(center)) < half_sizes).all(axis=2) for center, half_sizes in BOXES]
    return np.any(inside, axis=(0, 2))


@pytest.mark.parametrize("solid", [True, False])
@pytest.mark.parametrize("fineness", [0, 2])
def test_capsules_touch_as_deep_as_their_axes_are_near(fineness, solid):
    rng, radius, half = np.random.default_rng(1), 0.08, 0.3
    points = rng.uniform([-0.2, 0.1, 0.6], [2.2, 0.9, 2.4], size=(5 * COUNT, 3))
    poses = random_poses(rng, points)
    expected = axis_distance(poses, half)
    near = ~axes_enter(poses, half) & (expected > 1e-3) & (expected < 1.2 * radius)
    poses, expected = poses[near], expected[near]
    mesh = step_mesh(fineness, solid)
    model = model_of(mesh, lambda b, body: b.add_shape_capsule(body, radius=radius, half_height=half), poses, FRAMES[0])
    touching = 0
    for contacts, distance in zip(contacts_of(model, FRAMES[0]), expected, strict=True):
        if distance > radius + 1e-5:
            assert contacts == []
        elif distance < radius - 1e-5:
            touching += 1
            # The nearest part of the axis may be up to a thousandth of it away from where it is looked for.
            assert min(d for d, _, _ in contacts) == pytest.approx(distance - radius, abs=2e-4)
    assert touching > 100


def settled(mesh: trimesh.Trimesh, add_geom: object, pose: tuple[float, ...], steps: int = 400) -> tuple:
    """Pose and speed of a body that was let go above a mesh, after ``steps`` steps of 5 ms."""
    model = model_of(mesh, add_geom, np.array([pose]), FRAMES[0])
    model.set_gravity((0.0, 0.0, -9.81))
    solver = SolverFused(model, nconmax=20, njmax=100, kinematic_switchable_roots=False)
    solver.static_triangles = True
    state = model.state()
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    for _ in range(steps):
        solver.step(state, state, model.control(), None, 0.005)
    return state.body_q.numpy()[0], float(np.abs(state.body_qd.numpy()).max())


def box(b: newton.ModelBuilder, body: int) -> int:
    return b.add_shape_box(body, hx=0.1, hy=0.075, hz=0.05)


def wide_box(b: newton.ModelBuilder, body: int) -> int:
    return b.add_shape_box(body, hx=0.3, hy=0.8, hz=0.05)


def capsule(b: newton.ModelBuilder, body: int) -> int:
    return b.add_shape_capsule(body, radius=0.05, half_height=0.2)


LYING = tuple(wp.quat_rpy(0.5 * np.pi, 0.0, 0.0))


@pytest.mark.parametrize("solid", [True, False])
@pytest.mark.parametrize(
    ("add_geom", "place", "turn", "height"),
    [
        (box, (1.5, 0.5, 1.12), (0.0, 0.0, 0.3, 1.0), 1.05),
        (box, (0.97, 0.5, 2.1), (0.0, 0.0, 0.0, 1.0), 2.05),  # over the edge by 7 cm of 20
        (wide_box, (0.7, 0.5, 2.1), (0.0, 0.0, 0.0, 1.0), 2.05),  # no corner is above the tread
        (capsule, (1.5, 0.5, 1.1), LYING, 1.05),
        (capsule, (0.5, 0.9, 2.1), LYING, 2.05),  # one end is beyond the edge
    ],
)
def test_bodies_come_to_rest(add_geom, place, turn, height, solid):
    turn = np.array(turn) / np.linalg.norm(turn)
    pose, speed = settled(step_mesh(1, solid), add_geom, (*place, *turn))
    assert pose[2] == pytest.approx(height, abs=1e-3)
    assert np.abs(pose[:2] - place[:2]).max() < 2e-2
    assert speed < 1e-2


def test_cells_list_all_faces_that_are_near():
    fine, reach = step_mesh(3), 0.09
    grids = MeshGrids([[TriangleMesh(fine.vertices, fine.faces, 3)]], reach, "cpu")
    first, items, faces, planes, _, _, edges, _, record = (a.numpy() for a in grids._arrays)
    # Edges at which it bends down: those at the five convex corners of its outline, and the outline itself, twice.
    assert (len(faces) // 64, len(edges) // 64) == (len(fine.faces), 8 * (5 + 2 * 6))
    low, scale, size = record[:12].view(np.float32), record[12:16].view(np.float32)[0], record[16:28].view(np.int32)
    corners = faces.view(np.float32).reshape(-1, 4, 4)[:, 1:, :3]  # behind the normals
    level = 0
    for point in np.random.default_rng(4).uniform([-0.05, -0.05, -0.05], [2.05, 1.05, 2.05], size=(300, 3)):
        col, row, layer = np.floor((point - low) * scale).astype(int)
        cell = (layer * size[1] + row) * size[0] + col
        nearest = trimesh.triangles.closest_point(corners, np.tile(point, (len(corners), 1)))
        distance = np.linalg.norm(nearest - point, axis=1)
        near = np.flatnonzero(distance < reach)
        assert set(near) <= set(items[first[cell] : first[cell + 1]])
        if planes[cell] >= 0:
            a, b, c = corners[planes[cell]].astype(float)
            normal = np.cross(b - a, c - a)
            height = abs((point - a) @ normal) / np.linalg.norm(normal)
            assert min(distance.min(), reach) == pytest.approx(min(height, reach), abs=1e-6)
            level += 1
    assert level > 40  # of the points that are near a face


@pytest.mark.parametrize("solid", [True, False])
def test_no_face_is_nearer_to_the_centre_of_a_cell_than_it_says(solid):
    mesh = step_mesh(1, solid)
    grids = MeshGrids([[TriangleMesh(mesh.vertices, mesh.faces, 3)]], 0.05, "cpu")
    cells, record = grids._arrays[-2].numpy(), grids._arrays[-1].numpy()[128:]  # behind two grids of 64 bytes
    low, scale, size = record[:12].view(np.float32), record[12:16].view(np.float32)[0], record[16:28].view(np.int32)
    unit = record[28:32].view(np.float32)[0]
    points = np.random.default_rng(4).uniform(low, low + size / scale, size=(400, 3))
    place = np.floor((points - low) * scale)
    col, row, layer = place.astype(int).T
    away = np.linalg.norm(points - low - (place + 0.5) / scale, axis=1)
    clear, clear_of_edges = unit * cells[(layer * size[1] + row) * size[0] + col].T
    distance = trimesh.proximity.closest_point_naive(mesh, points)[1]
    within = [(np.abs(points - center) < half).all(axis=1) for center, half in BOXES]
    inside = (within[0] | within[1]) & solid
    assert (clear - away <= distance).all()
    diagonal = 3**0.5 / scale
    assert (clear >= distance - away - 2 * unit)[~inside & (clear > 0.0)].all()  # and it says much
    assert (clear > 0.0)[~inside & (distance > away + 2 * unit)].all()
    deep = inside & (distance > diagonal)
    assert (clear[deep] == 0.0).all()
    assert deep.any() == solid
    to_edges = distance_to_edges(points, grids._arrays[6].numpy().view(np.float32).reshape(-1, 16)[:, :6])
    assert (clear_of_edges - away <= to_edges + 1e-6).all()
    assert (clear_of_edges >= to_edges - away - 2 * unit)[to_edges < 255 * unit].all()


def distance_to_edges(points: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Distances from points to the nearest of edges from three numbers of a row of ``ends`` to the next three [m]."""
    nearest = np.full(len(points), np.inf)
    for row in ends.astype(float):
        a, along = row[:3], row[3:] - row[:3]
        share = np.clip((points - a) @ along / (along @ along), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - a - share[:, None] * along, axis=1))
    return nearest


def test_a_mesh_of_faces_that_are_seen_from_inside_is_not_solid():
    mesh = step_mesh()
    points = np.array([[1.5, 0.5, 0.97, 0.0, 0.0, 0.0, 1.0]])  # 3 cm below the tread

    def touch(faces: np.ndarray) -> float:
        turned = trimesh.Trimesh(mesh.vertices, faces, process=False)
        add = lambda b, body: b.add_shape_sphere(body, radius=0.1)  # noqa: E731
        return contacts_of(model_of(turned, add, points, FRAMES[0]), FRAMES[0])[0][0][2][2]

    assert touch(mesh.faces) == pytest.approx(1.0)  # out through the tread
    assert touch(mesh.faces[:, ::-1]) == pytest.approx(-1.0)  # away from it


def test_boxes_that_share_edges_are_solid():
    """As stairs are often made: boxes up to a common end, four of whose edges are those of all of them."""
    boxes = [trimesh.creation.box(bounds=[(0.5 * k, 0.0, 0.0), (2.0, 1.0, 0.5 * (k + 1))]) for k in range(4)]
    stairs = trimesh.util.concatenate(boxes)
    points = np.array(
        [(0.5 * k + x, y, 0.5 * (k + 1) - 0.02) for k in range(4) for x in (0.1, 0.25) for y in (0.3, 0.5)]
    )
    model = model_of(stairs, lambda b, body: b.add_shape_sphere(body, radius=0.01), random_poses(
        np.random.default_rng(0), points), FRAMES[1])  # fmt: skip
    for contacts in contacts_of(model, FRAMES[1]):  # their centres are 2 cm inside
        ((dist, _, normal),) = contacts
        assert dist == pytest.approx(-0.03, abs=1e-5)
        np.testing.assert_allclose(normal, (0.0, 0.0, 1.0), atol=1e-3)


def rough_corner(random: np.random.Generator, cells: int = 40, bumps: float = 0.008) -> trimesh.Trimesh:
    """The corner of a room, 1 m long, whose floor and two walls are cut finely and have bumps."""
    x = np.linspace(0.0, 1.0, cells + 1)
    u, v = (a.reshape(-1) for a in np.meshgrid(x, x))
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).reshape(-1)
    faces = np.concatenate([first[:, None] + [0, 1, cells + 2], first[:, None] + [0, cells + 2, cells + 1]])
    sides = []
    for axis in range(3):
        height = np.where((u > 0.0) & (v > 0.0), bumps * random.random(len(u)), 0.0)
        points = np.stack([height, u, v], axis=1)
        sides.append(trimesh.Trimesh(np.roll(points, axis, axis=1), faces, process=False))
    corner = trimesh.util.concatenate(sides)
    corner.merge_vertices()
    return corner


def test_a_box_in_a_rough_corner_has_room_for_its_contacts() -> None:
    random, half = np.random.default_rng(0), 0.1
    turns = Rotation.from_euler("xyz", random.normal(size=(COUNT, 3)) * 2.0, degrees=True)
    reach = np.abs(turns.as_matrix()).sum(axis=2) * half
    poses = np.concatenate([reach + random.uniform(-0.002, 0.01, (COUNT, 3)), turns.as_quat()], axis=1)
    model = model_of(rough_corner(random), lambda b, body: b.add_shape_box(body, hx=half, hy=half, hz=half), poses,
                     wp.transform_identity())  # fmt: skip
    counts = [len(found) for found in contacts_of(model, wp.transform_identity())]
    room, rows = contact_capacity(model, on_triangles=True)
    assert 8 < max(counts) <= room
    assert rows >= 4 * room
