// SPDX-License-Identifier: Apache-2.0
// Newton state: joints, controls and forces as Newton has them, to and from MuJoCo's. Source: the conversions of Newton's
// SolverMuJoCo, whose conventions these are:
//
//   free    Newton: pose of the child's anchor in the parent's, velocity of the centre of mass, angular velocity, both in
//           the axes of the parent's anchor. MuJoCo: pose of the body, velocity of its origin, angular velocity in its axes.
//   ball    Newton: in the axes of the parent's anchor. MuJoCo: rotation from the rest pose, velocity in the body's axes.
//   others  the same but for a reference coordinate.
//
// Newton's quaternions are (x, y, z, w), and its numbers are floats in both precisions of this source.

namespace fused {

FN Vec load_newton(const float* p) { return Vec{p[0], p[1], p[2]}; }
FN Quat load_newton_quat(const float* p) { return Quat{p[3], p[0], p[1], p[2]}; }
FN void store_newton(float* p, Vec v) { p[0] = v.x, p[1] = v.y, p[2] = v.z; }
FN void store_newton_quat(float* p, Quat q) { p[0] = q.x, p[1] = q.y, p[2] = q.z, p[3] = q.w; }

struct Pose {
    Vec p;
    Quat q;
};
FN Pose load_pose(const float* p) { return Pose{load_newton(p), load_newton_quat(p + 3)}; }
FN Pose operator*(Pose a, Pose b) { return Pose{a.p + rotate(a.q, b.p), a.q * b.q}; }
FN Pose inverse(Pose a) { return Pose{-1 * rotate(conjugate(a.q), a.p), conjugate(a.q)}; }

#if HAS_NEWTON
// Rows of Newton's arrays of joints and bodies.
FN int newton_body_of(const Parameters& P, int b) { return ((const int*)P.m.newton_body)[(long long)P.id * NB + b]; }
FN Pose anchor_in_parent(const Parameters& P, int n) {
    return load_pose((const float*)P.m.joint_X_p + 7 * ((long long)P.id * NEWTON_JOINTS + n));
}
FN Pose anchor_in_child(const Parameters& P, int n) {
    return load_pose((const float*)P.m.joint_X_c + 7 * ((long long)P.id * NEWTON_JOINTS + n));
}
FN Vec newton_com(const Parameters& P, int j) {
    return load_newton((const float*)P.m.body_com + 3LL * newton_body_of(P, dof_body(joint_v(j))));
}
FN real reference(const Parameters& P, int newton_dof) {
    return P.m.dof_ref ? ((const float*)P.m.dof_ref)[(long long)P.id * NEWTON_DOFS + newton_dof] : 0;
}
// Joints of kinematic bodies are the caller's, and no force acts on such bodies.
FN bool is_kinematic(const Parameters& P, int newton_body) {
    return ((const int*)P.m.body_flags)[newton_body] & KINEMATIC;
}
FN bool moves_kinematic(const Parameters& P, int j) { return is_kinematic(P, newton_body_of(P, dof_body(joint_v(j)))); }

// One joint, of which `q` and `v` are Newton's coordinates and velocities.
FN void read_newton_joint(World& w, const Parameters& P, int j, const float* q, const float* v) {
    real *own_q = w.q + joint_q(j), *own_v = w.v + joint_v(j);
    if (joint_type(j) == FREE) {
        Pose in_parent = anchor_in_parent(P, newton_joint[j]);
        Pose pose = in_parent * load_pose(q) * inverse(anchor_in_child(P, newton_joint[j]));
        Vec velocity = rotate(in_parent.q, load_newton(v)), turning = rotate(in_parent.q, load_newton(v + 3));
        store(own_q, pose.p), store_quat(own_q + 3, pose.q);
        store(own_v, velocity - cross(turning, rotate(pose.q, newton_com(P, j))));
        store(own_v + 3, rotate(conjugate(pose.q), turning));
    } else if (joint_type(j) == BALL) {
        Quat rest = anchor_in_child(P, newton_joint[j]).q, moved = load_newton_quat(q);
        store_quat(own_q, rest * moved * conjugate(rest));
        store(own_v, rotate(rest * conjugate(moved), load_newton(v)));
    } else
        own_q[0] = q[0] + reference(P, newton_v[j]), own_v[0] = v[0];
}
FN void write_newton_joint(const World& w, const Parameters& P, int j, float* q, float* v) {
    const real *own_q = w.q + joint_q(j), *own_v = w.v + joint_v(j);
    if (joint_type(j) == FREE) {
        Pose in_parent = anchor_in_parent(P, newton_joint[j]), pose{load(own_q), load_quat(own_q + 3)};
        Pose moved = inverse(in_parent) * pose * anchor_in_child(P, newton_joint[j]);
        Vec turning = rotate(pose.q, load(own_v + 3));
        Vec velocity = load(own_v) + cross(turning, rotate(pose.q, newton_com(P, j)));
        store_newton(q, moved.p), store_newton_quat(q + 3, moved.q);
        store_newton(v, rotate(conjugate(in_parent.q), velocity));
        store_newton(v + 3, rotate(conjugate(in_parent.q), turning));
    } else if (joint_type(j) == BALL) {
        Quat rest = anchor_in_child(P, newton_joint[j]).q, moved = conjugate(rest) * load_quat(own_q);
        store_newton_quat(q, moved * rest), store_newton(v, rotate(moved, load(own_v)));
    } else
        q[0] = own_q[0] - reference(P, newton_v[j]), v[0] = own_v[0];
}

// All joints, or those of kinematic bodies alone.
FN void read_newton_joints(World& w, const Parameters& P, const float* q, const float* v, bool all, int lane) {
    q += (long long)P.id * NEWTON_COORDS, v += (long long)P.id * NEWTON_DOFS;
    EACH(j, NJ)
        if (all || moves_kinematic(P, j)) read_newton_joint(w, P, j, q + newton_q[j], v + newton_v[j]);
}
FN void write_newton_joints(const World& w, const Parameters& P, float* q, float* v, int lane) {
    q += (long long)P.id * NEWTON_COORDS, v += (long long)P.id * NEWTON_DOFS;
    EACH(j, NJ)
        if (!moves_kinematic(P, j)) write_newton_joint(w, P, j, q + newton_q[j], v + newton_v[j]);
}

// Mocap bodies that a fixed joint holds in the world.
FN void place_fixed_bodies(const Parameters& P, int lane) {
    EACH(i, NEWTON_FIXED) {
        Pose pose = anchor_in_parent(P, fixed_joint[i]) * inverse(anchor_in_child(P, fixed_joint[i]));
        store((real*)P.mocap_pos() + 3 * fixed_mocap[i], pose.p);
        store_quat((real*)P.mocap_quat() + 4 * fixed_mocap[i], pose.q);
    }
}

// Torques on ball joints, which Newton has in the axes of the parent's anchor and MuJoCo in those of the body: they turn with
// the body from step to step.
FN void read_ball_torques(const World& w, const Parameters& P, int lane) {
    if (!P.m.joint_f) return;
    const float* given = (const float*)P.m.joint_f + (long long)P.id * NEWTON_DOFS;
    EACH(j, NJ) {
        if (joint_type(j) != BALL || moves_kinematic(P, j)) continue;
        Quat rest = anchor_in_child(P, newton_joint[j]).q;
        store(P.qfrc_applied() + joint_v(j),
              rotate(conjugate(load_quat(w.q + joint_q(j))) * rest, load_newton(given + newton_v[j])));
    }
}

// Wrenches on bodies, into MuJoCo's array. A force on a free joint acts on the centre of mass of its body.
FN void read_body_forces(const Parameters& P, int lane) {
    const float* force = (const float*)P.m.joint_f;
    if (force) force += (long long)P.id * NEWTON_DOFS;
    EACH(b, NB) {
        int n = newton_body_of(P, b), j = body_joint(b);
        Vec f{0, 0, 0}, torque{0, 0, 0};
        if (n >= 0 && !is_kinematic(P, n)) {
            const float* given = (const float*)P.m.body_f + 6LL * n;
            f = load_newton(given), torque = load_newton(given + 3);
            if (force && body_joints(b) && joint_type(j) == FREE)
                f = f + load_newton(force + newton_v[j]), torque = torque + load_newton(force + newton_v[j] + 3);
        }
        store(P.xfrc_applied() + 6 * b, f), store(P.xfrc_applied() + 6 * b + 3, torque);
    }
}

// Controls of the actuators, and forces on joints and bodies, into MuJoCo's arrays.
FN void read_newton_controls(const Parameters& P, int lane) {
    if (P.m.joint_f) {
        const float* force = (const float*)P.m.joint_f + (long long)P.id * NEWTON_DOFS;
        EACH(u, ACTUATORS) {
            int i = control_index[u];
            if (control_source[u] == FROM_POSITIONS && P.m.joint_target_q)
                P.ctrl()[u] = ((const float*)P.m.joint_target_q)[(long long)P.id * NEWTON_TARGETS + i] +
                              reference(P, control_dof[u]);
            else if (control_source[u] == FROM_VELOCITIES && P.m.joint_target_qd)
                P.ctrl()[u] = ((const float*)P.m.joint_target_qd)[(long long)P.id * NEWTON_DOFS + i];
            else if (control_source[u] == FROM_CONTROLS && P.m.controls)
                P.ctrl()[u] = ((const float*)P.m.controls)[(long long)P.id * NEWTON_CONTROLS + i];
        }
        EACH(j, NJ) {
            real* f = P.qfrc_applied() + joint_v(j);
            if (joint_type(j) == HINGE || joint_type(j) == SLIDE)
                f[0] = moves_kinematic(P, j) ? 0 : force[newton_v[j]];
            else store(f, Vec{0, 0, 0});  // of balls see `read_ball_torques`
            if (joint_type(j) == FREE) store(f + 3, Vec{0, 0, 0});
        }
    }
    if (P.m.body_f) read_body_forces(P, lane);
}

// Forces of actuators by Newton's degrees of freedom; none acts on a free joint or a ball.
FN void write_newton_efforts(const Parameters& P, int lane) {
    float* all = (float*)P.m.efforts + (long long)P.id * NEWTON_DOFS;
    EACH(j, NJ) {
        int size = joint_type(j) == FREE ? 6 : joint_type(j) == BALL ? 3 : 1;
        ROLLED for (int k = 0; k < size; k++) all[newton_v[j] + k] = P.qfrc_actuator()[joint_v(j) + k];
    }
}
#endif

}  // namespace fused
