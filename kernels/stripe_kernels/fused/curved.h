// SPDX-License-Identifier: Apache-2.0
// Curved: contacts of cylinders and ellipsoids with each other and with spheres, capsules and boxes, and of cylinders, ellipsoids
// and capsules with hulls of meshes, as MuJoCo's mjc_Convex and mjc_SphereCylinder find them.
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

// A face of a cylinder, as 16 corners, of a box or of a hull: the one that faces in a direction most, with its corners as MuJoCo
// has them.
struct Side {
    const Core& body;
    Vec corner[16], normal;
    int count, face;  // the face of a hull
};
FN Vec corner_of(const Side& side, int, int i) {
#if HAS_HULLS
    if (side.body.shape == HULL_SHAPE) return side.body.at.pos + side.body.at.axes * corner_of(*side.body.hull, side.face, i);
#endif
    return side.corner[i];
}
FN Vec normal_of(const Side& side, int) { return side.normal; }
FN int sides_of(const Side& side, int) { return side.count; }

FN bool find_side(Side& side, Vec direction) {
    const Core& core = side.body;
    const Vec d = transposed(core.at.axes) * direction, s = core.at.size;
    side.count = 0;
    if (core.shape == CYLINDER_SHAPE) {
        const real up = d.z >= 0 ? 1 : -1;
        side.normal = up * column(core.at.axes, 2), side.count = 16;
        for (int i = 0; i < 16; i++) {
            real sine, cosine;
            SINCOS((real)(0.39269908169872414 * i), sine, cosine);
            side.corner[i] = core.at.pos + core.at.axes * Vec{s.x * cosine, -up * s.x * sine, up * s.y};
        }
    } else if (core.shape == BOX_SHAPE) {
        const Vec steep = magnitudes(d);
        const int k = steep.y > steep.x ? (steep.z > steep.y ? 2 : 1) : (steep.z > steep.x ? 2 : 0);
        const real up = component(d, k) >= 0 ? 1 : -1;
        side.normal = up * column(core.at.axes, k), side.count = 4;
        for (int i = 0; i < 4; i++) {
            const real u = i == 0 || i == 3 ? 1 : -1, v = i < 2 ? up : -up;  // clockwise
            Vec p = with(s, k, up * component(s, k));
            p = with(p, (k + 1) % 3, v * component(s, (k + 1) % 3)), p = with(p, (k + 2) % 3, u * component(s, (k + 2) % 3));
            side.corner[i] = core.at.pos + core.at.axes * p;
        }
    }
#if HAS_HULLS
    if (core.shape == HULL_SHAPE) {
        real best = 0;
        for (int f = 0; f < core.hull->num_faces; f++) {
            const real facing = dot(normal_of(*core.hull, f), d);
            if (facing > best) best = facing, side.face = f;
        }
        if (best > 0) side.normal = core.at.axes * normal_of(*core.hull, side.face), side.count = sides_of(*core.hull, side.face);
    }
#endif
    return side.count > 0 && dot(side.normal, direction) > SQRT(SAME_DIRECTION);
}

// The edge of a body that is farthest in a direction and most parallel to a plane with the normal `n`: the line of a capsule or
// of the side of a cylinder, or an edge of a box or a hull.
FN bool edge_towards(const Core& core, Vec direction, Vec n, Vec& from, Vec& to) {
    int k = 2;
    Vec middle{0, 0, 0};
    real half = core.at.size.y;
    const Vec d = transposed(core.at.axes) * direction;
    if (core.shape == CYLINDER_SHAPE) middle = core.at.size.x * unit(Vec{d.x, d.y, 0}, Vec{1, 0, 0});
    if (core.shape == BOX_SHAPE) {
        const Vec steep = magnitudes(transposed(core.at.axes) * n);
        k = steep.y < steep.x ? (steep.z < steep.y ? 2 : 1) : (steep.z < steep.x ? 2 : 0);
        middle = with(corner_towards(d, core.at.size), k, 0), half = component(core.at.size, k);
    }
    const Vec axis = column(core.at.axes, k), center = core.at.pos + core.at.axes * middle + core.radius * direction;
    from = center - half * axis, to = center + half * axis;
#if HAS_HULLS
    if (core.shape == HULL_SHAPE) {
        const Hull& hull = *core.hull;
        const int vertex = support(hull, d), *corners = hull.corners + hull.corners[vertex];
        const Vec up = transposed(core.at.axes) * n, start = vertex_of(hull, vertex);
        real least = EDGE_ALIGNED;
        bool found = false;
        for (int i = 0; i < (hull.corners[vertex + 1] - hull.corners[vertex]) / 2; i++) {
            const Vec end = vertex_of(hull, corners[2 * i + 1]), along = unit(end - start, up);
            if (!(FABS(dot(along, up)) < least)) continue;
            least = FABS(dot(along, up)), found = true;
            from = core.at.pos + core.at.axes * start, to = core.at.pos + core.at.axes * end;
        }
        return found;
    }
#endif
    return core.shape != ELLIPSOID_SHAPE && core.shape != BALL_SHAPE && FABS(dot(axis, n)) < EDGE_ALIGNED;
}

