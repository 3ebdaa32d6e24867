// SPDX-License-Identifier: Apache-2.0
// Cores: nearest points of two convex bodies, and the least overlap of two that touch.
//
// A body is a *core* with a radius around it: a sphere is a point, a capsule is a line, others are their own core. Cores that
// are apart have nearest points. Of those that overlap the contact is where the overlap is least. Both are found from the
// points of the two cores that are farthest in some direction, that is, from corners of their Minkowski difference.

#if HAS_CURVED
namespace fused {

// Relative gap between bounds of a distance at which it is found, the squared sine of directions that are the same, and the
// number of steps to either.
#ifdef FUSED_DOUBLE
#define BOUNDS_MEET 1e-15
#define SAME_DIRECTION 1e-24
#define MOST_STEPS 100
#else
#define BOUNDS_MEET 2e-7f
#define SAME_DIRECTION 1e-12f
#define MOST_STEPS 40
#endif

struct Hull;
struct Core {
    Geom at;
    int shape;
    real radius;
    const Hull* hull;  // of a shape that is a HULL_SHAPE
};
FN Core core_of(int shape, const Geom& geom, const Hull* hull = nullptr) {
    return Core{geom, shape, shape == BALL_SHAPE || shape == CAPSULE_SHAPE ? geom.size.x : 0, hull};
}

FN Vec unit(Vec v, Vec otherwise) {
    const real square = dot(v, v);
    return square > (real)1e-30 ? (1 / SQRT(square)) * v : otherwise;
}

// The point of a core that is farthest in a direction.
FN Vec farthest(const Core& core, Vec direction) {
    if (core.shape == BALL_SHAPE) return core.at.pos;
    const Vec d = transposed(core.at.axes) * direction, s = core.at.size;
    Vec p = corner_towards(d, s);  // of a box
#if HAS_HULLS
    if (core.shape == HULL_SHAPE) p = vertex_of(*core.hull, support(*core.hull, d));
#endif
    if (core.shape == CAPSULE_SHAPE) p = Vec{0, 0, d.z >= 0 ? s.y : -s.y};
    if (core.shape == CYLINDER_SHAPE) {
        const Vec out = s.x * unit(Vec{d.x, d.y, 0}, Vec{0, 0, 0});
        p = Vec{out.x, out.y, d.z >= 0 ? s.y : -s.y};
    }
    if (core.shape == ELLIPSOID_SHAPE) {
        const Vec out = unit(Vec{s.x * d.x, s.y * d.y, s.z * d.z}, Vec{1, 0, 0});
        p = Vec{s.x * out.x, s.y * out.y, s.z * out.z};
    }
    return core.at.pos + core.at.axes * p;
}

// A point of the Minkowski difference of two cores: `at` is `first`, a point of the first one, minus one of the second.
struct Corner {
    Vec at, first;
};
ONE_COPY Corner corner(const Core& a, const Core& b, Vec direction) {
    const Vec p = farthest(a, direction);
    return Corner{p - farthest(b, -1 * direction), p};
}

// Up to four corners, the weights of which make the point of their simplex that is nearest to the origin.
struct Simplex {
    Corner corner[4];
    real weight[4];
    int count;
};
FN Vec nearest_to_origin(const Simplex& s) {
    Vec p{0, 0, 0};
    for (int i = 0; i < s.count; i++) p = p + s.weight[i] * s.corner[i].at;
    return p;
}

FN Vec first_at(const Simplex& s) {
    Vec p{0, 0, 0};
    for (int i = 0; i < s.count; i++) p = p + s.weight[i] * s.corner[i].first;
    return p;
}

// Weights of the point of a triangle that is nearest to the origin. Source: C. Ericson, "Real-Time Collision Detection", 2005,
// section 5.1.5, with the regions of Voronoi.
ONE_COPY void triangle_weights(Vec a, Vec b, Vec c, real* weight) {
    const Vec ab = b - a, ac = c - a;
    const real d1 = -dot(ab, a), d2 = -dot(ac, a), d3 = -dot(ab, b), d4 = -dot(ac, b), d5 = -dot(ab, c), d6 = -dot(ac, c);
    const real va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    real x, y;  // weights of b and c
    if (d1 <= 0 && d2 <= 0) x = 0, y = 0;
    else if (d3 >= 0 && d4 <= d3) x = 1, y = 0;
    else if (vc <= 0 && d1 >= 0 && d3 <= 0) x = d1 / (d1 - d3), y = 0;
    else if (d6 >= 0 && d5 <= d6) x = 0, y = 1;
    else if (vb <= 0 && d2 >= 0 && d6 <= 0) x = 0, y = d2 / (d2 - d6);
    else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) y = (d4 - d3) / ((d4 - d3) + (d5 - d6)), x = 1 - y;
    else x = vb / (va + vb + vc), y = vc / (va + vb + vc);
    weight[0] = 1 - x - y, weight[1] = x, weight[2] = y;
}

