// SPDX-License-Identifier: Apache-2.0
// Ground parts: geoms on height fields and meshes, the parts of them that are searched for touches, and which
// are near.

#if HAS_SEARCHES
namespace fused {

enum GroundPart { SPHERE_OF, HIGH_END_OF, LOW_END_OF, AXIS_OF, BOX_OF, CYLINDER_OF, CORNERS_OF };
// Part of a geom that the routine of a pair searches, or a number of CORNERS_OF and above for a corner of a box.
FN int ground_part(int pair) {
    const int kind = contact_kind(pair);
    if (kind < MESH_SPHERE) return kind - FIELD_SPHERE;
    return kind - MESH_SPHERE + (kind >= MESH_CORNER_0);  // meshes have no routine for cylinders
}

// Balls that hold a geom: along the longest of its axes, so that they are smaller than one around all of it.
struct Cover {
    int count;
    Vec first, step;  // centres relative to that of the geom
    real radius;
};
FN Cover cover(const Geom& geom, int part) {
    if (part == SPHERE_OF) return Cover{1, {0, 0, 0}, {0, 0, 0}, geom.size.x};
    Vec h = geom.size;
    int longest = 2;
    if (part < BOX_OF || part == CYLINDER_OF) return Cover{3, (real)(-2.0 / 3) * h.y * column(geom.axes, 2), (real)(2.0 / 3) * h.y * column(geom.axes, 2), h.x + h.y / 3};
    if (h.x >= h.y && h.x >= h.z) longest = 0;
    else if (h.y >= h.z) longest = 1;
    real half = longest == 0 ? h.x : longest == 1 ? h.y : h.z, third = half / 3;
    Vec along = 2 * third * column(geom.axes, longest);
    return Cover{3, -1 * along, along, SQRT(dot(h, h) - half * half + third * third)};
}
// What is searched for, and at which end of a capsule or corner of a box.
FN PartKind kind_of(int part) {
    const PartKind kinds[] = {BALL_PART, BALL_PART, BALL_PART, AXIS_PART, BOX_PART, CYLINDER_PART};
    return part < CORNERS_OF ? kinds[part] : CORNER_PART;
}
FN int end_of(int part) {
    return part == HIGH_END_OF ? 1 : part == LOW_END_OF ? -1 : part >= CORNERS_OF ? part - CORNERS_OF : 0;
}

// Whether a geom may touch faces, also that of a capsule with its low and its high end, and whether it may touch edges.
struct Near {
    bool faces, low, high, edges;
};
// Whether a part of it may touch.
FN bool is_part_near(const Near& near, int part) {
    if (part == AXIS_OF || part == BOX_OF) return near.edges;
    return part == LOW_END_OF ? near.low : part == HIGH_END_OF ? near.high : near.faces;
}

#if HAS_FIELDS
FN Field field_of(const Parameters& P, int g) {
    int f = geom_field(g);
    const real* size = (const real*)P.m.field_size + 4 * f;
    return Field{(const float*)P.m.field_heights + field_start(f), field_rows(f), field_cols(f), size[0], size[1], size[2]};
}

// Whether balls that hold a geom, by `reach` larger, go down to the highest vertex of the field below them. The rows of `axes`
// are those of the field.
FN bool is_near_field(const Patch& patch, const Mat& axes, const Cover& c, real reach) {
    const Vec step = axes * c.step;
    Vec half = (real)(c.count / 2) * step;
    half = Vec{FABS(half.x) + reach, FABS(half.y) + reach, FABS(half.z) + reach};
    return peak(patch, cells_below(patch, -1 * half, half)) >= -half.z;
}
#endif

#if HAS_MESHES
// Whether balls that hold a geom, by `reach` larger, may come to a face, and to an edge: by the distances to the nearest ones.
// The rows of `axes` are those of the meshes, in whose frame the geom is `at` a point.
FN Near near_mesh(const Clearance& field, const Mat& axes, Vec at, const Cover& c, real reach) {
    const Vec first = at + axes * c.first, step = axes * c.step;
    Near near{false, false, false, false};
    ROLLED for (int i = 0; i < c.count; i++) {
        const Clear clear = clearance_at(field, first + (real)i * step);
        const bool touches = clear.faces <= reach;
        near.faces |= touches, near.edges |= clear.edges <= reach, near.high = touches;  // the last ball is that of the high end
        if (i == 0) near.low = touches;
    }
    return near;
}

// Whether a part of a geom that is near is near itself: a ball at an end or a corner by itself; other parts are near.
FN bool is_part_near_mesh(const Clearance& field, const Mat& axes, Vec at, const Geom& geom, int part, real margin) {
    if (part == SPHERE_OF || part == AXIS_OF || part == BOX_OF) return true;
    const Vec h = geom.size;
    const int k = part - CORNERS_OF;
    const bool is_end = part < AXIS_OF;
    const Vec end{0, 0, part == HIGH_END_OF ? h.y : -h.y};
    const Vec local = is_end ? end : Vec{k & 1 ? -h.x : h.x, k & 2 ? -h.y : h.y, k & 4 ? -h.z : h.z};
    const real reach = (is_end ? h.x : 0) + larger(margin, 0) + (real)1e-5;
    return clearance_at(field, at + axes * (geom.axes * local)).faces <= reach;
}
#endif

}  // namespace fused
#endif
