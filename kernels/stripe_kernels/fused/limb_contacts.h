// SPDX-License-Identifier: Apache-2.0
// Limb contacts: those of limbs, and of the hub, with what does not move. Each belongs to the lane of its limb; those of the
// hub are shared out.

namespace fused {

// A contact of a slot, from what collision detection found of the pair `p`, of which one geom moves. `geom` is the first one:
// meshes that do not move are together in pairs of one of them.
FN void set_contact(LimbContact& o, const World& w, const Parameters& P, const Limb& L, int slot, int p, int geom, const Hit& hit) {
    const int b1 = geom_body(contact_geom1(p)), b2 = geom_body(contact_geom2(p));
    const bool is_first = MORE_THAN_PLANES && !body_dofs(b2);  // the geom that moves
    const int b = is_first ? b1 : b2;
    const Vec n = hit.normal, t = tangent_of(n, hit.along), frame[3] = {n, t, cross(n, t)};
    Material m;
    real friction[5];
    mix(m, friction, P, p, geom_with_parameters(P, geom));
    const real pos = hit.dist - margin_of(P, p), mu = friction[0] * SQRT(1 / (real)IMPRATIO);
    const real weight = P.weight()[2 * b1] + P.weight()[2 * b2];
    const Impedance z = impedance(P, m.solref, m.solimp, pos);
    // Without friction a contact is a row. It is four of the same here.
    const bool slides = contact_dim(p) == 1;
    const real R = regularization(z.imp, slides ? weight : weight + friction[0] * friction[0] * weight);
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
        Vec u = s.l + cross(s.a, hit.pos);
        if (!is_moved_by(b, i)) u = Vec{0, 0, 0};
        if (is_first) u = -1 * u;
        for (int k = 0; k < 3; k++) {
            real moved = dot(frame[k], u);
            o.J[k][c] = moved, e[k] += moved * w.a[i], v[k] += moved * w.v[i];
        }
    }
    for (int k = 0; k < 3; k++) o.e[k] = e[k] + z.b * v[k] + (k ? 0 : z.k * z.imp * pos), o.js[k] = 0;
    o.D = slides ? 1 / (4 * R) : 1 / (2 * mu * mu * R);
    for (int k = 0; k < 2; k++) o.friction[k] = slides ? 0 : friction[k];
    o.rows = slides ? 1 : 4;
#if CONTACT_FORCES
    o.pair = p, o.normal = n, o.tangent = t;
#if HAS_MESHES
    o.geom = geom;
#endif
#endif
}

// A geom that does not move, relative to the origin of the tree of the body `b`.
FN Geom static_geom(const World& w, const Parameters& P, int g, int b) {
    Geom o = geom_of(w, P, g);
    o.pos = o.pos + (origin_of(w, geom_body(g)) - origin_of(w, b));
    return o;
}
#if HAS_SEARCHES
// The ground of a searched pair, relative to the origin of the tree of the body `b`.
FN Geom ground_of(const World& w, const Parameters& P, int p, int b) {
#if NGROUNDS
    const real* at = w.grounds + 12 * pair_ground(p);
    return Geom{load(at) + (origin_of(w, geom_body(contact_geom1(p))) - origin_of(w, b)), load_matrix(at + 3), {0, 0, 0}};
#else
    return static_geom(w, P, contact_geom1(p), b);
#endif
}
#endif
FN Geom plane_of(const World& w, int p) {
    const real* at = w.planes + 6 * pair_plane(p);
    const Vec normal = load(at + 3);
    return Geom{load(at) - origin_of(w, geom_body(contact_geom2(p))), Mat{{0, 0, normal.x}, {0, 0, normal.y}, {0, 0, normal.z}}, {0, 0, 0}};
}

// Whether balls around two primitives, whose radii are at most the sums of their sizes, do not touch.
FN bool are_far(const Geom& a, const Geom& b, real margin) {
    const Vec d = b.pos - a.pos;
    const real reach = a.size.x + a.size.y + a.size.z + b.size.x + b.size.y + b.size.z + margin;
    return dot(d, d) > reach * reach;
}

