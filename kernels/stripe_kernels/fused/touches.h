// SPDX-License-Identifier: Apache-2.0
// Touches: the search for the touches of several parts, in height fields and in meshes, by all lanes of a world.

#if HAS_SEARCHES
namespace fused {

#if SEARCHES_BOXES
// The box of a search for touches of one, behind its hits.
FN Box& box_of(World& w, const Search& s) { return *(Box*)(w.hits + s.place + s.most); }
FN const Box& box_of(const World& w, const Search& s) { return *(const Box*)(w.hits + s.place + s.most); }
#endif

// The touch of a candidate, if it is one; the first hit is that of lowest order. Of the parameters it gets one address: all of
// them would have to lie in memory for a function that is not inlined.
ONE_COPY bool touch(World& world, const Mesh* meshes, const Search& s, int candidate, Touch& hit, real& order) {
    const World& w = in_place(world);
#if HAS_MESHES
    if (contact_kind(s.pair) >= MESH_SPHERE) {
        const Mesh& mesh = meshes[contact_mesh(s.pair)];
#if SEARCHES_BOXES
        if (s.kind == BOX_PART) return edge_in_box(s, mesh.edges, box_of(w, s), candidate, hit, order);
#endif
        return s.kind == AXIS_PART ? edge_touch(s, mesh.edges, candidate, hit, order)
                                   : face_touch(s, mesh.faces, candidate, hit, order);
    }
    hit.geom = -1;
#endif
#if HAS_FIELDS
    const Patch p = patch_of(w, s.pair, s.geom);
#if SEARCHES_BOXES
    if (s.kind == BOX_PART) return box_touch(s, p, box_of(w, s), candidate, hit, order);
#endif
    return s.kind == BALL_PART ? ball_touch(s, p, candidate, hit, order) : ridge_touch(s, p, candidate, hit, order);
#else
    return false;
#endif
}

// Whether a touch is still one beside the hits that there are, and then its order.
FN bool remains(const World& w, const Search& s, const Touch& hit, real& order) {
    const Touch* hits = w.hits + s.place;
    if (s.ended) return false;
    if (!s.count) return true;
#if HAS_MESHES
    if (contact_kind(s.pair) >= MESH_SPHERE) return remains_on_mesh(s, hits, hit, order);
#endif
    return s.kind == BALL_PART ? is_above_planes(s, hits, hit.pos) : is_apart(s, hits, hit.pos);
}

// Make a touch the next hit.
FN void accept(World& w, Search& s, const Touch& hit) {
#if HAS_MESHES
    if (contact_kind(s.pair) >= MESH_SPHERE) {
        if (s.kind == BALL_PART) s.inside = hit.dist < -s.radius;
        if (hit.dist >= s.reach) {  // it only told that the centre is outside
            s.ended = true;
            return;
        }
    }
#endif
    w.hits[s.place + s.count++] = hit;
    s.ended = s.inside || s.count == s.most;
}

// The last search that starts at a candidate or before it, from `k` on: those that start there and are not the last are empty.
FN int search_of(const World& w, int count, int candidate, int k) {
    while (k + 1 < count && w.search[k + 1].start <= candidate) k++;
    return k;
}

// Candidates of all searches that have not ended: sets where those of each start. Returns their number.
FN int count_candidates(World& w, int count, int lane) {
    int mine = lane < count && !w.search[lane].ended ? w.search[lane].size : 0, before = 0, all = mine;
    BEFORE(mine, before, all);
    if (lane < count) w.search[lane].start = before;
    SYNC();
    return all;
}

#if LANES > 1
// Find the candidates that are touches, among more than there are lanes. Returns that of this lane, -1 if it has none, or -2 in
// all lanes if there are more.
FN int own_touch(World& w, const Mesh* meshes, int count, int all, int lane) {
    int found = 0, k = 0;
    for (int first = 0; first < all; first += LANES) {
        const int c = first + lane;
        bool is_touch = false;
        if (c < all) {
            Touch hit;
            real order;
            k = search_of(w, count, c, k);
            is_touch = touch(w, meshes, w.search[k], c - w.search[k].start, hit, order);
        }
        unsigned votes = BALLOT(is_touch);
        int place = found + __popc(votes & ((1u << lane) - 1));
        if (is_touch && place < LANES) w.touches[place] = c;
        found += __popc(votes);
    }
    SYNC();
    return found > LANES ? -2 : lane < found ? w.touches[lane] : -1;
}

// Hits of searches of which each lane has a candidate, -1 for none: it keeps the touch of it.
FN void take_own_touches(World& w, const Mesh* meshes, int count, int candidate, int lane) {
    Touch hit;
    real order = 0;
    int k = 0, own = -1;
    if (candidate >= 0) {
        k = search_of(w, count, candidate, 0), own = candidate - w.search[k].start;
        if (!touch(w, meshes, w.search[k], own, hit, order)) own = -1;
    }
    for (;;) {
        if (lane < count) expect(w.search[lane]);
        SYNC();
        bool offers = own >= 0 && remains(w, w.search[k], hit, order);
        if (offers) offer(w.search[k], order, own);
        SYNC();
        if (offers && taken(w.search[k]) == own) accept(w, w.search[k], hit);
        SYNC();
        bool goes_on = lane < count && !w.search[lane].ended && taken(w.search[lane]) >= 0;
        if (lane < count) w.search[lane].ended = !goes_on;
        if (!ANY(goes_on)) break;
    }
}
#endif

// Hits of searches with more touches than lanes, or of a lane alone: each round computes them again.
COLD void take_touches(World& world, const Mesh* meshes, int count, int all, int lane) {
    World& w = in_place(world);
    while (all) {
        if (lane < count) expect(w.search[lane]);
        SYNC();
        for (int c = lane, k = 0; c < all; c += LANES) {
            k = search_of(w, count, c, k);
            Search& s = w.search[k];
            Touch hit;
            real order;
            const int candidate = c - s.start;
            if (touch(w, meshes, s, candidate, hit, order) && remains(w, s, hit, order)) offer(s, order, candidate);
        }
        SYNC();
        if (lane < count && !w.search[lane].ended) {
            Search& s = w.search[lane];
            Touch hit;
            real order;
            const int candidate = taken(s);
            s.ended = candidate < 0;
            if (candidate >= 0) touch(w, meshes, s, candidate, hit, order), accept(w, s, hit);
        }
        SYNC();
        all = count_candidates(w, count, lane);
    }
}

// Hits of the first `count` searches, nearest first; at most as many searches as there are lanes.
FN void find_hits(World& w, const Mesh* meshes, int count, int lane) {
    const int all = count_candidates(w, count, lane);
#if LANES > 1
    int candidate = lane < all ? lane : -1;
    if (all > LANES) candidate = own_touch(w, meshes, count, all, lane);
    if (candidate != -2) {
        take_own_touches(w, meshes, count, candidate, lane);
        return;
    }
#endif
    take_touches(w, meshes, count, all, lane);
}

// A hit in the axes of the world, halfway between the two surfaces.
FN Hit to_world(const Touch& h, const Geom& ground, const Geom& geom) {
    return Hit{h.dist, geom.pos + ground.axes * (h.pos + ((real)0.5 * h.dist) * h.normal), ground.axes * h.normal, {0, 0, 0}};
}

}  // namespace fused
#endif
