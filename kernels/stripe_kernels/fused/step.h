// SPDX-License-Identifier: Apache-2.0
// Step: one time step of a world. Source: MuJoCo's mj_step with the integrators Euler and implicitfast.

namespace fused {

// What M - h dF/dv has beside M. Actuators couple a degree of freedom with itself (j = i), tendons also with ancestors.
FN real coupled(const World& w, const Parameters& P, int i, int j) {
    real sum = i == j ? P.step_size() * P.damping()[i] : 0;
    if (IMPLICIT)
        ROLLED for (int t = coupling_start(i); t < coupling_start(i + 1); t++) {
            int u = coupling_actuator(t);
            real gear = P.gear()[6 * u];
            if (coupling_dof(t) == j) sum -= P.step_size() * coupling_factor(t) * gear * gear * w.slope[u];
        }
    return sum;
}

// Solve the implicit step of free bodies without joints below them, for which the change of the bias force with the angular
// velocity counts, too: A = M + h (damping + d(bias)/dv), not symmetric. With the spatial inertia about the body's origin
//     bias = (m w x (w x s), R' (w x I w)),  s the centre of mass, w = R v_angular.
// Source: L. Euler's equations; that MuJoCo's implicitfast has them for such bodies, its changelog of 3.x.
FN void step_free_bodies(World& w, const Parameters& P, int lane) {
    const real h = P.step_size();
    EACH(f, NFREE) {
        int b = free_body(f), d = joint_v(body_joint(b));
        real X[10];  // the body's is the tree's
        Quat turn_b = normalized(load_quat(w.q + joint_q(body_joint(b)) + 3));
        Mat R = matrix(turn_b);
        body_inertia(X, P, b, turn_b, R * load(P.com() + 3 * b));
        Vec mc = load(X + 1), wb = load(w.v + d + 3), turning = R * wb;
        Spatial momentum = operator_inertia(X, Spatial{turning, {0, 0, 0}});
        real A[6][7];
        for (int i = 0; i < 6; i++) {
            for (int k = 0; k < 6; k++) A[i][k] = mass_matrix(w, d + i, d + k);
            A[i][6] = w.Ma[d + i];
        }
        for (int k = 0; k < 3; k++) {
            Vec r = column(R, k);  // the angular velocity changes along this axis
            Vec force = cross(r, cross(turning, mc)) + cross(turning, cross(r, mc));
            Vec torque = cross(r, momentum.a) + cross(turning, operator_inertia(X, Spatial{r, {0, 0, 0}}).a);
            real rows[6] = {force.x, force.y, force.z, dot(column(R, 0), torque), dot(column(R, 1), torque),
                            dot(column(R, 2), torque)};
            for (int i = 0; i < 6; i++) A[i][3 + k] += h * rows[i];
        }
        // Gauss's elimination. The matrix is M with a small change, so that its pivots are as good as those of M.
        for (int i = 0; i < 6; i++)
            for (int r = i + 1; r < 6; r++) {
                real factor = A[r][i] / A[i][i];
                for (int k = i; k < 7; k++) A[r][k] -= factor * A[i][k];
            }
        for (int i = 5; i >= 0; i--) {
            real x = A[i][6];
            for (int k = i + 1; k < 6; k++) x -= A[i][k] * w.s[d + k];
            w.s[d + i] = x / A[i][i];
        }
    }
    SYNC();
}

// Advance velocities by the accelerations w.a, with damping taken implicitly, and positions by the new velocities.
FN void integrate(World& w, const Parameters& P, int lane) {
    const real h = P.step_size();
    // (M - h dF/dv) a' = M a: the forces that a needs, but for their change with the velocity. M is not needed any more.
    EACH(t, NPAIRS) {
        int i = pair_dof(t), j = pair_ancestor(t);
        if (i == j || COUPLED) w.M[i * LD + j] += coupled(w, P, i, j);
    }
    SYNC();
    solve<true>(w, 0, 0, &World::Ma, 1, lane);
    if (IMPLICIT != 0 && NFREE > 0) step_free_bodies(w, P, lane);
    EACH(i, NV) w.v[i] += h * w.s[i];
    SYNC();
    EACH(j, NJ) {
        real *q = w.q + joint_q(j), *v = w.v + joint_v(j);
        if (joint_type(j) == FREE) {
            store(q, load(q) + h * load(v));
            store_quat(q + 3, normalized(load_quat(q + 3) * turn_by(h * load(v + 3))));
        } else if (joint_type(j) == BALL)
            store_quat(q, normalized(load_quat(q) * turn_by(h * load(v))));
        else
            q[0] += h * v[0];
    }
    SYNC();
}

// Accelerations under the constraints, of which `rows` are placed. Returns the number of iterations.
template <bool FITS>
FN int solve_constraints(World& w, int rows, int contacts, int lane) {
    contact_rows<FITS>(w, contacts, lane);
    complete_rows<FITS>(w, rows, contacts, lane);
    return constrained_acceleration<FITS>(w, rows, contacts, lane);
}
COLD int solve_spilled(World& w, int rows, int contacts, int lane) {
    return solve_constraints<false>(w, rows, contacts, lane);
}

FN void begin_steps(World& w, const Parameters& P, int lane) {
    EACH(i, NV * LD) w.M[i] = 0;  // what degrees of freedom do not share stays so
    read_state(w, P, lane);
}
FN void end_steps(World& w, const Parameters& P, int lane) { write_state(w, P, lane); }

// One time step. `given` are contacts that the caller found, beside those that are found here. Of the steps of a launch `left` are left with
// this one, see `is_last_pass`; in the last of them results are written where somebody reads them.
FN void step(World& w, const Parameters& P, const real* given, int given_count, int left, int lane) {
    const bool is_last = is_last_pass(w, P, left, lane), last = left == 1;
    if (left == 0 && !is_last) return;
    together(P);
    lane = fresh(lane) % LANES;
#if HAS_NEWTON && NBALLS
    if (left) read_ball_torques(w, fresh(P), lane);
#endif
    kinematics(w, fresh(P), lane);
#if HAS_NEWTON
    if (is_last) {
        write_newton_bodies(w, fresh(P), lane);
        return;
    }
#endif
#if WRENCHES
    apply_external_wrenches(w, fresh(P), lane);
#endif
    forces(w, fresh(P), lane);
    together(P);
#if CONTACTS
    const bool is_read = last && P.m.contact_geom;
    if (is_read) write_body_poses(w, fresh(P), lane);
#endif
#if ACCELERATIONS
    if (last && (P.m.body_qdd || P.m.body_parent_f)) keep_bodies(w, fresh(P), lane);
#endif
#if NATTACHMENTS
    place_attachments(w, fresh(P), lane);
#endif
    int overflow = 0, found = collide(w, fresh(P), lane), contacts = found + given_count;
    if (contacts > MAX_CONTACTS) contacts = MAX_CONTACTS, overflow |= OVERFLOW_CONTACTS;
    for (int c = found + lane; c < contacts; c += LANES) contact(w, c)[C_PAIR] = -1 - (c - found);
    complete_contacts(w, fresh(P), given, contacts, lane);
    int rows = equality_rows(w, fresh(P), lane);
    rows = joint_rows(w, fresh(P), rows, lane);
    bool dropped = rows > MAX_ROWS;
    rows = place_rows(w, contacts, dropped ? MAX_ROWS : rows, dropped, lane);
    if (dropped) overflow |= OVERFLOW_ROWS;
    bool fits = SPILL == 0 || (rows <= SHARED_ROWS && contacts <= SHARED_CONTACTS);
    together(P);
    int iterations = fits ? solve_constraints<true>(w, rows, contacts, lane) : solve_spilled(w, rows, contacts, lane);
    if (lane == 0) *P.nefc() = rows, *P.solver_niter() = iterations;
    if (lane == 0 && overflow) report_overflow(P, overflow);
#if ELLIPTIC_CONES && (CONTACTS || CONTACT_FORCES || ACCELERATIONS)
    if (last) unscale_forces(w, contacts, lane);
#endif
#if CONTACTS
    if (is_read) write_contacts(w, fresh(P), given, contacts, rows, lane);
#endif
#if CONTACT_FORCES
    if (last && P.m.force_geoms) write_contact_forces(w, fresh(P), given, contacts, lane);
#endif
#if ACCELERATIONS
    if (last && (P.m.body_qdd || P.m.body_parent_f)) write_accelerations(w, fresh(P), contacts, lane);
#endif
    together(P);
    integrate(w, fresh(P), lane);
#if VELOCITY_LIMITS
    limit_velocities(w, fresh(P), lane);
#endif
}

}  // namespace fused
