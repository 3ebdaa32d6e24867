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

// Four numbers that lie together, or three and an integer, in one load: lanes read records that are far apart.
FN void load_four(float* to, const float* from) {
#ifdef __CUDACC__
    asm("ld.global.nc.v4.f32 {%0, %1, %2, %3}, [%4];" : "=f"(to[0]), "=f"(to[1]), "=f"(to[2]), "=f"(to[3]) : "l"(from));
#else
    for (int k = 0; k < 4; k++) to[k] = from[k];
#endif
}
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

FN const MeshEdge& edge_of(const Grid& g, int number) { return ((const MeshEdge*)g.things)[number]; }
// The points of an edge: its ends, and the third corners of the faces on both sides.
struct EdgePoints {
    float a[3], b[3], left[3], right[3];
};
FN EdgePoints points_of(const MeshEdge& e) {
    float x[12];
    UNROLLED for (int i = 0; i < 12; i += 4) load_four(x + i, e.a + i);
    EdgePoints o;
    UNROLLED for (int k = 0; k < 3; k++) o.a[k] = x[k], o.b[k] = x[3 + k], o.left[k] = x[6 + k], o.right[k] = x[9 + k];
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
    real u[3] = {p.x - g.low[0], p.y - g.low[1], p.z - g.low[2]}, beyond = 0, square = 0;  // the grid; distance from a centre
    int cell[3];
    for (int k = 0; k < 3; k++) {
        const real x = g.cells_per_metre * u[k], size = (real)g.size[k];
        cell[k] = (int)smaller(larger(x, 0), size - 1);
        beyond = larger(beyond, g.metres_per_cell * larger(larger(-x, x - size), 0));
        const real off = u[k] - g.metres_per_cell * ((real)cell[k] + (real)0.5);
        square += off * off;
    }
    const int units = g.cells[(cell[2] * g.size[1] + cell[1]) * g.size[0] + cell[0]];
    const real away = SQRT(square);
    return Clear{larger(g.unit * (units & 255) - away, beyond), larger(g.unit * (units >> 8) - away, beyond)};
}

// Items of cells: those of a row of cells lie one after another. One that reaches into several cells is there several times.
FN const int* row_of_cells(const Grid& g, int layer, int row) { return g.cells + (layer * g.size[1] + row) * g.size[0]; }
FN int count_items(const Grid& g, const Cells& c) {
    int count = 0;
    if (c.col > c.last_col) return 0;
    ROLLED for (int layer = c.layer; layer <= c.last_layer; layer++)
        ROLLED for (int row = c.row; row <= c.last_row; row++) {
            const int* cells = row_of_cells(g, layer, row);
            count += cells[c.last_col + 1] - cells[c.col];
        }
    return count;
}
FN int item(const Grid& g, const Cells& c, int i) {
    int layer = c.layer, row = c.row;
    ROLLED for (;;) {
        const int* cells = row_of_cells(g, layer, row);
        int first = cells[c.col], count = cells[c.last_col + 1] - first;
        if (i < count) return g.items[first + i];
        i -= count;
        if (++row > c.last_row) row = c.row, layer++;
    }
}
FN Vec normal_of(const MeshFace& f) { return Vec{(real)f.normal[0], (real)f.normal[1], (real)f.normal[2]}; }

// The face or edge of a candidate. That of a box is twice its number, and one more for its second end.
FN int thing_of(const Search& s, const Mesh& mesh, int candidate) {
    const bool is_box = s.kind == BOX_PART;
    const Grid& g = is_box || s.kind == AXIS_PART ? mesh.edges : mesh.faces;
    const int i = is_box ? candidate / 2 : candidate, thing = s.first >= 0 ? g.items[s.first + i] : item(g, s.cells, i);
    return is_box ? 2 * thing + candidate % 2 : thing;
}

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
// touch, and outside it may be farther away than what touches. It is told then if `far` faces are. Of faces with the same
// nearest point the one whose plane is farthest from the centre tells its side, and comes first by `order`.
//
// Which side of a face is outside of a corner the box's centre tells: where the centre is behind a face of a solid, another one is
// nearer to it. A corner on the other side than the centre is inside, and leaves that way, the shortest first.
FN bool face_touch(const Search& s, const MeshFace& f, bool far, Touch& hit, real& order) {
    const bool is_corner = SEARCHES_BOXES && s.kind == CORNER_PART;
    const Triangle t{in_mesh(f.a, s.geom), in_mesh(f.b, s.geom), in_mesh(f.c, s.geom)};
    Vec n = normal_of(f);
    if (is_corner && dot(t.a, n) > 0) {
        if (f.is_solid) return false;
        n = -1 * n;
    }
    const real above = dot(s.at - t.a, n), depth = s.radius + MESH_DEPTH;
    const bool behind = above < 0 && (is_corner || f.is_solid);
    real reach = s.radius + s.reach;
    if (behind) reach = depth;
    else if (far && f.is_solid && !is_corner) reach = larger(reach, depth);
    if (FABS(above) >= reach) return false;
    const Vec point = closest_on_triangle(s.at, t), offset = s.at - point;
    const real dist = SQRT(dot(offset, offset));
    hit.pos = point, hit.geom = f.geom;
    if (is_corner && behind) {
        if (dist > (real)-1.001 * above + (real)1e-6) return false;  // beside the face
        hit.dist = above, hit.normal = n, order = -1 - above;        // before those outside
        return true;
    }
    if (dist >= reach) return false;
    hit.normal = dist <= (real)1e-7 ? n : ((behind ? -1 : 1) / dist) * offset;
    hit.dist = (behind ? -dist : dist) - s.radius;
    order = is_corner ? dist : dist - (real)1e-3 * FABS(above);
    return true;
}

