// SPDX-License-Identifier: Apache-2.0
// Height field: contacts of spheres, capsules, boxes and cylinders with a height field. But for those of cylinders they are
// those of stripe_kernels/heightfield.py, which says what counts as a touch, in the order of mujoco_ground.py.

#if HAS_FIELDS
namespace fused {

// Form of MuJoCo: `rows` by `cols` heights over [-x, x] by [-y, y], each cell cut into two triangles from its corner
// (row + 1, col) to its corner (row, col + 1). Everything below the surface is solid.
struct Field {
    const float* heights;  // as shares of `scale`, rows one after another, along y
    int rows, cols;
    real x, y, scale;  // half extents, and the height of a share of 1 [m]
};

FN Patch patch_at(const Field& field, Vec geom) {
    real width = 2 * field.x, length = 2 * field.y, cols = field.cols - 1, rows = field.rows - 1;
    return Patch{field.heights,  field.rows,    field.cols,   field.scale, width / cols,
                 length / rows,  cols / width,  rows / length, geom};
}

// Vertices from the middle of the field outwards: 2 col + 1 - cols is exact.
FN Vec vertex(const Patch& p, int row, int col) {
    return Vec{(real)0.5 * (2 * col + 1 - p.cols) * p.step_x, (real)0.5 * (2 * row + 1 - p.rows) * p.step_y,
               p.heights[row * p.cols + col] * p.scale} -
           p.geom;
}
// Where a point is over the grid, in columns and in rows.
FN real column_at(const Patch& p, real x) { return (p.geom.x + x) * p.cols_per_metre + (real)0.5 * (p.cols - 1); }
FN real row_at(const Patch& p, real y) { return (p.geom.y + y) * p.rows_per_metre + (real)0.5 * (p.rows - 1); }

FN Cells cells_below(const Patch& p, Vec low, Vec high) {
    return Cells{first_cell(column_at(p, low.x), p.cols - 1), last_cell(column_at(p, high.x), p.cols - 1),
                 first_cell(row_at(p, low.y), p.rows - 1), last_cell(row_at(p, high.y), p.rows - 1)};
}

// Height of the highest vertex of the cells. Each is read whatever the others are, so that reads do not wait for each other.
FN real peak(const Patch& p, const Cells& c) {
    real height = (real)-1e30;
    for (int row = c.row; row <= c.last_row + 1; row++)
#pragma unroll 4
        for (int col = c.col; col <= c.last_col + 1; col++) height = larger(height, p.heights[row * p.cols + col]);
    return height * p.scale - p.geom.z;
}

// The lower (0) or the upper (1) triangle of a cell.
FN Triangle triangle(const Patch& p, int row, int col, int upper) {
    return Triangle{vertex(p, row, col + upper), vertex(p, row + upper, col + 1), vertex(p, row + 1, col)};
}
// The triangle straight above or below a point tells on which side of the surface it is. Returns whether it is below; then
// `hit` is the touch there.
FN bool is_below(const Patch& p, Vec point, Touch& hit) {
    real u = column_at(p, point.x), v = row_at(p, point.y);
    if (!(u >= 0 && u < p.cols - 1 && v >= 0 && v < p.rows - 1)) return false;
    int col = (int)u, row = (int)v;
    Triangle t = triangle(p, row, col, (u - col) + (v - row) > 1);
    Vec n = normal_of(t);
    real above = dot(point - t.a, n);
    hit.dist = above, hit.pos = point - above * n, hit.normal = n;
    return above < 0;
}

// Touch of a point with a triangle: its distance, or from below the surface (`inside`) less than 0, the least depth being that
// of the triangles that the perpendicular from the point meets. Returns whether there is one.
FN bool triangle_touch(const Patch& p, Vec center, bool inside, real reach, int row, int col, int upper, Touch& hit) {
    Triangle t = triangle(p, row, col, upper);
    if (!inside && larger(larger(t.a.z, t.b.z), t.c.z) < center.z - reach) return false;
    Vec n = normal_of(t);
    real above = dot(center - t.a, n);
    // From above the surface, a triangle that the centre is below is on the far side of a ridge.
    if (inside ? above > 0 : above < 0) return false;
    Vec from = inside ? center - above * n : center, point = closest_on_triangle(from, t), offset = from - point;
    real dist = SQRT(dot(offset, offset));
    hit.pos = inside ? from : point, hit.dist = inside ? above : dist;
    hit.normal = inside || dist <= (real)1e-7 ? n : (1 / dist) * offset;
    return inside ? dist < (real)1e-5 : dist < reach;
}

// Candidates of a ball: the triangle straight above it, then those of the cells. From below the surface there is one touch.
FN bool ball_touch(const Search& s, const Patch& p, int i, Touch& hit, real& order) {
    if (i == 0) {
        if (!s.inside) return false;
        is_below(p, s.at, hit);
    } else {
        int width = 2 * (s.cells.last_col - s.cells.col + 1), row = (i - 1) / width, k = (i - 1) % width;
        if (!triangle_touch(p, s.at, s.inside, s.radius + s.reach, s.cells.row + row, s.cells.col + k / 2, k % 2, hit))
            return false;
    }
    order = s.inside ? -hit.dist : hit.dist;
    hit.dist -= s.radius;
    return true;
}

// An edge of a cell, a to b of the triangle `t`, with the vertex of the triangle on its other side: the lower (0), the left (1)
// or the diagonal one (2); the others belong to neighbours. Returns whether the surface bends down at it, and is not below
// `lowest`.
FN bool ridge(const Patch& p, int row, int col, int edge, real lowest, Triangle& t, Vec& right) {
    t = triangle(p, row, col, 0);
    if (larger(larger(t.a.z, t.b.z), t.c.z) < lowest) return false;
    Vec n = normal_of(t);
    right = vertex(p, row + (edge == 0 ? -1 : 1), col + (edge == 1 ? -1 : 1));
    if (edge == 1) t = Triangle{t.c, t.a, t.b};
    if (edge == 2) t = Triangle{t.b, t.c, t.a};
    return dot(right - t.a, n) <= (real)-1e-5;  // else level, or a valley
}

// Candidates of an axis from -half to half, its ends left out: the edges, three of each cell.
FN bool ridge_touch(const Search& s, const Patch& p, int i, Touch& hit, real& order) {
    int width = 3 * (s.cells.last_col - s.cells.col + 1);
    Triangle t;
    Vec right;
    if (!ridge(p, s.cells.row + i / width, s.cells.col + i % width / 3, i % 3, -FABS(s.at.z) - s.radius - s.reach, t, right))
        return false;
    return axis_touch(s, t, right, hit, order) && hit.normal.z > 0;
}

#if HAS_FIELD_CYLINDER
// Candidates of a cylinder in each cell: four points of its rims for each of the two triangles; for each of three edges the
// barrel and the two ends of what is below the cap.
enum { RIM_POINTS = 4, EDGE_TOUCHES = 3, OF_CELL = 2 * RIM_POINTS + 3 * EDGE_TOUCHES };

// Whether a point is above or below a triangle.
FN bool is_over(const Patch& p, Vec point, int row, int col, int upper) {
    real u = column_at(p, point.x) - col, v = row_at(p, point.y) - row;
    return u >= 0 && u < 1 && v >= 0 && v < 1 && (u + v > 1) == upper;
}

// Touch of a rim of a cylinder with the triangle that a point of it is over. The points are those that MuJoCo finds on the
// triangle's plane (`plane_cylinder`): on a slope its contacts are those of a plane.
FN bool rim_touch(const Search& s, const Patch& p, int row, int col, int upper, int k, Touch& hit) {
    Triangle t = triangle(p, row, col, upper);
    if (larger(larger(t.a.z, t.b.z), t.c.z) < -FABS(s.at.z) - s.radius - s.reach) return false;
    Vec n = normal_of(t), aside = cross(s.at, FABS(s.at.x) < FABS(s.at.y) ? Vec{1, 0, 0} : Vec{0, 1, 0});
    Vec point = rim_point(s.at, s.radius, n, (1 / SQRT(dot(aside, aside))) * aside, k);
    real above = dot(point - t.a, n);
    hit.dist = above, hit.pos = point - above * n, hit.normal = n;
    return above < s.reach && is_over(p, point, row, col, upper);
}

// Touch of the cap that faces down with the first (-1) or the second end (1) of what is below it of the edge a to b. Deeper
// edges, from which the way out through the barrel is shorter, touch that.
FN bool cap_touch(const Search& s, const Triangle& t, Vec right, int end, Touch& hit) {
    real height = SQRT(dot(s.at, s.at));
    Vec up = ((s.at.z > 0 ? 1 : -1) / height) * s.at, along = t.b - t.a;
    // In the plane of the cap: the edge is from + x across.
    Vec from = t.a - dot(t.a, up) * up, across = along - dot(along, up) * up;
    real square = dot(across, across), middle = -dot(from, across) / square, x = clamped(middle, 0, 1);
    Vec near = from + x * across, nearest = from + middle * across;
    real to_barrel = s.radius - SQRT(dot(near, near)), chord = s.radius * s.radius - dot(nearest, nearest);
    if (!(square > (real)1e-12) || to_barrel <= 0 || to_barrel <= height + dot(t.a + x * along, up)) return false;
    Vec point = t.a + clamped(middle + end * SQRT(chord / square), 0, 1) * along;
    // As of an edge and an axis: neither triangle goes on towards the cylinder.
    if (up.z < (real)0.1 || dot(up, t.c - point) > (real)1e-5 || dot(up, right - point) > (real)1e-5) return false;
    hit.dist = -height - dot(up, point), hit.pos = point, hit.normal = up;
    return hit.dist < s.reach;
}

FN bool cylinder_touch(const Search& s, const Patch& p, int i, Touch& hit, real& order) {
    int cell = i / OF_CELL, k = i % OF_CELL - 2 * RIM_POINTS, cols = s.cells.last_col - s.cells.col + 1;
    int row = s.cells.row + cell / cols, col = s.cells.col + cell % cols, end = k / 3 % EDGE_TOUCHES;
    bool found = false;
    if (k < 0) found = rim_touch(s, p, row, col, -k > RIM_POINTS, -k % RIM_POINTS, hit);
    else if (row == 0 || col == 0) return false;  // edges of the field's border are no ridges
    else if (end == 0) {
        found = ridge_touch(s, p, 3 * cell + k % 3, hit, order);
        real square = dot(s.at, s.at);
        if (found) found = -hit.dist <= SQRT(square) * (1 - FABS(dot(s.at, hit.pos)) / square);
    } else {
        Triangle t;
        Vec right;
        found = ridge(p, row, col, k % 3, -FABS(s.at.z) - s.radius - s.reach, t, right) &&
                cap_touch(s, t, right, 2 * end - 3, hit);
    }
    order = hit.dist;
    return found;
}
#endif

#if SEARCHES_BOXES
// Touch of a corner of a box, a ball of radius 0. It minds no other touches: corners lie side by side on a flat ground, on
// each other's tangent planes, and all of them must count.
FN bool corner_touch(const Patch& p, Vec corner, real reach, Touch& best) {
    bool inside = is_below(p, corner, best), found = inside;
    if (!inside) best.dist = reach;
    Cells cells = cells_below(p, corner - Vec{reach, reach, reach}, corner + Vec{reach, reach, reach});
    int width = 2 * (cells.last_col - cells.col + 1), rows = cells.last_row - cells.row + 1;
#pragma unroll 1
    for (int i = 0; i < (width > 0 ? width * rows : 0); i++) {
        Touch hit;
        int row = cells.row + i / width, k = i % width;
        if (!triangle_touch(p, corner, inside, best.dist, row, cells.col + k / 2, k % 2, hit)) continue;
        if (inside ? hit.dist > best.dist : hit.dist < best.dist) best = hit, found = true;
    }
    return found;
}

// Candidates of a box: its corners, then the vertices of the surface, which touch inside the box.
FN bool box_touch(const Search& s, const Patch& p, const Box& box, int i, Touch& hit, real& order) {
    if (i < 8) {
        Vec corner = (i & 1 ? -box.half[0] : box.half[0]) * box.axis[0] + (i & 2 ? -box.half[1] : box.half[1]) * box.axis[1] +
                     (i & 4 ? -box.half[2] : box.half[2]) * box.axis[2];
        if (!corner_touch(p, corner, larger(s.reach, 0) + (real)1e-6, hit)) return false;
    } else {
        int width = s.cells.last_col - s.cells.col + 2;
        hit.pos = vertex(p, s.cells.row + (i - 8) / width, s.cells.col + (i - 8) % width), hit.normal = Vec{0, 0, 1};
        if (hit.pos.z < -s.at.z) return false;
        // The depth is that to the nearest side that faces down: only through such a side the ground can leave the box.
        real depth = (real)1e6;
        bool inside = true;
        for (int k = 0; k < 3; k++) {
            Vec up = (box.axis[k].z < 0 ? -1 : 1) * box.axis[k];
            real x = dot(up, hit.pos);
            inside = inside && FABS(x) <= box.half[k];
            if (up.z > (real)0.1 && box.half[k] + x < depth) depth = box.half[k] + x, hit.normal = up;
        }
        if (!inside) return false;
        hit.dist = -depth;
    }
    order = hit.dist;
    return hit.dist < s.reach;
}
#endif

// Prepare the search for touches of a part of a geom, see `place`. Returns whether it is not above the highest vertex below
// it. The rows of `axes` are those of the field.
FN bool prepare(Search& s, PartKind kind, int end, real margin, const Patch& p, const Mat& axes, const Geom& geom) {
    s.geom = p.geom, s.size = 0;
    Bounds b = place(s, kind, end, margin, axes, geom);
    s.cells = cells_below(p, b.center - b.half, b.center + b.half);
    if (peak(p, s.cells) < b.center.z - b.half.z) return false;
    if (kind == AXIS_PART) {
        if (!is_long(s)) return false;
        // Those of the field's border have but one triangle and are no ridges.
        s.cells.row = s.cells.row > 1 ? s.cells.row : 1, s.cells.col = s.cells.col > 1 ? s.cells.col : 1;
    }
    if (kind == AXIS_PART || kind == CYLINDER_PART) {
        // One more row and column, as each cell has but some of its edges.
        if (s.cells.last_row + 1 <= p.rows - 2) s.cells.last_row++;
        if (s.cells.last_col + 1 <= p.cols - 2) s.cells.last_col++;
    }
    Touch hit;
    if (kind == BALL_PART) s.inside = is_below(p, s.at, hit);
    int rows = s.cells.last_row - s.cells.row + 1, cols = s.cells.last_col - s.cells.col + 1;
    s.size = rows > 0 && cols > 0 ? rows * cols : 0;
    if (kind == BALL_PART) s.size = 1 + 2 * s.size;
    if (kind == AXIS_PART) s.size = 3 * s.size;
#if HAS_FIELD_CYLINDER
    if (kind == CYLINDER_PART) s.size = OF_CELL * s.size;
#endif
    if (kind == BOX_PART) s.size = 8 + (s.size ? (rows + 1) * (cols + 1) : 0);
    return true;
}

// The touch of a candidate of a part of any kind. `box` places the geom of a search that is one.
template <class PlaceBox>
FN bool field_touch(const Search& s, const Patch& p, int candidate, PlaceBox box, Touch& hit, real& order) {
#if SEARCHES_BOXES
    if (s.kind == BOX_PART) return box_touch(s, p, box(), candidate, hit, order);
#endif
#if HAS_FIELD_CYLINDER
    if (s.kind == CYLINDER_PART) return cylinder_touch(s, p, candidate, hit, order);
#endif
    return s.kind == BALL_PART ? ball_touch(s, p, candidate, hit, order) : ridge_touch(s, p, candidate, hit, order);
}

}  // namespace fused
#endif
