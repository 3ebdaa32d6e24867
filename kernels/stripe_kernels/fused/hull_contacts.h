// SPDX-License-Identifier: Apache-2.0
// Hull contacts: the contacts of two polytopes that overlap. Source: MuJoCo 3.17, engine_collision_gjk.c, `multicontact`.
//
// Faces that all but face each other share a polygon, of which up to four corners touch; an edge that is all but parallel to
// a face touches with its ends above that. Others touch in one point.

#if HAS_HULLS
namespace fused {

#define FACES_ALIGNED ((real)0.99605117)  // cosine of 0.0889 rad: faces at less are parallel
#define EDGE_ALIGNED ((real)0.08878295)   // and its sine: an edge at less is parallel to a face

// Faces at a feature of a hull, and edges at a vertex, or the edge itself.
FN int count_faces(const Hull& h, HullPart kind, int number) {
    return kind == HULL_FACE ? 1 : kind == HULL_EDGE ? 2 : (h.corners[number + 1] - h.corners[number]) / 2;
}
FN int face_at(const Hull& h, HullPart kind, int number, int i) {
    return kind == HULL_FACE ? number : kind == HULL_EDGE ? h.edges[4 * number + 2 + i] : h.corners[h.corners[number] + 2 * i];
}
FN int count_edges(const Hull& h, HullPart kind, int number) { return kind == HULL_EDGE ? 1 : count_faces(h, kind, number); }
FN void edge_at(const Hull& h, HullPart kind, int number, int i, int* ends) {
    ends[0] = kind == HULL_EDGE ? h.edges[4 * number] : number;
    ends[1] = kind == HULL_EDGE ? h.edges[4 * number + 1] : h.corners[h.corners[number] + 2 * i + 1];
}

FN const Hull& hull_in(const Polytope& p) { return p.hull; }
FN const Hull& hull_in(const Hull& h) { return h; }

// A corner of a face, clockwise as seen from outside.
template <class Body>
FN Vec corner_of(const Body& body, int face, int i) {
    const Hull& h = hull_in(body);
    return vertex_of(body, h.faces[h.faces[face + 1] - 1 - i]);
}
FN int sides_of(const Hull& h, int face) { return h.faces[face + 1] - h.faces[face]; }

// Clip a polygon with the sides of a face: only what is above or below the face remains. Source: I. Sutherland, G. Hodgman,
// "Reentrant Polygon Clipping", Communications of the ACM, 1974. Returns the number of its corners, and which buffer has them.
template <class Body>
FN int clip(Vec polygon[2][HULL_SIDES], int corners, int& at, const Body& body, int face) {
    const Vec n = normal_of(body, face);
    const int sides = sides_of(hull_in(body), face);
    at = 0;
    for (int e = 0; e < sides && corners > 0; e++, at = 1 - at) {
        const Vec a = corner_of(body, face, e), inwards = cross(corner_of(body, face, (e + 1) % sides) - a, n);
        const Vec *from = polygon[at];
        Vec* to = polygon[1 - at];
        int count = 0;
        real here = dot(from[0] - a, inwards);
        for (int i = 0; i < corners; i++) {
            const Vec p = from[i], q = from[(i + 1) % corners];
            const real there = dot(q - a, inwards);
            if ((here > (real)-1e-10) != (there > (real)-1e-10) && count < HULL_SIDES)
                to[count++] = p + clamped(here / (here - there), 0, 1) * (q - p);
            if (there > (real)-1e-10 && count < HULL_SIDES) to[count++] = q;
            here = there;
        }
        corners = count;
    }
    return corners;
}

// Contacts of two faces that all but face each other: corners of the second one above the first one.
FN void face_contacts(Hits& hits, const Polytope& a, int first, const Hull& b, int second) {
    Vec polygon[2][HULL_SIDES];
    int count = 0, at;
    for (int i = 0; i < sides_of(b, second); i++) polygon[0][i] = corner_of(b, second, i);
    const int corners = clip(polygon, sides_of(b, second), at, a, first);
    Vec* kept = polygon[at];
    const Vec n1 = normal_of(a, first), n2 = normal_of(b, second), plane = corner_of(a, first, 0);
    for (int i = 0; i < corners; i++)
        if (dot(kept[i] - plane, n1) <= 0) kept[count++] = kept[i];
    int best[4] = {0, 1, 2, 3};
    if (count > 4) {  // a quadrilateral with a large area
        int q[3] = {1, 2, 3};
        real largest = area(kept[0], kept[1], kept[2], kept[3]);
        for (int c = 0; c < count; c++) {
            grow(kept, count, c, q, largest, best);
            if (q[0] != c) continue;
            q[0] = (q[0] + 1) % count;
            if (q[1] != q[0]) continue;
            q[1] = (q[1] + 1) % count;
            if (q[2] == q[1]) q[2] = (q[2] + 1) % count;
        }
        count = 4;
    }
    for (int i = 0; i < count; i++) {
        const Vec v = kept[best[i]];
        const real below = dot(v - plane, n1), dist = -below * dot(n1, n2);
        add(hits, dist < 0 ? dist : -dist, v - below * n1 - ((real)0.5 * dist) * n2, -1 * n2, Vec{0, 0, 0});
    }
}

// Contacts of the ends of what of the edge `from` to `to` is above a face, with a normal.
template <class Body>
FN void edge_contacts(Hits& hits, Vec from, Vec to, const Body& body, int face, Vec normal) {
    const Vec n = normal_of(body, face);
    const int sides = sides_of(hull_in(body), face);
    real first = 0, last = 1;
    for (int e = 0; e < sides; e++) {
        const Vec a = corner_of(body, face, e), inwards = cross(corner_of(body, face, (e + 1) % sides) - a, n);
        const real x = dot(from - a, inwards), y = dot(to - a, inwards);
        if (x <= (real)-1e-10 && y <= (real)-1e-10) return;
        if (x <= (real)-1e-10) first = larger(first, x / (x - y));
        if (y <= (real)-1e-10) last = smaller(last, x / (x - y));
    }
    if (!(first <= last)) return;
    for (int i = 0; i < 2; i++) {
        const Vec v = from + (i ? last : first) * (to - from);
        const real dist = dot(v - corner_of(body, face, 0), n);
        if (dist <= 0) add(hits, dist, v - ((real)0.5 * dist) * n, normal, Vec{0, 0, 0});
    }
}

// The faces at the two features that face each other most, if they do.
FN bool find_faces(const Overlap& o, const Polytope& a, const Hull& b, int* faces) {
    real best = -FACES_ALIGNED;
    bool found = false;
    for (int i = 0; i < count_faces(a.hull, o.kinds[0], o.numbers[0]); i++) {
        const int f = face_at(a.hull, o.kinds[0], o.numbers[0], i);
        const Vec n = normal_of(a, f);
        if (dot(n, o.normal) <= EDGE_ALIGNED) continue;
        for (int j = 0; j < count_faces(b, o.kinds[1], o.numbers[1]); j++) {
            const int g = face_at(b, o.kinds[1], o.numbers[1], j);
            const Vec m = normal_of(b, g);
            if (dot(m, o.normal) >= -EDGE_ALIGNED || dot(n, m) >= best) continue;
            best = dot(n, m), faces[0] = f, faces[1] = g, found = true;
        }
    }
    return found;
}

// Contacts of an edge at the feature of one polytope, all but parallel to a face at that of the other one. `side` is the place
// of the first one among the two.
template <class Own, class Other>
FN void find_edge_contacts(Hits& hits, const Overlap& o, int side, const Own& own, const Other& other) {
    const Hull &h = hull_in(own), &g = hull_in(other);
    for (int i = 0; i < count_faces(g, o.kinds[1 - side], o.numbers[1 - side]); i++) {
        const int f = face_at(g, o.kinds[1 - side], o.numbers[1 - side], i);
        const Vec n = normal_of(other, f);
        if (dot(n, o.normal) * (side ? 1 : -1) <= (real)1e-15) continue;
        for (int j = 0; j < count_edges(h, o.kinds[side], o.numbers[side]); j++) {
            int ends[2];
            edge_at(h, o.kinds[side], o.numbers[side], j, ends);
            const Vec from = vertex_of(own, ends[0]), to = vertex_of(own, ends[1]), along = to - from;
            if (FABS(dot(along, n)) >= EDGE_ALIGNED * SQRT(dot(along, along))) continue;
            edge_contacts(hits, from, to, other, f, (side ? 1 : -1) * n);
            return;
        }
    }
}

// The point halfway between the two surfaces where they overlap most.
FN Vec middle(const Overlap& o, const Polytope& a, const Hull& b) {
    const Vec half = ((real)0.5 * o.dist) * o.normal;
    if (o.kinds[0] == HULL_VERTEX) return vertex_of(a, o.numbers[0]) + half;
    if (o.kinds[1] == HULL_VERTEX) return vertex_of(b, o.numbers[1]) - half;
    const int *first = a.hull.edges + 4 * o.numbers[0], *second = b.edges + 4 * o.numbers[1];
    const Vec from = vertex_of(a, first[0]), along = vertex_of(a, first[1]) - from;
    const Vec start = vertex_of(b, second[0]), across = vertex_of(b, second[1]) - start, n = cross(along, across);
    return from + (dot(cross(start - from, across), n) / dot(n, n)) * along + half;
}

// Contacts of two polytopes, in the axes of the second one.
COLD void hull_hits(Hits& hits, const Overlap& o, const Polytope& a, const Hull& b) {
    int faces[2];
    if (find_faces(o, a, b, faces)) face_contacts(hits, a, faces[0], b, faces[1]);
    else if (o.kinds[0] != HULL_FACE && o.kinds[0] <= o.kinds[1]) find_edge_contacts(hits, o, 0, a, b);
    else if (o.kinds[1] != HULL_FACE) find_edge_contacts(hits, o, 1, b, a);
    if (hits.count == 0) add(hits, o.dist, middle(o, a, b), o.normal, Vec{0, 0, 0});
}

}  // namespace fused
#endif