// Contacts of two bodies: several where a face or an edge of one lies on a face of the other.
COLD void core_contacts(Hits& hits, real margin, int shape_a, const Geom& geom_a, int shape_b, const Geom& geom_b,
                        const Hull* hull = nullptr) {
    const Core a = core_of(shape_a, geom_a), b = core_of(shape_b, geom_b, hull);
    Meeting m;
    const Relation relation = approach(a, b, margin + a.radius + b.radius, m);
    if (relation == OVERLAPPING) m = overlap(a, b);
    if (relation == APART || !(-m.depth < margin)) return;
    const Vec n = m.normal;
    Side on_a{a}, on_b{b};
    Vec from, to;
    // A face of a box faces the other one's. Only where the second body has no face may its edge lie on one of the first.
    const bool has_a = find_side(on_a, n), has_b = find_side(on_b, has_a ? -1 * on_a.normal : -1 * n);
    if (has_a && has_b && dot(on_a.normal, on_b.normal) < -FACES_ALIGNED && dot(on_a.normal, n) > EDGE_ALIGNED &&
        dot(on_b.normal, n) < -EDGE_ALIGNED)
        face_contacts(hits, on_a, 0, on_b, 0, margin);
    else if (find_side(on_b, -1 * n)) {
        if (edge_towards(a, n, on_b.normal, from, to)) edge_contacts(hits, from, to, on_b, 0, -1 * on_b.normal, margin);
    } else if (has_a && edge_towards(b, -1 * n, on_a.normal, from, to))
        edge_contacts(hits, from, to, on_a, 0, on_a.normal, margin);
    if (hits.count == 0) add(hits, -m.depth, m.middle, n, Vec{0, 0, 0});
}

#if HAS_HULLS
// Contacts of a body with the hull of a mesh, which most often is apart from the ball of `radius` around the body.
FN void curved_hull(Hits& hits, real margin, int shape, const Geom& geom, real radius, const Geom& mesh, const Hull& hull) {
    const Vec center{hull.center[0], hull.center[1], hull.center[2]}, half{hull.half[0], hull.half[1], hull.half[2]};
    Vec out = magnitudes(transposed(mesh.axes) * (geom.pos - mesh.pos) - center) - half;
    out = Vec{larger(out.x, 0), larger(out.y, 0), larger(out.z, 0)};
    if (dot(out, out) < (radius + margin) * (radius + margin))
        core_contacts(hits, margin, shape, geom, HULL_SHAPE, mesh, &hull);
}
#endif

// The contact with a plane of the point of an ellipsoid that is lowest.
FN void plane_ellipsoid(Hits& hits, real margin, const Geom& plane, const Geom& ellipsoid) {
    const Vec n = column(plane.axes, 2), point = farthest(core_of(ELLIPSOID_SHAPE, ellipsoid), -1 * n);
    const real dist = dot(point - plane.pos, n);
    if (dist < margin) add(hits, dist, point - ((real)0.5 * dist) * n, n, Vec{0, 0, 0});
}

// The contact with the side, a cap or the rim of a cylinder; of a centre that is inside with the nearest of the first two.
FN void sphere_cylinder(Hits& hits, real margin, const Geom& sphere, const Geom& cylinder) {
    const Vec axis = column(cylinder.axes, 2), d = sphere.pos - cylinder.pos;
    const real radius = cylinder.size.x, x = dot(axis, d), up = x < 0 ? -1 : 1;
    const Vec out = d - x * axis;
    const real square = dot(out, out);
    if (!(dot(d, d) < (real)1e20)) return;  // also if it is not a number
    bool beside = FABS(x) < cylinder.size.y, above = square < radius * radius;
    if (beside && above) (cylinder.size.y - FABS(x) < radius - SQRT(square) ? beside : above) = false;
    if (beside) {
        sphere_sphere(hits, margin, sphere.pos, sphere.size.x, cylinder.pos + x * axis, radius, across(sphere, cylinder));
    } else if (above) {
        const real dist = up * x - cylinder.size.y - sphere.size.x;
        const Vec n = -up * axis;
        if (dist < margin) add(hits, dist, sphere.pos + (sphere.size.x + (real)0.5 * dist) * n, n, Vec{0, 0, 0});
    } else {
        const Vec rim = cylinder.pos + (up * cylinder.size.y) * axis + (radius / SQRT(square)) * out;
        sphere_sphere(hits, margin, sphere.pos, sphere.size.x, rim, 0, across(sphere, cylinder));
    }
}

}  // namespace fused
#endif
