// SPDX-License-Identifier: Apache-2.0
// Height field: contacts of spheres, capsules and boxes with a height field. They are those of
// stripe_kernels/heightfield.py, which says what counts as a touch, in the order of mujoco_ground.py.
//
// Touches are searched in the axes of the field, relative to the geom's centre, so that they are exact far from the world's
// origin. While they are, `pos` of a hit is the point on the surface; `to_world` completes the hits.
//
// A search is that of a part of a geom: a ball, the axis of a capsule, or a box. Its candidates, the triangles, edges or
// vertices that are below the part, are spread over the lanes of a world, all searches together. The best one is the next
// touch; then the rest are candidates again, of which some are no more, as they are too near to it.

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
    const float* heights;
    int rows, cols;
    real scale, step_x, step_y, cols_per_metre, rows_per_metre;
    Vec geom;  // the geom's centre in the frame of the field
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

// Cells below a box: the first and the last column and row; none where the first exceeds the last.
struct Cells {
    int col, last_col, row, last_row;
};
// The bounds come first: casts of what no int holds are undefined. A position that is not a number has no cells.
FN int first_cell(real u, int n) { return (int)smaller(larger(u, 0), (real)(n - 1)); }
FN int last_cell(real u, int n) { return u >= 0 ? (int)smaller(u, (real)(n - 2)) : -1; }
FN Cells cells_below(const Patch& p, Vec low, Vec high) {
    return Cells{first_cell(column_at(p, low.x), p.cols), last_cell(column_at(p, high.x), p.cols),
                 first_cell(row_at(p, low.y), p.rows), last_cell(row_at(p, high.y), p.rows)};
}

