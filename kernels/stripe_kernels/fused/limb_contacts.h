// SPDX-License-Identifier: Apache-2.0
// Limb contacts: those of limbs, and of the hub, with what does not move. Each belongs to the lane of its limb; those of the
// hub are shared out.

namespace fused {

// A contact of a slot, from what collision detection found of the pair `p`.
FN void set_contact(LimbContact& o, const World& w, const Parameters& P, const Limb& L, int slot, int p, const Hit& hit) {
    real C[CONTACT_SIZE];
    set_hit(C, p, hit);
    complete_contact(C, P);
    const int b1 = (int)C[C_BODY], b2 = (int)C[C_BODY + 1];
    const bool second = body_dofs(b2) != 0;  // which of the bodies moves
    const int b = second ? b2 : b1;
    Vec n = load(C + C_NORMAL), t = load(C + C_TANGENT), frame[3] = {n, t, cross(n, t)};
    Vec at = load(C + C_POS) + (origin_of(w, b1, b2) - origin_of(w, b));
    if (!second)
        for (int k = 0; k < 3; k++) frame[k] = -1 * frame[k];
    real e[3] = {0, 0, 0}, v[3] = {0, 0, 0};
    UNROLLED for (int c = 0; c < COLUMNS; c++) {
        const bool of_hub = c < NH;
        const int d = of_hub ? 0 : c - NH;
        if (!of_hub && d >= limb_size(slot)) {
            for (int k = 0; k < 3; k++) o.J[k][c] = 0;
            continue;
        }
        const int i = of_hub ? hub_dof(c) : limb_dof(slot * LD + d);
        Spatial s = of_hub ? hub_motion(w, c) : L.S[d];
        Vec u = s.l + cross(s.a, at);
        if (!is_moved_by(b, i)) u = Vec{0, 0, 0};
        for (int k = 0; k < 3; k++) {
            real moved = dot(frame[k], u);
            o.J[k][c] = moved, e[k] += moved * w.a[i], v[k] += moved * w.v[i];
        }
    }
    for (int k = 0; k < 3; k++) o.e[k] = e[k] + C[C_DAMPING] * v[k] + (k ? 0 : C[C_STIFFNESS]), o.js[k] = 0;
    // Without friction a contact is a row. It is four of the same here.
    const bool slides = (int)C[C_DIM] == 1;
    o.D = slides ? 1 / (4 * C[C_R]) : 1 / (2 * C[C_MU] * C[C_MU] * C[C_R]);
    o.friction[0] = slides ? 0 : C[C_FRICTION], o.friction[1] = slides ? 0 : C[C_FRICTION + 1];
    o.rows = slides ? 1 : 4;
#if CONTACT_FORCES
    o.pair = p, o.normal = n, o.tangent = t;
#endif
}

// Contacts of a slot. Returns their number.
FN int limb_contacts(LimbContact* found, const World& w, const Parameters& P, const Limb& L, int slot, int& rows, int& overflow) {
    int count = 0;
    ROLLED for (int t = limb_pair_start(slot); t < limb_pair_start(slot + 1); t++) {
        const int p = limb_pair(t);
        if (!has_both(P, p)) continue;
        PairGeoms g = geoms_of(w, P, p);
        Hits hits;
        primitive_hits(hits, p, margin_of(P, p), g.a, g.b);
        ROLLED for (int i = 0; i < hits.count; i++) {
            if (count == LIMB_CONTACTS) {
                overflow |= OVERFLOW_CONTACTS;
                break;
            }
            set_contact(found[count], w, P, L, slot, p, hits.hit[i]);
            rows += found[count].rows;
            count++;
        }
    }
    return count;
}

// Force of a contact along its normal and two tangents.
FN Vec contact_force(const LimbContact& o) {
    real F[4];
    for (int i = 0; i < 4; i++) {
        real x = o.e[0] + (i % 2 ? -1 : 1) * o.friction[i / 2] * o.e[1 + i / 2];
        F[i] = x < 0 ? -o.D * x : 0;
    }
    return Vec{F[0] + F[1] + F[2] + F[3], o.friction[0] * (F[0] - F[1]), o.friction[1] * (F[2] - F[3])};
}

#if CONTACT_FORCES
// Geoms of the contacts, and their forces on the second one in the world. The first place without a contact has geoms of -1.
FN void write_contact_forces(const Parameters& P, const LimbContact (*found)[LIMB_CONTACTS ? LIMB_CONTACTS : 1], const int* counts, int lane) {
    int mine = 0, before = 0, all;
    for (int l = 0; l < NL; l++) mine += counts[l];
    all = mine;
    BEFORE(mine, before, all);
    int place = before;
    for (int l = 0; l < NL; l++)
        ROLLED for (int c = 0; c < counts[l]; c++, place++) {
            if (place >= MAX_CONTACTS) break;
            const LimbContact& o = found[l][c];
            Vec f = contact_force(o);
            P.force_geoms()[2 * place] = contact_geom1(o.pair), P.force_geoms()[2 * place + 1] = contact_geom2(o.pair);
            store(P.contact_forces() + 3 * place, f.x * o.normal + f.y * o.tangent + f.z * cross(o.normal, o.tangent));
        }
    if (lane == 0 && all < MAX_CONTACTS) P.force_geoms()[2 * all] = P.force_geoms()[2 * all + 1] = -1;
}
#endif

}  // namespace fused
