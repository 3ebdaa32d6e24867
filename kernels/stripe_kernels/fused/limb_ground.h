// SPDX-License-Identifier: Apache-2.0
// Limb ground: contacts with height fields and meshes in the form for a hub with limbs, in which a lane searches by itself.

namespace fused {

FN bool is_on_mesh(int p) { return HAS_MESHES && contact_kind(p) >= MESH_SPHERE; }

#if HAS_SEARCHES
// A geom on its ground, a height field or meshes: both in the axes of the ground.
struct OnGround {
    Mat axes;  // whose rows are those of the ground
    Vec at;    // where the geom is in the frame of the ground
    Geom geom;
};
FN OnGround on_ground(const Geom& ground, const Geom& geom) {
    const Mat axes = transposed(ground.axes);
    return OnGround{axes, axes * (geom.pos - ground.pos), geom};
}

#if HAS_FIELDS
FN Patch patch_of(const OnGround& o, const Parameters& P, int p) { return patch_at(field_of(P, contact_geom1(p)), o.at); }
#endif
#if HAS_MESHES
FN const Mesh& mesh_of(const Parameters& P, int p) { return ((const Mesh*)P.m.meshes)[contact_mesh(p)]; }
#endif

// Whether the geom of a pair may touch its ground.
FN bool is_near(const OnGround& o, const Parameters& P, int p) {
    const Cover c = cover(o.geom, ground_part(p));
    const real reach = c.radius + larger(margin_of(P, p), 0) + (real)1e-5;  // more than rounding
#if HAS_MESHES
    if (is_on_mesh(p)) return is_near_mesh(mesh_of(P, p).clearance, o.axes, o.at, c, reach);
#endif
#if HAS_FIELDS
    return is_near_field(patch_of(o, P, p), o.axes, c, reach);
#else
    return true;
#endif
}

// Prepare the search of the part of a pair, of which the geom is near; it has no candidates if nothing is near.
FN void prepare(Search& s, const OnGround& o, const Parameters& P, int p) {
    const int part = ground_part(p);
    s.pair = p, s.count = 0, s.ended = false, s.size = 0;
#if HAS_MESHES
    if (is_on_mesh(p)) {
        const Mesh& mesh = mesh_of(P, p);
        if (is_part_near_mesh(mesh.clearance, o.axes, o.at, o.geom, part, margin_of(P, p)))
            prepare(s, kind_of(part), end_of(part), margin_of(P, p), mesh, o.at, o.axes, o.geom);
        return;
    }
#endif
#if HAS_FIELDS
    prepare(s, kind_of(part), end_of(part), margin_of(P, p), patch_of(o, P, p), o.axes, o.geom);
#endif
}

// A lane that searches alone.
struct OneLane {
    enum { FIRST = 0, STEP = 1 };
    FN_METHOD void agree(Search&, Touch&, int&, real&) const {}
};

#if WARP_SEARCHES
// Words of something that the lane `from` of the warp has.
template <class T>
FN T heard(const T& x, int from) {
    static_assert(sizeof(T) % 4 == 0, "whole words");
    T y;
    UNROLLED for (int i = 0; i < (int)(sizeof(T) / 4); i++)
        ((unsigned*)&y)[i] = __shfl_sync(0xffffffffu, ((const unsigned*)&x)[i], from, 32);
    return y;
}
// All lanes of a warp, which search together: candidates are shared out, and all end up with the same hits.
struct WholeWarp {
    int FIRST;
    enum { STEP = 32 };
    FN_METHOD void agree(Search& s, Touch& best, int& touches, real& outside) const {
        real order = s.best < 0 ? (real)1e30 : s.order;
        int taken = s.best < 0 ? 0x7fffffff : s.best;
        ROLLED for (int mask = 16; mask; mask /= 2) {
            const real other = __shfl_xor_sync(0xffffffffu, order, mask, 32);
            const int its = __shfl_xor_sync(0xffffffffu, taken, mask, 32);
            if (other < order || (other == order && its < taken)) order = other, taken = its;
            touches += __shfl_xor_sync(0xffffffffu, touches, mask, 32);
            outside = smaller(outside, __shfl_xor_sync(0xffffffffu, outside, mask, 32));
        }
        s.best = taken == 0x7fffffff ? -1 : taken, s.order = order;
        best = heard(best, taken % 32);
    }
};
#endif

// Take the hits of a part, nearest first. Most parts touch once or not at all, so that a round computes the touches of all
// candidates again rather than keep them; `touch` gives that of a candidate.
template <class Lanes, class Touches>
FN void take_hits(Search& s, Found* found, const Lanes& lanes, Touches touch) {
    bool far = false;  // faces are told that a ball is in front of and does not touch: asked for if it is behind another one
    ROLLED while (s.size && !s.ended) {
        int touches = 0;
        real outside = (real)1e30;  // order of the nearest of those
        Touch best;
        expect(s);
        ROLLED for (int c = lanes.FIRST; c < s.size; c += lanes.STEP) {
            Touch hit;
            real order;
            if (!touch(c, far, hit, order)) continue;
            if (far && hit.dist >= s.reach) {
                outside = smaller(outside, order);
                continue;
            }
            touches++;
            if (!remains(s, found, hit, order)) continue;
            if (s.best < 0 || order < s.order) best = hit;
            offer(s, order, c);
        }
        lanes.agree(s, best, touches, outside);
        if (taken(s) < 0) break;
#if HAS_MESHES
        if (is_on_mesh(s.pair) && s.kind == BALL_PART && s.count == 0 && best.dist < -s.radius) {
            if (far && s.order >= outside) break;
            far = !far;
            if (far) continue;
        }
#endif
        found[s.count].touch = best;
        accept(s, s.count, best);
        if (touches == s.count) break;
    }
}

// The hits of a search, in the world.
FN void to_world(Hits& hits, int* geoms, const Search& s, const Found* found, const OnGround& o) {
    const Mat axes = transposed(o.axes);
    hits.count = s.count;
    ROLLED for (int i = 0; i < s.count; i++) {
        const Touch& h = found[i].touch;
        hits.hit[i] = Hit{h.dist, o.geom.pos + axes * (h.pos + ((real)0.5 * h.dist) * h.normal), axes * h.normal, {0, 0, 0}};
#if HAS_MESHES
        geoms[i] = h.geom < 0 ? contact_geom1(s.pair) : h.geom;
#endif
    }
}

// Hits of the part of a pair by one lane, and the geoms of meshes. With more than MANY candidates it has none, and returns false:
// all lanes are to look at them.
enum { MANY = 10 };
FN bool ground_hits(Hits& hits, int* geoms, const OnGround& o, const Parameters& P, int p, bool alone) {
    Search s;
    Found found[4];
    prepare(s, o, P, p);
    hits.count = 0;
#if HAS_MESHES
    if (!alone && s.size > MANY && is_on_mesh(p)) return false;
#endif
    take_hits(s, found, OneLane(), [&](int c, bool far, Touch& hit, real& order) {
        const auto box = [&] { return box_in(o.axes, o.geom); };
#if HAS_MESHES
        if (is_on_mesh(p)) return mesh_touch(s, mesh_of(P, p), c, box, far, hit, order);
        hit.geom = -1;
#endif
#if HAS_FIELDS
        return field_touch(s, patch_of(o, P, p), c, box, hit, order);
#else
        return false;
#endif
    });
    to_world(hits, geoms, s, found, o);
    return true;
}

#if WARP_SEARCHES
// The same of a part of the lane `from` by all lanes of the warp, each of which calls it. Only that lane gets the hits.
COLD void ground_hits_of_warp(Hits& hits, int* geoms, const Mesh* meshes, const Search& given, const OnGround& o, int lane, int from) {
    Search s = heard(given, from);
    Found found[4];
    Box box;
    if (s.kind == BOX_PART) box = heard(box_in(o.axes, o.geom), from);
    const Mesh& mesh = meshes[contact_mesh(s.pair)];
    take_hits(s, found, WholeWarp{lane}, [&](int c, bool far, Touch& hit, real& order) {
        return mesh_touch(s, mesh, c, [&] { return box; }, far, hit, order);
    });
    hits.count = 0;
    if (lane == from) to_world(hits, geoms, s, found, o);
}
#endif
#endif

}  // namespace fused
