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

// Body of Newton's with the number of MuJoCo's body `b`, -1 for none.
#if HAS_NEWTON
FN int newton_body_of(const Parameters& P, int b) {
    const int n = newton_body(b);
    return n < 0 ? n : P.id * NEWTON_BODIES + n;
}
#else
FN int newton_body_of(const Parameters& P, int b) { return ((const int*)P.m.newton_body)[(long long)P.id * NB + b]; }
#endif

#if HAS_NEWTON
// Number `i` of a world in an array of Newton's, in which worlds with `size` numbers each lie one after another.
FN float* in_newton(unsigned long long array, int id, int size, int i) { return (float*)array + (long long)id * size + i; }

FN Pose anchor_in_parent(const Parameters& P, int n) { return load_pose(in_newton(P.m.joint_X_p, P.id, 7 * NEWTON_JOINTS, 7 * n)); }
FN Pose anchor_in_child(const Parameters& P, int n) { return load_pose(in_newton(P.m.joint_X_c, P.id, 7 * NEWTON_JOINTS, 7 * n)); }
FN Vec newton_com(const Parameters& P, int j) {
    return load_newton((const float*)P.m.body_com + 3LL * newton_body_of(P, dof_body(joint_v(j))));
}
// Reference coordinates have no address if all are 0.
FN real reference(const Parameters& P, int id, int newton_dof) {
    return P.m.dof_ref ? *in_newton(P.m.dof_ref, id, NEWTON_DOFS, newton_dof) : 0;
}
// Joints of kinematic bodies are the caller's, and no force acts on such bodies.
FN bool is_kinematic(const Parameters& P, int id, int newton_body) {
    return ((const int*)P.m.body_flags)[(long long)id * NEWTON_BODIES + newton_body] & KINEMATIC;
}
FN bool moves_kinematic(const World& w, const Parameters& P, int id, int j) {
    return KINEMATIC_BODIES && w.has_kinematic && is_kinematic(P, id, newton_body(dof_body(joint_v(j))));
}

FN Quat ball_rest(const Parameters& P, int n) { return P.m.joint_X_p ? anchor_in_child(P, n).q : Quat{1, 0, 0, 0}; }

// One joint, of which `q` and `v` are Newton's coordinates and velocities. Anchors have no address if those of all free joints
// and balls are at the bodies' origins, without a rotation.
FN void read_newton_joint(World& w, const Parameters& P, int j, const float* q, const float* v) {
    real *own_q = w.q + joint_q(j), *own_v = w.v + joint_v(j);
    if (joint_type(j) == FREE) {
        Pose pose = load_pose(q);
        Vec velocity = load_newton(v), turning = load_newton(v + 3);
        if (P.m.joint_X_p) {
            const Pose in_parent = anchor_in_parent(P, newton_joint(j));
            pose = in_parent * pose * inverse(anchor_in_child(P, newton_joint(j)));
            velocity = rotate(in_parent.q, velocity), turning = rotate(in_parent.q, turning);
        }
        store(own_q, pose.p), store_quat(own_q + 3, pose.q);
        store(own_v, velocity - cross(turning, rotate(pose.q, newton_com(P, j))));
        store(own_v + 3, rotate(conjugate(pose.q), turning));
    } else if (joint_type(j) == BALL) {
        Quat rest = ball_rest(P, newton_joint(j)), moved = load_newton_quat(q);
        store_quat(own_q, rest * moved * conjugate(rest));
        store(own_v, rotate(rest * conjugate(moved), load_newton(v)));
    } else
        own_q[0] = q[0] + reference(P, P.id, newton_v(j)), own_v[0] = v[0];
}
FN void write_newton_joint(const World& w, const Parameters& P, int j, float* q, float* v) {
    const real *own_q = w.q + joint_q(j), *own_v = w.v + joint_v(j);
    if (joint_type(j) == FREE) {
        Pose pose{load(own_q), load_quat(own_q + 3)};
        Vec turning = rotate(pose.q, load(own_v + 3));
        Vec velocity = load(own_v) + cross(turning, rotate(pose.q, newton_com(P, j)));
        if (P.m.joint_X_p) {
            const Pose from_parent = inverse(anchor_in_parent(P, newton_joint(j)));
            pose = from_parent * pose * anchor_in_child(P, newton_joint(j));
            velocity = rotate(from_parent.q, velocity), turning = rotate(from_parent.q, turning);
        }
        store_newton(q, pose.p), store_newton_quat(q + 3, pose.q);
        store_newton(v, velocity), store_newton(v + 3, turning);
    } else if (joint_type(j) == BALL) {
        Quat rest = ball_rest(P, newton_joint(j)), moved = conjugate(rest) * load_quat(own_q);
        store_newton_quat(q, moved * rest), store_newton(v, rotate(moved, load(own_v)));
    } else
        q[0] = own_q[0] - reference(P, P.id, newton_v(j)), v[0] = own_v[0];
}
FN bool is_turning(int j) { return joint_type(j) == FREE || joint_type(j) == BALL; }
FN int coordinates(int j) { return joint_type(j) == FREE ? 7 : joint_type(j) == BALL ? 4 : 1; }
FN int velocities(int j) { return joint_type(j) == FREE ? 6 : joint_type(j) == BALL ? 3 : 1; }

