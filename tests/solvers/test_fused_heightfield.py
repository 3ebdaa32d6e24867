# SPDX-License-Identifier: Apache-2.0
"""Height-field contacts of the fused step against the Warp functions that find those of MuJoCo Warp's solver.

Those of cylinders are compared with MuJoCo's contacts with a plane."""

# No `from __future__ import annotations`: Warp reads annotations as types, and some of them are local here.

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
import warp as wp
from mujoco_warp import GeomType

import stripe_kernels
from stripe_kernels.heightfield import Field, Touch, Touches, add_touch, field_peak
from stripe_kernels.mujoco_ground import _find_touch, _half_extents

SPHERE, CAPSULE, BOX, CYLINDER = (int(GeomType[name]) for name in ("SPHERE", "CAPSULE", "BOX", "CYLINDER"))
COUNT, MAX_HITS, HIT = 2000, 6, 7
SIZE = (1.0, 0.8, 0.12, 0.1)
"""Half extents of the field and its height [m]; the last, the depth of its base, is not used."""
FIND = f"""
const real *pos = (real*)xpos.data + 6 * tid, *axes = (real*)xmat.data + 18 * tid, *sizes = (real*)size.data + 3 * tid;
const fused::Geom ground{{fused::load(pos), fused::load_matrix(axes), fused::Vec{{0, 0, 0}}}};
const fused::Geom geom{{fused::load(pos + 3), fused::load_matrix(axes + 9), fused::load(sizes)}};
const fused::Field surface{{field.heights.data, field.nrow, field.ncol, field.size[0], field.size[1], field.size[2]}};
fused::Hit hits[MAX_HITS];
int count = 0;
fused::PartKind whole = kind == {BOX} ? fused::BOX_PART : fused::BALL_PART;
if (kind == {CYLINDER}) whole = fused::CYLINDER_PART;
const fused::PartKind kinds[] = {{whole, fused::BALL_PART, fused::AXIS_PART}};
for (int part = 0; part < (kind == {CAPSULE} ? 3 : 1); part++) {{
    const fused::Mat turned = fused::transposed(ground.axes);
    const fused::Patch patch = fused::patch_at(surface, turned * (geom.pos - ground.pos));
    fused::World w{{patch, fused::box_in(turned, geom)}};
    fused::Search& s = w.search[0];
    s.pair = 0, s.count = 0, s.ended = false;
    if (!fused::prepare(s, kinds[part], kind == {CAPSULE} ? 1 - 2 * part : 0, margin, patch, turned, geom)) continue;
    fused::find_hits(w, fused::Sources(), 0, 1, 0);
    for (int i = 0; i < s.count; i++) hits[count++] = fused::to_world(w.found[s.hit[i]].touch, ground, geom);
}}
real* out = (real*)found.data + {1 + HIT * MAX_HITS} * tid;
*out++ = count;
for (int i = 0; i < count; i++, out += {HIT}) {{
    out[0] = hits[i].dist, fused::store(out + 1, hits[i].pos), fused::store(out + 4, hits[i].normal);
}}
"""

WORLD = """
namespace fused {
// A world of one geom on one field, in the place of world.h.
struct World {
    Patch patch;
    Box box;
    Search search[1];
    Found found[TOUCHES];
    unsigned short complete;
};
struct Sources {};
FN World& in_place(World& w) { return w; }
FN Patch patch_of(const World& w, int, Vec) { return w.patch; }
FN Box box_of(const World& w, const Sources&, int) { return w.box; }
}  // namespace fused
"""


@cache
def fused_kernel(double: bool) -> wp.Kernel:
    """Kernel of the C++ source, for geoms that need no model."""
    folder = Path(stripe_kernels.__file__).parent / "fused"
    names = "algebra.h", "primitives.h", "search.h", "heightfield.h", "search_hits.h"
    touches = (folder / "touches.h").read_text()
    search = "\n#if HAS_SEARCHES\nnamespace fused {\n" + touches[touches.index("// The touch of a candidate") :]
    sources = "".join((folder / name).read_text() for name in names) + WORLD + search
    head = (
        f"#define LANES 1\n#define SEARCH_LANES 1\n#define MAX_HITS {MAX_HITS}\n"
        "#define SEARCHES_BOXES 1\n#define HAS_SEARCHES 1\n"
        "#define HAS_FIELDS 1\n#define HAS_FIELD_CYLINDER 1\n"
        "#define TOUCHES 24\n#define NFIELDS 1\n#define HAS_MESHES 0\n" + "#define FUSED_DOUBLE\n" * double
    )
    vec, mat, real = (wp.vec3d, wp.mat33d, wp.float64) if double else (wp.vec3, wp.mat33, wp.float32)

    # As in step_kernel.py: the first brace closes the body of the function, and so makes room for a library.
    @wp.func_native(f"}}\n{head}{sources}\nstatic CUDA_CALLABLE inline void end_() {{\n")
    def library(): ...

    @wp.func_native(FIND)
    def find(
        tid: int,
        field: Field,
        kind: int,
        margin: float,
        xpos: wp.array2d(dtype=vec),
        xmat: wp.array2d(dtype=mat),
        size: wp.array(dtype=vec),
        found: wp.array2d(dtype=real),
    ): ...

    # In a module of its own: the macros of the two precisions differ.
    @wp.kernel(module="unique", enable_backward=False)
    def find_hits(
        field: Field,
        kind: int,
        margin: float,
        xpos: wp.array2d(dtype=vec),
        xmat: wp.array2d(dtype=mat),
        size: wp.array(dtype=vec),
        found: wp.array2d(dtype=real),
    ):
        library()
        find(wp.tid(), field, kind, margin, xpos, xmat, size, found)

    return find_hits


