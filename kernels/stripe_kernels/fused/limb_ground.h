// SPDX-License-Identifier: Apache-2.0
// Limb ground: geoms on height fields and meshes in the form for a hub with limbs, and a thread's search for their contacts.

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

// Whether the geom of a pair may touch the ground with its faces, and with its edges.
FN Near near_ground(const OnGround& o, const Parameters& P, int p) {
    const Cover c = cover(o.geom, ground_part(p));
    const real reach = c.radius + larger(margin_of(P, p), 0) + (real)1e-5;  // more than rounding
#if HAS_MESHES
    if (is_mesh_pair(p)) return near_mesh(mesh_of(P, p).clearance, o.axes, o.at, c, reach);
#endif
#if HAS_FIELDS
    const bool near = is_near_field(patch_of(o, P, p), o.axes, c, reach);
    return Near{near, near, near, near};
#else
    return Near{true, true, true, true};
#endif
}

// Prepare the search of the part of a pair, of which the geom is near; it has no candidates if nothing is near.
FN void prepare(Search& s, const OnGround& o, const Parameters& P, int p) {
    const int part = ground_part(p);
    s.pair = p, s.count = 0, s.ended = false, s.size = 0;
#if HAS_MESHES
    if (is_mesh_pair(p)) {
        prepare(s, kind_of(part), end_of(part), margin_of(P, p), mesh_of(P, p), o.at, o.axes, o.geom);
        return;
    }
#endif
#if HAS_FIELDS
    s.on_plane = false;
    prepare(s, kind_of(part), end_of(part), margin_of(P, p), patch_of(o, P, p), o.axes, o.geom);
#endif
}

#if HAS_MESHES
// The touch of a part with the plane that its search has as candidates, if it is one.
FN bool touches_plane(const Search& s, Touch& hit, const Parameters& P) {
    return plane_touch(s, face_at(mesh_of(P, s.pair).faces, s.first), hit);
}
#endif

// A hit of a geom on its ground, in the world: halfway between the two surfaces.
FN Hit in_world(const Touch& h, const Mat& ground_axes, Vec geom_pos) {
    return Hit{h.dist, geom_pos + ground_axes * (h.pos + ((real)0.5 * h.dist) * h.normal), ground_axes * h.normal, {0, 0, 0}};
}

#if !WARP_SEARCHES
// Take the hits of a part, nearest first. Most parts touch once or not at all, so that a round computes the touches of all
// candidates again rather than keep them; `touch` gives that of a candidate.
template <class Touches>
FN void take_hits(Search& s, Found* found, Touches touch) {
    bool far = false;  // faces are told that a ball is in front of and does not touch: asked for if it is behind another one
    while (s.size && !s.ended) {
        int touches = 0;
        real outside = (real)1e30;  // order of the nearest of those
        Touch best;
        expect(s);
        for (int c = 0; c < s.size; c++) {
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
        if (taken(s) < 0) break;
#if HAS_MESHES
        if (is_mesh_pair(s.pair) && s.kind == BALL_PART && s.count == 0 && best.dist < -s.radius) {
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
    hits.count = s.count;
    for (int i = 0; i < s.count; i++) {
        const Touch& h = found[i].touch;
        hits.hit[i] = in_world(h, transposed(o.axes), o.geom.pos);
#if HAS_MESHES
        geoms[i] = h.geom < 0 ? contact_geom1(s.pair) : h.geom;
#endif
    }
}

// Hits of the part of a pair, and the geoms of meshes.
FN void ground_hits(Hits& hits, int* geoms, const OnGround& o, const Parameters& P, int p) {
    Search s;
    Found found[4];
    prepare(s, o, P, p);
#if HAS_MESHES
    if (s.on_plane) {
        s.ended = true;
        if (touches_plane(s, found[0].touch, P)) s.hit[0] = 0, s.count = 1;
    }
#endif
    take_hits(s, found, [&](int c, bool far, Touch& hit, real& order) {
        const auto box = [&] { return box_in(o.axes, o.geom); };
#if HAS_MESHES
        if (is_mesh_pair(p)) return mesh_touch(s, mesh_of(P, p), thing_of(s, mesh_of(P, p), c), box, far, hit, order);
        hit.geom = -1;
#endif
#if HAS_FIELDS
        return field_touch(s, patch_of(o, P, p), c, box, hit, order);
#else
        return false;
#endif
    });
    to_world(hits, geoms, s, found, o);
}
#endif

#endif

}  // namespace fused
