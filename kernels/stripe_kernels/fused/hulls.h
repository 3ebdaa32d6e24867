// SPDX-License-Identifier: Apache-2.0
// Hulls: convex polytopes, the hulls of meshes and boxes; their contacts with planes, and how deep two of them overlap.
//
// Two polytopes overlap if no plane separates them. Those to try are parallel to a face of one of them, or to an edge of each:
// the faces of the Minkowski difference. The one with the largest distance, which is negative where they overlap, is where the
// shortest way out is. MuJoCo's expanding polytope (engine_collision_gjk.c) ends in the same face of the difference; to try all
// of them is work for many lanes, needs no memory and does not depend on an order. Source: D. Gregorius, "The Separating Axis
// Test between Convex Polyhedra", Game Developers Conference, 2013.

#if HAS_HULLS
namespace fused {

// As in hulls.py. A list of lists has the place of each of its lists, and of the end, before these.
struct Hull {
    const real* vertices;
    const real* planes;     // of each face the normal, and the greatest height of its vertices along it
    const int* neighbours;  // of each vertex, with -1 at the end
    const int* faces;       // their vertices, counterclockwise
    const int* edges;       // two vertices, and the faces on its left and right
    const int* corners;     // of each vertex its faces, and the vertex before it in each
    int num_vertices, num_faces, num_edges, climbs;
    float center[3], half[3];  // the box along the axes around it
};
static_assert(sizeof(Hull) == 88, "as the record of hulls.py");

// A hull that is scaled, turned by the rows of `axes` and moved, in the axes of another one.
struct Polytope {
    const Hull& hull;
    Vec scale;
    Mat axes;
    Vec pos;
};

FN Vec scaled(Vec s, Vec v) { return Vec{s.x * v.x, s.y * v.y, s.z * v.z}; }
FN Vec vertex_of(const Hull& h, int v) { return load(h.vertices + 3 * v); }
FN Vec normal_of(const Hull& h, int f) { return load(h.planes + 4 * f); }
FN Vec vertex_of(const Polytope& p, int v) { return p.pos + p.axes * scaled(p.scale, vertex_of(p.hull, v)); }
FN Vec normal_of(const Polytope& p, int f) { return p.axes * normal_of(p.hull, f); }

// The vertex that is lowest along a direction, and its height.
FN int lowest(const Hull& h, Vec along, real& height) {
    int best = 0;
    height = (real)1e30;
#pragma unroll 4
    for (int v = 0; v < h.num_vertices; v++) {
        real x = dot(along, vertex_of(h, v));
        if (x < height) height = x, best = v;
    }
    return best;
}
FN int lowest(const Polytope& p, Vec along, real& height) {
    int best = lowest(p.hull, scaled(p.scale, transposed(p.axes) * along), height);
    height += dot(along, p.pos);
    return best;
}

// The vertex farthest along a direction. As MuJoCo does it in large meshes: it climbs from vertex to vertex.
FN int support(const Hull& h, Vec along) {
    int best = 0;
    real height;
    if (!h.climbs) return lowest(h, -1 * along, height);
    height = dot(along, vertex_of(h, 0));
    for (int last = -1; last != best;) {
        last = best;
        for (const int* n = h.neighbours + h.neighbours[best]; *n >= 0; n++) {
            real x = dot(along, vertex_of(h, *n));
            if (x > height) height = x, best = *n;
        }
    }
    return best;
}

// Corners of a convex polygon.
struct FaceCorners {
    const Hull& hull;
    const int* list;
    FN_METHOD Vec operator[](int i) const { return vertex_of(hull, list[i]); }
};

// Contacts with a plane: the lowest vertex, and of the face at it that faces the plane most up to three more with a large area.
// Source: mjc_PlaneConvex of MuJoCo 3.17.
FN void plane_hull(Hits& hits, real margin, const Geom& plane, const Geom& geom, const Hull& h) {
    const Vec n = column(plane.axes, 2), up = transposed(geom.axes) * n;
    const real height = dot(geom.pos - plane.pos, n);
    const Vec center{h.center[0], h.center[1], h.center[2]}, half{h.half[0], h.half[1], h.half[2]};
    if (!(height + dot(up, center) - dot(half, Vec{FABS(up.x), FABS(up.y), FABS(up.z)}) < margin)) return;
    int found[4] = {support(h, -1 * up)}, sides = 1, face = -1;
    if (!(height + dot(up, vertex_of(h, found[0])) < margin)) return;
    real least = 1;
    for (int i = h.corners[found[0]]; i < h.corners[found[0] + 1]; i += 2) {
        real facing = dot(normal_of(h, h.corners[i]), up);
        if (facing < least) least = facing, face = h.corners[i];
    }
    if (face >= 0) {
        const FaceCorners corner{h, h.faces + h.faces[face]};
        sides = h.faces[face + 1] - h.faces[face];
        int a = 0;
        while (corner.list[a] != found[0]) a++;
        int q[3] = {(a + 1) % sides, (a + 2) % sides, (a + 3) % sides}, best[4] = {a, q[0], q[1], q[2]};
        real largest = area(corner[a], corner[q[0]], corner[q[1]], corner[q[2]]);
        if (sides > 4) grow(corner, sides, a, q, largest, best);
        for (int i = 1; i < 4; i++) found[i] = corner.list[best[i]];
    }
    for (int i = 0; i < 4 && i < sides; i++) {
        real below = dot(up, vertex_of(h, found[i])), dist = height + below;
        if (dist >= margin || (i > 0 && below > 0)) continue;
        add(hits, dist, geom.pos + geom.axes * vertex_of(h, found[i]) - ((real)0.5 * dist) * n, n, Vec{0, 0, 0});
    }
}

// How two polytopes overlap: what of each touches, the least depth as a negative distance, and the normal from the first to the
// second.
enum HullPart { HULL_VERTEX = 1, HULL_EDGE = 2, HULL_FACE = 3 };
struct Overlap {
    HullPart kinds[2];
    int numbers[2];
    real dist;
    Vec normal;
    bool found;
};

// Whether the boxes around two polytopes overlap.
FN bool are_near(const Polytope& a, const Hull& b) {
    const Vec center{a.hull.center[0], a.hull.center[1], a.hull.center[2]}, half{b.half[0], b.half[1], b.half[2]};
    const Vec reach = scaled(a.scale, Vec{a.hull.half[0], a.hull.half[1], a.hull.half[2]});
    const Vec d = a.pos + a.axes * scaled(a.scale, center) - Vec{b.center[0], b.center[1], b.center[2]};
    const Vec rows[3] = {a.axes.r0, a.axes.r1, a.axes.r2}, off = transposed(a.axes) * d;
    const real ds[3] = {d.x, d.y, d.z}, offs[3] = {off.x, off.y, off.z};
    const real halves[3] = {half.x, half.y, half.z}, reaches[3] = {reach.x, reach.y, reach.z};
    for (int i = 0; i < 3; i++) {
        const Vec r = rows[i], c = column(a.axes, i);
        if (!(FABS(ds[i]) <= halves[i] + dot(reach, Vec{FABS(r.x), FABS(r.y), FABS(r.z)}))) return false;
        if (!(FABS(offs[i]) <= reaches[i] + dot(half, Vec{FABS(c.x), FABS(c.y), FABS(c.z)}))) return false;
    }
    return true;
}

// The best of all lanes: the largest distance, and the smallest number where two are equal.
FN void best_of_lanes(real& best, real& number, int lane) {
#if LANES > 1
    for (int o = LANES / 2; o; o >>= 1) {
        real other = from_lane(best, lane ^ o), n = from_lane(number, lane ^ o);
        if (other > best || (other == best && n < number)) best = other, number = n;
    }
#endif
}

// Height of the plane of a face.
FN real height_of(const Polytope& p, int f) {
    Vec n = normal_of(p.hull, f);
    return dot(normal_of(p, f), p.pos) + p.hull.planes[4 * f + 3] * dot(scaled(n, n), p.scale);  // only cubes are scaled
}

// The two edges that separate most of those that make a face of the Minkowski difference: on the sphere of directions the
// arc between the normals at one crosses that of the other one turned back.
FN void try_edges(const Polytope& a, const Hull& b, real& best, real& number, int lane) {
    const real parallel = sizeof(real) == 8 ? (real)1e-20 : (real)1e-8;  // the sine of the angle, squared
    ROLLED for (int i = 0; i < a.hull.num_edges; i++) {
        const int* edge = a.hull.edges + 4 * i;
        const Vec from = vertex_of(a, edge[0]), along = vertex_of(a, edge[1]) - from;
        const Vec left = normal_of(a, edge[2]), right = normal_of(a, edge[3]);
        EACH(j, b.num_edges) {
            const int* other = b.edges + 4 * j;
            const real c = dot(normal_of(b, other[2]), along), d = dot(normal_of(b, other[3]), along);
            if (!(c * d < 0)) continue;
            const Vec start = vertex_of(b, other[0]), across = vertex_of(b, other[1]) - start;
            const real e = dot(left, across), f = dot(right, across);
            if (!(e * f < 0 && c * f < 0)) continue;
            Vec n = cross(along, across);
            const real square = dot(n, n);
            if (square <= parallel * dot(along, along) * dot(across, across)) continue;
            n = ((dot(n, left + right) < 0 ? -1 : 1) / SQRT(square)) * n;
            const real dist = dot(n, start - from);
            if (dist > best) best = dist, number = (real)(i * b.num_edges + j);
        }
    }
    best_of_lanes(best, number, lane);
}

// How a polytope overlaps a hull, in whose axes it is, found by all lanes.
COLD Overlap overlap_of(Polytope a, const Hull& b, int lane) {
    Overlap o;
    real best = (real)-1e30, number = 0, height, edge = (real)-1e30, edges = 0;
    EACH(f, a.hull.num_faces) {
        lowest(b, normal_of(a, f), height);
        height -= height_of(a, f);
        if (height > best) best = height, number = (real)f;
    }
    EACH(f, b.num_faces) {
        lowest(a, normal_of(b, f), height);
        height -= b.planes[4 * f + 3];
        if (height > best) best = height, number = (real)(a.hull.num_faces + f);
    }
    best_of_lanes(best, number, lane);
    o.found = false;
    if (!(best < 0)) return o;
    try_edges(a, b, edge, edges, lane);
    if (!(edge < 0) && edge > best) return o;
    if (edge > best + (real)(10 * LINE_TOLERANCE)) {  // more than rounding
        const int i = (int)edges / b.num_edges, j = (int)edges % b.num_edges;
        const int *first = a.hull.edges + 4 * i, *second = b.edges + 4 * j;
        Vec n = cross(vertex_of(a, first[1]) - vertex_of(a, first[0]), vertex_of(b, second[1]) - vertex_of(b, second[0]));
        n = ((dot(n, normal_of(a, first[2]) + normal_of(a, first[3])) < 0 ? -1 : 1) / SQRT(dot(n, n))) * n;
        return Overlap{{HULL_EDGE, HULL_EDGE}, {i, j}, edge, n, true};
    }
    const int f = (int)number;
    if (f < a.hull.num_faces)
        return Overlap{{HULL_FACE, HULL_VERTEX}, {f, lowest(b, normal_of(a, f), height)}, best, normal_of(a, f), true};
    const Vec n = normal_of(b, f - a.hull.num_faces);
    return Overlap{{HULL_VERTEX, HULL_FACE}, {lowest(a, n, height), f - a.hull.num_faces}, best, -1 * n, true};
}

// Point of an edge that is nearest to `p`.
FN Vec closest_on_edge(const Hull& h, int e, Vec p) {
    const Vec a = vertex_of(h, h.edges[4 * e]), ab = vertex_of(h, h.edges[4 * e + 1]) - a;
    return a + clamped(dot(p - a, ab) / dot(ab, ab), 0, 1) * ab;
}

// Whether the perpendicular from a point onto a face meets it.
FN bool is_above(const Hull& h, int face, Vec p) {
    const Vec n = normal_of(h, face);
    const int *list = h.faces + h.faces[face], sides = h.faces[face + 1] - h.faces[face];
    for (int i = 0; i < sides; i++) {
        const Vec a = vertex_of(h, list[i]), b = vertex_of(h, list[i + 1 < sides ? i + 1 : 0]);
        if (dot(cross(n, b - a), p - a) < 0) return false;
    }
    return true;
}

// How a ball touches a hull, found by all lanes: along the normal of the nearest face from inside, from outside where the
// hull is nearest to the centre.
COLD Overlap ball_overlap(Vec center, real radius, real margin, const Hull& h, int lane) {
    Overlap o;
    real best = (real)-1e30, number = 0;
    EACH(f, h.num_faces) {
        const real height = dot(normal_of(h, f), center) - h.planes[4 * f + 3];
        if (height > best) best = height, number = (real)f;
    }
    best_of_lanes(best, number, lane);
    o.found = best < radius + margin, o.dist = best - radius, o.normal = -1 * normal_of(h, (int)number);
    if (!o.found || best <= 0) return o;
    best = (real)-1e30;
    EACH(f, h.num_faces) {
        const real height = dot(normal_of(h, f), center) - h.planes[4 * f + 3];
        if (height > 0 && -height > best && is_above(h, f, center)) best = -height, number = (real)f;
    }
    EACH(e, h.num_edges) {
        const Vec d = closest_on_edge(h, e, center) - center;
        const real length = SQRT(dot(d, d));
        if (-length > best) best = -length, number = (real)(h.num_faces + e);
    }
    best_of_lanes(best, number, lane);
    const int n = (int)number;
    o.found = -best < radius + margin, o.dist = -best - radius;
    if (n < h.num_faces) o.normal = -1 * normal_of(h, n);
    else o.normal = (-1 / best) * (closest_on_edge(h, n - h.num_faces, center) - center);
    return o;
}

}  // namespace fused
#endif
