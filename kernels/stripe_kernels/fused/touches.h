// SPDX-License-Identifier: Apache-2.0
// Touches: the search for the touches of several parts, in height fields and in meshes, by all lanes of a world.

#if HAS_SEARCHES
namespace fused {

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

// Hits of the first `count` searches, nearest first; at most as many searches as there are lanes.
FN void find_hits(Search* searches, int count, int lane) {
    for (;;) {
        int before = 0, all = 0, mine = 0;
        if (lane < count) {
            mine = searches[lane].ended ? 0 : searches[lane].size;
            expect(searches[lane]);
        }
        all = mine;
        BEFORE(mine, before, all);
        if (lane < count) searches[lane].start = before;
        SYNC();
        if (all == 0) break;
        int k = 0;
        for (int c = lane; c < all; c += LANES) {
            while (k + 1 < count && searches[k + 1].start <= c) k++;  // the last that starts there: those before are empty
            Touch hit;
            real order;
            if (touch(searches[k], c - searches[k].start, hit, order)) offer(searches[k], order, c - searches[k].start);
        }
        SYNC();
        if (lane < count && !searches[lane].ended) {
            Search& s = searches[lane];
            int candidate = taken(s);
            real order;
            if (candidate >= 0) {
                Touch hit;
                touch(s, candidate, hit, order);
#if HAS_MESHES
                if (s.mesh && s.kind == BALL_PART) s.inside = hit.dist < -s.radius;
                if (hit.dist >= s.reach) candidate = -1;  // it only told that the centre is outside
                else
#endif
                    s.hit[s.count++] = hit;
            }
            s.ended = candidate < 0 || s.inside || s.count == s.most;
        }
        SYNC();
    }
}

// A hit in the axes of the world, halfway between the two surfaces.
FN Hit to_world(const Touch& h, const Geom& ground, const Geom& geom) {
    return Hit{h.dist, geom.pos + ground.axes * (h.pos + ((real)0.5 * h.dist) * h.normal), ground.axes * h.normal, {0, 0, 0}};
}

}  // namespace fused
#endif
