// SPDX-License-Identifier: Apache-2.0
// Accelerations: those of bodies under the constraints, and the wrenches that bodies receive through their joints, as Newton
// has them in `body_qdd` and `body_parent_f`. Both are of the state before the last step, as MuJoCo's are
// (mj_rnePostConstraint): a force belongs to the acceleration that it causes.
//
// Source: R. Featherstone, "Rigid Body Dynamics Algorithms", Springer, 2008, section 5.3: the recursive Newton-Euler
// algorithm.

namespace fused {

// Wrench about the origin of its tree, of a force and a torque that act on a body at a point relative to that origin.
FN Spatial wrench_at(Vec at, Vec force, Vec torque) { return Spatial{torque + cross(at, force), force}; }

// Force (normal, two tangents) and torque about the same axes of a contact, from the forces of its rows. In a pyramid the
// rows are pairs of edges, each the normal and plus or minus a friction coefficient times another axis.
FN void contact_force(const World& w, const real* C, real* f) {
    int dim = (int)C[C_DIM], r = (int)C[C_ROW];
    for (int i = 0; i < 6; i++) f[i] = 0;
    for (int i = 0; i < rows_of(C); i++) {
        real x = row_of<false>(w, r + i)[R_F];
        if (dim == 1 || ELLIPTIC_CONES) f[i] = x;
        else f[0] += x, f[1 + i / 2] += (i % 2 ? -x : x) * C[C_FRICTION + i / 2];
    }
}

// Wrenches of the contacts on each body. The rows must still have their forces.
FN void write_wrenches(const World& w, const Parameters& P, int contacts, int lane) {
    EACH(b, NB) {
        Spatial sum{{0, 0, 0}, {0, 0, 0}};
        for (int c = 0; c < contacts; c++) {
            const real* C = contact_of<false>(w, c);
            int b1 = (int)C[C_BODY], b2 = (int)C[C_BODY + 1];
            if (b1 == b2 || (b != b1 && b != b2)) continue;
            real f[6], sign = b == b2 ? 1 : -1;
            contact_force(w, C, f);
            Vec n = load(C + C_NORMAL), t1 = load(C + C_TANGENT), t2 = cross(n, t1);
            Vec at = load(C + C_POS) + (origin_of(w, b1, b2) - origin_of(w, b));
            sum = sum + sign * wrench_at(at, f[0] * n + f[1] * t1 + f[2] * t2, f[3] * n + f[4] * t1 + f[5] * t2);
        }
        store_spatial(P.wrench() + 6 * b, sum);
    }
    SYNC();
}

// Wrench on each body through its joint, about the origin of its tree, in w.X: inverse dynamics of its subtree, less what
// pushes it from outside.
FN void joint_wrenches(World& w, const Parameters& P, int lane) {
    EACH(b, NB) {
        real* X = w.X + 16 * b;
        Vec c = load(w.pos + 3 * b) + rotate(load_quat(w.quat + 4 * b), load(P.com() + 3 * b));
        const real* push = P.xfrc_applied() + 6 * b;
        Spatial v = load_spatial(w.V + 6 * b);
        Spatial f = operator_inertia(X, load_spatial(w.A + 6 * b)) + cross_force(v, operator_inertia(X, v));
        Spatial outside = wrench_at(c, load(push), load(push + 3)) + load_spatial(P.wrench() + 6 * b);
        store_spatial(X + 10, f + (real)-1 * outside);
    }
    SYNC();
    for (int level = NLEVELS - 1; level > 1; level--) {
        int first = level_parent_start[level];
        EACH(i, 6 * (level_parent_start[level + 1] - first)) {
            int parent = first + i / 6, k = 10 + i % 6;
            for (int c = child_start[parent]; c < child_start[parent + 1]; c++)
                w.X[16 * level_parent[parent] + k] += w.X[16 * child[c] + k];
        }
        SYNC();
    }
}

// Of bodies that Newton has: (acceleration of the centre of mass, angular acceleration), and (force, torque about the centre
// of mass), in the world. Rows are lost, as bodies are placed again; contacts and what integration needs are not.
COLD void write_accelerations(World& w, const Parameters& P, int contacts, int lane) {
    if (P.m.body_parent_f) write_wrenches(w, P, contacts, lane);
    kinematics(w, P, lane);
    EACH(b, NB) {
        Spatial a = load_spatial(w.A + 6 * b);
        for (int i = 0; i < NV; i++)
            if ((body_dofs[b] >> i) & 1) a = a + w.a[i] * load_spatial(w.S + 6 * i);
        store_spatial(w.A + 6 * b, a);
    }
    SYNC();
    if (P.m.body_parent_f) joint_wrenches(w, P, lane);
    EACH(b, NB) {
        int n = ((const int*)P.m.newton_body)[(long long)P.id * NB + b];
        if (n < 0) continue;
        Vec c = load(w.pos + 3 * b) + rotate(load_quat(w.quat + 4 * b), load(P.com() + 3 * b));
        if (P.m.body_qdd) {
            Spatial a = load_spatial(w.A + 6 * b), v = load_spatial(w.V + 6 * b);
            real* o = (real*)P.m.body_qdd + 6LL * n;
            // A spatial acceleration is that of what passes a point; following the body adds its turning velocity there.
            // The world's own is that of gravity upwards, see `kinematics`.
            Vec own = a.l + cross(a.a, c) + cross(v.a, v.l + cross(v.a, c)) + load(P.gravity());
            store(o, own), store(o + 3, a.a);
        }
        if (P.m.body_parent_f) {
            const real* f = w.X + 16 * b + 10;
            real* o = (real*)P.m.body_parent_f + 6LL * n;
            store(o, load(f + 3)), store(o + 3, load(f) - cross(c, load(f + 3)));
        }
    }
    SYNC();
}

}  // namespace fused
