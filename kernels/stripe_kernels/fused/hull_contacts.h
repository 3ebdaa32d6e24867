// SPDX-License-Identifier: Apache-2.0
// Hull contacts: the contacts of two polytopes that overlap, by polygons.h.

#if HAS_HULLS
namespace fused {

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
template <class Body>
FN int sides_of(const Body& body, int face) {
    const Hull& h = hull_in(body);
    return h.faces[face + 1] - h.faces[face];
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
