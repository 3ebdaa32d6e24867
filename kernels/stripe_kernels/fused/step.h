// SPDX-License-Identifier: Apache-2.0
// Step: one time step of a world. Source: MuJoCo's mj_step with the integrators Euler and implicitfast.

namespace fused {

// Solve the implicit step of free bodies without joints below them, for which the change of the bias force with the angular
// velocity counts, too: A = M + h (damping + d(bias)/dv), not symmetric. With the spatial inertia about the body's origin
//     bias = (m w x (w x s), R' (w x I w)),  s the centre of mass, w = R v_angular.
// Source: L. Euler's equations; that MuJoCo's implicitfast has them for such bodies, its changelog of 3.x.
FN void step_free_bodies(World& w, const Parameters& P, int lane) {
    const real h = P.timestep[0];
    EACH(f, NFREE) {
        int b = free_body[f], d = joint_v[body_joint[b]];
        const real* X = w.X + 16 * b;
        Mat R = matrix(load_quat(w.quat + 4 * b));
        Vec mc = load(X + 1), wb = load(w.v + d + 3), turning = R * wb;
        Spatial momentum = operator_inertia(X, Spatial{turning, {0, 0, 0}});
        real A[6][7];
        for (int i = 0; i < 6; i++) {
            for (int k = 0; k < 6; k++) A[i][k] = w.M[(d + i) * LD + d + k];
            A[i][i] += h * P.damping[d + i];
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
    const real h = P.timestep[0];
    // (M - h dF/dv) a' = M a: the forces that a needs, but for their change with the velocity.
    solve(w, &P, 0, w.Ma, 1, w.s, lane);
    if (IMPLICIT) step_free_bodies(w, P, lane);
    EACH(i, NV) w.v[i] += h * w.s[i];
    SYNC();
    EACH(j, NJ) {
        real *q = w.q + joint_q[j], *v = w.v + joint_v[j];
        if (joint_type[j] == FREE) {
            store(q, load(q) + h * load(v));
            store_quat(q + 3, normalized(load_quat(q + 3) * turn_by(h * load(v + 3))));
        } else if (joint_type[j] == BALL)
            store_quat(q, normalized(load_quat(q) * turn_by(h * load(v))));
        else
            q[0] += h * v[0];
    }
    SYNC();
}

struct Results {  // where they are written
    int *rows, *iterations, *overflow;
    real* actuator_forces;  // of each degree of freedom; may be null
};

FN void step(World& w, const Parameters& P, const real* ctrl, const real* applied, const real* wrench, const real* contacts,
             int contact_count, const Results& out, int lane) {
    kinematics(w, P, lane);
    forces(w, P, ctrl, applied, wrench, out.actuator_forces, lane);
    int overflow = 0;
    if (contacts) {  // they are in the world, those found here relative to the tree
        if (contact_count > MAX_CONTACTS) contact_count = MAX_CONTACTS, overflow |= OVERFLOW_CONTACTS;
        EACH(i, contact_count * CONTACT_SIZE) w.contacts[i] = contacts[i];
        SYNC();
        EACH(c, contact_count) {
            real* C = w.contacts + c * CONTACT_SIZE;
            store(C + C_POS, load(C + C_POS) - load(w.origin + 3 * (int)C[C_BODY + 1]));
        }
        SYNC();
    } else
        contact_count = collide(w, P, lane);
    if (contact_count > MAX_CONTACTS) contact_count = MAX_CONTACTS, overflow |= OVERFLOW_CONTACTS;
    int rows = equality_rows(w, P, lane);
    rows = joint_rows(w, P, rows, lane);
    bool dropped = rows > MAX_ROWS;
    rows = contact_rows(w, P, contact_count, dropped ? MAX_ROWS : rows, dropped, lane);
    if (dropped) overflow |= OVERFLOW_ROWS;
    int iterations = constrained_acceleration(w, rows, lane);
    if (lane == 0) *out.rows = rows, *out.iterations = iterations, *out.overflow |= overflow;
    integrate(w, P, lane);
}

}  // namespace fused
