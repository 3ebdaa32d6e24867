// SPDX-License-Identifier: Apache-2.0
// Collision: the contacts of pairs of primitives that the model lets collide, and the frames and parameters of all contacts.

namespace fused {

// Radius of the ball around a geom, with some room for rounding.
FN real radius_of(int shape, Vec size) {
    real radius = 0;
    if (shape == BALL_SHAPE) radius = size.x;
    if (shape == CAPSULE_SHAPE) radius = size.x + size.y;
    if (shape == CYLINDER_SHAPE) radius = SQRT(size.x * size.x + size.y * size.y);
    if (shape == BOX_SHAPE) radius = SQRT(dot(size, size));
    if (shape == ELLIPSOID_SHAPE) radius = larger(size.x, larger(size.y, size.z));
    return (real)1.0001 * radius;
}

FN void place_geoms(World& w, const Parameters& P, int lane) {
    EACH(i, NGEOMS) {
        Geom o = geom_of(w, P, used_geom(i));
        store(w.geoms + 12 * i, o.pos), store_matrix(w.geoms + 12 * i + 3, o.axes);
        store(w.balls + 4 * i, o.pos), w.balls[4 * i + 3] = radius_of(geom_shape(i), o.size) + P.geom_margin()[used_geom(i)];
    }
    SYNC();
}

// The same of all contacts, of which those of `given` come last.
FN void complete_contacts(World& w, const Parameters& P, const real* given, int count, int lane) {
    EACH(c, count) {
        real* C = contact(w, c);
        if (C[C_PAIR] >= 0) {
            complete_contact(C, P);
            continue;
        }
        const real* G = given + GIVEN_SIZE * (-1 - (int)C[C_PAIR]);
        int b1 = geom_body((int)G[G_GEOM]), b2 = geom_body((int)G[G_GEOM + 1]);
        store(C + C_POS, load(G + G_POS) - origin_of(w, b1, b2));
        store(C + C_NORMAL, load(G + G_FRAME)), store(C + C_TANGENT, load(G + G_FRAME + 3));
        Material m;
        for (int i = 0; i < 2; i++) m.solref[i] = G[G_SOLREF + i], m.solreffriction[i] = G[G_SOLREF_FRICTION + i];
        for (int i = 0; i < 5; i++) m.solimp[i] = G[G_SOLIMP + i], C[C_FRICTION + i] = G[G_FRICTION + i];
        C[C_DIST] = G[G_DIST], C[C_DIM] = G[G_DIM], C[C_BODY] = b1, C[C_BODY + 1] = b2;
        set_coefficients(C, P, m, G[G_DIST] - G[G_MARGIN]);
    }
    SYNC();
}

// Write a contact of pair `p`, if there is room for it.
FN void place_contact(World& w, int c, int p, const Hit& hit, int geom = -1) {
    if (c < MAX_CONTACTS) set_hit(contact(w, c), p, hit, geom);
}

// Contacts of a pair of primitives in each lane, -1 for none, behind the first `count` ones. Returns the number of all.
FN int collide_pairs(World& w, const Parameters& P, int p, int count, int lane) {
    Hits hits;
    hits.count = 0;
    if (p >= 0 && has_both(P, p)) {
        PairGeoms g = geoms_of(w, P, p);
        primitive_hits(hits, p, margin_of(P, p), g.a, g.b);
    }
    int before = 0, all = hits.count;
    BEFORE(hits.count, before, all);
    ROLLED for (int i = 0; i < hits.count; i++) place_contact(w, count + before + i, p, hits.hit[i]);
    return count + all;
}

#if GEOMS_PLACED
// Whether the balls around two geoms touch, or that around the second one a plane. `near_test` has of each pair the places of
// its geoms among those that are used, in 12 bits each, and how they are compared.
FN bool may_touch(const World& w, int p) {
    const int test = near_test(p), a = test & 4095, b = test >> 12 & 4095;
    if (test & ALWAYS_NEAR) return true;
    const Four first = ((const Four*)w.balls)[a], second = ((const Four*)w.balls)[b];
    Vec d{second.x[0] - first.x[0], second.x[1] - first.x[1], second.x[2] - first.x[2]};
    const real reach = first.x[3] + second.x[3];
    if (test & IN_TREES) d = d + (origin_of(w, geom_body(contact_geom2(p))) - origin_of(w, geom_body(contact_geom1(p))));
    if (test & ON_PLANE) return dot(column(load_matrix(w.geoms + 12 * a + 3), 2), d) < reach;
    return reach > 0 && dot(d, d) < reach * reach;
}

// Contacts of primitives, in the order of the pairs. Returns their number. Most pairs are apart: those that may touch are
// listed, and looked at by as many lanes.
FN int collide_primitives(World& w, const Parameters& P, int lane) {
    int count = 0, listed = 0;
    ROLLED for (int first = 0; first < FIRST_HULL_PAIR; first += LANES) {
        const int p = first + lane;
        const bool near = p < FIRST_HULL_PAIR && may_touch(w, p);
        int before, all;
        RANK(near, before, all);
        if (near) w.near_pairs[listed + before] = (unsigned short)p;
        listed += all;
        const bool is_last = first + LANES >= FIRST_HULL_PAIR;
        SYNC();
        ROLLED while (listed >= LANES || (is_last && listed > 0)) {
            count = collide_pairs(w, P, lane < listed ? w.near_pairs[lane] : -1, count, lane);
            const unsigned short next = w.near_pairs[LANES + lane];
            SYNC();
            w.near_pairs[lane] = next, listed -= LANES;
            SYNC();
        }
    }
    return count;
}
#else
// Contacts of primitives, in the order of the pairs. Returns their number.
FN int collide_primitives(World& w, const Parameters& P, int lane) {
    int count = 0;
    for (int first = 0; first < FIRST_HULL_PAIR; first += LANES)
        count = collide_pairs(w, P, first + lane < FIRST_HULL_PAIR ? first + lane : -1, count, lane);
    return count;
}
#endif

#if HAS_HULLS
// The first geom of a pair of hulls, in the axes of the second one; of a ball the box around it and its margin.
FN Polytope first_polytope(const Hull* hulls, const Parameters& P, int p, const PairGeoms& g) {
    const int number = contact_hull(2 * p);
    const Mat to_second = transposed(g.b.axes), from_first = transposed(g.a.axes);
    const Mat axes{from_first * to_second.r0, from_first * to_second.r1, from_first * to_second.r2};
    const Vec ball = (g.a.size.x + margin_of(P, p)) * Vec{1, 1, 1};
    const Vec scale = contact_kind(p) == SPHERE_HULL ? ball : number ? Vec{1, 1, 1} : g.a.size;
    return Polytope{hulls[number], scale, axes, to_second * (g.a.pos - g.b.pos)};
}

// Contacts of hulls behind the first `count` ones, in the order of the pairs. A lane finds those with a plane or a curved geom; all
// lanes look at balls, boxes and hulls that are near, one pair after another. Returns the number of all contacts.
FN int collide_hulls(World& w, const Parameters& P, int count, int lane) {
    const Hull* hulls = (const Hull*)P.m.hulls;
    ROLLED for (int first = FIRST_HULL_PAIR; first < FIRST_SEARCHED_PAIR; first += LANES) {
        const int p = first + lane;
        const bool is_pair = p < FIRST_SEARCHED_PAIR && has_both(P, p);
        Hits hits;
        Overlap own;
        hits.count = 0, own.found = false;
        bool near = false;
        if (is_pair) {
            const PairGeoms g = geoms_of(w, P, p);
            const Hull& second = hulls[contact_hull(2 * p + 1)];
            if (contact_kind(p) == PLANE_HULL) plane_hull(hits, margin_of(P, p), g.a, g.b, second);
#if HAS_CURVED
            else if (contact_kind(p) == CAPSULE_HULL || contact_kind(p) == ELLIPSOID_HULL || contact_kind(p) == CYLINDER_HULL) {
                const int shape = geom_shape(contact_geoms(2 * p));
                curved_hull(hits, margin_of(P, p), shape, g.a, radius_of(shape, g.a.size), g.b, second);
            }
#endif
            else near = are_near(first_polytope(hulls, P, p, g), second);
        }
        ROLLED for (unsigned votes = BALLOT(near); votes; votes &= votes - 1) {
            const int k = first_lane(votes), q = first + k;
            const PairGeoms g = geoms_of(w, P, q);
            const Polytope a = first_polytope(hulls, P, q, g);
            const Hull& second = hulls[contact_hull(2 * q + 1)];
            Overlap overlap;
            if (contact_kind(q) == SPHERE_HULL) overlap = ball_overlap(a.pos, g.a.size.x, margin_of(P, q), second, lane);
            else overlap = overlap_of(a, second, lane);
            if (k == lane) own = overlap;
        }
        if (own.found) {
            const PairGeoms g = geoms_of(w, P, p);
            const Polytope a = first_polytope(hulls, P, p, g);
            if (contact_kind(p) != SPHERE_HULL) hull_hits(hits, own, a, hulls[contact_hull(2 * p + 1)]);
            else add(hits, own.dist, a.pos + (g.a.size.x + (real)0.5 * own.dist) * own.normal, own.normal, Vec{0, 0, 0});
            for (int i = 0; i < hits.count; i++) {
                Hit& h = hits.hit[i];
                h.pos = g.b.pos + g.b.axes * h.pos, h.normal = g.b.axes * h.normal;
            }
        }
        int before = 0, all = hits.count;
        BEFORE(hits.count, before, all);
        ROLLED for (int i = 0; i < hits.count; i++) place_contact(w, count + before + i, p, hits.hit[i]);
        count += all;
    }
    return count;
}
#endif

}  // namespace fused