#if !WARP_SEARCHES  // else see limb_search.h
// What a thread has found so far for the pairs of a limb: the geom that moves and its ground, which the pairs of it share.
struct Held {
    int geom;
    Geom own;
#if HAS_SEARCHES
    int searched;
    Near near;
    OnGround ground;
#endif
};
// Hold the geom of the pair `p`. Returns the other one.
FN int hold(Held& h, const World& w, const Parameters& P, int p) {
    const bool is_first = MORE_THAN_PLANES && !body_dofs(geom_body(contact_geom2(p)));
    const int g = is_first ? contact_geom1(p) : contact_geom2(p);
    if (!MORE_THAN_PLANES || g != h.geom) {
        h.geom = g, h.own = geom_of(w, P, g);
#if HAS_SEARCHES
        h.searched = -1;
#endif
    }
    return is_first ? contact_geom2(p) : contact_geom1(p);
}
#if HAS_SEARCHES
// The same with its ground, if the pair has one that is searched.
FN void hold_ground(Held& h, const World& w, const Parameters& P, int p) {
    hold(h, w, P, p);
    const int k = searched_geom(p - FIRST_SEARCHED_PAIR);
    if (k == h.searched) return;
    h.searched = k;
    h.ground = on_ground(ground_of(w, P, p, geom_body(h.geom)), h.own);
    h.near = near_ground(h.ground, P, p);
}
#endif

// Hits of the pair `p`.
FN void pair_hits(Hits& hits, int* geoms, Held& h, const World& w, const Parameters& P, int p) {
    hits.count = 0;
    if (!has_both(P, p)) return;
#if HAS_SEARCHES
    if (p >= FIRST_SEARCHED_PAIR) {
        hold_ground(h, w, P, p);
        if (is_part_near(h.near, ground_part(p))) ground_hits(hits, geoms, h.ground, P, p);
        return;
    }
#endif
    const int other = hold(h, w, P, p);
    if (!MORE_THAN_PLANES || contact_kind(p) <= PLANE_CYLINDER) {
        primitive_hits(hits, p, margin_of(P, p), plane_of(w, p), h.own);
        return;
    }
    const Geom still = static_geom(w, P, other, geom_body(h.geom));
    const bool is_first = other == contact_geom2(p);
    if (are_far(still, h.own, margin_of(P, p))) return;
    primitive_hits(hits, p, margin_of(P, p), is_first ? h.own : still, is_first ? still : h.own);
}

// Contacts of a slot. Returns their number. Pairs of a geom that moves come one after another, and so do its parts on a ground,
// so that each geom is placed once.
FN int limb_contacts(LimbContact* found, const World& w, const Parameters& P, const Limb& L, int slot, int& rows, int& overflow) {
    int count = 0;
    const int end = limb_pair_start(slot + 1);
    Held held;
    held.geom = -1;
    ROLLED for (int t = limb_pair_start(slot); t < end; t++) {
        Hits hits;
        int geoms[4], p = limb_pair(t);
        pair_hits(hits, geoms, held, w, P, p);
        ROLLED for (int i = 0; i < hits.count; i++) {
            if (count == LIMB_CONTACTS) {
                overflow |= OVERFLOW_CONTACTS;
                break;
            }
            set_contact(found[count], w, P, L, slot, p, is_on_mesh(p) ? geoms[i] : contact_geom1(p), hits.hit[i]);
            rows += found[count].rows;
            count++;
        }
    }
    return count;
}
#endif

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
FN int first_geom(const LimbContact& o) {
#if HAS_MESHES
    return o.geom;
#else
    return contact_geom1(o.pair);
#endif
}
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
            P.force_geoms()[2 * place] = first_geom(o), P.force_geoms()[2 * place + 1] = contact_geom2(o.pair);
            store(P.contact_forces() + 3 * place, f.x * o.normal + f.y * o.tangent + f.z * cross(o.normal, o.tangent));
        }
    if (lane == 0 && all < MAX_CONTACTS) P.force_geoms()[2 * all] = P.force_geoms()[2 * all + 1] = -1;
    if (lane == 0 && all > MAX_CONTACTS) *P.overflow() |= OVERFLOW_CONTACTS;  // limbs have room for more
}
#endif

}  // namespace fused
