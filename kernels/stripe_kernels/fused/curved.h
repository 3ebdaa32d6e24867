// SPDX-License-Identifier: Apache-2.0
// Curved: contacts of cylinders and ellipsoids with each other and with spheres, capsules and boxes, and of cylinders, ellipsoids
// and capsules with hulls of meshes, as MuJoCo's mjc_Convex and mjc_SphereCylinder find them.

#if HAS_CURVED
namespace fused {

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
