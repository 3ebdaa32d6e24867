// SPDX-License-Identifier: Apache-2.0
// Boxes: contacts of capsules with boxes. Each routine finds what MuJoCo's of the same name finds (engine_collision_box.c
// of MuJoCo), in the same order, as those of primitives.h do.
//
// Vectors in the axes of a box are indexed by selection: an array with an index that is not a constant would lie in the
// local memory of a GPU. Loops of few passes are not unrolled, as few pairs are so near that they run.

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
        // It crosses the edge if it leads inwards along one axis and outwards along the other. It is then above the face
        // that it is more parallel to.
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
FN void capsule_box(Hits& hits, real margin, const Geom& capsule, const Geom& box) {
    Mat axes = transposed(box.axes);
    Vec half = capsule.size.y * column(capsule.axes, 2), s = box.size;
    Vec p = axes * (capsule.pos - box.pos), h = axes * half;
    // Most pairs are apart: the box around the capsule's axis, in the axes of the other one, is out of reach.
    Vec apart = magnitudes(p) - magnitudes(h) - s;
    apart = Vec{larger(0, apart.x), larger(0, apart.y), larger(0, apart.z)};
    real reach = capsule.size.x + margin;
    if (!(dot(apart, apart) < reach * reach)) return;  // also if it is not a number
    Nearest n = nearest_feature(p, h, s);
    if (n.feature == NONE) return;
    real second;
    bool is_along = second_point(n, h, s, second);
#pragma unroll 1
    for (int i = 0; i <= is_along; i++)
        sphere_box(hits, margin, capsule.pos + (i ? second : n.t) * half, capsule.size.x, box);
}

}  // namespace fused
