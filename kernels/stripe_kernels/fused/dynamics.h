// SPDX-License-Identifier: Apache-2.0
// Dynamics: kinematics, mass matrix, bias, passive and actuator forces of one world. Formulas are MuJoCo's (mj_kinematics,
// mj_comVel, mj_crb, mj_rne, mj_passive, mj_actuation of MuJoCo's engine), with one difference: spatial quantities of a tree
// are about the origin of its root body rather than about its centre of mass, and positions are relative to that origin.
// So nothing loses digits in worlds that are far from the world's origin.
//
// `P` has the parameters of the world, each a row of an array of MuJoCo's model: worlds may share it or have their own. The
// generated part defines the sizes N... and the tables of the topology.

namespace fused {

// Pose of each body in its parent, as its joints have moved it, and in w.S axis and anchor of the joints there.
FN void place_in_parents(World& w, const Parameters& P, int lane) {
    EACH(b, NB) {
        Quat turn_b = load_quat(P.body_quat() + 4 * b);
        Vec x = load(P.body_pos() + 3 * b);
        if (NMOCAP && body_mocap(b) >= 0)  // the caller places it
            x = load(P.mocap_pos() + 3 * body_mocap(b)), turn_b = load_quat(P.mocap_quat() + 4 * body_mocap(b));
        ROLLED for (int j = body_joint(b); j < body_joint(b) + body_joints(b); j++) {  // they move it one after another
            const real* q = w.q + joint_q(j);
            if (joint_type(j) == FREE) {
                x = load(q), turn_b = load_quat(q + 3);
                continue;
            }
            Vec axis, anchor;
            if (joint_type(j) == BALL) {
                Vec at = load(P.joint_pos() + 3 * j);
                axis = Vec{0, 0, 0}, anchor = x + rotate(turn_b, at);
                turn_b = turn_b * normalized(load_quat(q)), x = anchor - rotate(turn_b, at);
            } else
                move_by_joint(P, j, q[0], x, turn_b, axis, anchor);
            store(w.S + 6 * joint_v(j), axis), store(w.S + 6 * joint_v(j) + 3, anchor);
        }
        if (b == 0) store(w.origin, Vec{0, 0, 0});
        else if (body_parent(b) == 0) store(w.origin + 3 * body_tree(b), x), x = Vec{0, 0, 0};
        store(w.pos + 3 * b, b ? x : Vec{0, 0, 0}), store_quat(w.quat + 4 * b, b ? normalized(turn_b) : Quat{1, 0, 0, 0});
    }
    SYNC();
}

// Poses, motions of the degrees of freedom, inertias, velocities and velocity-dependent accelerations.
FN void kinematics(World& w, const Parameters& P, int lane) {
    place_in_parents(w, P, lane);
    ROLLED for (int level = 2; level < NLEVELS; level++) {  // from the roots outwards
        EACH(i, level_start(level + 1) - level_start(level)) {
            int b = level_body(level_start(level) + i), p = body_parent(b);
            Quat turn_p = load_quat(w.quat + 4 * p);
            store(w.pos + 3 * b, load(w.pos + 3 * p) + rotate(turn_p, load(w.pos + 3 * b)));
            store_quat(w.quat + 4 * b, turn_p * load_quat(w.quat + 4 * b));
        }
        SYNC();
    }
    // Motions about the tree's origin. A ball's axes are those of the body, known when all joints have turned it; nothing
    // turns it after a ball, as compilers of models place one last.
    EACH(j, NJ) {
        int d = joint_v(j), b = dof_body(d), p = body_parent(b);
        real* s = w.S + 6 * d;
        Vec axis = load(s), anchor = load(s + 3);
        Quat turn_p = load_quat(w.quat + 4 * p);
        if (p) axis = rotate(turn_p, axis), anchor = load(w.pos + 3 * p) + rotate(turn_p, anchor);
        else anchor = anchor - origin_of(w, b);
        if (joint_type(j) == SLIDE) store_spatial(s, Spatial{{0, 0, 0}, axis});
        else if (joint_type(j) == HINGE) store_spatial(s, Spatial{axis, cross(anchor, axis)});
        else {
            Mat B = matrix(load_quat(w.quat + 4 * b));
            bool is_free = joint_type(j) == FREE;
            for (int k = 0; k < 3; k++) {
                Vec e = column(B, k);
                if (is_free) store_spatial(s + 6 * k, Spatial{{0, 0, 0}, {(real)(k == 0), (real)(k == 1), (real)(k == 2)}});
                store_spatial(s + 6 * (is_free ? 3 + k : k), Spatial{e, is_free ? Vec{0, 0, 0} : cross(anchor, e)});
            }
        }
    }
    EACH(b, NB) {
        Quat turn_b = load_quat(w.quat + 4 * b);
        Vec c = load(w.pos + 3 * b) + rotate(turn_b, load(P.com() + 3 * b));
        body_inertia(w.X + 16 * b, P, b, turn_b, c);
        if (b) continue;
        store_spatial(w.V, Spatial{{0, 0, 0}, {0, 0, 0}});
        store_spatial(w.A, Spatial{{0, 0, 0}, -1 * load(P.gravity())});  // gravity as an acceleration of the world
    }
    SYNC();
    ROLLED for (int level = 1; level < NLEVELS; level++) {
        EACH(i, level_start(level + 1) - level_start(level)) {
            int b = level_body(level_start(level) + i), p = body_parent(b), first = body_joint(b);
            Spatial v = load_spatial(w.V + 6 * p), a = load_spatial(w.A + 6 * p);
            ROLLED for (int j = first; j < first + body_joints(b); j++) {
                int d = joint_v(j), size = joint_type(j) == FREE ? 6 : joint_type(j) == BALL ? 3 : 1;
                // The translations of a free joint are in fixed directions: their motions do not change.
                if (joint_type(j) == FREE) v.l = v.l + load(w.v + d), d += 3, size = 3;
                Spatial own = v;  // the axes of one joint do not turn each other
                ROLLED for (int k = 0; k < size; k++) {
                    Spatial s = load_spatial(w.S + 6 * (d + k));
                    a = a + w.v[d + k] * cross_motion(own, s);
                    v = v + w.v[d + k] * s;
                }
            }
            store_spatial(w.V + 6 * b, v), store_spatial(w.A + 6 * b, a);
        }
        SYNC();
    }
}

// Mass matrix by composite inertias, and the generalised forces but for those of constraints.
FN void forces(World& w, const Parameters& P, int lane) {
    EACH(b, NB) {
        real* X = w.X + 16 * b;
        if (b == 0)
            for (int k = 0; k < 16; k++) X[k] = 0;
        else {
            Vec c = load(w.pos + 3 * b) + rotate(load_quat(w.quat + 4 * b), load(P.com() + 3 * b));
            store_spatial(X + 10, body_force(X, P, w.is_pushed, b, c, load_spatial(w.V + 6 * b), load_spatial(w.A + 6 * b)));
        }
    }
    SYNC();
    ROLLED for (int level = NLEVELS - 1; level > 1; level--) {  // of the subtrees: each body adds those of its children
        int first = level_parent_start(level);
        EACH(i, 16 * (level_parent_start(level + 1) - first)) {
            int parent = first + i / 16, k = i % 16;
            real sum = w.X[16 * level_parent(parent) + k];
            ROLLED for (int c = child_start(parent); c < child_start(parent + 1); c++) sum += w.X[16 * child(c) + k];
            w.X[16 * level_parent(parent) + k] = sum;
        }
        SYNC();
    }
    EACH(i, NV) {
        const real* X = w.X + 16 * dof_body(i);
        Spatial s = load_spatial(w.S + 6 * i);
        store_spatial(w.U + 6 * i, operator_inertia(X, s));
        real f = APPLIED(w, P.id, i) - dot(s, Spatial{load(X + 10), load(X + 13)}) - P.damping()[i] * w.v[i];
        int j = dof_joint(i);
        if (joint_type(j) == HINGE || joint_type(j) == SLIDE)
            f -= P.stiffness()[j] * (w.q[joint_q(j)] - P.spring()[joint_q(j)]);
        w.smooth[i] = f;
    }
    // The length of an actuator is a sum over degrees of freedom of joints or fixed tendons, with its coefficients.
    EACH(u, ACTUATORS) {
        real length = 0, speed = 0;
        ROLLED for (int t = actuator_start(u); t < actuator_start(u + 1); t++) {
            int i = actuator_dof(t);
            length += actuator_coefficient(t) * w.q[joint_q(dof_joint(i))], speed += actuator_coefficient(t) * w.v[i];
        }
        w.drive[u] = actuator_force(P, u, CONTROL(w, P.id, u), length, speed, w.slope[u]);
    }
    SYNC();
    EACH(t, NPAIRS) {
        int i = pair_dof(t), j = pair_ancestor(t);
        real m = dot(load_spatial(w.S + 6 * j), load_spatial(w.U + 6 * i));
        if (i == j) m += P.armature()[i];
        w.M[i * LD + j] = m;
        if (!IN_REGISTERS) w.M[j * LD + i] = m;
    }
    SYNC();
    EACH(i, NV) {  // the joint's own limit is on the sum of its actuators
        int j = dof_joint(i);
        real total = 0;
        ROLLED for (int t = dof_actuator_start(i); t < dof_actuator_start(i + 1); t++)
            total += dof_coefficient(t) * P.gear()[6 * dof_actuator(t)] * w.drive[dof_actuator(t)];
        if (joint_force_limited(j)) total = clamped(total, P.joint_force()[2 * j], P.joint_force()[2 * j + 1]);
        w.smooth[i] += total;
        EFFORT(w, P.id, i) = total;
    }
    SYNC();
}

}  // namespace fused
