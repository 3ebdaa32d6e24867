// SPDX-License-Identifier: Apache-2.0
// Impedance: how stiff and damped a constraint is, and its regularisation.
// Formulas: MuJoCo's documentation, chapter "Computation", section "Solver parameters".

namespace fused {

struct Impedance {
    real k, b, imp;  // stiffness, damping and impedance of a row
};

// Impedance of a row at the distance `pos` from its reference: solref is `time`, `ratio`, and solimp the five that follow.
ONE_COPY Impedance impedance_of(real h, real time, real ratio, real dmin, real dmax, real width, real middle, real power,
                                real pos) {
    const real least = (real)1e-4, most = (real)0.9999;
    bool is_step = width <= (real)1e-15;
    dmin = clamped(dmin, least, most), dmax = clamped(dmax, least, most);
    width = larger(width, (real)1e-15), middle = clamped(middle, least, most), power = larger(power, 1);
    real x = FABS(pos) / width, y = x;
    if (x >= 1) y = 1;
    else if (power == 2) y = x <= middle ? x * x / middle : 1 - (1 - x) * (1 - x) / (1 - middle);
    else if (power > 1) {
        real part = x <= middle ? x : 1 - x, whole = x <= middle ? middle : 1 - middle;
        y = POW(part, power) / POW(whole, power - 1);
        if (x > middle) y = 1 - y;
    }
    Impedance r;
    r.imp = dmin == dmax || is_step ? (real)0.5 * (dmin + dmax) : dmin + y * (dmax - dmin);
    if (time > 0) {
        if (REFSAFE) time = larger(time, 2 * h);
        r.k = 1 / larger((real)1e-15, dmax * dmax * time * time * ratio * ratio);
        r.b = 2 / larger((real)1e-15, dmax * time);
    } else
        r.k = -time / (dmax * dmax), r.b = -ratio / dmax;
    return r;
}
FN Impedance impedance(const Parameters& P, const real* solref, const real* solimp, real pos) {
    return impedance_of(P.step_size(), solref[0], solref[1], solimp[0], solimp[1], solimp[2], solimp[3], solimp[4], pos);
}

FN real regularization(real imp, real weight) { return larger((real)1e-15, (1 - imp) / imp * weight); }

}  // namespace fused