// Candidates of an axis, its ends left out: edges at which the surface bends down or ends.
FN bool edge_touch(const Search& s, const MeshEdge& edge, Touch& hit, real& order) {
    const EdgePoints e = points_of(edge);
    Triangle t{in_mesh(e.a, s.geom), in_mesh(e.b, s.geom), in_mesh(e.left, s.geom)};
    hit.geom = edge.geom;
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
FN bool edge_in_box(const Search& s, const MeshEdge& edge, int end, const Box& box, Touch& hit, real& order) {
    const EdgePoints e = points_of(edge);
    Vec a = in_mesh(e.a, s.geom), b = in_mesh(e.b, s.geom), left = in_mesh(e.left, s.geom), ends[2];
    real first, last;
    if (!clip(box, a, b - a, first, last)) return false;
    ends[0] = a + first * (b - a), ends[1] = a + last * (b - a);
    // The surface's normal at the edge. Of two outsides it is that of the box's centre, where a bend must be a ridge.
    Vec n1 = normal_of(Triangle{a, b, left}), n2 = n1, right = in_mesh(e.right, s.geom), across = right - left;
    bool is_border = dot(across, across) == 0;
    if (!is_border) n2 = normal_of(Triangle{b, a, right});
    Vec up = n1 + n2;
    if (!edge.is_solid) {
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
    hit.pos = ends[end], hit.dist -= dot(hit.normal, hit.pos), hit.geom = edge.geom, order = hit.dist;
    return hit.dist < s.reach;
}
#endif

// The touch of a candidate of a part of any kind, by its `thing_of`. `box` places the geom of a search that is one.
template <class PlaceBox>
FN bool mesh_touch(const Search& s, const Mesh& mesh, int thing, PlaceBox box, bool far, Touch& hit, real& order) {
#if SEARCHES_BOXES
    if (s.kind == BOX_PART) return edge_in_box(s, edge_of(mesh.edges, thing / 2), thing % 2, box(), hit, order);
#endif
    if (s.kind == AXIS_PART) return edge_touch(s, edge_of(mesh.edges, thing), hit, order);
    return face_touch(s, face_at(mesh.faces, thing), far, hit, order);
}

#if LIMBS
// Whether a candidate of a part may touch, which takes less time to tell than whether it does: bounds are in reach.
FN bool may_touch(const Search& s, const Mesh& mesh, int thing, bool far) {
    const real more = (real)1e-4;  // than rounding
    const bool of_edges = s.kind == AXIS_PART || s.kind == BOX_PART;
    Vec center = s.geom, half, a, b, c;
    real reach = s.radius + s.reach;
    if (of_edges) {
        const EdgePoints e = points_of(edge_of(mesh.edges, s.kind == BOX_PART ? thing / 2 : thing));
        a = in_mesh(e.a, center), b = c = in_mesh(e.b, center);
        reach += more;
        half = Vec{FABS(s.at.x) + reach, FABS(s.at.y) + reach, FABS(s.at.z) + reach};
    } else {
        const MeshFace f = face_at(mesh.faces, thing);
        const real depth = s.radius + MESH_DEPTH, above = dot(s.at - in_mesh(f.a, center), normal_of(f));
        if (s.kind == CORNER_PART || (f.is_solid && (far || above < 0))) reach = larger(reach, depth);
        reach += more;
        if (FABS(above) > reach) return false;
        center = center + s.at, half = reach * Vec{1, 1, 1};
        a = in_mesh(f.a, center), b = in_mesh(f.b, center), c = in_mesh(f.c, center);
    }
    const auto meets = [](real by, real x, real y, real z) {
        return smaller(smaller(x, y), z) <= by && larger(larger(x, y), z) >= -by;
    };
    return meets(half.x, a.x, b.x, c.x) && meets(half.y, a.y, b.y, c.y) && meets(half.z, a.z, b.z, c.z);
}
#endif

// Whether a touch remains one beside the hits, see `remains`.
template <class Hits>
FN bool remains_on_mesh(const Search& s, const Hits* found, const Touch& hit, real& order) {
    if (s.kind == BALL_PART && !(hit.dist < s.reach && hit.dist >= -s.radius)) return false;  // the centre is outside, as else there is one touch
    const bool is_point = s.kind == BALL_PART || s.kind == CORNER_PART;
    // The deepest touch of a box, then those that are far from the others: on a flat floor all are equally deep, and four
    // hold the box if they are far apart.
    real apart = (real)1e12;
#pragma unroll 1
    for (int k = 0; k < s.count; k++) {
        const Touch& other = found[s.hit[k]].touch;
        const Vec d = hit.pos - other.pos;
        const real square = dot(d, d);
        if (is_point ? dot(d, other.normal) <= (real)1e-4 : square < (real)1e-6) return false;
        apart = smaller(apart, square);
    }
    if (s.kind == BOX_PART) order = hit.dist - (real)0.02 * SQRT(apart);
    return true;
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
