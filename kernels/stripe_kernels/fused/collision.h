// SPDX-License-Identifier: Apache-2.0
// Collision: the contacts of pairs of primitives that the model lets collide, and the frames and parameters of all contacts.

namespace fused {

FN void place_geoms(World& w, const Parameters& P, int lane) {
    EACH(i, NGEOMS) {
        Geom o = geom_of(w, P, used_geom(i));
        store(w.geoms + 12 * i, o.pos), store_matrix(w.geoms + 12 * i + 3, o.axes);
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

// Contacts of primitives, in the order of the pairs. Returns their number.
FN int collide_primitives(World& w, const Parameters& P, int lane) {
    int count = 0;
    for (int first = 0; first < FIRST_SEARCHED_PAIR; first += LANES) {
        int p = first + lane;
        Hits hits;
        hits.count = 0;
        if (p < FIRST_SEARCHED_PAIR && has_both(P, p)) {
            PairGeoms g = geoms_of(w, P, p);
            primitive_hits(hits, p, margin_of(P, p), g.a, g.b);
        }
        int before = 0, all = hits.count;
        BEFORE(hits.count, before, all);
        ROLLED for (int i = 0; i < hits.count; i++) place_contact(w, count + before + i, p, hits.hit[i]);
        count += all;
    }
    return count;
}

}  // namespace fused
