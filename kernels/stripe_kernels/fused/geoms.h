// SPDX-License-Identifier: Apache-2.0
// Geoms: where those of a pair are, what touches of two primitives, and the parameters of contacts.

namespace fused {

// Place of a geom relative to the origin of its tree. One of the world is where MuJoCo's data has it: it may have been moved.
FN Geom geom_of(const World& w, const Parameters& P, int g) {
    int b = geom_body(g);
    if (b == 0) return Geom{load(P.geom_xpos() + 3 * g), load_matrix(P.geom_xmat() + 9 * g), load(P.geom_size() + 3 * g)};
    Quat turn_b = load_quat(w.quat + 4 * b);
    return Geom{load(w.pos + 3 * b) + rotate(turn_b, load(P.geom_pos() + 3 * g)),
                matrix(turn_b * load_quat(P.geom_quat() + 4 * g)), load(P.geom_size() + 3 * g)};
}

// First geom of a contact of a pair. Meshes that do not move are together in pairs of one of them. Those from NALLGEOMS on
// are shapes that are no geoms of the model.
FN int first_geom(const real* C, int pair) {
#if HAS_MESHES
    if (C[C_GEOM] >= 0) return (int)C[C_GEOM];
#endif
    return contact_geom1(pair);
}
// The geom that has the parameters of it: of a shape that is no geom, another one stands for it.
FN int geom_with_parameters(const Parameters& P, int geom) {
    return geom < NALLGEOMS ? geom : ((const int*)P.m.hidden)[geom - NALLGEOMS];
}

// A geom of a pair, relative to `origin`.
FN Geom geom_at(const World& w, const Parameters& P, int index, Vec origin) {
    int g = used_geom(index);
#if GEOMS_PLACED
    const real* o = w.geoms + 12 * index;
    Geom at{load(o), load_matrix(o + 3), load(P.geom_size() + 3 * g)};
#else
    Geom at = geom_of(w, P, g);
#endif
    at.pos = at.pos + (origin_of(w, geom_body(g)) - origin);
    return at;
}

// Margin of a pair. `pair` has two geoms, the dimension of contacts, the rule of their parameters, and the pair of the model.
FN real margin_of(const Parameters& P, int pair) {
    return contact_rule(pair) == OF_PAIR ? P.pair_margin()[contact_explicit(pair)] : P.geom_margin()[contact_geom1(pair)] + P.geom_margin()[contact_geom2(pair)];
}

// Whether the world has both geoms of a pair: one that it lacks has the margin ABSENT_MARGIN of mujoco_model.py.
FN bool has_both(const Parameters& P, int pair) {
    return P.geom_margin()[contact_geom1(pair)] + P.geom_margin()[contact_geom2(pair)] > (real)-1e20;
}

struct Material {
    real solref[2], solreffriction[2], solimp[5];
};

// Solver parameters and friction of a contact: those of the pair, of the geom of higher priority, or of both geoms mixed.
// Source: MuJoCo's documentation, chapter "Computation", section "Contact", as mj_contactParam has it.
FN void mix(Material& m, real* friction, const Parameters& P, int pair, int g1) {
    int g2 = contact_geom2(pair), rule = contact_rule(pair);
    if (rule == OF_PAIR) {
        for (int i = 0; i < 2; i++) m.solref[i] = P.pair_solref()[2 * contact_explicit(pair) + i];
        for (int i = 0; i < 2; i++) m.solreffriction[i] = P.pair_solreffriction()[2 * contact_explicit(pair) + i];
        for (int i = 0; i < 5; i++) m.solimp[i] = P.pair_solimp()[5 * contact_explicit(pair) + i];
        for (int i = 0; i < 5; i++) friction[i] = larger(P.pair_friction()[5 * contact_explicit(pair) + i], (real)1e-5);
        return;
    }
    real a = P.geom_solmix()[g1], b = P.geom_solmix()[g2], share = (real)0.5;  // of the first geom
    if (rule == OF_FIRST) share = 1;
    else if (rule == OF_SECOND) share = 0;
    else if (a >= (real)1e-15 && b >= (real)1e-15) share = a / (a + b);
    else if (a >= (real)1e-15 || b >= (real)1e-15) share = a > b ? 1 : 0;
    const real *ref1 = P.geom_solref() + 2 * g1, *ref2 = P.geom_solref() + 2 * g2;
    bool least = rule == OF_BOTH && !(ref1[0] > 0 && ref2[0] > 0);  // stiffness and damping are given directly
    for (int i = 0; i < 2; i++) {
        m.solref[i] = least ? smaller(ref1[i], ref2[i]) : share * ref1[i] + (1 - share) * ref2[i];
        m.solreffriction[i] = 0;
    }
    for (int i = 0; i < 5; i++)
        m.solimp[i] = share * P.geom_solimp()[5 * g1 + i] + (1 - share) * P.geom_solimp()[5 * g2 + i];
    for (int i = 0; i < 5; i++) {
        int j = i < 2 ? 0 : (i + 1) / 2;  // sliding twice, torsional once, rolling twice
        real f1 = P.geom_friction()[3 * g1 + j], f2 = P.geom_friction()[3 * g2 + j];
        friction[i] = larger(rule == OF_FIRST ? f1 : rule == OF_SECOND ? f2 : larger(f1, f2), (real)1e-5);
    }
}

struct PairGeoms {
    Geom a, b;  // relative to the point that their contacts are relative to
};
FN PairGeoms geoms_of(const World& w, const Parameters& P, int p) {
    Vec origin = origin_of(w, geom_body(contact_geom1(p)), geom_body(contact_geom2(p)));
    return PairGeoms{geom_at(w, P, contact_geoms(2 * p), origin), geom_at(w, P, contact_geoms(2 * p + 1), origin)};
}

// A kind of which the model has pairs; the code of others is left out.
#define CASE(kind) \
    case kind:     \
        if (!HAS_##kind) break;

// Hits of the pair `p` of primitives, of which `a` is the first.
FN void primitive_hits(Hits& hits, int p, real margin, const Geom& a, const Geom& b) {
    hits.count = 0;
    switch (contact_kind(p)) {
        CASE(PLANE_SPHERE) plane_sphere(hits, margin, a, b.pos, b.size.x, Vec{0, 0, 0}); break;
        CASE(PLANE_CAPSULE) plane_capsule(hits, margin, a, b); break;
        CASE(PLANE_BOX) plane_box(hits, margin, a, b); break;
        CASE(PLANE_CYLINDER) plane_cylinder(hits, margin, a, b); break;
        CASE(SPHERE_SPHERE) sphere_sphere(hits, margin, a.pos, a.size.x, b.pos, b.size.x, across(a, b)); break;
        CASE(SPHERE_CAPSULE) sphere_capsule(hits, margin, a, b); break;
        CASE(SPHERE_BOX) sphere_box(hits, margin, a.pos, a.size.x, b); break;
        CASE(CAPSULE_CAPSULE) capsule_capsule(hits, margin, a, b); break;
        CASE(CAPSULE_BOX) capsule_box(hits, margin, a, b); break;
        CASE(BOX_BOX) box_box(hits, margin, a, b); break;
#if HAS_CURVED
        CASE(PLANE_ELLIPSOID) plane_ellipsoid(hits, margin, a, b); break;
        CASE(SPHERE_ELLIPSOID) core_contacts(hits, margin, BALL_SHAPE, a, ELLIPSOID_SHAPE, b); break;
        CASE(SPHERE_CYLINDER) sphere_cylinder(hits, margin, a, b); break;
        CASE(CAPSULE_ELLIPSOID) core_contacts(hits, margin, CAPSULE_SHAPE, a, ELLIPSOID_SHAPE, b); break;
        CASE(CAPSULE_CYLINDER) core_contacts(hits, margin, CAPSULE_SHAPE, a, CYLINDER_SHAPE, b); break;
        CASE(ELLIPSOID_ELLIPSOID) core_contacts(hits, margin, ELLIPSOID_SHAPE, a, ELLIPSOID_SHAPE, b); break;
        CASE(ELLIPSOID_CYLINDER) core_contacts(hits, margin, ELLIPSOID_SHAPE, a, CYLINDER_SHAPE, b); break;
        CASE(ELLIPSOID_BOX) core_contacts(hits, margin, ELLIPSOID_SHAPE, a, BOX_SHAPE, b); break;
        CASE(CYLINDER_CYLINDER) core_contacts(hits, margin, CYLINDER_SHAPE, a, CYLINDER_SHAPE, b); break;
        CASE(CYLINDER_BOX) core_contacts(hits, margin, CYLINDER_SHAPE, a, BOX_SHAPE, b); break;
#endif
    }
}

// Set the fields of a contact of pair `p` that collision detection knows.
FN void set_hit(real* C, int p, const Hit& hit, int geom = -1) {
#if HAS_MESHES
    C[C_GEOM] = geom;
#endif
    store(C + C_POS, hit.pos), store(C + C_NORMAL, hit.normal), store(C + C_TANGENT, hit.along);
    C[C_DIST] = hit.dist, C[C_PAIR] = p;
}

// Coefficients of the rows of a contact of which frame and friction are known, at the distance `pos` from its margin.
FN void set_coefficients(real* C, const Parameters& P, const Material& m, real pos) {
    const real* friction = C + C_FRICTION;
    Impedance z = impedance(P, m.solref, m.solimp, pos);
    int dim = (int)C[C_DIM];
    real weight = P.weight()[2 * (int)C[C_BODY]] + P.weight()[2 * (int)C[C_BODY + 1]];
    if (dim > 1 && !ELLIPTIC_CONES) weight += friction[0] * friction[0] * weight;
    C[C_DAMPING] = C[C_DAMPING + 1] = z.b, C[C_STIFFNESS] = z.k * z.imp * pos;
    C[C_R] = regularization(z.imp, weight), C[C_MU] = friction[0] * SQRT(1 / (real)IMPRATIO);
    if (ELLIPTIC_CONES && (m.solreffriction[0] != 0 || m.solreffriction[1] != 0))
        C[C_DAMPING + 1] = impedance(P, m.solreffriction, m.solimp, pos).b;
}

// First tangent of a contact with the normal `n`, near the direction `along` if that is not zero. Source: mju_makeFrame.
FN Vec tangent_of(Vec n, Vec along) {
    if (dot(along, along) < (real)0.25) along = FABS(n.y) < (real)0.5 ? Vec{0, 1, 0} : Vec{0, 0, 1};
    along = along - dot(n, along) * n;
    return (1 / SQRT(larger(dot(along, along), (real)1e-30))) * along;
}

// Frame, friction and the coefficients of the rows of a contact that was found here, whose first fields and pair are set.
FN void complete_contact(real* C, const Parameters& P) {
    const int pair = (int)C[C_PAIR];
    store(C + C_TANGENT, tangent_of(load(C + C_NORMAL), load(C + C_TANGENT)));
    Material m;
    mix(m, C + C_FRICTION, P, pair, geom_with_parameters(P, first_geom(C, pair)));
    C[C_DIM] = contact_dim(pair), C[C_BODY] = geom_body(contact_geom1(pair)), C[C_BODY + 1] = geom_body(contact_geom2(pair));
    set_coefficients(C, P, m, C[C_DIST] - margin_of(P, pair));
}

}  // namespace fused
