// SPDX-License-Identifier: Apache-2.0
// Poses: where bodies are, how joints move them, and what their inertia needs there.

namespace fused {

FN Vec origin_of(const World& w, int body) { return load(w.origin + 3 * body_tree(body)); }
// Point that a contact of two bodies is relative to: the origin of a tree that moves.
FN Vec origin_of(const World& w, int body1, int body2) { return origin_of(w, body2 ? body2 : body1); }

// Let a hinge or slide move a body from the pose (x, turn_b) by `moved`; its axis and anchor are in the same frame, `own_axis`
// and `at` in the body's.
FN void move_by_joint(int type, Vec own_axis, Vec at, real moved, Vec& x, Quat& turn_b, Vec& axis, Vec& anchor) {
    axis = rotate(turn_b, own_axis), anchor = x + rotate(turn_b, at);
    if (type == SLIDE) x = x + moved * axis;
    else turn_b = turn_b * turn(own_axis, moved), x = anchor - rotate(turn_b, at);
}
// The joint `j` at the coordinate `q`.
FN void move_by_joint(const Parameters& P, int j, real q, Vec& x, Quat& turn_b, Vec& axis, Vec& anchor) {
    move_by_joint(joint_type(j), load(P.joint_axis() + 3 * j), load(P.joint_pos() + 3 * j), q - P.qpos0()[joint_q(j)], x, turn_b,
                  axis, anchor);
}

// Spatial inertia of a body with the orientation `turn_b` and its centre of mass at `c`, both in the world's axes.
FN void body_inertia(real* I, const Parameters& P, int b, Quat turn_b, Vec c) {
    Mat axes = matrix(turn_b * load_quat(P.inertia_quat() + 4 * b));
    spatial_inertia(I, P.mass()[b], load(P.inertia() + 3 * b), axes, c);
}

// Wrench that a body alone needs for the acceleration `a` at the velocity `v`, about the point that its inertia is about:
// I a + v x* I v, less gravity compensation and, if any act in this world, external wrenches. Its centre of mass is at `c`.
FN Spatial body_force(const real* inertia, const Parameters& P, bool is_pushed, int b, Vec c, Spatial v, Spatial a) {
    Spatial f = operator_inertia(inertia, a) + cross_force(v, operator_inertia(inertia, v));
    Vec push = (-P.mass()[b] * P.gravcomp()[b]) * load(P.gravity());
    if (!is_pushed) return Spatial{f.a - cross(c, push), f.l - push};
    const real* wrench = P.xfrc_applied() + 6 * b;
    push = push + load(wrench);
    return Spatial{f.a - load(wrench + 3) - cross(c, push), f.l - push};
}

// Force of an affine actuator with the control `x`, gain(length, speed) x + bias(length, speed), limited; `slope` is its
// derivative by the speed. Length and speed are without the actuator's gear.
FN real actuator_force(const Parameters& P, int u, real x, real length, real speed, real& slope) {
    const real *gain = P.gain() + 10 * u, *bias = P.bias() + 10 * u;
    length *= P.gear()[6 * u], speed *= P.gear()[6 * u];
    if (actuator_ctrl_limited(u)) x = clamped(x, P.ctrl_range()[2 * u], P.ctrl_range()[2 * u + 1]);
    real f = (gain[0] + gain[1] * length + gain[2] * speed) * x + bias[0] + bias[1] * length + bias[2] * speed;
    slope = gain[2] * x + bias[2];
    if (actuator_force_limited(u)) {
        const real* range = P.force_range() + 2 * u;
        if (f <= range[0] || f >= range[1]) slope = 0;  // a limited force does not change with the velocity
        f = clamped(f, range[0], range[1]);
    }
    return f;
}

// Keep the velocity of the centre of mass of a body, and its angular velocity. `x` and `v` are about the origin of its tree.
FN void keep_velocity(real* o, const Parameters& P, int b, Vec x, Quat turn_b, Spatial v) {
    const Vec c = x + rotate(turn_b, load(P.com() + 3 * b));
    store(o, v.l + cross(v.a, c)), store(o + 3, v.a);
}

}  // namespace fused