// Height of the highest vertex of the cells. Each is read whatever the others are, so that reads do not wait for each other.
FN real peak(const Patch& p, const Cells& c) {
    real height = (real)-1e30;
    for (int row = c.row; row <= c.last_row + 1; row++)
#pragma unroll 4
        for (int col = c.col; col <= c.last_col + 1; col++) height = larger(height, p.heights[row * p.cols + col]);
    return height * p.scale - p.geom.z;
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

enum PartKind { BALL_PART, AXIS_PART, BOX_PART };

// A part of a geom that may touch the field.
struct Part {
    Patch patch;
    Cells cells;
    Vec at;              // centre of a ball, half of an axis, half of a box's bounding box
    real radius, reach;  // of a ball or axis; distance below which it touches
#if SEARCHES_BOXES
    Vec axis[3];         // of a box
    real half[3];        // its half sizes
#endif
    int kind, most;      // PartKind; touches that it may have
    int size;            // number of its candidates
    bool inside;         // whether a ball's centre is below the surface
};

struct Touch {
    real dist;
    Vec pos, normal;
};

// The search for touches of a part.
struct Search : Part {
    int pair;   // the caller's
    int start;  // its candidates among those of all searches
    int count;
    bool ended;
    Touch hit[4];
#if LANES > 1
    unsigned long long best;  // order and number of the best candidate
#else
    real order;
    int best;
#endif
};

// Offer a candidate for the next hit. The one of lowest order is taken; the first of those of equal order, whichever lane
// comes first.
#if LANES > 1
FN void expect(Search& s) { s.best = ~0ull; }
FN void offer(Search& s, real order, int candidate) {
#ifdef __CUDA_ARCH__
    unsigned bits = __float_as_uint(order);  // as an unsigned number of the same order
    bits ^= bits >> 31 ? 0xffffffffu : 0x80000000u;
    atomicMin(&s.best, (unsigned long long)bits << 32 | (unsigned)candidate);
#endif
}
FN int taken(const Search& s) { return s.best == ~0ull ? -1 : (int)(s.best & 0xffffffffu); }
#else
FN void expect(Search& s) { s.best = -1; }
FN void offer(Search& s, real order, int candidate) {
    if (s.best < 0 || order < s.order) s.order = order, s.best = candidate;
}
FN int taken(const Search& s) { return s.best; }
#endif

// Whether a point is above the tangent planes of the hits: those of a smooth surface are one touch.
FN bool is_above_planes(const Search& s, Vec point) {
#pragma unroll 1
    for (int i = 0; i < s.count; i++)
        if (dot(point - s.hit[i].pos, s.hit[i].normal) <= (real)1e-4) return false;
    return true;
}

// Whether a point is at least 1 mm away from the hits.
FN bool is_apart(const Search& s, Vec point) {
#pragma unroll 1
    for (int i = 0; i < s.count; i++) {
        Vec d = point - s.hit[i].pos;
        if (dot(d, d) < (real)1e-6) return false;
    }
    return true;
}

// The triangle straight above or below a point tells on which side of the surface it is. Returns whether it is below; then
// `hit` is the touch there.
FN bool is_below(const Patch& p, Vec point, Touch& hit) {
    real u = column_at(p, point.x), v = row_at(p, point.y);
    if (!(u >= 0 && u < p.cols - 1 && v >= 0 && v < p.rows - 1)) return false;
    int col = (int)u, row = (int)v;
    Triangle t = triangle(p, row, col, (u - col) + (v - row) > 1);
    Vec n = upward_normal(t);
    real above = dot(point - t.a, n);
    hit.dist = above, hit.pos = point - above * n, hit.normal = n;
    return above < 0;
}

// Touch of a point with a triangle: its distance, or from below the surface (`inside`) less than 0, the least depth being that
// of the triangles that the perpendicular from the point meets. Returns whether there is one.
FN bool triangle_touch(const Patch& p, Vec center, bool inside, real reach, int row, int col, int upper, Touch& hit) {
    Triangle t = triangle(p, row, col, upper);
    if (!inside && larger(larger(t.a.z, t.b.z), t.c.z) < center.z - reach) return false;
    Vec n = upward_normal(t);
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
FN bool ball_touch(const Search& s, int i, Touch& hit, real& order) {
    if (i == 0) {
        if (!s.inside) return false;
        is_below(s.patch, s.at, hit);
    } else {
        int width = 2 * (s.cells.last_col - s.cells.col + 1), row = (i - 1) / width, k = (i - 1) % width;
        if (!triangle_touch(s.patch, s.at, s.inside, s.radius + s.reach, s.cells.row + row, s.cells.col + k / 2, k % 2, hit))
            return false;
        if (!s.inside && !is_above_planes(s, hit.pos)) return false;
    }
    order = s.inside ? -hit.dist : hit.dist;
    hit.dist -= s.radius;
    return true;
}

// Candidates of an axis from -half to half, its ends left out: the edges, of which those at which the surface bends down may
// touch. Each cell has three: its lower, its left and its diagonal one; the others belong to its neighbours.
FN bool ridge_touch(const Search& s, int i, Touch& hit, real& order) {
    const Patch& p = s.patch;
    const Vec half = s.at, axis = 2 * half;
    int width = 3 * (s.cells.last_col - s.cells.col + 1), row = s.cells.row + i / width, edge = i % width;
    int col = s.cells.col + edge / 3;
    edge %= 3;
    real pp = dot(axis, axis), size = s.radius + s.reach;
    Triangle t = triangle(p, row, col, 0);
    if (larger(larger(t.a.z, t.b.z), t.c.z) < -FABS(half.z) - size) return false;
    // The edge a to b of the triangle, and the triangle on its other side.
    Vec n = upward_normal(t), right = vertex(p, row + (edge == 0 ? -1 : 1), col + (edge == 1 ? -1 : 1));
    if (edge == 1) t = Triangle{t.c, t.a, t.b};
    if (edge == 2) t = Triangle{t.b, t.c, t.a};
    if (dot(right - t.a, n) > (real)-1e-5) return false;  // level, or a valley
    // Nearest points of axis and edge: -half + x axis and a + y ab. Source: Ericson, 5.1.9, with the difference of products
    // in x as products of cross products, which keep their digits when axis and edge are parallel.
    Vec ab = t.b - t.a, r = -1 * half - t.a, across = cross(axis, ab);
    real pq = dot(axis, ab), c = dot(axis, r), det = dot(across, across);
    real x = det > 0 ? clamped(dot(across, cross(ab, r)) / det, 0, 1) : 0;
    real y = (pq * x + dot(ab, r)) / dot(ab, ab);
    if (y < 0) y = 0, x = clamped(-c / pp, 0, 1);
    else if (y > 1) y = 1, x = clamped((pq - c) / pp, 0, 1);
    if (x <= (real)1e-3 || x >= 1 - (real)1e-3) return false;  // the balls at the ends have their own touches
    Vec point = t.a + y * ab, offset = x * axis - half - point;
    // The point is the nearest one of both triangles only if neither goes on towards the axis.
    if (dot(offset, t.c - point) > (real)1e-5 || dot(offset, right - point) > (real)1e-5) return false;
    real dist = SQRT(dot(offset, offset));
    if (dist <= (real)1e-6 || offset.z <= 0 || dist >= size || !is_apart(s, point)) return false;
    hit.pos = point, hit.normal = (1 / dist) * offset, hit.dist = dist - s.radius, order = dist;
    return true;
}

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
FN bool box_touch(const Search& s, int i, Touch& hit, real& order) {
    const Patch& p = s.patch;
    if (i < 8) {
        Vec corner = (i & 1 ? -s.half[0] : s.half[0]) * s.axis[0] + (i & 2 ? -s.half[1] : s.half[1]) * s.axis[1] +
                     (i & 4 ? -s.half[2] : s.half[2]) * s.axis[2];
        if (!corner_touch(p, corner, larger(s.reach, 0) + (real)1e-6, hit)) return false;
    } else {
        int width = s.cells.last_col - s.cells.col + 2;
        hit.pos = vertex(p, s.cells.row + (i - 8) / width, s.cells.col + (i - 8) % width), hit.normal = Vec{0, 0, 1};
        if (hit.pos.z < -s.at.z) return false;
        // The depth is that to the nearest side that faces down: only through such a side the ground can leave the box.
        real depth = (real)1e6;
        bool inside = true;
        for (int k = 0; k < 3; k++) {
            Vec up = (s.axis[k].z < 0 ? -1 : 1) * s.axis[k];
            real x = dot(up, hit.pos);
            inside = inside && FABS(x) <= s.half[k];
            if (up.z > (real)0.1 && s.half[k] + x < depth) depth = s.half[k] + x, hit.normal = up;
        }
        if (!inside) return false;
        hit.dist = -depth;
    }
    order = hit.dist;
    return hit.dist < s.reach && is_apart(s, hit.pos);
}
#endif

ONE_COPY bool touch(const Search& s, int candidate, Touch& hit, real& order) {
#if SEARCHES_BOXES
    if (s.kind == BOX_PART) return box_touch(s, candidate, hit, order);
#endif
    return s.kind == BALL_PART ? ball_touch(s, candidate, hit, order) : ridge_touch(s, candidate, hit, order);
}

// Prepare the search for touches of a part of a geom: its ball at `end` times its half length along its axis z, its axis, or
// the whole box. Returns whether it is not above the highest vertex below it.
FN bool prepare(Part& s, PartKind kind, int end, real margin, const Field& field, const Geom& ground, const Geom& geom) {
    Mat axes = transposed(ground.axes);  // rows: the axes of the field
    s.patch = patch_at(field, axes * (geom.pos - ground.pos));
    s.kind = kind, s.reach = margin, s.radius = kind == BOX_PART ? 0 : geom.size.x;
    s.inside = false;
    Vec center{0, 0, 0}, more = (s.radius + margin) * Vec{1, 1, 1};
    if (kind != BOX_PART) s.at = (kind == BALL_PART ? end : 1) * geom.size.y * (axes * column(geom.axes, 2));
    if (kind == BALL_PART) center = s.at, s.most = end ? 2 : 4;
    if (kind == AXIS_PART) more = more + Vec{FABS(s.at.x), FABS(s.at.y), FABS(s.at.z)}, s.most = 2;
#if SEARCHES_BOXES
    if (kind == BOX_PART) {
        s.half[0] = geom.size.x, s.half[1] = geom.size.y, s.half[2] = geom.size.z, s.at = Vec{0, 0, 0}, s.most = 4;
        for (int i = 0; i < 3; i++) {
            s.axis[i] = axes * column(geom.axes, i);
            s.at = s.at + s.half[i] * Vec{FABS(s.axis[i].x), FABS(s.axis[i].y), FABS(s.axis[i].z)};
        }
        more = more + s.at;
    }
#endif
    s.cells = cells_below(s.patch, center - more, center + more);
    if (peak(s.patch, s.cells) < center.z - more.z) return false;
    if (kind == AXIS_PART) {
        if (4 * dot(s.at, s.at) <= (real)1e-8) return false;  // all but a ball
        // One more row and column, as each cell has but some of its edges. Those of the field's border have but one triangle
        // and are no ridges.
        s.cells.row = s.cells.row > 1 ? s.cells.row : 1, s.cells.col = s.cells.col > 1 ? s.cells.col : 1;
        if (s.cells.last_row + 1 <= s.patch.rows - 2) s.cells.last_row++;
        if (s.cells.last_col + 1 <= s.patch.cols - 2) s.cells.last_col++;
    }
    Touch hit;
    if (kind == BALL_PART) s.inside = is_below(s.patch, s.at, hit);
    int rows = s.cells.last_row - s.cells.row + 1, cols = s.cells.last_col - s.cells.col + 1;
    s.size = rows > 0 && cols > 0 ? rows * cols : 0;
    if (kind == BALL_PART) s.size = 1 + 2 * s.size;
    if (kind == AXIS_PART) s.size = 3 * s.size;
    if (kind == BOX_PART) s.size = 8 + (s.size ? (rows + 1) * (cols + 1) : 0);
    return true;
}

// Hits of the first `count` searches, nearest first; at most as many searches as there are lanes.
FN void find_hits(Search* searches, int count, int lane) {
    for (;;) {
        int before = 0, all = 0, mine = 0;
        if (lane < count) {
            mine = searches[lane].ended ? 0 : searches[lane].size;
            expect(searches[lane]);
        }
        all = mine;
        BEFORE(mine, before, all);
        if (lane < count) searches[lane].start = before;
        SYNC();
        if (all == 0) break;
        int k = 0;
        for (int c = lane; c < all; c += LANES) {
            while (k + 1 < count && searches[k + 1].start <= c) k++;  // the last that starts there: those before are empty
            Touch hit;
            real order;
            if (touch(searches[k], c - searches[k].start, hit, order)) offer(searches[k], order, c - searches[k].start);
        }
        SYNC();
        if (lane < count && !searches[lane].ended) {
            Search& s = searches[lane];
            int candidate = taken(s);
            real order;
            if (candidate >= 0) {
                Touch hit;
                touch(s, candidate, hit, order);
                s.hit[s.count++] = hit;
            }
            s.ended = candidate < 0 || s.inside || s.count == s.most;
        }
        SYNC();
    }
}

// A hit in the axes of the world, halfway between the two surfaces.
FN Hit to_world(const Touch& h, const Geom& ground, const Geom& geom) {
    return Hit{h.dist, geom.pos + ground.axes * (h.pos + ((real)0.5 * h.dist) * h.normal), ground.axes * h.normal, {0, 0, 0}};
}

}  // namespace fused