FN void convert_read_joints(World& w, const Parameters& P, int lane);
// All joints: first the numbers as they are, then those are converted in place that Newton has otherwise.
FN void read_newton_joints(World& w, const Parameters& P, int lane) {
    const Rows r = rows_of(w, P, lane);
    read_rows<NQ>(
        r, [&](const World&, int id, int i) { return *in_newton(P.m.joint_q_in, id, NEWTON_COORDS, newton_coord(i)); },
        [](World& o, int, int i, real x) { o.q[i] = x; });
    read_rows<NV>(
        r, [&](const World&, int id, int i) { return *in_newton(P.m.joint_qd_in, id, NEWTON_DOFS, newton_dof(i)); },
        [](World& o, int, int i, real x) { o.v[i] = x; });
    SYNC_WARP();
    convert_read_joints(w, P, lane);
}
// Those that Newton has otherwise, of numbers as they are.
FN void convert_read_joints(World& w, const Parameters& P, int lane) {
    EACH(j, NJ) {
        if (!is_turning(j) && !P.m.dof_ref) continue;
        float q[7], v[6];
        for (int k = 0; k < coordinates(j); k++) q[k] = w.q[joint_q(j) + k];
        for (int k = 0; k < velocities(j); k++) v[k] = w.v[joint_v(j) + k];
        read_newton_joint(w, P, j, q, v);
    }
}
// Free joints and balls as Newton has them.
FN void convert_turned(World& w, const Parameters& P, int lane) {
    EACH(j, NJ)
        if (is_turning(j)) write_newton_joint(w, P, j, w.turned + turned_start(j), w.turned + turned_start(j) + coordinates(j));
    SYNC_WARP();
}
// All joints as Newton has them in the place of MuJoCo's, after `convert_turned`.
FN void convert_written_joints(World& w, const Parameters& P, int lane) {
    EACH(j, NJ) {
        real *q = w.q + joint_q(j), *v = w.v + joint_v(j);
        if (is_turning(j)) {
            const float* turned = w.turned + turned_start(j);
            ROLLED for (int k = 0; k < coordinates(j); k++) q[k] = turned[k];
            ROLLED for (int k = 0; k < velocities(j); k++) v[k] = turned[coordinates(j) + k];
        } else
            q[0] -= reference(P, P.id, newton_v(j));
    }
    SYNC_WARP();
}
// Velocity of a degree of freedom as Newton has it, after `convert_turned`.
FN float newton_velocity(const World& w, int i) {
    const int j = dof_joint(i);
    return is_turning(j) ? w.turned[turned_start(j) + coordinates(j) + i - joint_v(j)] : w.v[i];
}
// All joints but those of kinematic bodies, after `convert_turned`; `q` may have no address.
FN void write_newton_joints(World& w, const Parameters& P, unsigned long long q, unsigned long long v, int lane) {
    const Rows r = rows_of(w, P, lane);
    if (q) write_rows<NQ>(r, [&](const World& o, int id, int i) {
        const int j = coord_joint(i), first = joint_q(j);
        if (moves_kinematic(o, P, id, j)) return;
        const float x = is_turning(j) ? o.turned[turned_start(j) + i - first] : o.q[i] - reference(P, id, newton_v(j));
        *in_newton(q, id, NEWTON_COORDS, newton_coord(i)) = x;
    });
    write_rows<NV>(r, [&](const World& o, int id, int i) {
        if (!moves_kinematic(o, P, id, dof_joint(i))) *in_newton(v, id, NEWTON_DOFS, newton_dof(i)) = newton_velocity(o, i);
    });
    SYNC_WARP();  // the worlds' own lanes go on to change what others have read
}
// Joints of kinematic bodies, as the caller has placed them.
FN void read_kinematic_joints(World& w, const Parameters& P, unsigned long long q, unsigned long long v, int lane) {
    if (!KINEMATIC_BODIES || !w.has_kinematic) return;
    EACH(j, NJ)
        if (moves_kinematic(w, P, P.id, j))
            read_newton_joint(w, P, j, in_newton(q, P.id, NEWTON_COORDS, newton_q(j)), in_newton(v, P.id, NEWTON_DOFS, newton_v(j)));
}

// Mocap bodies that a fixed joint holds in the world.
FN void place_fixed_bodies(const Parameters& P, int lane) {
    EACH(i, NEWTON_FIXED) {
        Pose pose = anchor_in_parent(P, fixed_joint(i)) * inverse(anchor_in_child(P, fixed_joint(i)));
        store((real*)P.mocap_pos() + 3 * fixed_mocap(i), pose.p);
        store_quat((real*)P.mocap_quat() + 4 * fixed_mocap(i), pose.q);
    }
}