@wp.kernel(enable_backward=False)
def find_expected(
    field: Field,
    kind: int,
    margin: float,
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
    size: wp.array[wp.vec3],
    found: wp.array2d[float],
):
    """Touches in the slots of add_ground_contacts."""
    i = wp.tid()
    frame = xmat[i, 0]
    pos = wp.transpose(frame) * (xpos[i, 1] - xpos[i, 0])
    rot = wp.transpose(frame) * xmat[i, 1]
    extent = _half_extents(kind, rot, size[i]) + wp.vec3(1.0, 1.0, 1.0) * margin
    if field_peak(field, pos - extent, pos + extent) < pos[2] - extent[2]:
        return
    touches, touch, search, count = Touches(), Touch(), wp.bool(True), wp.int32(0)
    for slot in range(wp.where(kind == CAPSULE, 6, 4)):
        if kind == CAPSULE and (slot == 2 or slot == 4):
            touches.count = 0
            search = wp.bool(True)
        if search:
            touch = _find_touch(slot, kind, field, pos, rot, size[i], margin, touches)
        search = search and touch.found
        if search:
            touches = add_touch(touches, touch)
            point = xpos[i, 0] + frame * (touch.point + 0.5 * touch.dist * touch.normal)
            normal = frame * touch.normal
            found[i, 1 + HIT * count] = touch.dist
            for k in range(3):
                found[i, 2 + HIT * count + k] = point[k]
                found[i, 5 + HIT * count + k] = normal[k]
            count += 1
    found[i, 0] = float(count)


def random_case(kind: int, rough: bool) -> dict[str, np.ndarray]:
    """A field, and geoms at random around its surface: above, deep inside, and beyond its border."""
    rng = np.random.default_rng(kind)
    heights = rng.uniform(size=(33, 41)) if rough else np.full((33, 41), 0.5)
    turn = [trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3] for _ in range(2 * COUNT)]
    xmat = np.reshape(turn, (COUNT, 2, 3, 3))
    local = rng.uniform(-1.0, 1.0, (COUNT, 3)) * (1.1, 0.9, 0.2) + (0.0, 0.0, 0.1)
    near = rng.uniform(-0.3, 0.3, (COUNT, 3))  # the origin is that of a tree of bodies, near the geom
    far = near - np.einsum("nij,nj->ni", xmat[:, 0], local)
    size = rng.uniform(0.02, 0.15, (COUNT, 3))
    case = {"heights": heights, "xpos": np.stack([far, near], axis=1), "xmat": xmat, "size": size}
    return {name: values.astype(np.float32) for name, values in case.items()}


def hits_of(kernel: wp.Kernel, kind: int, margin: float, case: dict[str, np.ndarray], double: bool = False) -> tuple:
    """Counts of hits, and distances, positions and normals, shape ``(n, 6, 7)``."""
    vec, mat, real = (wp.vec3d, wp.mat33d, wp.float64) if double else (wp.vec3, wp.mat33, wp.float32)
    field = Field()
    field.heights = wp.array(case["heights"].ravel(), dtype=float, device="cpu")
    field.nrow, field.ncol = case["heights"].shape
    field.size = wp.vec4(*SIZE)
    arrays = [wp.array(case[n], dtype=t, device="cpu") for n, t in (("xpos", vec), ("xmat", mat), ("size", vec))]
    found = wp.zeros((COUNT, 1 + HIT * MAX_HITS), dtype=real, device="cpu")
    wp.launch(kernel, dim=COUNT, inputs=[field, kind, margin, *arrays, found], device="cpu")
    numbers = found.numpy()
    return numbers[:, 0].astype(int), numbers[:, 1:].reshape(COUNT, MAX_HITS, HIT)


