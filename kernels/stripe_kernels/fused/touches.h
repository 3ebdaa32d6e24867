// SPDX-License-Identifier: Apache-2.0
// Touches: the search for the touches of several parts, in height fields and in meshes, by all lanes of a world.

#if HAS_SEARCHES
namespace fused {

// The touch of a candidate, if it is one; the first hit is that of lowest order.
ONE_COPY bool touch(const Search& s, int candidate, Touch& hit, real& order) {
#if HAS_MESHES
    if (s.mesh) {
#if SEARCHES_BOXES
        if (s.kind == BOX_PART) return edge_in_box(s, candidate, hit, order);
#endif
        return s.kind == AXIS_PART ? edge_touch(s, candidate, hit, order) : face_touch(s, candidate, hit, order);
    }
    hit.geom = -1;
#endif
#if HAS_FIELDS
#if SEARCHES_BOXES
    if (s.kind == BOX_PART) return box_touch(s, candidate, hit, order);
#endif
    return s.kind == BALL_PART ? ball_touch(s, candidate, hit, order) : ridge_touch(s, candidate, hit, order);
#else
    return false;
#endif
}

// Whether a touch is still one beside the hits that there are, and then its order.
FN bool remains(const Search& s, const Touch& hit, real& order) {
    if (s.ended) return false;
    if (!s.count) return true;
#if HAS_MESHES
    if (s.mesh) return remains_on_mesh(s, hit, order);
#endif
    return s.kind == BALL_PART ? is_above_planes(s, hit.pos) : is_apart(s, hit.pos);
}

// Make a touch the next hit.
FN void accept(Search& s, const Touch& hit) {
#if HAS_MESHES
    if (s.mesh && s.kind == BALL_PART) s.inside = hit.dist < -s.radius;
    if (hit.dist >= s.reach) {  // it only told that the centre is outside
        s.ended = true;
        return;
    }
#endif
    s.hit[s.count++] = hit;
    s.ended = s.inside || s.count == s.most;
}

// Hits of the first `count` searches, nearest first; at most as many searches as there are lanes.
FN void find_hits(Search* searches, int count, int lane) {
    int all = 0, own = -1, k = 0;
    Touch hit;
    real order;
    for (bool first = true;; first = false) {
        if (first || all > LANES) {  // candidates, of all searches that have not ended
            int before = 0, mine = 0;
            if (lane < count) mine = searches[lane].ended ? 0 : searches[lane].size;
            all = mine;
            BEFORE(mine, before, all);
            if (lane < count) searches[lane].start = before;
            k = 0;
        }
        if (lane < count) expect(searches[lane]);
        SYNC();
        if (all == 0) break;
        if (all <= LANES) {  // each lane keeps the touch of its candidate
            if (own < 0 && lane < all) {
                while (k + 1 < count && searches[k + 1].start <= lane) k++;  // the last that starts there: those before are empty
                own = lane - searches[k].start;
                if (!touch(searches[k], own, hit, order)) own = -2;
            }
            bool offers = own >= 0 && remains(searches[k], hit, order);
            if (offers) offer(searches[k], order, own);
            SYNC();
            if (offers && taken(searches[k]) == own) accept(searches[k], hit);
            SYNC();
            bool goes_on = lane < count && !searches[lane].ended && taken(searches[lane]) >= 0;
            if (lane < count) searches[lane].ended = !goes_on;
            if (!ANY(goes_on)) break;
        } else {
            for (int c = lane; c < all; c += LANES) {
                while (k + 1 < count && searches[k + 1].start <= c) k++;
                const int candidate = c - searches[k].start;
                if (touch(searches[k], candidate, hit, order) && remains(searches[k], hit, order))
                    offer(searches[k], order, candidate);
            }
            SYNC();
            if (lane < count && !searches[lane].ended) {
                Search& s = searches[lane];
                const int candidate = taken(s);
                s.ended = candidate < 0;
                if (candidate >= 0) touch(s, candidate, hit, order), accept(s, hit);
            }
            SYNC();
        }
    }
}

// A hit in the axes of the world, halfway between the two surfaces.
FN Hit to_world(const Touch& h, const Geom& ground, const Geom& geom) {
    return Hit{h.dist, geom.pos + ground.axes * (h.pos + ((real)0.5 * h.dist) * h.normal), ground.axes * h.normal, {0, 0, 0}};
}

}  // namespace fused
#endif
