// SPDX-License-Identifier: Apache-2.0
// Touches: the search for the touches of several parts, in height fields and in meshes, by all lanes of a world.

#if HAS_SEARCHES
namespace fused {

// What a search reads beside the world. It is no part of the parameters, all of which the compiler would keep in memory for a
// function that is not inlined.
struct Sources {
    const Mesh* meshes;
    const real* geom_size;
};
FN Sources sources_of(const Parameters& P) {
#if HAS_MESHES
    return Sources{(const Mesh*)P.m.meshes, P.geom_size()};
#else
    return Sources{nullptr, P.geom_size()};
#endif
}

// The box of a search; geoms have been placed.
FN Box box_of(const World& w, const Sources& from, int pair) {
    const real *ground = w.geoms + 12 * contact_geoms(2 * pair), *geom = w.geoms + 12 * contact_geoms(2 * pair + 1);
    const Vec size = load(from.geom_size + 3 * contact_geom2(pair));
    return box_in(transposed(load_matrix(ground + 3)), Geom{{0, 0, 0}, load_matrix(geom + 3), size});
}

// The touch of a candidate, if it is one; the first hit is that of lowest order.
FN bool touch(const World& w, const Sources& from, const Search& s, int candidate, Touch& hit, real& order) {
#if HAS_MESHES
    if (contact_kind(s.pair) >= MESH_SPHERE) {
        const Mesh& mesh = from.meshes[contact_mesh(s.pair)];
        return mesh_touch(s, mesh, thing_of(s, mesh, candidate), [&] { return box_of(w, from, s.pair); }, true, hit, order);
    }
    hit.geom = -1;
#endif
#if HAS_FIELDS
    return field_touch(s, patch_of(w, s.pair, s.geom), candidate, [&] { return box_of(w, from, s.pair); }, hit, order);
#else
    return false;
#endif
}

// List the candidates of some searches that touch, in order. Returns their number; if that exceeds the room for them, not all
// have been looked at, and `w.complete` is the number of the searches before the one with the first touch without a place.
//
// A face that only tells that a ball's centre is outside, as it is in front of it and farther away than what touches, needs no
// place: the nearest of them does, by its order alone.
FN int list_touches(World& w, const Sources& from, Search* searches, int count, int all, int lane) {
    int found = 0, k = 0;
    ROLLED for (int first = 0; first < all && found <= TOUCHES; first += LANES) {
        const int c = first + lane;
        bool is_touch = false;
        int before, more;
        Found own;
        if (c < all) {
            while (k + 1 < count && searches[k + 1].start <= c) k++;  // the last that starts there: those before are empty
            own.search = k;
            is_touch = touch(w, from, searches[k], c - searches[k].start, own.touch, own.order);
#if HAS_MESHES
            if (is_touch && searches[k].kind == BALL_PART && own.touch.dist >= searches[k].reach)
                offer(searches[k], own.order, c), is_touch = false;
#endif
        }
        RANK(is_touch, before, more);
        if (is_touch && found + before < TOUCHES) w.found[found + before] = own;
        if (is_touch && found + before == TOUCHES) w.complete = own.search;
        found += more;
    }
    SYNC();
    return found;
}

// Hits of some searches, of which all touches are listed, nearest first; a search for each lane at most. There may be touches
// of later searches behind theirs.
FN void take_hits(World& w, Search* searches, int count, int found, int lane) {
    if (lane < count) keep_outside(searches[lane]);
    for (;;) {
        if (lane < count) expect(searches[lane]);
        SYNC();
        EACH(i, found) {
            const Found& f = w.found[i];
            if (f.search >= count) continue;
            Search& s = searches[f.search];
            real order = f.order;
            if (remains(s, w.found, f.touch, order)) offer(s, order, i);
        }
        SYNC();
        bool goes_on = false;
        if (lane < count && !searches[lane].ended) {
            Search& s = searches[lane];
            const int best = taken(s);
            if (best < 0 || (s.count == 0 && is_behind_outside(s))) s.ended = true;
            else accept(s, best, w.found[best].touch);
            goes_on = !s.ended;
        }
        SYNC();
        if (!ANY(goes_on)) break;
    }
}

// Hits of a search with more touches than there is room for: each round computes them again.
COLD void take_hits_of_many(World& world, Sources from, int number, int lane) {
    World& w = in_place(world);
    Search& s = w.search[number];
    while (!s.ended) {
        SYNC();
        if (lane == 0) expect(s);
        SYNC();
        EACH(c, s.size) {
            Touch hit;
            real order;
            if (touch(w, from, s, c, hit, order) && remains(s, w.found, hit, order)) offer(s, order, c);
        }
        SYNC();
        if (lane == 0) {
            const int best = taken(s), number = s.count;
            if (best < 0) s.ended = true;
            else {
                touch(w, from, s, best, w.found[number].touch, w.found[number].order);
                accept(s, number, w.found[number].touch);
            }
        }
        SYNC();
    }
}

// Find the hits of some searches, from number `first` on. Returns how many have them now: all, or the first ones if there is no
// room for the touches of all.
FN int find_hits(World& w, const Sources& from, int first, int count, int lane) {
    Search* searches = w.search + first;
    int mine = lane < count ? searches[lane].size : 0, before = 0, all = mine;
    BEFORE(mine, before, all);
    if (lane < count) searches[lane].start = before, expect(searches[lane]);
    SYNC();
    int found = list_touches(w, from, searches, count, all, lane);
    if (found > TOUCHES) count = w.complete, found = TOUCHES;
    if (count == 0) {
        SYNC();
        take_hits_of_many(w, from, first, lane);
        return 1;
    }
    take_hits(w, searches, count, found, lane);
    return count;
}

// A hit in the axes of the world, halfway between the two surfaces.
FN Hit to_world(const Touch& h, const Geom& ground, const Geom& geom) {
    return Hit{h.dist, geom.pos + ground.axes * (h.pos + ((real)0.5 * h.dist) * h.normal), ground.axes * h.normal, {0, 0, 0}};
}

}  // namespace fused
#endif
