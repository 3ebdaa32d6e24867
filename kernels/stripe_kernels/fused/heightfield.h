// SPDX-License-Identifier: Apache-2.0
// Height field: contacts of spheres, capsules and boxes with a height field. They are those of
// stripe_kernels/heightfield.py, which says what counts as a touch, in the order of mujoco_ground.py.
//
// Touches are searched in the axes of the field, relative to the geom's centre, so that they are exact far from the world's
// origin. While they are, `pos` of a hit is the point on the surface; `to_world` completes the hits.
//
// Loops of few passes are not unrolled, which would make the code larger by 40 %.

namespace fused {

// Form of MuJoCo: `rows` by `cols` heights over [-x, x] by [-y, y], each cell cut into two triangles from its corner
// (row + 1, col) to its corner (row, col + 1). Everything below the surface is solid.
struct Field {
    const float* heights;  // as shares of `scale`, rows one after another, along y
    int rows, cols;
    real x, y, scale;  // half extents, and the height of a share of 1 [m]
};

// A field as seen from a geom: points are in the field's axes, relative to the geom's centre.
struct Patch {
    const Field& field;
    Mat axes;  // rows: the axes of the field
    Vec geom;  // the geom's centre in the frame of the field
    real step_x, step_y, cols_per_metre, rows_per_metre;
};
FN Patch patch_at(const Field& field, const Geom& ground, const Geom& geom) {
    Mat axes{column(ground.axes, 0), column(ground.axes, 1), column(ground.axes, 2)};
    real width = 2 * field.x, length = 2 * field.y, cols = field.cols - 1, rows = field.rows - 1;
    return Patch{field, axes, axes * (geom.pos - ground.pos), width / cols, length / rows, cols / width, rows / length};
}

// Vertices from the middle of the field outwards: 2 col + 1 - cols is exact.
FN Vec vertex(const Patch& p, int row, int col) {
    const Field& f = p.field;
    return Vec{(real)0.5 * (2 * col + 1 - f.cols) * p.step_x, (real)0.5 * (2 * row + 1 - f.rows) * p.step_y,
               f.heights[row * f.cols + col] * f.scale} -
           p.geom;
}
// Where a point is over the grid, in columns and in rows.
FN real column_at(const Patch& p, real x) { return (p.geom.x + x + p.field.x) * p.cols_per_metre; }
FN real row_at(const Patch& p, real y) { return (p.geom.y + y + p.field.y) * p.rows_per_metre; }

// Cells below a box: the first and the last column and row; none where the first exceeds the last.
struct Cells {
    int col, last_col, row, last_row;
};
// The bounds come first: casts of what no int holds are undefined. A position that is not a number has no cells.
FN int first_cell(real u, int n) { return (int)smaller(larger(u, 0), (real)(n - 1)); }
FN int last_cell(real u, int n) { return u >= 0 ? (int)smaller(u, (real)(n - 2)) : -1; }
FN Cells cells_below(const Patch& p, Vec low, Vec high) {
    const Field& f = p.field;
    return Cells{first_cell(column_at(p, low.x), f.cols), last_cell(column_at(p, high.x), f.cols),
                 first_cell(row_at(p, low.y), f.rows), last_cell(row_at(p, high.y), f.rows)};
}

// Whether a part of a geom is above the highest vertex below it; `extent` is half of its bounding box.
FN bool is_above(const Patch& p, Vec center, Vec extent) {
    Cells c = cells_below(p, center - extent, center + extent);
    for (int row = c.row; row <= c.last_row + 1; row++)
        for (int col = c.col; col <= c.last_col + 1; col++)
            if (vertex(p, row, col).z >= center.z - extent.z) return false;
    return true;
}

// Counterclockwise, seen from above.
struct Triangle {
    Vec a, b, c;
};
// The lower (0) or the upper (1) triangle of a cell.
FN Triangle triangle(const Patch& p, int row, int col, int upper) {
    return Triangle{vertex(p, row, col + upper), vertex(p, row + upper, col + 1), vertex(p, row + 1, col)};
}
FN Vec upward_normal(const Triangle& t) {
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

// Whether a point is above the tangent planes of the hits from the first on: those of a smooth surface are one touch.
FN bool is_above_planes(const Hits& hits, int first, Vec point) {
#pragma unroll 1
    for (int i = first; i < hits.count; i++)
        if (dot(point - hits.hit[i].pos, hits.hit[i].normal) <= (real)1e-4) return false;
    return true;
}

// Whether a point is at least 1 mm away from the hits from the first on.
FN bool is_apart(const Hits& hits, int first, Vec point) {
#pragma unroll 1
    for (int i = first; i < hits.count; i++) {
        Vec d = point - hits.hit[i].pos;
        if (dot(d, d) < (real)1e-6) return false;
    }
    return true;
}

// Nearest touch of a sphere, apart from the hits from the first on. Returns whether there is one.
FN bool sphere_touch(const Hits& hits, int first, real reach, const Patch& p, Vec center, real radius, Hit& best) {
    const Field& f = p.field;
    real size = radius + reach, u = column_at(p, center.x), v = row_at(p, center.y);
    bool inside = false;
    best.dist = size;
    // The triangle straight above or below the centre tells on which side of the surface it is.
    if (u >= 0 && u < f.cols - 1 && v >= 0 && v < f.rows - 1) {
        int col = (int)u, row = (int)v;
        Triangle t = triangle(p, row, col, (u - col) + (v - row) > 1);
        Vec n = upward_normal(t);
        real above = dot(center - t.a, n);
        if (above < 0) inside = true, best = Hit{above, center - above * n, n, Vec{0, 0, 0}};
    }
    if (inside && hits.count > first) return false;  // below the surface there is one touch only
    bool found = inside;
    Cells cells = cells_below(p, center - Vec{size, size, size}, center + Vec{size, size, size});
    for (int row = cells.row; row <= cells.last_row; row++) {
        for (int i = 2 * cells.col; i < 2 * (cells.last_col + 1); i++) {
            Triangle t = triangle(p, row, i / 2, i % 2);
            // Vertices that are all lower than the best distance reaches have no nearer point between them.
            if (!inside && larger(larger(t.a.z, t.b.z), t.c.z) < center.z - best.dist) continue;
            Vec n = upward_normal(t);
            real above = dot(center - t.a, n);
            // From above the surface, a triangle that the centre is below is on the far side of a ridge.
            if (inside ? above > 0 : above < 0) continue;
            Vec from = inside ? center - above * n : center, point = closest_on_triangle(from, t), offset = from - point;
            real dist = SQRT(dot(offset, offset));
            if (inside) {  // the least depth, of the triangles that the perpendicular from the centre meets
                if (above > best.dist && dist < (real)1e-5) best = Hit{above, from, n, Vec{0, 0, 0}};
            } else if (dist < best.dist && is_above_planes(hits, first, point)) {
                found = true;
                best = Hit{dist, point, dist > (real)1e-7 ? (1 / dist) * offset : n, Vec{0, 0, 0}};
            }
        }
    }
    best.dist -= radius;
    return found;
}

// Nearest touch of an axis from -half to half, its ends left out, with a ridge: an edge at which the surface bends down.
FN bool ridge_touch(const Hits& hits, int first, real reach, const Patch& p, Vec half, real radius, Hit& best) {
    real size = radius + reach, pp = 4 * dot(half, half);
    if (pp <= (real)1e-8) return false;  // all but a sphere
    Vec axis = 2 * half, high{FABS(half.x) + size, FABS(half.y) + size, FABS(half.z) + size};
    bool found = false;
    best.dist = size;
    Cells cells = cells_below(p, -1 * high, high);
    // Each cell looks at three edges: its lower, its left and its diagonal one; the others belong to its neighbours. Hence
    // one more row and column. The edges of the field's border have but one triangle and are no ridges.
    int row_end = cells.last_row + 1, col_end = cells.last_col + 1;
    if (row_end > p.field.rows - 2) row_end = p.field.rows - 2;
    if (col_end > p.field.cols - 2) col_end = p.field.cols - 2;
    for (int row = cells.row > 1 ? cells.row : 1; row <= row_end; row++) {
        for (int col = cells.col > 1 ? cells.col : 1; col <= col_end; col++) {
            Triangle t = triangle(p, row, col, 0);
            if (larger(larger(t.a.z, t.b.z), t.c.z) < -high.z) continue;
            Vec n = upward_normal(t);
            // The edges a to b of the triangle, which turns from one to the next, and the triangle on their other side.
#pragma unroll 1
            for (int edge = 0; edge < 3; edge++, t = Triangle{t.c, t.a, t.b}) {
                Vec right = vertex(p, row + (edge == 0 ? -1 : 1), col + (edge == 1 ? -1 : 1));
                if (dot(right - t.a, n) > (real)-1e-5) continue;  // level, or a valley
                // Nearest points of axis and edge: -half + s axis and a + y ab. Source: Ericson, 5.1.9, with the difference
                // of products in s as products of cross products, which keep their digits when axis and edge are parallel.
                Vec ab = t.b - t.a, r = -1 * half - t.a, across = cross(axis, ab);
                real pq = dot(axis, ab), c = dot(axis, r), det = dot(across, across);
                real s = det > 0 ? clamped(dot(across, cross(ab, r)) / det, 0, 1) : 0;
                real y = (pq * s + dot(ab, r)) / dot(ab, ab);
                if (y < 0) y = 0, s = clamped(-c / pp, 0, 1);
                else if (y > 1) y = 1, s = clamped((pq - c) / pp, 0, 1);
                if (s <= (real)1e-3 || s >= 1 - (real)1e-3) continue;  // the spheres at the ends have their own touches
                Vec point = t.a + y * ab, offset = s * axis - half - point;
                // The point is the nearest one of both triangles only if neither goes on towards the axis.
                if (dot(offset, t.c - point) > (real)1e-5 || dot(offset, right - point) > (real)1e-5) continue;
                real dist = SQRT(dot(offset, offset));
                if (dist <= (real)1e-6 || offset.z <= 0 || dist >= best.dist || !is_apart(hits, first, point)) continue;
                found = true;
                best = Hit{dist, point, (1 / dist) * offset, Vec{0, 0, 0}};
            }
        }
    }
    best.dist -= radius;
    return found;
}

// Deepest touch of a box, apart from the hits from the first on: a corner below the surface, or a vertex of the surface
// inside the box. `axis` are the box's axes, `half` its half sizes, `extent` half of its bounding box.
FN bool box_touch(const Hits& hits, int first, real reach, const Patch& p, const Vec* axis, const real* half, Vec extent,
                  Hit& best) {
    bool found = false;
    best.dist = reach;
    for (int i = 0; i < 8; i++) {
        Vec corner = (i & 1 ? -half[0] : half[0]) * axis[0] + (i & 2 ? -half[1] : half[1]) * axis[1] +
                     (i & 4 ? -half[2] : half[2]) * axis[2];
        Hit hit;
        // A corner is a sphere of radius 0. It gets no hits to avoid: corners lie side by side on a flat ground, on each
        // other's tangent planes, and all of them must count.
        bool touches = sphere_touch(hits, hits.count, larger(reach, 0) + (real)1e-6, p, corner, 0, hit);
        if (touches && hit.dist < best.dist && is_apart(hits, first, hit.pos)) best = hit, found = true;
    }
    Cells cells = cells_below(p, -1 * extent, extent);
    for (int row = cells.row; row <= cells.last_row + 1; row++) {
        for (int col = cells.col; col <= cells.last_col + 1; col++) {
            Vec point = vertex(p, row, col), normal{0, 0, 1};
            if (point.z < -extent.z) continue;
            // The depth is that to the nearest side that faces down: only through such a side the ground can leave the box.
            real depth = (real)1e6;
            bool inside = true;
            for (int i = 0; i < 3; i++) {
                Vec up = (axis[i].z < 0 ? -1 : 1) * axis[i];
                real x = dot(up, point);
                inside = inside && FABS(x) <= half[i];
                if (up.z > (real)0.1 && half[i] + x < depth) depth = half[i] + x, normal = up;
            }
            if (!inside || -depth >= best.dist || !is_apart(hits, first, point)) continue;
            found = true;
            best = Hit{-depth, point, normal, Vec{0, 0, 0}};
        }
    }
    return found;
}

// Touches from the first on, as hits in the axes of the world, with points halfway between the two surfaces.
FN void to_world(Hits& hits, int first, const Geom& ground, const Geom& geom) {
#pragma unroll 1
    for (int i = first; i < hits.count; i++) {
        Hit& h = hits.hit[i];
        h.pos = geom.pos + ground.axes * (h.pos + ((real)0.5 * h.dist) * h.normal), h.normal = ground.axes * h.normal;
    }
}

// At most `most` contacts of a sphere, or of an end of a capsule: `end` is 1 or -1.
FN void field_ball(Hits& hits, real margin, const Field& field, const Geom& ground, const Geom& geom, int end, int most) {
    Patch p = patch_at(field, ground, geom);
    Vec center = end * geom.size.y * (p.axes * column(geom.axes, 2));
    real radius = geom.size.x, size = radius + margin;
    if (is_above(p, center, Vec{size, size, size})) return;
    int first = hits.count;
    Hit hit;
    while (hits.count < first + most && sphere_touch(hits, first, margin, p, center, radius, hit))
        hits.hit[hits.count++] = hit;  // nearest first; after a miss there is none
    to_world(hits, first, ground, geom);
}

// At most two contacts of the axis of a capsule, its ends left out.
FN void field_axis(Hits& hits, real margin, const Field& field, const Geom& ground, const Geom& capsule) {
    Patch p = patch_at(field, ground, capsule);
    Vec half = capsule.size.y * (p.axes * column(capsule.axes, 2));
    real radius = capsule.size.x, size = radius + margin;
    if (is_above(p, Vec{0, 0, 0}, Vec{FABS(half.x) + size, FABS(half.y) + size, FABS(half.z) + size})) return;
    int first = hits.count;
    Hit hit;
    while (hits.count < first + 2 && ridge_touch(hits, first, margin, p, half, radius, hit)) hits.hit[hits.count++] = hit;
    to_world(hits, first, ground, capsule);
}

// At most four contacts.
FN void field_box(Hits& hits, real margin, const Field& field, const Geom& ground, const Geom& box) {
    Patch p = patch_at(field, ground, box);
    real half[3] = {box.size.x, box.size.y, box.size.z};
    Vec axis[3], extent{0, 0, 0}, more{margin, margin, margin};
    for (int i = 0; i < 3; i++) {
        axis[i] = p.axes * column(box.axes, i);
        extent = extent + half[i] * Vec{FABS(axis[i].x), FABS(axis[i].y), FABS(axis[i].z)};
    }
    if (is_above(p, Vec{0, 0, 0}, extent + more)) return;
    int first = hits.count;
    Hit hit;
    while (hits.count < first + 4 && box_touch(hits, first, margin, p, axis, half, extent, hit))
        hits.hit[hits.count++] = hit;
    to_world(hits, first, ground, box);
}

}  // namespace fused
