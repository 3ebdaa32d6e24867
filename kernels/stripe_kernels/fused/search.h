// SPDX-License-Identifier: Apache-2.0
// Search: what searches for contacts with the triangles of height fields and meshes share.
//
// Touches are searched in the axes of the ground, which is a height field or the meshes of a world, relative to the geom's
// centre, so that they are exact far from the world's origin. While they are, `pos` of a hit is the point on the surface;
// `to_world` completes the hits.
//
// A search is that of a part of a geom: a ball, the axis of a capsule, a cylinder, or a box. Its candidates, the triangles, edges or
// vertices that are near the part, are spread over the lanes of a world, all searches together. The best one is the next
// touch; then those of the rest are candidates again that are not too near to it. Searches are small, so that there is room
// for all of a world: what a seldom candidate needs of the geom is computed again.

namespace fused {

// Counterclockwise, seen from outside.
struct Triangle {
    Vec a, b, c;
};
FN Vec normal_of(const Triangle& t) {
    Vec n = cross(t.b - t.a, t.c - t.a);
    return (1 / SQRT(dot(n, n))) * n;
}

// Point of a triangle nearest to `p`. Source: C. Ericson, "Real-Time Collision Detection", Morgan Kaufmann, 2005, 5.1.5.
FN Vec closest_on_triangle(Vec p, const Triangle& t) {
    // Voronoi regions in Ericson's order: each test relies on the ones before. Vertices first, then edges, then the inside,
    // whose barycentric coordinates are va, vb and vc over their sum.
    Vec ab = t.b - t.a, ac = t.c - t.a, ap = p - t.a, bp = p - t.b, cp = p - t.c;
    real d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp), d5 = dot(ab, cp), d6 = dot(ac, cp);
    if (d1 <= 0 && d2 <= 0) return t.a;
    if (d3 >= 0 && d4 <= d3) return t.b;
    if (d6 >= 0 && d5 <= d6) return t.c;
    real va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    real u = vb, v = vc, sum = va + vb + vc;  // inside: shares of ab and ac
    if (vc <= 0 && d1 >= 0 && d3 <= 0) u = d1, v = 0, sum = d1 - d3;
    else if (vb <= 0 && d2 >= 0 && d6 <= 0) u = 0, v = d2, sum = d2 - d6;
    else if (va <= 0 && d4 >= d3 && d5 >= d6) u = d5 - d6, v = d4 - d3, sum = u + v;
    return t.a + (1 / sum) * (u * ab + v * ac);
}

// A field as seen from a geom: points are in the field's axes, relative to the geom's centre.
struct Patch {
    const float* heights;
    int rows, cols;
    real scale, step_x, step_y, cols_per_metre, rows_per_metre;
    Vec geom;  // the geom's centre in the frame of the field
};

// A cubic grid over the faces or the edges of meshes, as in mesh_grid.py. Cells are numbered along x, then y, then z.
struct Grid {
    float low[3], cells_per_metre;
    int size[3];
    float reach;        // items are in the lists of all cells that they are nearer to than this [m]
    const int* cells;   // place of the first item of each cell; behind it those of the next cell
    const int* items;   // numbers of the faces or edges, cell by cell
    const void* things; // MeshFace or MeshEdge
    const int* planes;  // of each cell a face for whose plane all of its faces may be taken, or -1; none for edges
};
// A grid of distances to the nearest face and the nearest edge, as in mesh_grid.py: the centre of a cell is not nearer to one
// than the cell says.
struct Clearance {
    float low[3], cells_per_metre;
    int size[3];
    float unit;                  // of the numbers of the cells [m]
    const unsigned short* cells;  // to faces, which is 0 inside of a solid, and 256 times that to edges
    float metres_per_cell, none;
};
// Meshes that do not move, together. What can touch an edge is on the outside of a bend.
struct Mesh {
    Grid faces, edges;
    Clearance clearance;
};

// Cells that a box reaches into: the first and the last along each axis; none where the first exceeds the last. Those of a
// height field are below and above it, in one layer.
struct Cells {
    short col, last_col, row, last_row;
#if HAS_MESHES
    short layer, last_layer;
#endif
};
// Of `n` cells along an axis. The bounds come first: casts of what no int holds are undefined. A position that is not a number has no cells.
FN short first_cell(real u, int n) { return (short)smaller(larger(u, 0), (real)n); }
FN short last_cell(real u, int n) { return u >= 0 ? (short)smaller(u, (real)(n - 1)) : -1; }

