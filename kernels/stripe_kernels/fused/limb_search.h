// SPDX-License-Identifier: Apache-2.0
// Limb search: contacts of limbs on a GPU, where the lanes of a warp search for touches on height fields and meshes together.
//
// Robots differ in what is near them, and a warp takes as long as its busiest lane. So a lane only finds out which geoms of its
// limb are near, and touches planes: of most robots nothing else is near. The triangles near the other parts of those geoms are
// shared out over the lanes of the warp: first those are left out whose bounds are not in reach, as there may be hundreds around a
// round table's foot. The touches of the others are listed, so that the rounds after the first look at them alone. A lane takes the
// hits of its limb in the order of their parts, so that neither their number nor their order depends on the other lanes.
//
// All of a step's code should stay in a multiprocessor's cache for instructions, 128 KB: what does not is fetched again in each
// step of a launch. So each piece of this code is there once.

#if WARP_SEARCHES
namespace fused {

struct Kept {
    Touch touch;
};
// A candidate: the number of its search, and of what may touch: a face or edge of meshes, or a piece of a height field.
struct Candidate {
    unsigned search : 5, number : 27;
};
static_assert(MOST_SEARCHES <= 32, "number of a search");
// What the lanes of a warp share.
struct alignas(16) WarpSearches {
    unsigned long long best[MOST_SEARCHES];  // order and number of the best candidate of a round
    unsigned long long own[32];              // of each lane: the searches for its pairs
    Search search[MOST_SEARCHES];
    Kept found[MOST_SEARCHES][4];            // hits; behind them that of the best candidate of a round
    unsigned outside[MOST_SEARCHES];         // order of the nearest face that a ball is in front of and does not touch
    int touches[MOST_SEARCHES];
    unsigned short part[MOST_SEARCHES];      // see `PartOfLane`
    bool far[MOST_SEARCHES];                 // whether such faces are asked for
    bool is_listed[MOST_SEARCHES];           // whether all its touches are listed
    int count;                               // searches, of which there may be more than places
    int num_listed;                          // touches, of which there may be more than places
    Candidate touching[MOST_LISTED];         // those of a round that has more are found again in the next one
    Candidate queue[64];                     // candidates that may touch
};
static_assert(sizeof(WarpSearches) <= 4 * WARP_SEARCHES_SIZE, "size of WarpSearches");

FN WarpSearches& warp_searches() {
    extern __shared__ char dynamic_smem_base[];
    return ((WarpSearches*)(dynamic_smem_base + sizeof(Tables) + WORLDS_PER_BLOCK * sizeof(World)))[threadIdx.x / 32];
}

// A part that a lane of the warp has found near: its number among the pairs of the lane's limb.
struct PartOfLane {
    int lane, number;
};
FN unsigned short packed(PartOfLane p) { return (unsigned short)(p.lane << 8 | p.number); }
FN PartOfLane unpacked(unsigned short x) { return PartOfLane{x >> 8, x & 255}; }

// The world of a lane of the warp, and its parameters.
FN World& world_of(int lane) {
    extern __shared__ char dynamic_smem_base[];
    return ((World*)(dynamic_smem_base + sizeof(Tables)))[(threadIdx.x / 32 * 32 + lane) / LANES];
}
FN Parameters parameters_of(const Parameters& P, int lane) {
    return Parameters{P.m, P.id + (lane / LANES - (int)(threadIdx.x % 32) / LANES), P.num_worlds};
}
// Lanes of the warp, without those of worlds that are missing.
FN int lanes_of_warp(const Parameters& P) {
    const int worlds = P.num_worlds - (P.id - (int)(threadIdx.x % 32) / LANES);
    return worlds < 32 / LANES ? worlds * LANES : 32;
}

// A hit of a limb's pair.
struct PairHit {
    Hit hit;
    int geom;
    short pair;
    unsigned char number;  // of the pair among those of the limb
};
// Contacts of a limb that have been found so far.
struct PairHits {
    PairHit* hits;
    int count, overflow;
};
// Add a hit behind those of the same pair and the pairs before it.
ONE_COPY void add(PairHits& found, const PairHit& hit) {
    if (found.count == LIMB_CONTACTS) {
        found.overflow |= OVERFLOW_CONTACTS;
        return;
    }
    int i = found.count++;
    ROLLED for (; i && found.hits[i - 1].number > hit.number; i--) found.hits[i] = found.hits[i - 1];
    found.hits[i] = hit;
}
// Add a hit of the geom at `pos` on its ground.
FN void add_touch(PairHits& found, const Touch& h, const Mat& ground_axes, Vec pos, int p, int number) {
#if HAS_MESHES
    const int geom = h.geom < 0 ? contact_geom1(p) : h.geom;
#else
    const int geom = contact_geom1(p);
#endif
    add(found, PairHit{in_world(h, ground_axes, pos), geom, (short)p, (unsigned char)number});
}

// Hits of a pair of primitives, of which `own` moves.
FN void add_primitive(PairHits& found, const World& w, const Parameters& P, int p, int number, const Geom& own, int g) {
    const int a = contact_geom1(p);
    const bool is_plane = contact_kind(p) <= PLANE_CYLINDER, is_first = g == a;
    const Geom still = is_plane ? plane_of(w, p) : static_geom(w, P, is_first ? contact_geom2(p) : a, geom_body(g));
    if (!is_plane && are_far(still, own, margin_of(P, p))) return;
    if (!has_both(P, p)) return;
    Hits hits;
    primitive_hits(hits, p, margin_of(P, p), is_first ? own : still, is_first ? still : own);
    ROLLED for (int i = 0; i < hits.count; i++) add(found, PairHit{hits.hit[i], a, (short)p, (unsigned char)number});
}

// Look at those of a limb's pairs that are asked for, geom by geom: add the hits of primitives, and of what is near a plane alone,
// and prepare the searches for other parts that are near a ground. Returns the pairs of those for which there is no place.
FN unsigned long long look_at_geoms(PairHits& found, WarpSearches& all, const World& w, const Parameters& P, int slot,
                                    unsigned long long asked) {
    unsigned long long without_place = 0;
    const int first = limb_pair_start(slot), end = limb_geom_start(slot + 1);
    ROLLED for (int k = limb_geom_start(slot); k < end; k++) {
        const int g = limb_geom(k), begin = limb_geom_pair(k), searched = limb_geom_search(k), last = limb_geom_pair(k + 1);
        if (asked >> (begin - first) << (64 - (last - begin)) == 0) continue;
        const Geom own = geom_of(w, P, g);
        ROLLED for (int t = begin; t < searched; t++)
            if (asked >> (t - first) & 1) add_primitive(found, w, P, limb_pair(t), t - first, own, g);
        ROLLED for (int t = searched, parts; t < last; t += parts) {
            const int p = limb_pair(t);
            parts = limb_parts(t);
            if (!has_both(P, p)) continue;
            const Geom ground = ground_of(w, P, p, geom_body(g));
            const OnGround o = on_ground(ground, own);
            const Near near = near_ground(o, P, p);
            if (!near.faces && !near.edges) continue;
            ROLLED for (int i = t; i < t + parts; i++) {
                const int q = limb_pair(i);
                if (!is_part_near(near, ground_part(q)) || !(asked >> (i - first) & 1)) continue;
                Search s;
                prepare(s, o, P, q);
                if (s.size == 0) continue;
#if HAS_MESHES
                if (s.on_plane) {
                    Touch hit;
                    if (touches_plane(s, hit, P)) add_touch(found, hit, ground.axes, own.pos, q, i - first);
                    continue;
                }
#endif
                s.pos = own.pos;
                const int place = atomicAdd(&all.count, 1);
                if (place < MOST_SEARCHES) {
                    all.search[place] = s, all.part[place] = packed(PartOfLane{(int)(threadIdx.x % 32), i - first});
                    all.far[place] = all.is_listed[place] = false;
                } else
                    without_place |= 1ull << (i - first);
            }
        }
    }
    return without_place;
}

// A number of the same order as a real one.
FN unsigned in_order(real x) {
    const unsigned bits = __float_as_uint(x);
    return bits ^ (bits >> 31 ? 0xffffffffu : 0x80000000u);
}

// The touch of a candidate of a search for a part of the lane `lane` of the warp.
FN bool touch_of(const Search& s, const Parameters& P, int lane, int thing, bool far, Touch& hit, real& order) {
    const int p = s.pair;
    const auto box = [&] {
        const World& w = world_of(lane);
        const Parameters Q = parameters_of(P, lane);
        const int g = contact_geom2(p);
        return box_in(transposed(ground_of(w, Q, p, geom_body(g)).axes), geom_of(w, Q, g));
    };
#if HAS_MESHES
    if (is_mesh_pair(p)) return mesh_touch(s, mesh_of(P, p), thing, box, far, hit, order);
    hit.geom = -1;
#endif
#if HAS_FIELDS
    return field_touch(s, patch_at(field_of(P, contact_geom1(p)), s.geom), thing, box, hit, order);
#else
    return false;
#endif
}

// A candidate of a search as what may touch. Returns whether its bounds are in reach.
FN bool may_touch(unsigned& thing, const Search& s, const Parameters& P, int candidate, bool far) {
    thing = candidate;
#if HAS_MESHES
    if (is_mesh_pair(s.pair)) {
        const Mesh& mesh = mesh_of(P, s.pair);
        thing = thing_of(s, mesh, candidate);
        return may_touch(s, mesh, thing, far);
    }
#endif
    return true;
}

// Number the candidates of all searches that go on and whose touches are not listed, and begin a round of all that go on.
// Returns the number of candidates.
FN int begin_round(WarpSearches& all, int count, int lane, int lanes) {
    int total = 0;
    ROLLED for (int first = 0; first < count; first += lanes) {
        const int k = first + lane;
        const int mine = k < count && !all.search[k].ended && !all.is_listed[k] ? all.search[k].size : 0;
        int sum = mine;
        ROLLED for (int by = 1; by < 32; by *= 2) {
            const int other = __shfl_up_sync(0xffffffffu, sum, by, 32);
            if (lane >= by) sum += other;
        }
        if (k < count) all.search[k].start = total + sum - mine, all.best[k] = ~0ull, all.outside[k] = ~0u, all.touches[k] = 0;
        total += __shfl_sync(0xffffffffu, sum, lanes - 1, 32);
    }
    SYNC_WARP();
    return total;
}

// The touch of a candidate, if it is one that remains beside the hits of its search, which keeps the best. Returns its key, which
// is least for the best.
FN unsigned long long offer(WarpSearches& all, const Parameters& P, Candidate c, Touch& hit) {
    const int k = c.search;
    const Search& s = all.search[k];
    const bool far = all.far[k];
    real order;
    if (!touch_of(s, P, unpacked(all.part[k]).lane, c.number, far, hit, order)) return ~0ull;
    if (far && hit.dist >= s.reach) {
        atomicMin(&all.outside[k], in_order(order));
        return ~0ull;
    }
    atomicAdd(&all.touches[k], 1);
    if (!all.is_listed[k]) {
        const int place = atomicAdd(&all.num_listed, 1);
        if (place < MOST_LISTED) all.touching[place] = c;
    }
    if (!remains(s, all.found[k], hit, order)) return ~0ull;
    const unsigned long long key = (unsigned long long)in_order(order) << 32 | c.number;
    atomicMin(&all.best[k], key);
    return key;
}

// Find the touches of a round: of all candidates, which are numbered, and of those that are listed.
FN void find_touches(WarpSearches& all, const Parameters& P, int count, int candidates, int lane, int lanes) {
    const int listed = all.num_listed < MOST_LISTED ? all.num_listed : MOST_LISTED, end = candidates + listed;
    int first = 0, queued = 0, k = 0;
    SYNC_WARP();
    ROLLED for (;;) {
        ROLLED while (queued < lanes && first < end) {
            const int i = first + lane;
            Candidate c{0, 0};
            bool is_one = false;
            if (i < candidates) {
                while (k + 1 < count && all.search[k + 1].start <= i) k++;  // the last that starts there: those before are empty
                unsigned thing;
                is_one = may_touch(thing, all.search[k], P, i - all.search[k].start, all.far[k]);
                c = Candidate{(unsigned)k, thing};
            } else if (i < end) {
                c = all.touching[i - candidates];
                is_one = all.is_listed[c.search] && !all.search[c.search].ended;
            }
            const unsigned votes = __ballot_sync(0xffffffffu, is_one);
            if (is_one) all.queue[queued + __popc(votes & (1u << lane) - 1)] = c;
            queued += __popc(votes), first += lanes;
            SYNC_WARP();
        }
        if (!queued) break;
        const int taken = queued < lanes ? queued : lanes;
        queued -= taken;
        const Candidate c = all.queue[queued + (lane < taken ? lane : 0)];
        Touch hit;
        const unsigned long long key = lane < taken ? offer(all, P, c, hit) : ~0ull;
        SYNC_WARP();
        if (key != ~0ull && all.best[c.search] == key) all.found[c.search][all.search[c.search].count].touch = hit;
        SYNC_WARP();
    }
}

// Make the best candidate of a round the next hit of its search.
FN void take_best(WarpSearches& all, int k) {
    Search& s = all.search[k];
    if (all.best[k] == ~0ull) {
        s.ended = true;
        return;
    }
    const Touch hit = all.found[k][s.count].touch;
#if HAS_MESHES
    // Faces that a ball is in front of and does not touch are asked for if it is behind another one.
    if (is_mesh_pair(s.pair) && s.kind == BALL_PART && s.count == 0 && hit.dist < -s.radius) {
        if (all.far[k] && (unsigned)(all.best[k] >> 32) >= all.outside[k]) {
            s.ended = true;
            return;
        }
        all.far[k] = !all.far[k];
        if (all.far[k]) {
            all.is_listed[k] = false;
            return;
        }
    }
#endif
    accept(s, s.count, hit);
    if (all.touches[k] == s.count) s.ended = true;
}

// Find the hits of some searches, and add each to those of the lane that it belongs to.
FN void find_hits(PairHits& found, WarpSearches& all, const World& w, const Parameters& P, int count, int lane, int lanes) {
    all.own[lane] = 0;
    if (lane == 0) all.num_listed = 0;
    bool goes_on = true;
    ROLLED while (goes_on) {
        const int candidates = begin_round(all, count, lane, lanes);
        find_touches(all, P, count, candidates, lane, lanes);
        const bool has_room = all.num_listed <= MOST_LISTED;
        goes_on = false;
        SYNC_WARP();
        ROLLED for (int k = lane; k < count; k += lanes) {
            if (all.search[k].ended) continue;
            all.is_listed[k] = all.is_listed[k] || has_room;
            take_best(all, k);
            goes_on = goes_on || !all.search[k].ended;
        }
        if (lane == 0 && !has_room) all.num_listed = MOST_LISTED;
        goes_on = any_in_warp(goes_on);
    }
    ROLLED for (int k = lane; k < count; k += lanes)
        if (all.search[k].count) atomicOr(&all.own[unpacked(all.part[k]).lane], 1ull << k);
    SYNC_WARP();
    ROLLED for (unsigned long long own = all.own[lane]; own; own &= own - 1) {
        const int k = __ffsll(own) - 1;
        const Search& s = all.search[k];
        const Mat axes = ground_of(w, P, s.pair, geom_body(contact_geom2(s.pair))).axes;
        ROLLED for (int i = 0; i < s.count; i++)
            add_touch(found, all.found[k][i].touch, axes, s.pos, s.pair, unpacked(all.part[k]).number);
    }
    SYNC_WARP();
}

// Contacts of a slot. Returns their number.
FN int limb_contacts(LimbContact* contacts, const World& w, const Parameters& P, const Limb& L, int slot, int& rows, int& overflow) {
    const int lane = threadIdx.x % 32, lanes = lanes_of_warp(P);
    PairHit hits[LIMB_CONTACTS ? LIMB_CONTACTS : 1];
    PairHits found{hits, 0, 0};
    WarpSearches& all = warp_searches();
    unsigned long long asked = ~0ull;
    ROLLED do {
        if (lane == 0) all.count = 0;
        SYNC_WARP();
        asked = look_at_geoms(found, all, w, P, slot, asked);
        SYNC_WARP();
        const int count = all.count < MOST_SEARCHES ? all.count : MOST_SEARCHES;
        if (count) find_hits(found, all, w, P, count, lane, lanes);
    } while (any_in_warp(asked != 0));
    overflow |= found.overflow;
    ROLLED for (int c = 0; c < found.count; c++) {
        set_contact(contacts[c], w, P, L, slot, hits[c].pair, hits[c].geom, hits[c].hit);
        rows += contacts[c].rows;
    }
    return found.count;
}

}  // namespace fused
#endif
