// SPDX-License-Identifier: Apache-2.0
// Primitives: contacts of planes, spheres, capsules, boxes and cylinders. Each routine finds what MuJoCo's of the same name
// finds (engine_collision_primitive.c of MuJoCo), in the same order, but for contacts whose distance is their margin: they
// act on nothing.
//
// Positions are relative to the origin of a tree that moves, so that they are exact far from the world's origin.

namespace fused {

struct Geom {
    Vec pos;
    Mat axes;
    Vec size;
};

struct Hit {
    real dist;
    Vec pos, normal, along;  // `along` is the wanted direction of the first tangent, zero for any
};

// Hits of one pair; no routine finds more than MAX_HITS.
struct Hits {
    Hit hit[MAX_HITS];
    int count;
};

FN void add(Hits& hits, real dist, Vec pos, Vec normal, Vec along) {
    Hit& h = hits.hit[hits.count++];
    h.dist = dist, h.pos = pos, h.normal = normal, h.along = along;
}

FN void plane_sphere(Hits& hits, real margin, const Geom& plane, Vec center, real radius, Vec along) {
    Vec n = column(plane.axes, 2);
    real dist = dot(center - plane.pos, n) - radius;
    if (dist < margin) add(hits, dist, center - ((real)0.5 * dist + radius) * n, n, along);
}

FN void plane_capsule(Hits& hits, real margin, const Geom& plane, const Geom& capsule) {
    Vec axis = column(capsule.axes, 2), end = capsule.size.y * axis;
    plane_sphere(hits, margin, plane, capsule.pos + end, capsule.size.x, axis);
    plane_sphere(hits, margin, plane, capsule.pos - end, capsule.size.x, axis);
}

FN void plane_box(Hits& hits, real margin, const Geom& plane, const Geom& box) {
    Vec n = column(plane.axes, 2);
    real dist = dot(box.pos - plane.pos, n);
    for (int i = 0; i < 8 && hits.count < 4; i++) {
        Vec corner = box.axes * Vec{i & 1 ? box.size.x : -box.size.x, i & 2 ? box.size.y : -box.size.y,
                                    i & 4 ? box.size.z : -box.size.z};
        real below = dot(n, corner);
        if (dist + below >= margin || below > 0) continue;
        add(hits, dist + below, box.pos + corner - ((real)0.5 * (dist + below)) * n, n, Vec{0, 0, 0});
    }
}

// A point of the rims of a cylinder, relative to its centre, that is near a plane with the normal `n`: the lowest of the lower
// cap (0), that of the upper one (1), and two that are a triangle with the first (2 and 3). `half` is half of the axis,
// `otherwise` the direction of the first from the axis where all are equally low.
FN Vec rim_point(Vec half, real radius, Vec n, Vec otherwise, int k) {
    real height = SQRT(dot(half, half));
    Vec axis = ((dot(n, half) > 0 ? -1 : 1) / height) * half;  // towards the plane
    Vec down = dot(n, axis) * axis - n;
    real square = dot(down, down);
    down = square >= (real)1e-24 ? (radius / SQRT(square)) * down : radius * otherwise;
    if (k < 2) return down + (k ? -height : height) * axis;
    return height * axis - (real)0.5 * down + (k == 2 ? 1 : -1) * (real)0.86602540378443864676 * cross(down, axis);
}

FN void plane_cylinder(Hits& hits, real margin, const Geom& plane, const Geom& cylinder) {
    Vec n = column(plane.axes, 2), half = cylinder.size.y * column(cylinder.axes, 2);
    for (int k = 0; k < 4; k++) {
        Vec point = cylinder.pos + rim_point(half, cylinder.size.x, n, column(cylinder.axes, 0), k);
        real dist = dot(point - plane.pos, n);
        if (dist < margin) add(hits, dist, point - ((real)0.5 * dist) * n, n, Vec{0, 0, 0});
        else if (k == 0) return;
    }
}

FN void sphere_sphere(Hits& hits, real margin, Vec a, real radius_a, Vec b, real radius_b, Vec otherwise) {
    Vec d = b - a;
    real square = dot(d, d), reach = margin + radius_a + radius_b;
    if (square >= reach * reach) return;
    real length = SQRT(square), dist = length - radius_a - radius_b;
    Vec n = length < (real)1e-15 ? otherwise : (1 / length) * d;
    add(hits, dist, a + (radius_a + (real)0.5 * dist) * n, n, Vec{0, 0, 0});
}

// The normal of spheres whose centres coincide is across both geoms' axes.
FN Vec across(const Geom& a, const Geom& b) {
    Vec n = cross(column(a.axes, 2), column(b.axes, 2));
    real length = SQRT(dot(n, n));
    return length < (real)1e-15 ? Vec{1, 0, 0} : (1 / length) * n;
}

FN void sphere_capsule(Hits& hits, real margin, const Geom& sphere, const Geom& capsule) {
    Vec axis = column(capsule.axes, 2);
    real x = clamped(dot(axis, sphere.pos - capsule.pos), -capsule.size.y, capsule.size.y);
    Vec n = across(sphere, capsule);
    sphere_sphere(hits, margin, sphere.pos, sphere.size.x, capsule.pos + x * axis, capsule.size.x, n);
}

FN void capsule_capsule(Hits& hits, real margin, const Geom& a, const Geom& b) {
    Vec p = a.size.y * column(a.axes, 2), q = b.size.y * column(b.axes, 2), d = a.pos - b.pos, n = across(a, b);
    real pp = dot(p, p), pq = -dot(p, q), qq = dot(q, q), u = -dot(p, d), v = dot(q, d), det = pp * qq - pq * pq;
    if (FABS(det) >= PARALLEL) {
        real x = (qq * u - pq * v) / det, y = (pp * v - pq * u) / det;
        if (x > 1) x = 1, y = (v - pq) / qq;
        else if (x < -1) x = -1, y = (v + pq) / qq;
        if (y > 1) y = 1, x = clamped((u - pq) / pp, -1, 1);
        else if (y < -1) y = -1, x = clamped((u + pq) / pp, -1, 1);
        sphere_sphere(hits, margin, a.pos + x * p, a.size.x, b.pos + y * q, b.size.x, n);
        return;
    }
    // Parallel: the ends of each against the other, until there are two contacts.
    for (int i = 0; i < 4 && hits.count < 2; i++) {
        real end = i & 1 ? -1 : 1, x = end, y = end;
        if (i < 2) y = clamped((v - end * pq) / qq, -1, 1);
        else x = clamped((u - end * pq) / pp, -1, 1);
        sphere_sphere(hits, margin, a.pos + x * p, a.size.x, b.pos + y * q, b.size.x, n);
    }
}

FN void sphere_box(Hits& hits, real margin, Vec center, real radius, const Geom& box) {
    Vec d = center - box.pos;
    real c[3] = {dot(column(box.axes, 0), d), dot(column(box.axes, 1), d), dot(column(box.axes, 2), d)};
    real size[3] = {box.size.x, box.size.y, box.size.z}, near[3], square = 0;
    for (int i = 0; i < 3; i++) near[i] = clamped(c[i], -size[i], size[i]), square += (c[i] - near[i]) * (c[i] - near[i]);
    real dist = SQRT(square);
    if (dist - radius >= margin) return;
    Vec n, pos;
    if (dist <= (real)1e-15) {  // the centre is inside: out through the nearest face
        real least = 2 * (size[0] + size[1] + size[2]);
        int face = 0;
        for (int i = 0; i < 6; i++) {
            real depth = FABS((i % 2 ? 1 : -1) * size[i / 2] - c[i / 2]);
            if (least > depth) least = depth, face = i;
        }
        real sign = face % 2 ? -1 : 1;
        n = sign * column(box.axes, face / 2);
        pos = center + ((real)0.5 * (radius - least)) * n;
        dist = -least;
    } else {
        real s = 1 / dist, in[3] = {s * (near[0] - c[0]), s * (near[1] - c[1]), s * (near[2] - c[2])};
        n = box.axes * Vec{in[0], in[1], in[2]};
        pos = center + ((real)0.5 * (radius + dist)) * n;
    }
    add(hits, dist - radius, pos, n, Vec{0, 0, 0});
}

}  // namespace fused