enum PartKind { BALL_PART, AXIS_PART, CYLINDER_PART, BOX_PART, CORNER_PART };

struct Touch {
    real dist;
    Vec pos, normal;
#if HAS_MESHES
    int geom;  // of the meshes, -1 for a height field
#endif
};

// The search for touches of a part of a geom.
struct Search {
    Vec geom;            // the geom's centre in the frame of the ground
    Vec at;              // centre of a ball, half of an axis, half of a box's bounding box, a corner
    real radius, reach;  // of a ball, axis or cylinder; distance below which it touches
#if HAS_MESHES
    int first;           // place of its items in the grid's list if they are that of one cell, else -1
#endif
    Cells cells;
    int size;            // number of its candidates
    int start;           // the first of them among those of all searches
    short pair;
    unsigned char kind;         // PartKind
    unsigned char most, count;  // hits that it may have and has
    bool inside;                // whether a ball's centre is inside the ground
    bool ended;
#if LIMBS
    bool on_plane;              // whether its candidates are the plane of a face, the number of which is `first`
#endif
    unsigned char hit[4];       // their numbers among the touches that were found
#if SEARCH_LANES > 1
    unsigned outside;         // order of the nearest face that a ball's centre is in front of and that it does not touch
    unsigned long long best;  // order and number of the best candidate
#else
    union {
        struct {
            real outside, order;
            int best;
        };
        Vec pos;              // where the geom is in the world, if the lanes of a warp search together
    };
#endif
};

// Whether a searched pair is one with meshes.
#if HAS_MESHES && HAS_FIELDS
FN bool is_mesh_pair(int p) { return contact_kind(p) >= MESH_SPHERE; }
#else
FN bool is_mesh_pair(int) { return HAS_MESHES; }
#endif

// A touch that was found, of one of the searches; its order is that before there are hits.
struct Found {
    Touch touch;
    real order;
    int search;
};

// A box around its centre, in the ground's axes.
struct Box {
    Vec axis[3];
    real half[3];
};
FN Box box_in(const Mat& axes, const Geom& geom) {
    return Box{{axes * column(geom.axes, 0), axes * column(geom.axes, 1), axes * column(geom.axes, 2)},
               {geom.size.x, geom.size.y, geom.size.z}};
}

// Place a part of a geom in the ground's axes, the rows of `axes`: its ball at `end` times its half length along its axis z,
// its axis, the whole cylinder or box, or its corner `end`. It touches in [center - half, center + half].
struct Bounds {
    Vec center, half;
};
FN Bounds place(Search& s, PartKind kind, int end, real reach, const Mat& axes, const Geom& geom) {
    s.kind = kind, s.reach = reach, s.radius = kind < BOX_PART ? geom.size.x : 0, s.inside = false;
    Bounds b{{0, 0, 0}, (s.radius + reach) * Vec{1, 1, 1}};
    if (kind < BOX_PART) s.at = (kind == BALL_PART ? end : 1) * geom.size.y * (axes * column(geom.axes, 2));
    if (kind == BALL_PART) b.center = s.at, s.most = end ? 2 : 4;
    if (kind == AXIS_PART || kind == CYLINDER_PART) {
        b.half = b.half + Vec{FABS(s.at.x), FABS(s.at.y), FABS(s.at.z)};
        s.most = kind == AXIS_PART ? 2 : 4;
    }
#if SEARCHES_BOXES
    if (kind == BOX_PART) {
        Box box = box_in(axes, geom);
        s.at = Vec{0, 0, 0}, s.most = 4;
        for (int i = 0; i < 3; i++)
            s.at = s.at + box.half[i] * Vec{FABS(box.axis[i].x), FABS(box.axis[i].y), FABS(box.axis[i].z)};
        b.half = b.half + s.at;
    }
    if (kind == CORNER_PART) {
        Vec x = geom.size;
        x = Vec{end & 1 ? -x.x : x.x, end & 2 ? -x.y : x.y, end & 4 ? -x.z : x.z};
        b.center = s.at = axes * (geom.axes * x), s.most = 2;
    }
#endif
    return b;
}
// Whether a capsule's axis is so long that it is more than a ball.
FN bool is_long(const Search& s) { return 4 * dot(s.at, s.at) > (real)1e-8; }