// Set the weights of a simplex and leave out corners without weight. Four corners remain if the origin is between them.
FN void reduce(Simplex& s) {
    real weight[4] = {1, 0, 0, 0};
    if (s.count == 2) {
        const Vec from = s.corner[0].at, along = s.corner[1].at - from;
        const real square = dot(along, along);
        weight[1] = square > 0 ? clamped(-dot(from, along) / square, 0, 1) : 0, weight[0] = 1 - weight[1];
    } else if (s.count == 3) {
        triangle_weights(s.corner[0].at, s.corner[1].at, s.corner[2].at, weight);
    } else if (s.count == 4) {
        // The nearest of the faces that the origin is beyond; if there is none, it is inside.
        real nearest = (real)1e30;
        bool inside = true;
        for (int k = 0; k < 4; k++) {  // the face opposite of corner k
            const int i = k == 0 ? 1 : 0, j = k <= 1 ? 2 : 1, l = k == 3 ? 2 : 3;
            const Vec p = s.corner[i].at, n = cross(s.corner[j].at - p, s.corner[l].at - p);
            const real here = -dot(n, p), there = dot(n, s.corner[k].at - p);
            if (here * there > 0) continue;
            real w[3];
            triangle_weights(p, s.corner[j].at, s.corner[l].at, w);
            const Vec point = w[0] * p + w[1] * s.corner[j].at + w[2] * s.corner[l].at;
            inside = false;
            if (dot(point, point) >= nearest) continue;
            nearest = dot(point, point);
            for (int m = 0; m < 4; m++) weight[m] = m == i ? w[0] : m == j ? w[1] : m == l ? w[2] : 0;
        }
        if (inside) return;
    }
    int kept = 0;
    for (int i = 0; i < s.count; i++) {
        if (!(weight[i] > 0)) continue;
        s.corner[kept] = s.corner[i], s.weight[kept++] = weight[i];
    }
    s.count = kept;
}

// Where two bodies touch: the depth of their overlap, negative if they are apart, the direction from the first to the second in
// which it is least, and the point halfway between the surfaces.
struct Meeting {
    bool found;
    real depth;
    Vec normal, middle;
};
FN Meeting meeting(const Core& a, const Core& b, real depth, Vec normal, Vec first, Vec at) {
    const Vec middle = first - (real)0.5 * at + ((real)0.5 * (a.radius - b.radius)) * normal;
    return Meeting{true, depth + a.radius + b.radius, normal, middle};
}

enum Relation { APART, NEAR, OVERLAPPING };

// The nearest points of two cores. They are APART if their distance is `reach` or more. Source: E. G. Gilbert, D. W. Johnson,
// S. S. Keerthi, "A fast procedure for computing the distance between complex objects in three-dimensional space", 1988.
FN Relation approach(const Core& a, const Core& b, real reach, Meeting& found) {
    Simplex s;
    Vec v = a.at.pos - b.at.pos;
    if (!(dot(v, v) < (real)1e20)) return APART;  // also if it is not a number
    s.corner[0] = corner(a, b, -1 * v), s.weight[0] = 1, s.count = 1;
    v = s.corner[0].at;
    real square = dot(v, v);
    for (int step = 0; step < MOST_STEPS && square > 0; step++) {
        const Corner next = corner(a, b, -1 * v);
        const real bound = dot(v, next.at);  // no point of the difference is nearer than this over the length of v
        if (bound > 0 && bound * bound >= reach * reach * square) return APART;
        if (square - bound <= BOUNDS_MEET * square) break;
        const Corner here{v, first_at(s)};
        s.corner[s.count++] = next;
        reduce(s);
        if (s.count == 4 && bound <= 0) return OVERLAPPING;
        v = nearest_to_origin(s);
        if (s.count == 4 || !(dot(v, v) < square)) {
            // The corners are all but in a line or a plane: by the straight way to the new one it gets nearer.
            s.corner[0] = here, s.corner[1] = next, s.count = 2;
            reduce(s);
            v = nearest_to_origin(s);
        }
        const real now = dot(v, v);
        if (!(now < square)) break;
        square = now;
    }
    // So near that rounding decides: as if they overlapped.
    real size = 0;
    for (int i = 0; i < s.count; i++) size = larger(size, dot(s.corner[i].at, s.corner[i].at));
    if (square <= 1000 * BOUNDS_MEET * BOUNDS_MEET * size) return OVERLAPPING;
    if (square >= reach * reach) return APART;
    const real distance = SQRT(square);
    found = meeting(a, b, -distance, (-1 / distance) * v, first_at(s), v);
    return NEAR;
}

