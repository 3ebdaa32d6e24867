// SPDX-License-Identifier: Apache-2.0
// Boxes: contacts of capsules and boxes with boxes. Each routine finds what MuJoCo's of the same name finds
// (engine_collision_box.c of MuJoCo), in the same order, as those of primitives.h do.
//
// Vectors in the axes of a box are indexed by selection: an array with an index that is not a constant would lie in the
// local memory of a GPU. Loops of few passes are not unrolled, as few pairs are so near that they run.

// Bounds of rounding for boxes, those of MuJoCo: relative gap below which they are not apart, squared sine of parallel
// edges, cosine of perpendicular axes, squared relative distance of equal vertices.
#ifdef FUSED_DOUBLE
#define GAP_SLACK 1e-13
#define PARALLEL_EDGES 1e-16
#define PERPENDICULAR 1e-9
#define SAME_VERTEX 1e-14
#else
#define GAP_SLACK 1e-6f
#define PARALLEL_EDGES 1e-7f
#define PERPENDICULAR 1e-5f
#define SAME_VERTEX 1e-10f
#endif

namespace fused {

FN real component(Vec v, int i) { return i == 0 ? v.x : i == 1 ? v.y : v.z; }
FN Vec with(Vec v, int i, real value) { return Vec{i == 0 ? value : v.x, i == 1 ? value : v.y, i == 2 ? value : v.z}; }
FN Vec magnitudes(Vec v) { return Vec{FABS(v.x), FABS(v.y), FABS(v.z)}; }

// Sets of the axes x, y and z are bits, which make an axis of a set with one bit by a shift.
FN int positive(Vec v) { return (v.x > 0) | (v.y > 0) << 1 | (v.z > 0) << 2; }
FN bool has(int set, int axis) { return set >> axis & 1; }
FN bool is_single(int set) { return set == 1 || set == 2 || set == 4; }

// Feature of a box that is nearest to the axis of a capsule.
enum Feature { NONE, FACE, EDGE, CORNER, INTERIOR };
struct Nearest {
    real square;  // squared distance
    real t;       // nearest point of the capsule's axis, from -1 to 1
    Vec point;    // of an edge or a corner the nearest point; above a face that of the capsule
    Feature feature;
    int axis;     // normal of the face, or direction of the edge
};

// The axis of the capsule is `p` + t `h`, the box has half sizes `s`.
FN Nearest nearest_feature(Vec p, Vec h, Vec s) {
    Nearest best{(real)1e30, 0, p, NONE, 0};
    // A face can only be nearest to an end of the axis that is above it.
#pragma unroll 1
    for (int end = -1; end <= 1; end += 2) {
        Vec tip = p + end * h, out = magnitudes(tip) - s;
        int beyond = positive(out);
        if (beyond != 0 && !is_single(beyond)) continue;
        real height = larger(larger(out.x, out.y), larger(out.z, 0));
        if (height * height < best.square)
            best = Nearest{height * height, (real)end, tip, beyond ? FACE : INTERIOR, beyond >> 1};
    }
    // The twelve edges, of which those along j have corners at -s[j]. The edge is the line d + y e_j as seen from `p`.
    real hh = dot(h, h);
#pragma unroll 1
    for (int i = 0; i < 24 && best.square > 0; i++) {
        int j = i >> 3;
        if (has(i, j)) continue;
        Vec corner{has(i, 0) ? s.x : -s.x, has(i, 1) ? s.y : -s.y, has(i, 2) ? s.z : -s.z}, d = with(corner - p, j, 0);
        Vec across = with(h, j, 0);  // both lines are nearest to each other where they are so as seen along the edge
        real half = component(s, j), from = component(p, j), slope = component(h, j), square = dot(across, across);
        if (half * half * square < (real)1e-15) continue;  // parallel: the nearest point is that of an edge at its ends
        real t = dot(across, d) / square, y = from + t * slope;
        int end = 0;  // of the edge
        if (FABS(y) > half) {
            end = y > 0 ? 1 : -1, y = end * half;
            t = (dot(across, d) + slope * (y - from)) / hh;
        }
        if (FABS(t) > 1) {
            t = t > 0 ? 1 : -1, y = from + t * slope;
            // A nearest point that was at an end counts as a corner even if it is not there any more, as in MuJoCo.
            if (FABS(y) > half) end = y > 0 ? 1 : -1, y = end * half;
        }
        Vec gap = with(d, j, y - from) - t * h;
        square = dot(gap, gap);
        if (square < best.square - (real)1e-15)
            best = Nearest{square, t, with(corner, j, end ? end * half : y), end ? CORNER : EDGE, j};
    }
    return best;
}

// Whether the capsule's axis leads from the nearest point across a face or along an edge, and to where: its end, or the
// point at which it is no longer above the box.
FN bool second_point(const Nearest& n, Vec h, Vec s, real& t) {
    int inward = positive(h) ^ positive(n.point);  // axes along which the capsule's axis leads to the box's other side
    int walls = 0, forward = 1;                    // axes along which it may leave the box; its direction, 1 or -1
    if (n.feature == FACE) {
        walls = 7 & ~(1 << n.axis), forward = n.t > 0 ? -1 : 1;
    } else if (n.feature == EDGE) {
        // It crosses the edge if it leads inwards along one axis and outwards along the other. It is then above the
        // face that it is more parallel to.
        inward &= ~(1 << n.axis);
        int a = (n.axis + 1) % 3, b = (n.axis + 2) % 3;
        int over = FABS(component(h, a)) > FABS(component(h, b)) ? a : b;
        if (is_single(inward)) walls = 1 << n.axis | 1 << over, forward = has(inward, over) ? 1 : -1;
    } else if (n.feature == CORNER && inward != 0 && inward != 7) {
        // One way leads inwards along one axis, the other way along two: along an edge, or across a face.
        if (!is_single(inward)) inward = 7 - inward, forward = -1;
        real along = component(h, inward >> 1);
        walls = inward;
        if (along * along <= (real)0.5 * dot(h, h)) walls = 7 - inward, forward = -forward;
    }
    if (walls == 0) return false;
    real way = 1 - forward * n.t;
#pragma unroll 1
    for (int i = 0; i < 3; i++) {
        if (!has(walls, i)) continue;
        real slope = component(h, i), start = component(n.point, i);
        if (forward * slope < 0) start = -start;
        real room = (component(s, i) - start) / FABS(slope);
        if (room < way && (room > 0 || n.feature != FACE)) way = room;
    }
    t = n.t + forward * way;
    return true;
}

// At most two contacts: of the capsule's spheres at the nearest point of its axis and where the axis leaves the box.
// Whether a rectangle of half sizes (sx, sy) is farther than `reach` from the line through (x, y) along (hx, hy).
FN bool across_edge(real x, real y, real hx, real hy, real sx, real sy, real reach) {
    const real gap = FABS(x * hy - y * hx) - FABS(hy) * sx - FABS(hx) * sy, length = SQRT(hx * hx + hy * hy);
    return gap > (real)1.0001 * reach * length;
}

FN void capsule_box(Hits& hits, real margin, const Geom& capsule, const Geom& box) {
    Mat axes = transposed(box.axes);
    Vec half = capsule.size.y * column(capsule.axes, 2), s = box.size;
    Vec p = axes * (capsule.pos - box.pos), h = axes * half;
    // Most pairs are apart: the box around the capsule's axis, in the axes of the other one, is out of reach.
    Vec apart = magnitudes(p) - magnitudes(h) - s;
    apart = Vec{larger(0, apart.x), larger(0, apart.y), larger(0, apart.z)};
    real reach = capsule.size.x + margin;
    if (!(dot(apart, apart) < reach * reach)) return;  // also if it is not a number
    // Of the others most are apart across the capsule's axis and an edge.
    if (across_edge(p.y, p.z, h.y, h.z, s.y, s.z, reach) || across_edge(p.z, p.x, h.z, h.x, s.z, s.x, reach) ||
        across_edge(p.x, p.y, h.x, h.y, s.x, s.y, reach))
        return;
    Nearest n = nearest_feature(p, h, s);
    if (n.feature == NONE) return;
    real second;
    bool is_along = second_point(n, h, s, second);
#pragma unroll 1
    for (int i = 0; i <= is_along; i++)
        sphere_box(hits, margin, capsule.pos + (i ? second : n.t) * half, capsule.size.x, box);
}

// Directions that may separate two boxes of axes `a` and `b`: the normals of the faces of both, and from 6 on those
// across an edge of each, zero if these are parallel. Source: S. Gottschalk, M. C. Lin, D. Manocha, "OBBTree", SIGGRAPH
// 1996.
FN Vec candidate_axis(const Mat& a, const Mat& b, int k) {
    if (k < 6) return k < 3 ? column(a, k) : column(b, k - 3);
    Vec n = cross(column(a, k / 3 - 2), column(b, k % 3));
    real square = dot(n, n);
    return (square < PARALLEL_EDGES ? 0 : 1 / SQRT(square)) * n;
}

// Corner of a box of half sizes `s` that is farthest in a direction.
FN Vec corner_towards(Vec n, Vec s) {
    return Vec{n.x >= 0 ? s.x : -s.x, n.y >= 0 ? s.y : -s.y, n.z >= 0 ? s.z : -s.z};
}
// An axis perpendicular to `n`, other than axis i; -1 for none.
FN int perpendicular_axis(Vec n, int i) {
    int a = (i + 1) % 3, b = (i + 2) % 3;
    return FABS(component(n, a)) < PERPENDICULAR ? a : FABS(component(n, b)) < PERPENDICULAR ? b : -1;
}

// Contact of an edge of each box, along their axes i and j, `n` being across both: halfway between the nearest points.
FN void edge_contact(Hits& hits, real margin, const Geom& a, const Geom& b, int i, int j, Vec n) {
    Vec d = b.pos - a.pos;
    if (dot(n, d) < 0) n = -1 * n;
    Vec na = transposed(a.axes) * n, nb = transposed(b.axes) * n;
    Vec u = column(a.axes, i), v = column(b.axes, j), uxv = cross(u, v);
    real half_u = component(a.size, i), half_v = component(b.size, j), uv = dot(u, v), det = dot(uxv, uxv);
    // The edges are those farthest along n and against it. Of an axis perpendicular to n either end may be: the nearest
    // edges count.
    int swap_a = perpendicular_axis(na, i), swap_b = perpendicular_axis(nb, j);
    real nearest = (real)1e30, dist = 0;
    Vec middle = d;
#pragma unroll 1
    for (int swapped = 0; swapped < 4; swapped++) {
        if ((has(swapped, 1) && swap_a < 0) || (has(swapped, 0) && swap_b < 0)) continue;
        Vec at = with(corner_towards(na, a.size), i, 0), bt = with(-1 * corner_towards(nb, b.size), j, 0);
        if (has(swapped, 1)) at = with(at, swap_a, -component(at, swap_a));
        if (has(swapped, 0)) bt = with(bt, swap_b, -component(bt, swap_b));
        Vec p = a.axes * at, q = d + b.axes * bt, gap = q - p;
        // Nearest points of two lines, in a form that keeps its digits if they are all but parallel, then of the edges.
        real x = det < (real)1e-15 ? 0 : clamped(dot(cross(gap, v), uxv) / det, -half_u, half_u);
        real y = clamped(uv * x - dot(v, gap), -half_v, half_v);
        x = clamped(dot(u, gap) + uv * y, -half_u, half_u);
        p = p + x * u, q = q + y * v, gap = q - p;
        real square = dot(gap, gap);
        if (square < nearest) nearest = square, dist = dot(gap, n), middle = (real)0.5 * (p + q);
    }
    if (dist < margin) add(hits, dist, a.pos + middle, n, Vec{0, 0, 0});
}

// Clips a convex polygon, the points of the first hits, where `sign` times a coordinate exceeds a limit. Returns its
// number of vertices, one more at most, so that each is read before its place is written. Source: I. E. Sutherland,
// G. W. Hodgman, "Reentrant polygon clipping", Communications of the ACM 17 (1), 1974.
FN int clip(Hits& hits, int count, int coordinate, real sign, real limit) {
    Vec first = hits.hit[0].pos, p = first;
    real over = sign * component(p, coordinate) - limit;
    int kept = 0;
#pragma unroll 1
    for (int k = 1; k <= count; k++) {
        Vec q = k < count ? hits.hit[k].pos : first;
        real over_q = sign * component(q, coordinate) - limit;
        if (over <= 0 && kept < MAX_HITS) hits.hit[kept++].pos = p;
        if (over * over_q < 0 && kept < MAX_HITS) hits.hit[kept++].pos = p + (over / (over - over_q)) * (q - p);
        p = q, over = over_q;
    }
    return kept;
}

// Contacts of a face of one box, along its axis k, with the face of the other that is most opposed to it: the vertices
// of the latter, clipped at the sides of the former. `sign` is 1 if the face is that of the first geom, else -1.
FN void face_contacts(Hits& hits, real margin, const Geom& box, const Geom& other, int k, real sign) {
    int kx = (k + 1) % 3, ky = (k + 2) % 3;
    Vec d = other.pos - box.pos, up = column(box.axes, k);
    if (dot(up, d) < 0) up = -1 * up;
    Mat axes{column(box.axes, kx), column(box.axes, ky), up};  // of the face; its middle is at height `top`
    real x = component(box.size, kx), y = component(box.size, ky), top = component(box.size, k);
    Vec slope = transposed(other.axes) * up, steep = magnitudes(slope);
    int j = steep.y > steep.x ? (steep.z > steep.y ? 2 : 1) : (steep.z > steep.x ? 2 : 0);
    int ju = (j + 1) % 3, jv = (j + 2) % 3;
    real out = component(slope, j) > 0 ? -component(other.size, j) : component(other.size, j);
    Vec middle = axes * (d + out * column(other.axes, j)) - Vec{0, 0, top};
    Vec u = component(other.size, ju) * (axes * column(other.axes, ju));
    Vec v = component(other.size, jv) * (axes * column(other.axes, jv));
    hits.hit[0].pos = middle + u + v, hits.hit[1].pos = middle - u + v;
    hits.hit[2].pos = middle - u - v, hits.hit[3].pos = middle + u - v;
    int count = 4;
#pragma unroll 1
    for (int side = 0; side < 4; side++) count = clip(hits, count, side >> 1, side & 1 ? -1 : 1, side < 2 ? x : y);
    // Vertices in reach, each once: clipping at a corner may give it twice.
    real same = SAME_VERTEX * (x * x + y * y);
#pragma unroll 1
    for (int i = 0; i < count; i++) {
        Vec p = hits.hit[i].pos;
        bool is_new = p.z < margin;
        for (int n = 0; n < hits.count && is_new; n++) {
            Vec gap = with(p - hits.hit[n].pos, 2, 0);
            is_new = dot(gap, gap) >= same;
        }
        if (is_new) hits.hit[hits.count++].pos = p;
    }
#pragma unroll 1
    for (int i = 0; i < hits.count; i++) {
        Hit& h = hits.hit[i];
        Vec p = h.pos;
        h.dist = p.z, h.normal = sign * up, h.along = Vec{0, 0, 0};
        h.pos = box.pos + p.x * axes.r0 + p.y * axes.r1 + (top + (real)0.5 * p.z) * up;  // halfway between the surfaces
    }
}

// At most eight contacts: of two faces, or one of two edges, whichever are the least deep in each other.
FN void box_box(Hits& hits, real margin, const Geom& a, const Geom& b) {
    Vec d = b.pos - a.pos;
    real reach = margin + SQRT(dot(a.size, a.size)) + SQRT(dot(b.size, b.size));
    if (!(dot(d, d) < reach * reach)) return;  // most pairs are apart; also if it is not a number
    Mat to_a = transposed(a.axes), to_b = transposed(b.axes);
    Vec sizes = a.size + b.size;
    real best = (real)-1e30, best_face = best, apart = margin + GAP_SLACK * (sizes.x + sizes.y + sizes.z);
    int axis = 0, face = 0;
#pragma unroll 1
    for (int k = 0; k < 15; k++) {
        Vec n = candidate_axis(a.axes, b.axes, k);
        if (dot(n, n) == 0) continue;
        real gap = FABS(dot(n, d)) - dot(a.size, magnitudes(to_a * n)) - dot(b.size, magnitudes(to_b * n));
        if (gap > apart) return;
        // Of equal ones a face is better: its several points hold a body more steadily than one of two edges.
        if (gap - (k < 6 ? 0 : (real)1e-6) * FABS(gap) > best) best = gap, axis = k;
        if (k < 6) face = axis, best_face = best;
    }
    if (axis >= 6) {
        // Nor should edges that are all but in the best face take turns with it while a body rests.
        Vec n = candidate_axis(a.axes, b.axes, axis);
        bool is_face = FABS(dot(n, candidate_axis(a.axes, b.axes, face))) > (real)0.99 &&
                       best < best_face + (real)0.05 * FABS(best_face) + (real)1e-15;
        if (!is_face) {
            edge_contact(hits, margin, a, b, axis / 3 - 2, axis % 3, n);
            return;
        }
    }
    Geom box = a, other = b;
    if (face >= 3) box = b, other = a;
    face_contacts(hits, margin, box, other, face % 3, face < 3 ? 1 : -1);
}

}  // namespace fused