// Offer a candidate for the next hit. The one of lowest order is taken; the first of those of equal order, whichever lane
// comes first.
#if SEARCH_LANES > 1
FN void expect(Search& s) { s.best = ~0ull; }
FN void offer(Search& s, real order, int candidate) {
#ifdef __CUDA_ARCH__
    unsigned bits = __float_as_uint(order);  // as an unsigned number of the same order
    bits ^= bits >> 31 ? 0xffffffffu : 0x80000000u;
    atomicMin(&s.best, (unsigned long long)bits << 32 | (unsigned)candidate);
#endif
}
FN int taken(const Search& s) { return s.best == ~0ull ? -1 : (int)(s.best & 0xffffffffu); }
// Keep the order of the best candidate, that of none if there is none, and whether the best one now comes behind it.
FN void keep_outside(Search& s) { s.outside = (unsigned)(s.best >> 32); }
FN bool is_behind_outside(const Search& s) { return (unsigned)(s.best >> 32) >= s.outside; }
#else
FN void expect(Search& s) { s.best = -1; }
FN void offer(Search& s, real order, int candidate) {
    if (s.best < 0 || order < s.order) s.order = order, s.best = candidate;
}
FN int taken(const Search& s) { return s.best; }
FN void keep_outside(Search& s) { s.outside = s.best < 0 ? (real)1e30 : s.order; }
FN bool is_behind_outside(const Search& s) { return s.order >= s.outside; }
#endif

// Whether a point is above the tangent planes of a search's hits: those of a smooth surface are one touch.
template <class Hits>
FN bool is_above_planes(const Search& s, const Hits* found, Vec point) {
#pragma unroll 1
    for (int i = 0; i < s.count; i++)
        if (dot(point - found[s.hit[i]].touch.pos, found[s.hit[i]].touch.normal) <= (real)1e-4) return false;
    return true;
}

// Whether a point is at least 1 mm away from the hits.
template <class Hits>
FN bool is_apart(const Search& s, const Hits* found, Vec point) {
#pragma unroll 1
    for (int i = 0; i < s.count; i++) {
        Vec d = point - found[s.hit[i]].touch.pos;
        if (dot(d, d) < (real)1e-6) return false;
    }
    return true;
}

// Touch of an axis from -half to half, its ends left out, with the edge a to b of a triangle, on whose other side there is a
// triangle with the vertex `right`.
FN bool axis_touch(const Search& s, const Triangle& t, Vec right, Touch& hit, real& order) {
    const Vec half = s.at, axis = 2 * half;
    real pp = dot(axis, axis), size = s.radius + s.reach;
    // Nearest points of axis and edge: -half + x axis and a + y ab. Source: Ericson, 5.1.9, with the difference of products
    // in x as products of cross products, which keep their digits when axis and edge are parallel.
    Vec ab = t.b - t.a, r = -1 * half - t.a, across = cross(axis, ab);
    real pq = dot(axis, ab), c = dot(axis, r), det = dot(across, across);
    real x = det > 0 ? clamped(dot(across, cross(ab, r)) / det, 0, 1) : 0;
    real y = (pq * x + dot(ab, r)) / dot(ab, ab);
    if (y < 0) y = 0, x = clamped(-c / pp, 0, 1);
    else if (y > 1) y = 1, x = clamped((pq - c) / pp, 0, 1);
    if (x <= (real)1e-3 || x >= 1 - (real)1e-3) return false;  // the balls at the ends have their own touches
    Vec point = t.a + y * ab, offset = x * axis - half - point;
    // The point is the nearest one of both triangles only if neither goes on towards the axis.
    if (dot(offset, t.c - point) > (real)1e-5 || dot(offset, right - point) > (real)1e-5) return false;
    real dist = SQRT(dot(offset, offset));
    if (dist <= (real)1e-6 || dist >= size) return false;
    hit.pos = point, hit.normal = (1 / dist) * offset, hit.dist = dist - s.radius, order = dist;
    return true;
}

}  // namespace fused