@pytest.mark.parametrize("margin", [0.0, 0.02])
@pytest.mark.parametrize(
    ("kind", "rough", "most"),
    [(SPHERE, True, 4), (CAPSULE, True, 6), (BOX, True, 4), (SPHERE, False, 1), (CAPSULE, False, 2), (BOX, False, 4)],
)
def test_hits_are_those_of_the_warp_functions_in_both_precisions(kind, rough, most, margin):
    case = random_case(kind, rough)
    counts, hits = hits_of(fused_kernel(False), kind, margin, case)
    assert np.bincount(counts)[1:].min() > 50
    assert len(np.bincount(counts)) == 1 + most
    for kernel, double in ((find_expected, False), (fused_kernel(True), True)):
        expected_counts, expected = hits_of(kernel, kind, margin, case, double)
        same = counts == expected_counts
        assert same.mean() > 0.999
        np.testing.assert_allclose(hits[same, :, 0], expected[same, :, 0], atol=1e-5)
        # The normal of a sphere whose centre is all but on the surface is inexact, and its point halfway, too.
        error = np.abs(hits - expected)[same].max(axis=(1, 2))
        assert np.median(error) < 1e-6
        assert np.mean(error < 1e-4) > 0.995


def plane_contacts(case: dict[str, np.ndarray], margin: float) -> list[np.ndarray]:
    """MuJoCo's contacts of each cylinder with the plane of a level field: distances, positions and normals."""
    geom = "<body><freejoint/><geom type='cylinder' size='1 1' contype='0' conaffinity='0' name='c'/></body>"
    plane = "<body mocap='true'><geom type='plane' size='0 0 1' contype='0' conaffinity='0' name='p'/></body>"
    pair = f"<contact><pair geom1='p' geom2='c' margin='{margin}'/></contact>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{plane}{geom}</worldbody>{pair}</mujoco>")
    data, height, found = mujoco.MjData(model), SIZE[2] * float(case["heights"][0, 0]), []
    model.geom_rbound[:] = 0.0  # no broad phase
    for xpos, xmat, size in zip(*(case[n].astype(float) for n in ("xpos", "xmat", "size")), strict=True):
        data.mocap_pos[0], data.qpos[:3] = xpos[0] + height * xmat[0, :, 2], xpos[1]
        mujoco.mju_mat2Quat(data.mocap_quat[0], xmat[0].ravel())
        mujoco.mju_mat2Quat(data.qpos[3:], xmat[1].ravel())
        model.geom_size[1] = size
        mujoco.mj_fwdPosition(model, data)
        found.append(np.array([[c.dist, *c.pos, *c.frame[:3]] for c in data.contact]).reshape(-1, HIT))
    return found


@pytest.mark.parametrize("margin", [0.0, 0.02])
def test_a_cylinder_touches_a_level_field_as_mujoco_touches_a_plane(margin):
    case = random_case(CYLINDER, rough=False)
    counts, hits = hits_of(fused_kernel(True), CYLINDER, margin, case, double=True)
    contacts, compared = plane_contacts(case, margin), []
    for xpos, xmat, count, hit, contact in zip(case["xpos"], case["xmat"], counts, hits, contacts, strict=True):
        beyond = np.abs((contact[:, 1:4] - xpos[0]) @ xmat[0])[:, :2] > SIZE[:2]
        if beyond.any():
            continue
        assert count == len(contact)
        compared.append(count)
        order = [np.lexsort(np.round(found, 6).T) for found in (hit[:count], contact)]
        np.testing.assert_allclose(hit[order[0]], contact[order[1]], atol=1e-6)
    assert np.bincount(compared).min() > 50


def test_a_cylinder_lies_on_a_ridge_and_stands_on_a_peak():
    """With its barrel, and with a cap, where no rim touches; all contacts are straight up."""
    case = {name: np.repeat(values[:1], COUNT, axis=0) for name, values in random_case(CYLINDER, False).items()}
    case["xpos"][:], case["xmat"][:], case["size"][:] = 0.0, np.eye(3), (0.08, 0.1, 0.0)
    peak, ridge = np.zeros((33, 41), dtype=np.float32), np.zeros((33, 41), dtype=np.float32)
    peak[16, 20] = ridge[:, 20] = 1.0  # 0.12 m high
    lying = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    for heights, turn, reach in ((peak, np.eye(3), 0.1), (ridge, lying, 0.08)):
        case["heights"], case["xmat"][:, 1], case["xpos"][:, 1, 2] = heights, turn, 0.119 + reach
        counts, hits = hits_of(fused_kernel(False), CYLINDER, 0.0, case)
        found = hits[0, : counts[0]]
        assert len(found) >= (1 if heights is peak else 2)
        np.testing.assert_allclose(found[:, 0], -0.001, atol=1e-6)
        np.testing.assert_allclose(found[:, 4:], [[0.0, 0.0, 1.0]] * len(found), atol=1e-6)
        np.testing.assert_allclose(found[:, [1, 3]], [[0.0, 0.1195]] * len(found), atol=1e-6)


@pytest.mark.parametrize("kind", [SPHERE, CAPSULE, BOX, CYLINDER])
@pytest.mark.parametrize("place", [np.nan, np.inf, 1e30])
def test_a_geom_that_flew_away_touches_nothing(kind, place):
    case = random_case(kind, rough=True)
    case["xpos"][:, 1] = place
    assert not hits_of(fused_kernel(False), kind, 0.0, case)[0].any()
