// SPDX-License-Identifier: Apache-2.0
// Meshes: contacts of spheres, capsules and boxes with the triangles of meshes that do not move.
//
// A solid mesh is closed: a ball whose nearest face is seen from behind is inside, and leaves through that face. An open one
// has two outsides; a ball is on that of its centre. All of a box is on the side of the box's centre.

#if HAS_MESHES
namespace fused {

// As in mesh_grid.py. Corners are counterclockwise, seen from outside; `geom` is whose face it is.
struct alignas(16) MeshFace {
    float normal[3];
    int geom;
    float a[3];
    int is_solid;
    float b[3];
    int none1;
    float c[3];
    int none2;
};
// The edge a to b of a face whose third corner is `left`; `right` is that of the face on its other side, or `left` again at
// a border.
struct alignas(16) MeshEdge {
    float a[3], b[3], left[3], right[3];
    int geom, is_solid, none[2];
};

// Three numbers and an integer that lie together, in one load: lanes read records that are far apart.
FN void load_four(float* numbers, int& integer, const float* from) {
#ifdef __CUDACC__
    asm("ld.global.nc.v4.b32 {%0, %1, %2, %3}, [%4];" : "=f"(numbers[0]), "=f"(numbers[1]), "=f"(numbers[2]), "=r"(integer) : "l"(from));
#else
    for (int k = 0; k < 3; k++) numbers[k] = from[k];
    integer = *(const int*)(from + 3);
#endif
}
FN MeshFace face_at(const Grid& g, int number) {
    const MeshFace& f = ((const MeshFace*)g.things)[number];
    MeshFace o;
    load_four(o.normal, o.geom, f.normal), load_four(o.a, o.is_solid, f.a);
    load_four(o.b, o.none1, f.b), load_four(o.c, o.none2, f.c);
    return o;
}

#define MESH_DEPTH ((real)0.05)  // of a centre or a corner in a solid mesh, beyond the radius, that is still found [m]

FN Vec in_mesh(const float* p, Vec geom) { return Vec{(real)p[0], (real)p[1], (real)p[2]} - geom; }

FN Cells cells_near(const Grid& g, Vec low, Vec high) {
    real scale = g.cells_per_metre;
    Vec from{scale * (low.x - g.low[0]), scale * (low.y - g.low[1]), scale * (low.z - g.low[2])};
    Vec to{scale * (high.x - g.low[0]), scale * (high.y - g.low[1]), scale * (high.z - g.low[2])};
    return Cells{first_cell(from.x, g.size[0]), last_cell(to.x, g.size[0]), first_cell(from.y, g.size[1]),
                 last_cell(to.y, g.size[1]),    first_cell(from.z, g.size[2]), last_cell(to.z, g.size[2])};
}

// Distances from a point within which there is no face, and no edge [m]; 0 where the point is not a number, and that of faces 0
// inside of a solid.
struct Clear {
    real faces, edges;
};
FN Clear clearance_at(const Clearance& g, Vec p) {
    real u[3] = {p.x - g.low[0], p.y - g.low[1], p.z - g.low[2]}, least = 0, most = 0;  // bounds of the distance to the grid
    int cell[3];
    for (int k = 0; k < 3; k++) {
        const real x = g.cells_per_metre * u[k], size = (real)g.size[k];
        cell[k] = (int)smaller(larger(x, 0), size - 1);
        const real beyond = g.metres_per_cell * larger(larger(-x, x - size), 0);
        least = larger(least, beyond), most += beyond;
    }
    const int units = g.cells[(cell[2] * g.size[1] + cell[1]) * g.size[0] + cell[0]];
    return Clear{larger(least, g.unit * (units & 255) - most), larger(least, g.unit * (units >> 8) - most)};
}

// Items of cells: those of a row of cells lie one after another. One that reaches into several cells is there several times.
FN const int* row_of_cells(const Grid& g, int layer, int row) { return g.cells + (layer * g.size[1] + row) * g.size[0]; }
FN int count_items(const Grid& g, const Cells& c) {
    int count = 0;
    if (c.col > c.last_col) return 0;
    for (int layer = c.layer; layer <= c.last_layer; layer++)
#pragma unroll 4
        for (int row = c.row; row <= c.last_row; row++) {
            const int* cells = row_of_cells(g, layer, row);
            count += cells[c.last_col + 1] - cells[c.col];
        }
    return count;
}
FN int item(const Grid& g, const Cells& c, int i) {
    int layer = c.layer, row = c.row;
    for (;;) {
        const int* cells = row_of_cells(g, layer, row);
        int first = cells[c.col], count = cells[c.last_col + 1] - first;
        if (i < count) return g.items[first + i];
        i -= count;
        if (++row > c.last_row) row = c.row, layer++;
    }
}
FN Vec normal_of(const MeshFace& f) { return Vec{(real)f.normal[0], (real)f.normal[1], (real)f.normal[2]}; }

// Touch of a point with a face within `reach`, or within `depth` where it is behind a face of a solid. Of faces with the same
// nearest point the one whose plane is farthest from it tells its side, and comes first by `order`.
FN bool point_touch(const MeshFace& f, Vec geom, Vec p, real reach, real depth, Touch& hit, real& order) {
    const Vec n = normal_of(f), a = in_mesh(f.a, geom);
    const real above = dot(p - a, n);
    const bool behind = f.is_solid && above < 0;
    if (behind) reach = depth;
    if (FABS(above) >= reach) return false;
    const Triangle t{a, in_mesh(f.b, geom), in_mesh(f.c, geom)};
    Vec point = closest_on_triangle(p, t), offset = p - point;
    real dist = SQRT(dot(offset, offset));
    if (dist >= reach) return false;
    hit.pos = point, hit.geom = f.geom, hit.dist = behind ? -dist : dist;
    hit.normal = dist <= (real)1e-7 ? n : ((behind ? -1 : 1) / dist) * offset;
    order = dist - (real)1e-3 * FABS(above);
    return true;
}

FN int item(const Search& s, const Grid& g, int i) { return s.first >= 0 ? g.items[s.first + i] : item(g, s.cells, i); }

#if SEARCHES_BOXES
// Touch of a corner of a box with a face. Which side of it is outside the box's centre tells: where the centre is behind a face
// of a solid, another one is nearer to it. A corner on the other side than the centre is inside, and leaves that way.
FN bool corner_touch(const MeshFace& f, const Search& s, Touch& hit, real& order) {
    Triangle t{in_mesh(f.a, s.geom), in_mesh(f.b, s.geom), in_mesh(f.c, s.geom)};
    Vec n = normal_of(f);
    if (dot(t.a, n) > 0) {
        if (f.is_solid) return false;
        n = -1 * n;
    }
    real above = dot(s.at - t.a, n);
    if (above <= -MESH_DEPTH || above >= s.reach) return false;
    Vec point = closest_on_triangle(s.at, t), offset = s.at - point;
    real dist = SQRT(dot(offset, offset));
    hit.pos = point, hit.geom = f.geom;
    if (above < 0) {
        if (dist > (real)-1.001 * above + (real)1e-6) return false;  // beside the face
        hit.dist = above, hit.normal = n, order = -1 - above;  // before those outside, the way out that is shortest first
        return true;
    }
    hit.dist = order = dist, hit.normal = dist <= (real)1e-7 ? n : (1 / dist) * offset;
    return dist < s.reach;
}
#endif

#if LIMBS
// Touch of a ball or a corner with the plane of a face.
FN bool plane_touch(const Search& s, const MeshFace& f, Touch& hit) {
    const Vec a = in_mesh(f.a, s.geom), n = normal_of(f);
    const real above = dot(s.at - a, n);
    real side = above < 0 ? -1 : 1, dist = FABS(above), reach = s.radius + s.reach;
    if (s.kind == CORNER_PART) {
        side = dot(a, n) > 0 ? -1 : 1, dist = side * above;  // of an open mesh the side of the box's centre
        if ((side < 0 && f.is_solid) || dist <= -MESH_DEPTH) return false;
    } else if (f.is_solid) {
        side = 1, dist = above;
        if (dist <= -s.radius - MESH_DEPTH) return false;
    }
    if (dist >= reach) return false;
    hit.pos = s.at - above * n, hit.normal = side * n, hit.dist = dist - s.radius, hit.geom = f.geom;
    return true;
}
#endif

// Candidates of a ball or a corner: faces. That nearest to a ball's centre tells where it is: inside of a solid it is the only
// touch, and outside it may be farther away than what touches. It is told then if `far` faces are.
FN bool face_touch(const Search& s, const Grid& g, int i, bool far, Touch& hit, real& order) {
    const MeshFace f = face_at(g, item(s, g, i));
#if SEARCHES_BOXES
    if (s.kind == CORNER_PART) return corner_touch(f, s, hit, order);
#endif
    real reach = s.radius + s.reach, depth = s.radius + MESH_DEPTH;
    if (far && f.is_solid) reach = larger(reach, depth);
    if (!point_touch(f, s.geom, s.at, reach, depth, hit, order)) return false;
    hit.dist -= s.radius;
    return true;
}

// Candidates of an axis, its ends left out: edges at which the surface bends down or ends.
FN bool edge_touch(const Search& s, const Grid& g, int i, Touch& hit, real& order) {
    const MeshEdge& e = ((const MeshEdge*)g.things)[item(s, g, i)];
    Triangle t{in_mesh(e.a, s.geom), in_mesh(e.b, s.geom), in_mesh(e.left, s.geom)};
    hit.geom = e.geom;
    return axis_touch(s, t, in_mesh(e.right, s.geom), hit, order);
}

#if SEARCHES_BOXES
// The piece of an edge that is inside a box, as shares of its length from `from`. Returns whether there is one. Source: Ericson,
// 5.3.3, with the planes of the box's sides.
FN bool clip(const Box& box, Vec from, Vec along, real& first, real& last) {
    first = 0, last = 1;
    for (int k = 0; k < 3; k++) {
        real x = dot(box.axis[k], from), d = dot(box.axis[k], along);
        if (FABS(d) < (real)1e-9) {
            if (FABS(x) > box.half[k]) return false;
            continue;
        }
        real u = (-box.half[k] - x) / d, v = (box.half[k] - x) / d;
        first = larger(first, smaller(u, v)), last = smaller(last, larger(u, v));
    }
    return first < last;
}

// Candidates of a box beside its corners: the two ends of what of each edge is inside the box.
FN bool edge_in_box(const Search& s, const Grid& g, const Box& box, int i, Touch& hit, real& order) {
    const MeshEdge& e = ((const MeshEdge*)g.things)[item(s, g, i / 2)];
    Vec a = in_mesh(e.a, s.geom), b = in_mesh(e.b, s.geom), left = in_mesh(e.left, s.geom), ends[2];
    real first, last;
    if (!clip(box, a, b - a, first, last)) return false;
    ends[0] = a + first * (b - a), ends[1] = a + last * (b - a);
    // The surface's normal at the edge. Of two outsides it is that of the box's centre, where a bend must be a ridge.
    Vec n1 = normal_of(Triangle{a, b, left}), n2 = n1, right = in_mesh(e.right, s.geom), across = right - left;
    bool is_border = dot(across, across) == 0;
    if (!is_border) n2 = normal_of(Triangle{b, a, right});
    Vec up = n1 + n2;
    if (!e.is_solid) {
        real side = dot(right - a, n1) < 0 ? 1 : -1;
        if (is_border) side = dot(n1, a) < 0 ? 1 : -1;
        else if (side * dot(n1, a) >= 0 && side * dot(n2, a) >= 0) return false;
        up = side * up;
    }
    // The edge leaves the box through the nearest side. One that does not face the surface tells that the edge comes
    // in end on, as that below a corner of a table: the others at its end touch there.
    real least = (real)1e6;
    for (int k = 0; k < 6; k++) {
        Vec n = (k % 2 ? -1 : 1) * box.axis[k / 2];
        real depth = box.half[k / 2] + larger(dot(n, ends[0]), dot(n, ends[1]));
        if (depth < least) least = depth, hit.normal = n, hit.dist = -box.half[k / 2];
    }
    if (dot(hit.normal, up) <= (real)0.1 * SQRT(dot(up, up))) return false;
    hit.pos = ends[i % 2], hit.dist -= dot(hit.normal, hit.pos), hit.geom = e.geom, order = hit.dist;
    return hit.dist < s.reach;
}
#endif

// The touch of a candidate of a part of any kind. `box` places the geom of a search that is one.
template <class PlaceBox>
FN bool mesh_touch(const Search& s, const Mesh& mesh, int candidate, PlaceBox box, bool far, Touch& hit, real& order) {
#if SEARCHES_BOXES
    if (s.kind == BOX_PART) return edge_in_box(s, mesh.edges, box(), candidate, hit, order);
#endif
    if (s.kind == AXIS_PART) return edge_touch(s, mesh.edges, candidate, hit, order);
    return face_touch(s, mesh.faces, candidate, far, hit, order);
}

#if LIMBS
// Whether a box around a point or a part of a geom, by `reach` larger, has a point of the bounds of some points.
template <int N>
FN bool meets_bounds(const float* const (&points)[N], Vec center, Vec half) {
    for (int k = 0; k < 3; k++) {
        const real at = k == 0 ? center.x : k == 1 ? center.y : center.z, by = k == 0 ? half.x : k == 1 ? half.y : half.z;
        real low = points[0][k], high = low;
        for (int i = 1; i < N; i++) low = smaller(low, points[i][k]), high = larger(high, points[i][k]);
        if (low - at > by || at - high > by) return false;
    }
    return true;
}

// Whether a candidate of a part may touch, which takes less time to tell than whether it does: bounds are in reach.
FN bool may_touch(const Search& s, const Mesh& mesh, int candidate, bool far) {
    const real more = (real)1e-4;  // than rounding
    const bool of_edges = s.kind == AXIS_PART || s.kind == BOX_PART;
    if (of_edges) {
        const MeshEdge& e = ((const MeshEdge*)mesh.edges.things)[item(s, mesh.edges, s.kind == BOX_PART ? candidate / 2 : candidate)];
        const float* const ends[] = {e.a, e.b};
        const real reach = s.radius + s.reach + more;
        return meets_bounds(ends, s.geom, Vec{FABS(s.at.x) + reach, FABS(s.at.y) + reach, FABS(s.at.z) + reach});
    }
    const MeshFace f = face_at(mesh.faces, item(s, mesh.faces, candidate));
    const real depth = s.radius + MESH_DEPTH, above = dot(s.at - in_mesh(f.a, s.geom), normal_of(f));
    real reach = s.radius + s.reach;
    if (s.kind == CORNER_PART || (f.is_solid && (far || above < 0))) reach = larger(reach, depth);
    reach += more;
    const float* const corners[] = {f.a, f.b, f.c};
    return FABS(above) <= reach && meets_bounds(corners, s.geom + s.at, reach * Vec{1, 1, 1});
}
#endif

// Whether a touch remains one beside the hits, see `remains`.
template <class Hits>
FN bool remains_on_mesh(const Search& s, const Hits* found, const Touch& hit, real& order) {
    if (s.kind == BALL_PART)  // the centre is outside, as else there is one touch
        return hit.dist < s.reach && hit.dist >= -s.radius && is_above_planes(s, found, hit.pos);
    if (s.kind == CORNER_PART) return is_above_planes(s, found, hit.pos);
    if (s.kind == AXIS_PART) return is_apart(s, found, hit.pos);
    // The deepest touch of a box, then those that are far from the others: on a flat floor all are equally deep, and four
    // hold the box if they are far apart.
    real apart = (real)1e12;
    for (int k = 0; k < s.count; k++) {
        Vec d = hit.pos - found[s.hit[k]].touch.pos;
        apart = smaller(apart, dot(d, d));
    }
    order = hit.dist - (real)0.02 * SQRT(apart);
    return apart >= (real)1e-6;
}

// Prepare the search for touches of a part of a geom that is `at` a point, see `place`. Returns whether faces or edges are near.
// The rows of `axes` are those of the meshes.
FN bool prepare(Search& s, PartKind kind, int end, real margin, const Mesh& mesh, Vec at, const Mat& axes, const Geom& geom) {
    Bounds b = place(s, kind, end, margin, axes, geom);
    s.geom = at, s.first = -1;
    s.size = 0;
#if LIMBS
    s.on_plane = false;
#endif
    if (kind == AXIS_PART && !is_long(s)) return false;
    const bool of_edges = kind == AXIS_PART || kind == BOX_PART;
    const Grid& grid = of_edges ? mesh.edges : mesh.faces;
    Vec center = s.geom + b.center;
    real far = s.radius + larger(margin, MESH_DEPTH);
    if (!of_edges && far <= grid.reach) {  // the point's own cell has all that is near, as mostly
        const real u[3] = {grid.cells_per_metre * (center.x - grid.low[0]), grid.cells_per_metre * (center.y - grid.low[1]),
                           grid.cells_per_metre * (center.z - grid.low[2])};
        for (int k = 0; k < 3; k++)
            if (!(u[k] >= 0 && u[k] < grid.size[k])) return false;
        const int* cell = row_of_cells(grid, (int)u[2], (int)u[1]) + (int)u[0];
        s.first = cell[0], s.size = cell[1] - s.first;
#if LIMBS
        const int plane = grid.planes[cell - grid.cells];
        if (s.size && plane >= 0) s.on_plane = true, s.first = plane;
#endif
        return s.size > 0;
    }
    if (!of_edges) b.half = far * Vec{1, 1, 1};
    s.cells = cells_near(grid, center - b.half, center + b.half);
    s.size = count_items(grid, s.cells);
    if (s.cells.row == s.cells.last_row && s.cells.layer == s.cells.last_layer && s.size)
        s.first = row_of_cells(grid, s.cells.layer, s.cells.row)[s.cells.col];
    if (kind == BOX_PART) s.size *= 2;
    return s.size > 0;
}

}  // namespace fused
#endif
