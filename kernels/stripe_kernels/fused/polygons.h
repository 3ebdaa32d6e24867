// SPDX-License-Identifier: Apache-2.0
// Polygons: the contacts of two convex bodies that overlap, from the faces or the face and the edge with which they touch.
// Source: MuJoCo 3.17, engine_collision_gjk.c, `multicontact`.
//
// Faces that all but face each other share a polygon, of which up to four corners touch; an edge that is all but parallel to
// a face touches with its ends above that. Others touch in one point. A body has `corner_of` its faces, clockwise as seen from
// outside, `sides_of` and `normal_of`.

#if HAS_HULLS || HAS_CURVED
namespace fused {

#define FACES_ALIGNED ((real)0.99605117)  // cosine of 0.0889 rad: faces at less are parallel
#define EDGE_ALIGNED ((real)0.08878295)   // and its sine: an edge at less is parallel to a face

// Area of a quadrilateral with corners in a plane, times two.
FN real area(Vec a, Vec b, Vec c, Vec d) {
    Vec n = cross(a - c, b - d);
    return SQRT(dot(n, n));
}

// Let the quadrilateral of the corners `a`, q[0], q[1] and q[2] of a polygon grow while one of them, the last one first, can
// move to the next corner. Whenever it grows it is the `best`.
template <class Corners>
FN void grow(const Corners& corner, int sides, int a, int* q, real& largest, int* best) {
    for (int k = 2; k < 3;) {
        int next[3] = {q[0], q[1], q[2]};
        next[k] = (q[k] + 1) % sides;
        real size = area(corner[a], corner[next[0]], corner[next[1]], corner[next[2]]);
        if (size > largest) {
            largest = size, q[k] = next[k];
            best[0] = a, best[1] = q[0], best[2] = q[1], best[3] = q[2];
            k = k > 0 ? k - 1 : 0;
        } else
            k++;
    }
}

// Clip a polygon with the sides of a face: only what is above or below the face remains. Source: I. Sutherland, G. Hodgman,
// "Reentrant Polygon Clipping", Communications of the ACM, 1974. Returns the number of its corners, and which buffer has them.
template <class Body>
FN int clip(Vec polygon[2][POLYGON_SIDES], int corners, int& at, const Body& body, int face) {
    const Vec n = normal_of(body, face);
    const int sides = sides_of(body, face);
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
            if ((here > (real)-1e-10) != (there > (real)-1e-10) && count < POLYGON_SIDES)
                to[count++] = p + clamped(here / (here - there), 0, 1) * (q - p);
            if (there > (real)-1e-10 && count < POLYGON_SIDES) to[count++] = q;
            here = there;
        }
        corners = count;
    }
    return corners;
}

// Contacts of two faces that all but face each other: corners of the second one above the first one, nearer than `margin`.
template <class First, class Second>
FN void face_contacts(Hits& hits, const First& a, int first, const Second& b, int second, real margin = 0) {
    Vec polygon[2][POLYGON_SIDES];
    int count = 0, at;
    for (int i = 0; i < sides_of(b, second); i++) polygon[0][i] = corner_of(b, second, i);
    const int corners = clip(polygon, sides_of(b, second), at, a, first);
    Vec* kept = polygon[at];
    const Vec n1 = normal_of(a, first), n2 = normal_of(b, second), plane = corner_of(a, first, 0);
    for (int i = 0; i < corners; i++)
        if (dot(kept[i] - plane, n1) <= margin) kept[count++] = kept[i];
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
        add(hits, dist, v - below * n1 - ((real)0.5 * dist) * n2, -1 * n2, Vec{0, 0, 0});
    }
}

// Contacts of the ends of what of the edge `from` to `to` is above a face, nearer than `margin`, with a normal.
template <class Body>
FN void edge_contacts(Hits& hits, Vec from, Vec to, const Body& body, int face, Vec normal, real margin = 0) {
    const Vec n = normal_of(body, face);
    const int sides = sides_of(body, face);
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
        if (dist <= margin) add(hits, dist, v - ((real)0.5 * dist) * n, normal, Vec{0, 0, 0});
    }
}

}  // namespace fused
#endif
