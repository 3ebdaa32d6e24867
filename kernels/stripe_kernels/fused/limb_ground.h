// SPDX-License-Identifier: Apache-2.0
// Limb ground: contacts with height fields and meshes in the form for a hub with limbs, in which a lane searches by itself.

#if HAS_SEARCHES
namespace fused {

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
FN bool is_on_mesh(int p) { return !HAS_FIELDS || contact_kind(p) >= MESH_SPHERE; }
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

// The touch of a candidate, see touches.h and `face_touch`.
FN bool touch(const Search& s, const OnGround& o, const Parameters& P, int candidate, bool far, Touch& hit, real& order) {
    const auto box = [&] { return box_in(o.axes, o.geom); };
#if HAS_MESHES
    if (is_on_mesh(s.pair)) return mesh_touch(s, mesh_of(P, s.pair), candidate, box, far, hit, order);
    hit.geom = -1;
#endif
#if HAS_FIELDS
    return field_touch(s, patch_of(o, P, s.pair), candidate, box, hit, order);
#else
    return false;
#endif
}

#if HAS_MESHES
// Order of the nearest face that a ball's centre is in front of and that it does not touch. It is asked for only where the centre
// is behind a face, as it seldom is.
FN real order_of_outside(const Search& s, const OnGround& o, const Parameters& P) {
    real least = (real)1e30;
    ROLLED for (int c = 0; c < s.size; c++) {
        Touch hit;
        real order;
        if (touch(s, o, P, c, true, hit, order) && hit.dist >= s.reach) least = smaller(least, order);
    }
    return least;
}
#endif

// Hits of the part of the pair `p`, nearest first, and the geoms of the meshes. Most parts touch once or not at all, so that a
// round computes the touches of all candidates again rather than keep them.
FN void ground_hits(Hits& hits, int* geoms, const OnGround& o, const Parameters& P, int p) {
    Search s;
    Found found[4];
    const Mat to_world = transposed(o.axes);
    prepare(s, o, P, p);
    hits.count = 0;
    ROLLED while (s.size && !s.ended) {
        int touches = 0;
        Touch best;
        expect(s);
        ROLLED for (int c = 0; c < s.size; c++) {
            Touch hit;
            real order;
            if (!touch(s, o, P, c, false, hit, order)) continue;
            touches++;
            if (!remains(s, found, hit, order)) continue;
            if (s.best < 0 || order < s.order) best = hit;
            offer(s, order, c);
        }
        if (taken(s) < 0) break;
#if HAS_MESHES
        if (is_on_mesh(p) && s.kind == BALL_PART && s.count == 0 && best.dist < -s.radius && order_of_outside(s, o, P) <= s.order) break;
        geoms[s.count] = best.geom;
#endif
        found[s.count].touch = best;
        accept(s, s.count, best);
        hits.hit[hits.count++] = Hit{best.dist, o.geom.pos + to_world * (best.pos + ((real)0.5 * best.dist) * best.normal),
                                     to_world * best.normal, {0, 0, 0}};
        if (touches == s.count) break;
    }
}

}  // namespace fused
#endif
