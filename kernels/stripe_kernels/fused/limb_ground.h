// SPDX-License-Identifier: Apache-2.0
// Limb ground: contacts with height fields in the form for a hub with limbs, in which a lane searches by itself.

#if HAS_FIELDS
namespace fused {

// A geom over a height field: both in the axes of the field.
struct OnField {
    Patch patch;
    Mat axes;  // whose rows are those of the field
    Geom geom;
};
FN OnField on_field(const Parameters& P, int p, const PairGeoms& g) {
    const Mat axes = transposed(g.a.axes);
    return OnField{patch_at(field_of(P, contact_geom1(p)), axes * (g.b.pos - g.a.pos)), axes, g.b};
}
FN bool is_near(const OnField& o, const Parameters& P, int p) {
    const Cover c = cover(o.geom, ground_part(p));
    return is_near_field(o.patch, o.axes, c, c.radius + larger(margin_of(P, p), 0) + (real)1e-5);  // more than rounding
}

// Hits of the part of the pair `p`, nearest first. Most parts touch once or not at all, so that a round computes the touches of
// all candidates again rather than keep them.
FN void field_hits(Hits& hits, const OnField& o, const Parameters& P, int p, const Mat& to_world_axes) {
    const int part = ground_part(p);
    Search s;
    Found found[4];
    s.pair = p, s.count = 0, s.ended = false;
    prepare(s, kind_of(part), end_of(part), margin_of(P, p), o.patch, o.axes, o.geom);
    hits.count = 0;
    ROLLED while (s.size) {
        int touches = 0;
        Touch best;
        expect(s);
        ROLLED for (int c = 0; c < s.size; c++) {
            Touch hit;
            real order;
            if (!field_touch(s, o.patch, c, [&] { return box_in(o.axes, o.geom); }, hit, order)) continue;
            touches++;
            if (s.count && !(s.kind == BALL_PART ? is_above_planes(s, found, hit.pos) : is_apart(s, found, hit.pos))) continue;
            if (s.best < 0 || order < s.order) best = hit;
            offer(s, order, c);
        }
        if (taken(s) < 0) break;
        found[s.count].touch = best, s.hit[s.count] = s.count, s.count++;
        hits.hit[hits.count++] = Hit{best.dist, o.geom.pos + to_world_axes * (best.pos + ((real)0.5 * best.dist) * best.normal),
                                     to_world_axes * best.normal, {0, 0, 0}};
        if (s.inside || s.count == s.most || touches == s.count) break;
    }
}

}  // namespace fused
#endif