// Where the ray from the origin in a direction leaves the difference of two cores that overlap: the normal of the surface there,
// the height over the origin of the plane with that normal that touches it, the point, and that of the first core. Source: G.
// Snethen, "Xenocollide: complex collision made simple", Game Programming Gems 7, 2008.
struct Exit {
    Vec normal, at, first;
    real height;
};
ONE_COPY Exit leave(const Core& a, const Core& b, Vec ray) {
    Corner p[3];
    p[0] = corner(a, b, ray);
    const Vec low = dot(ray, p[0].at) * ray, aside = p[0].at - low;
    if (dot(aside, aside) <= SAME_DIRECTION * dot(low, low)) return Exit{ray, p[0].at, p[0].first, dot(ray, p[0].at)};
    // A triangle of corners around the ray, counterclockwise as seen from outside: the ray is on the inner side of each plane
    // through the origin and two of them.
    p[1] = corner(a, b, unit(-1 * aside, ray));
    Vec side = cross(p[0].at, p[1].at);
    if (dot(side, ray) < 0) {
        const Corner other = p[0];
        p[0] = p[1], p[1] = other, side = -1 * side;
    }
    p[2] = corner(a, b, unit(side, unit(cross(p[0].at, ray), ray)));
    for (int step = 0, inner = 0; step < 3 * MOST_STEPS && inner < 3; step++) {
        const int i = step % 3, j = (i + 1) % 3, k = (i + 2) % 3;
        side = cross(p[i].at, p[j].at);
        inner++;
        if (dot(side, ray) >= 0) continue;
        const Corner other = p[i];
        p[i] = p[j], p[j] = other, p[k] = corner(a, b, unit(-1 * side, ray));
        inner = 0;
    }
    Exit found{ray, p[0].at, p[0].first, dot(ray, p[0].at)};
    real least = (real)1e30;
    ROLLED for (int step = 0, last = 0; step < MOST_STEPS && step - last < 8; step++) {
        Vec n = cross(p[1].at - p[0].at, p[2].at - p[0].at);
        if (!(dot(n, ray) > 0)) break;  // a triangle without an area
        n = unit(n, ray);
        const Corner next = corner(a, b, n);
        const real height = dot(n, next.at), gap = height - dot(n, p[0].at);
        if (gap < least) least = gap, last = step, found.normal = n, found.height = height;
        if (gap <= BOUNDS_MEET * SQRT(dot(next.at, next.at))) break;
        // The part of the triangle around the new corner that the ray passes.
        const Vec across = cross(ray, next.at);
        const bool left0 = dot(across, p[0].at) >= 0, left1 = dot(across, p[1].at) >= 0, left2 = dot(across, p[2].at) >= 0;
        p[left0 && !left1 ? 2 : left1 && !left2 ? 0 : 1] = next;
    }
    real weight[3], sum = 0;
    for (int i = 0; i < 3; i++) {
        weight[i] = larger(dot(cross(p[(i + 1) % 3].at, p[(i + 2) % 3].at), ray), 0);
        sum += weight[i];
    }
    found.at = found.first = Vec{0, 0, 0};
    for (int i = 0; i < 3; i++) {
        const real share = sum > 0 ? weight[i] / sum : (real)(i == 0);
        found.at = found.at + share * p[i].at, found.first = found.first + share * p[i].first;
    }
    return found;
}

// A direction in which the overlap of two cores may be least: axes of both, from one to the other, and across two axes.
#define DIRECTIONS 31
FN Vec direction_to_try(const Core& a, const Core& b, int k) {
    if (k == 0) return unit(b.at.pos - a.at.pos, column(a.at.axes, 2));
    const int i = (k - 1) / 2;
    const real sign = k % 2 ? 1 : -1;
    if (i < 6) return sign * column(i < 3 ? a.at.axes : b.at.axes, i % 3);
    const Vec n = cross(column(a.at.axes, (i - 6) / 3), column(b.at.axes, i % 3));
    return sign * unit(n, column(a.at.axes, 2));
}

// How far two cores overlap at least, and along what. From the direction in which a ray leaves the difference, the normal of its
// surface there leads to a nearer part of it, until both are the same. That is a minimum, maybe not the least one, so that it
// begins with the best of several directions. MuJoCo's expanding polytope finds the same with memory for a whole surface.
#define STARTS 4
FN Meeting overlap(const Core& a, const Core& b) {
    Vec start[STARTS];
    real height[STARTS];
    for (int i = 0; i < STARTS; i++) height[i] = (real)1e30, start[i] = Vec{0, 0, 1};
    ROLLED for (int k = 0; k < DIRECTIONS; k++) {
        Vec n = direction_to_try(a, b, k);
        real h = dot(n, corner(a, b, n).at);
        for (int i = 0; i < STARTS; i++) {
            if (!(h < height[i])) continue;
            const Vec other = start[i];
            const real before = height[i];
            start[i] = n, height[i] = h, n = other, h = before;
        }
    }
    Meeting best;
    real least = (real)1e30;
    ROLLED for (int i = 0; i < STARTS && (i == 0 || height[i] > 0); i++) {
        Vec n = start[i];
        real h = larger(height[i], 0);
        ROLLED for (int step = 0; step < MOST_STEPS; step++) {
            const Exit exit = leave(a, b, n);
            const Vec turned = cross(exit.normal, n);
            const bool is_lower = exit.height < h - 4 * BOUNDS_MEET * FABS(h);  // if not, `n` may be exact: the normal of a face
            if (is_lower) h = exit.height;
            if (is_lower && dot(turned, turned) > SAME_DIRECTION) {
                n = exit.normal;
                continue;
            }
            if (i == 0 || h < least - 10 * BOUNDS_MEET * least)
                least = h, best = meeting(a, b, h, is_lower ? exit.normal : n, exit.first, exit.at);
            break;
        }
    }
    return best;
}

}  // namespace fused
#endif
