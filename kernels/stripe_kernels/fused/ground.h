// SPDX-License-Identifier: Apache-2.0
// Ground: contacts with height fields and meshes. Geoms that are far from their ground are left out first, then parts of the
// others are searched for touches.

namespace fused {

#if HAS_SEARCHES
// Whether a geom may touch its ground: by the distance to the nearest face, or by the highest vertex below it.
FN bool is_near(const World& w, const Parameters& P, int p) {
    if (!has_both(P, p)) return false;
    PairGeoms g = geoms_of(w, P, p);
    const Mat axes = transposed(g.a.axes);
    const Vec at = axes * (g.b.pos - g.a.pos);
    const Cover c = cover(g.b, ground_part(p));
    const real reach = c.radius + larger(margin_of(P, p), 0) + (real)1e-5;  // more than rounding
#if HAS_MESHES
    if (contact_kind(p) >= MESH_SPHERE) {
        return near_mesh(sources_of(P).meshes[contact_mesh(p)].clearance, axes, at, c, reach).faces;
    }
#endif
#if HAS_FIELDS
    return is_near_field(patch_of(w, p, at), axes, c, reach);
#else
    return true;
#endif
}

#if HAS_MESHES
// Whether a part of a geom that is near its ground is near itself.
FN bool is_part_near(const World& w, const Parameters& P, int p) {
    if (contact_kind(p) < MESH_SPHERE) return true;
    const PairGeoms g = geoms_of(w, P, p);
    const Mat axes = transposed(g.a.axes);
    const Clearance& field = sources_of(P).meshes[contact_mesh(p)].clearance;
    return is_part_near_mesh(field, axes, axes * (g.b.pos - g.a.pos), g.b, ground_part(p), margin_of(P, p));
}
#endif

// List the parts of geoms that are near their ground, in the order of the pairs. Returns their number.
FN int list_near_parts(World& w, const Parameters& P, int lane) {
    ROLLED for (int first = 0; first < NSEARCHED_GEOMS; first += LANES) {
        int k = first + lane;
        bool near = k < NSEARCHED_GEOMS && is_near(w, P, searched_geom_pair(k));
        unsigned votes = BALLOT(near);
        if (lane == 0) w.near_geoms[first / LANES] = votes;
    }
    SYNC();
    int count = 0;
    ROLLED for (int first = FIRST_SEARCHED_PAIR; first < NCONTACT_PAIRS; first += LANES) {
        int p = first + lane, before, more;
        bool near = false;
        if (p < NCONTACT_PAIRS) {
            int k = searched_geom(p - FIRST_SEARCHED_PAIR);
            near = w.near_geoms[k / LANES] >> k % LANES & 1;
#if HAS_MESHES
            near = near && is_part_near(w, P, p);
#endif
        }
        RANK(near, before, more);
        if (near) w.near_parts[count + before] = p;
        count += more;
    }
    SYNC();
    return count;
}

// Prepare the search for touches of the part of a pair; it has no candidates if nothing is near.
FN void prepare(Search& s, const World& w, const Parameters& P, int p) {
    const int k = ground_part(p);
    const PairGeoms g = geoms_of(w, P, p);
    const Mat axes = transposed(g.a.axes);
    const Vec at = axes * (g.b.pos - g.a.pos);
    const PartKind is = kind_of(k);
    const int end = end_of(k);
    s.pair = p, s.count = 0, s.ended = false;
#if HAS_MESHES
    if (contact_kind(p) >= MESH_SPHERE) {
        prepare(s, is, end, margin_of(P, p), sources_of(P).meshes[contact_mesh(p)], at, axes, g.b);
        return;
    }
#endif
#if HAS_FIELDS
    prepare(s, is, end, margin_of(P, p), patch_of(w, p, at), axes, g.b);
#endif
}

// Contacts with height fields and meshes behind the first `count` ones, in the order of the parts. Returns the number of all.
FN int collide_by_search(World& w, const Parameters& P, int count, int lane) {
#if HAS_FIELDS
    EACH(f, NFIELDS) w.patches[f] = patch_at(field_of(P, ground_geom(f)), Vec{0, 0, 0});
    SYNC();
#endif
    const int parts = list_near_parts(w, P, lane);
    ROLLED for (int first = 0; first < parts; first += SEARCHES) {
        const int size = parts - first < SEARCHES ? parts - first : SEARCHES;
        SYNC();  // the last ones have been read
        if (lane < size) prepare(w.search[lane], w, P, w.near_parts[first + lane]);
        SYNC();
        for (int done = 0, some; done < size; done += some) {
            some = find_hits(w, sources_of(P), done, size - done, lane);
            const int mine = lane < some ? w.search[done + lane].count : 0;
            int before = 0, all = mine;
            BEFORE(mine, before, all);
            ROLLED for (int i = 0; i < mine; i++) {
                const Search& s = w.search[done + lane];
                const Touch& hit = w.found[s.hit[i]].touch;
                PairGeoms g = geoms_of(w, P, s.pair);
#if HAS_MESHES
                const int geom = hit.geom;
#else
                const int geom = -1;
#endif
                place_contact(w, count + before + i, s.pair, to_world(hit, g.a, g.b), geom);
            }
            count += all;
            SYNC();
        }
    }
    return count;
}
#endif

// Contacts of all pairs. Returns their number, which may exceed the room for them.
FN int collide(World& w, const Parameters& P, int lane) {
    if (GEOMS_PLACED) place_geoms(w, P, lane);
    int count = collide_primitives(w, P, lane);
#if HAS_HULLS
    count = collide_hulls(w, P, count, lane);
#endif
#if HAS_SEARCHES
    count = collide_by_search(w, P, count, lane);
#endif
    SYNC();
    return count;
}

}  // namespace fused
