// SPDX-License-Identifier: Apache-2.0
// Dynamics: kinematics, mass matrix, bias, passive and actuator forces of one world. Formulas are MuJoCo's (mj_kinematics,
// mj_comVel, mj_crb, mj_rne, mj_passive, mj_actuation of MuJoCo's engine), with one difference: spatial quantities of a tree
// are about the origin of its root body rather than about its centre of mass, and positions are relative to that origin.
// So nothing loses digits in worlds that are far from the world's origin.
//
// `P` has the parameters of the world, each a row of an array of MuJoCo's model: worlds may share it or have their own. The
// generated part defines the sizes N... and the tables of the topology.

namespace fused {

struct World {
    real q[NQ], v[NV], a[NV];            // positions, velocities, accelerations (at first the warm start)
    real origin[NB * 3];                 // of each body's tree, in the world [m]
    real pos[NB * 3], quat[NB * 4];      // body frames relative to that origin
    real com[NB * 3];                    // centres of mass relative to it
    real S[NV * 6];                      // motion of each degree of freedom
    real V[NB * 6], A[NB * 6];           // velocities; accelerations without those of the joints
    real X[NB * 16];                     // spatial inertia (10) and force (6) of each body, then of its subtree
    real U[NV * 6];                      // force of a subtree for a unit acceleration of a degree of freedom
    real M[NV * LD], H[NV * LD];         // mass matrix; its factor, and that of the Hessian
    real smooth[NV];                     // forces but for those of constraints
    real drive[NU], slope[NU];           // forces of the actuators, and their derivatives by the actuators' velocities
    real Ma[NV], g[NV], s[NV], Ms[NV];   // M a; gradient; search direction; M s
    // Constraint rows: Jacobian, 1/R, J a - reference acceleration, J s, force, friction loss, weight in the Hessian. Behind
    // them stand two more for each elliptic contact, see `cones`.
    real J[ALL_ROWS * LD], D[MAX_ROWS], e[MAX_ROWS], js[MAX_ROWS], f[MAX_ROWS], loss[MAX_ROWS], weight[ALL_ROWS];
    int kind[MAX_ROWS];
    real contacts[MAX_CONTACTS * 31];    // see ContactField
    real cone[MAX_CONTACTS * 6];         // of each elliptic contact mu of the regularised cone, and the frictions
    int cone_row[MAX_CONTACTS], cone_dim[MAX_CONTACTS], cones;
};

// Poses, motions of the degrees of freedom, velocities and velocity-dependent accelerations, from the roots outwards.
FN void kinematics(World& w, const Parameters& P, int lane) {
    if (lane == 0) {
        store(w.pos, Vec{0, 0, 0}), store(w.origin, Vec{0, 0, 0}), store_quat(w.quat, Quat{1, 0, 0, 0});
        store_spatial(w.V, Spatial{{0, 0, 0}, {0, 0, 0}});
        store_spatial(w.A, Spatial{{0, 0, 0}, -1 * load(P.gravity)});  // gravity as an acceleration of the world
    }
    SYNC();
    for (int level = 1; level < NLEVELS; level++) {
        EACH(i, level_start[level + 1] - level_start[level]) {
            int b = level_body[level_start[level] + i], p = body_parent[b];
            bool is_root = p == 0;
            Quat turn_b = load_quat(w.quat + 4 * p);
            Vec x = load(w.pos + 3 * p) + matrix(turn_b) * load(P.body_pos + 3 * b);
            turn_b = turn_b * load_quat(P.body_quat + 4 * b);
            int first = body_joint[b], joints = body_joints[b];
            if (joints && joint_type[first] == FREE) {
                const real* q = w.q + joint_q[first];
                x = load(q), turn_b = normalized(load_quat(q + 3));
            }
            if (is_root) store(w.origin + 3 * b, x), x = Vec{0, 0, 0};
            else store(w.origin + 3 * b, load(w.origin + 3 * p));
            for (int j = first; j < first + joints; j++) {  // those of a body turn and move it one after another
                const real* q = w.q + joint_q[j];
                if (joint_type[j] == FREE) continue;
                Mat R = matrix(turn_b);
                Vec axis = R * load(P.joint_axis + 3 * j), at = load(P.joint_pos + 3 * j);
                Vec anchor = x + R * at;
                real moved = q[0] - P.qpos0[joint_q[j]];
                if (joint_type[j] == SLIDE) x = x + moved * axis;
                else {
                    turn_b = turn_b * (joint_type[j] == HINGE ? turn(load(P.joint_axis + 3 * j), moved)
                                                              : normalized(load_quat(q)));
                    x = anchor - matrix(turn_b) * at;
                }
                // Motions about the tree's origin. A ball's axes are those of the body, known when all joints have turned
                // it; nothing turns it after a ball, as compilers of models place one last.
                int d = joint_v[j];
                if (joint_type[j] == SLIDE) store_spatial(w.S + 6 * d, Spatial{{0, 0, 0}, axis});
                else if (joint_type[j] == HINGE) store_spatial(w.S + 6 * d, Spatial{axis, cross(anchor, axis)});
                else {
                    Mat B = matrix(turn_b);
                    for (int k = 0; k < 3; k++) {
                        Vec e = column(B, k);
                        store_spatial(w.S + 6 * (d + k), Spatial{e, cross(anchor, e)});
                    }
                }
            }
            turn_b = normalized(turn_b);
            Mat R = matrix(turn_b);
            if (joints && joint_type[first] == FREE)
                for (int k = 0; k < 3; k++) {
                    Vec e{(real)(k == 0), (real)(k == 1), (real)(k == 2)}, r = column(R, k);
                    store_spatial(w.S + 6 * (joint_v[first] + k), Spatial{{0, 0, 0}, e});
                    store_spatial(w.S + 6 * (joint_v[first] + 3 + k), Spatial{r, cross(x, r)});
                }
            store(w.pos + 3 * b, x), store_quat(w.quat + 4 * b, turn_b);
            Vec c = x + R * load(P.com + 3 * b);
            store(w.com + 3 * b, c);
            spatial_inertia(w.X + 16 * b, P.mass[b], load(P.inertia + 3 * b),
                            matrix(turn_b * load_quat(P.inertia_quat + 4 * b)), c);
            Spatial v = load_spatial(w.V + 6 * p), a = load_spatial(w.A + 6 * p);
            for (int j = first; j < first + joints; j++) {
                int d = joint_v[j], size = joint_type[j] == FREE ? 6 : joint_type[j] == BALL ? 3 : 1;
                // The translations of a free joint are in fixed directions: their motions do not change.
                if (joint_type[j] == FREE) {
                    for (int k = 0; k < 3; k++) v = v + w.v[d + k] * load_spatial(w.S + 6 * (d + k));
                    d += 3, size = 3;
                }
                Spatial own = v;  // the axes of one joint do not turn each other
                for (int k = 0; k < size; k++) {
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
FN void forces(World& w, const Parameters& P, const real* ctrl, const real* applied, const real* wrench,
               real* actuator_forces, int lane) {
    EACH(b, NB) {
        real* X = w.X + 16 * b;
        if (b == 0)
            for (int k = 0; k < 16; k++) X[k] = 0;
        else {
            // Inverse dynamics of the body alone: I a + v x* I v, less gravity compensation and external wrenches.
            Spatial v = load_spatial(w.V + 6 * b);
            Spatial f = operator_inertia(X, load_spatial(w.A + 6 * b)) + cross_force(v, operator_inertia(X, v));
            Vec c = load(w.com + 3 * b);
            Vec push = (-P.mass[b] * P.gravcomp[b]) * load(P.gravity), torque{0, 0, 0};
            if (wrench) push = push + load(wrench + 6 * b), torque = load(wrench + 6 * b + 3);
            store(X + 10, f.a - torque - cross(c, push)), store(X + 13, f.l - push);
        }
    }
    SYNC();
    for (int b = NB - 1; b > 0; b--) {
        EACH(k, 16) if (body_parent[b]) w.X[16 * body_parent[b] + k] += w.X[16 * b + k];
        SYNC();
    }
    EACH(i, NV * LD) w.M[i] = 0;
    EACH(i, NV) {
        const real* X = w.X + 16 * dof_body[i];
        Spatial s = load_spatial(w.S + 6 * i);
        store_spatial(w.U + 6 * i, operator_inertia(X, s));
        real f = applied[i] - dot(s, Spatial{load(X + 10), load(X + 13)}) - P.damping[i] * w.v[i];
        int j = dof_joint[i];
        if (joint_type[j] == HINGE || joint_type[j] == SLIDE)
            f -= P.stiffness[j] * (w.q[joint_q[j]] - P.spring[joint_q[j]]);
        w.smooth[i] = f;
    }
    // Affine actuators on joints and fixed tendons: force = gain(length, speed) control + bias(length, speed), limited.
    // The length is a sum over degrees of freedom, with the actuator's gear and the tendon's coefficients.
    EACH(u, ACTUATORS) {
        real length = 0, speed = 0, x = ctrl[u];
        for (int t = actuator_start[u]; t < actuator_start[u + 1]; t++) {
            int i = actuator_dof[t];
            length += actuator_coefficient[t] * w.q[joint_q[dof_joint[i]]], speed += actuator_coefficient[t] * w.v[i];
        }
        const real *gain = P.gain + 10 * u, *bias = P.bias + 10 * u;
        length *= P.gear[6 * u], speed *= P.gear[6 * u];
        if (actuator_ctrl_limited[u]) x = clamped(x, P.ctrl_range[2 * u], P.ctrl_range[2 * u + 1]);
        real f = (gain[0] + gain[1] * length + gain[2] * speed) * x + bias[0] + bias[1] * length + bias[2] * speed;
        real d = gain[2] * x + bias[2];
        if (actuator_force_limited[u]) {
            const real* range = P.force_range + 2 * u;
            if (f <= range[0] || f >= range[1]) d = 0;  // a limited force does not change with the velocity
            f = clamped(f, range[0], range[1]);
        }
        w.drive[u] = f, w.slope[u] = d;
    }
    SYNC();
    EACH(t, NPAIRS) {
        int i = pair_dof[t], j = pair_ancestor[t];
        real m = dot(load_spatial(w.S + 6 * j), load_spatial(w.U + 6 * i));
        if (i == j) m += P.armature[i];
        w.M[i * LD + j] = m, w.M[j * LD + i] = m;
    }
    SYNC();
    EACH(i, NV) {  // the joint's own limit is on the sum of its actuators
        int j = dof_joint[i];
        real total = 0;
        for (int t = dof_actuator_start[i]; t < dof_actuator_start[i + 1]; t++)
            total += dof_coefficient[t] * P.gear[6 * dof_actuator[t]] * w.drive[dof_actuator[t]];
        if (joint_force_limited[j]) total = clamped(total, P.joint_force[2 * j], P.joint_force[2 * j + 1]);
        w.smooth[i] += total;
        if (actuator_forces) actuator_forces[i] = total;
    }
    SYNC();
}

}  // namespace fused