// Torques on ball joints, which Newton has in the axes of the parent's anchor and MuJoCo in those of the body: they turn with
// the body from step to step.
FN void read_ball_torques(World& w, const Parameters& P, int lane) {
    if (!P.m.joint_f) return;
    EACH(j, NJ) {
        if (joint_type(j) != BALL || moves_kinematic(w, P, P.id, j)) continue;
        Quat rest = ball_rest(P, newton_joint(j));
        store(&APPLIED(w, P.id, joint_v(j)), rotate(conjugate(load_quat(w.q + joint_q(j))) * rest,
                                             load_newton(in_newton(P.m.joint_f, P.id, NEWTON_DOFS, newton_v(j)))));
    }
}

// Wrenches on bodies, into MuJoCo's array. A force on a free joint acts on the centre of mass of its body.
FN void read_body_forces(const World& w, const Parameters& P, int lane) {
    EACH(b, NB) {
        const int n = newton_body(b), j = body_joint(b);
        Vec f{0, 0, 0}, torque{0, 0, 0};
        if (n >= 0 && !(KINEMATIC_BODIES && w.has_kinematic && is_kinematic(P, P.id, n))) {
            const float* given = in_newton(P.m.body_f, P.id, 6 * NEWTON_BODIES, 6 * n);
            f = load_newton(given), torque = load_newton(given + 3);
            if (P.m.joint_f && body_joints(b) && joint_type(j) == FREE) {
                const float* force = in_newton(P.m.joint_f, P.id, NEWTON_DOFS, newton_v(j));
                f = f + load_newton(force), torque = torque + load_newton(force + 3);
            }
        }
        store(P.xfrc_applied() + 6 * b, f), store(P.xfrc_applied() + 6 * b + 3, torque);
    }
}

// Find out which worlds have kinematic bodies.
FN void find_kinematic(const Rows& r, const Parameters& P) {
    read_rows<NEWTON_BODIES>(
        r, [&](const World&, int id, int i) { return (real)is_kinematic(P, id, i); },
        [](World& o, int, int, real x) { if (x != 0) o.has_kinematic = 1; });
}
// Find out on which worlds' bodies any wrench acts.
FN void find_pushed(const Rows& r, const Parameters& P) {
    read_rows<6 * NEWTON_BODIES>(
        r, [&](const World&, int id, int i) { return *in_newton(P.m.body_f, id, 6 * NEWTON_BODIES, i); },
        [](World& o, int, int, real x) { if (x != 0) o.is_pushed = 1; });
}

// Forces on joints of kinematic bodies are none.
FN void keep_controls(World& w, const Parameters& P, int lane) {
    if (KINEMATIC_BODIES && w.has_kinematic)
        EACH(i, NV)
            if (moves_kinematic(w, P, P.id, dof_joint(i))) APPLIED(w, P.id, i) = 0;
#if LIMBS  // where no controls are given, those before go on
    SYNC_WARP();
    const Rows r = rows_of(w, P, lane);
#if ACTUATORS
    send_row(r, ROW_TO(ctrl, ctrl), NU);
#endif
    send_row(r, ROW_TO(qfrc_applied, applied), NV);
#endif
}
// Controls and forces on joints whose numbers have been read as they are.
FN void finish_controls(World& w, const Parameters& P, int lane) {
#if ACTUATORS
    if (P.m.dof_ref && P.m.joint_target_q && control_source(0) == FROM_POSITIONS)
        EACH(u, NU) CONTROL(w, P.id, u) += reference(P, P.id, control_dof(u));
#endif
    EACH(i, NV) {
        const int j = dof_joint(i);
        if (!is_turning(j)) continue;
        if (joint_type(j) == FREE && APPLIED(w, P.id, i) != 0) w.is_pushed = 1;
        APPLIED(w, P.id, i) = 0;  // of balls see `read_ball_torques`
    }
    keep_controls(w, P, lane);
}
// Controls of the actuators, and forces on joints.
FN void read_newton_controls(World& w, const Parameters& P, int lane) {
    const Rows r = rows_of(w, P, lane);
#if ACTUATORS
    read_rows<NU>(
        r,
        [&](const World&, int id, int u) {
            const int source = control_source(u), i = control_index(u);
            if (source == FROM_POSITIONS && P.m.joint_target_q)
                return *in_newton(P.m.joint_target_q, id, NEWTON_TARGETS, i) + reference(P, id, control_dof(u));
            if (source == FROM_VELOCITIES && P.m.joint_target_qd) return (real)*in_newton(P.m.joint_target_qd, id, NEWTON_DOFS, i);
            if (source == FROM_CONTROLS && P.m.controls) return (real)*in_newton(P.m.controls, id, NEWTON_CONTROLS, i);
            return IN_ROW(ctrl, id, u);
        },
        [&](World& o, int id, int u, real x) { CONTROL(o, id, u) = x; });
#endif
    read_rows<NV>(
        r, [&](const World&, int id, int i) { return *in_newton(P.m.joint_f, id, NEWTON_DOFS, newton_dof(i)); },
        [&](World& o, int id, int i, real x) {
            const int j = dof_joint(i);
            APPLIED(o, id, i) = is_turning(j) ? 0 : x;  // of balls see `read_ball_torques`
            if (joint_type(j) == FREE && x != 0) o.is_pushed = 1;
        });
    SYNC_WARP();
    keep_controls(w, P, lane);
}
#endif

}  // namespace fused
