// SPDX-License-Identifier: Apache-2.0
// Accelerations: those of bodies under the constraints, and the wrenches that bodies receive through their joints, as Newton
// has them in `body_qdd` and `body_parent_f`. Both are of the state before the last step, as MuJoCo's are
// (mj_rnePostConstraint): a force belongs to the acceleration that it causes.
//
// Source: R. Featherstone, "Rigid Body Dynamics Algorithms", Springer, 2008, section 5.3: the recursive Newton-Euler
// algorithm.

#if ACCELERATIONS
namespace fused {

// What is kept of a body until its acceleration is known, in memory of the device: geoms and the rows of the constraints are
// going to overwrite the kinematics, and placing bodies again would be a second copy of that code.
enum BodyField {
    B_COM = 0,   // centre of mass, relative to the origin of its tree [m]
    B_V = 3,     // velocity
    B_A = 9,     // acceleration: at first without those of the joints
    B_X = 15,    // spatial inertia
    B_F = 25,    // wrench from outside, then through its joint
    BODY_SIZE = 31,
};

FN void keep_bodies(const World& w, const Parameters& P, int lane) {
    EACH(b, NB) {
        real* o = P.bodies() + BODY_SIZE * b;
        Quat turn_b = load_quat(w.quat + 4 * b);
        Vec c = load(w.pos + 3 * b) + rotate(turn_b, load(P.com() + 3 * b));
        store(o + B_COM, c);
        for (int k = 0; k < 6; k++) o[B_V + k] = w.V[6 * b + k], o[B_A + k] = w.A[6 * b + k];
        // Of the body alone: those in w.X are of its subtree by now.
        body_inertia(o + B_X, P, b, turn_b, c);
        const real *wrench = P.xfrc_applied() + 6 * b, none[6] = {0, 0, 0, 0, 0, 0}, *push = w.is_pushed ? wrench : none;
        store_spatial(o + B_F, Spatial{load(push + 3) + cross(c, load(push)), load(push)});
    }
    SYNC();
}

// Wrenches on a body from outside, about the origin of its tree: of contacts and attachments.
FN Spatial constraint_wrench(const World& w, int b, int contacts) {
    Spatial sum{{0, 0, 0}, {0, 0, 0}};
    for (int c = 0; c < contacts; c++) {
        const real* C = contact_of<false>(w, c);
        int b1 = (int)C[C_BODY], b2 = (int)C[C_BODY + 1];
        if (b1 == b2 || (b != b1 && b != b2)) continue;
        Vec at = load(C + C_POS) + (origin_of(w, b1, b2) - origin_of(w, b));
        Spatial own = contact_wrench(w, C);
        sum = sum + (real)(b == b2 ? 1 : -1) * Spatial{own.a + cross(at, own.l), own.l};
    }
#if NATTACHMENTS
    for (int i = 0; i < NATTACHMENTS; i++)
        for (int k = 0; k < 2; k++)
            if (attached_body(2 * i + k) == b) sum = sum + attachment_wrench(w, i, k);
#endif
    return sum;
}

// Of bodies that Newton has: (acceleration of the centre of mass, angular acceleration), and (force, torque about the centre
// of mass), in the world, from what `keep_bodies` has kept. Rows must still have their forces.
FN void write_accelerations(const World& w, const Parameters& P, int contacts, int lane) {
    real *bodies = P.bodies(), *body_qdd = (real*)P.m.body_qdd, *body_parent_f = (real*)P.m.body_parent_f;
    EACH(b, NB) {
        real* o = bodies + BODY_SIZE * b;
        Spatial a = load_spatial(o + B_A), v = load_spatial(o + B_V);
        for (int i = 0; i < NV; i++)
            if ((body_dofs(b) >> i) & 1) a = a + w.a[i] * load_spatial(w.S + 6 * i);
        Spatial needed = operator_inertia(o + B_X, a) + cross_force(v, operator_inertia(o + B_X, v));
        Spatial outside = load_spatial(o + B_F);
        if (body_parent_f) outside = outside + constraint_wrench(w, b, contacts);
        store_spatial(o + B_A, a), store_spatial(o + B_F, needed + (real)-1 * outside);
    }
    SYNC();
    for (int level = NLEVELS - 1; level > 1; level--) {  // a joint carries all of its subtree
        int first = level_parent_start(level);
        EACH(i, 6 * (level_parent_start(level + 1) - first)) {
            int parent = first + i / 6, k = B_F + i % 6;
            for (int c = child_start(parent); c < child_start(parent + 1); c++)
                bodies[BODY_SIZE * level_parent(parent) + k] += bodies[BODY_SIZE * child(c) + k];
        }
        SYNC();
    }
    EACH(b, NB) {
        const int n = newton_body_of(P, b);
        if (n < 0) continue;
        const real* o = bodies + BODY_SIZE * b;
        Vec c = load(o + B_COM);
        Spatial a = load_spatial(o + B_A), v = load_spatial(o + B_V), f = load_spatial(o + B_F);
        // A spatial acceleration is that of what passes a point; following the body adds its turning velocity there. The
        // world's own is that of gravity upwards, see `kinematics`.
        Vec own = a.l + cross(a.a, c) + cross(v.a, v.l + cross(v.a, c)) + load(P.gravity());
        if (body_qdd) store(body_qdd + 6LL * n, own), store(body_qdd + 6LL * n + 3, a.a);
        if (body_parent_f) store(body_parent_f + 6LL * n, f.l), store(body_parent_f + 6LL * n + 3, f.a - cross(c, f.l));
    }
}

}  // namespace fused
#endif
