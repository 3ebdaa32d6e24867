// SPDX-License-Identifier: Apache-2.0
// Limb Newton: the method of newton.h for a hub with limbs. The Hessian couples limbs through the hub alone, so that each lane
// eliminates its limb, and what is left is a system of the hub's size, which all lanes solve.

namespace fused {

// M x, of which the hub's part is complete in all lanes.
FN void multiply(const Hub& H, const Limb* limb, const real* hub_x, real (Limb::*x)[LD], real* hub_product, real (Limb::*product)[LD]) {
    real sum[NH + 1] = {};
    for (int l = 0; l < NL; l++) {
        const Limb& L = limb[l];
        const real* own = L.*x;
        UNROLLED for (int d = 0; d < LD; d++) {
            real o = 0;
            UNROLLED for (int e = 0; e < LD; e++) o += L.A[e <= d ? PACKED(d, e) : PACKED(e, d)] * own[e];
            UNROLLED for (int h = 0; h < NH; h++) o += L.B[d * NH + h] * hub_x[h], sum[h] += L.B[d * NH + h] * own[d];
            (const_cast<Limb&>(L).*product)[d] = o;
        }
    }
    UNROLLED for (int h = 0; h < NH; h++) {
        real o = SUM(sum[h]);
        UNROLLED for (int k = 0; k < NH; k++) o += H.C[k <= h ? PACKED(h, k) : PACKED(k, h)] * hub_x[k];
        hub_product[h] = o;
    }
}

// Force on a degree of freedom by its own rows, and their weight in the Hessian.
template <int N>
FN real row_force(const JointRows<N>& r, int d, real& weight) {
    real f = 0;
    weight = 0;
    if (r.sign[d] != 0 && r.e[d] < 0) f = -r.D[d] * r.e[d] * r.sign[d], weight = r.D[d];
#if LOSSES
    if (r.loss[d] > 0) {
        real x = r.loss_D[d] * r.loss_e[d];
        if (FABS(x) < r.loss[d]) f -= x, weight += r.loss_D[d];
        else f += r.loss_e[d] < 0 ? r.loss[d] : -r.loss[d];
    }
#endif
    return f;
}

struct Line {
    real value, slope, curvature;
};
// Add what a row that pushes only has in the cost along the search direction, less that at the start.
FN void add_push(Line& o, real D, real e, real js, real step) {
    real x = e + step * js;
    if (x < 0) o.value += (real)0.5 * D * x * x, o.slope += D * x * js, o.curvature += D * js * js;
    if (e < 0) o.value -= (real)0.5 * D * e * e;
}
template <int N>
FN void add_joint_rows(Line& o, const JointRows<N>& r, const real* s, int d, real step) {
    if (r.sign[d] != 0) add_push(o, r.D[d], r.e[d], r.js[d], step);
#if LOSSES
    if (r.loss[d] > 0) {
        real D = r.loss_D[d], loss = r.loss[d], e = r.loss_e[d], x = e + step * s[d], outside = (real)0.5 * loss * loss / D;
        if (D * FABS(x) < loss) o.value += (real)0.5 * D * x * x, o.slope += D * x * s[d], o.curvature += D * s[d] * s[d];
        else o.value += loss * FABS(x) - outside, o.slope += x < 0 ? -loss * s[d] : loss * s[d];
        o.value -= D * FABS(e) < loss ? (real)0.5 * D * e * e : loss * FABS(e) - outside;
    }
#endif
}
template <int N>
FN void advance_rows(JointRows<N>& r, const real* s, int d, real step) {
    r.e[d] += step * r.js[d];
#if LOSSES
    r.loss_e[d] += step * s[d];
#endif
}

// A world's constraints: those of this lane, and those of the hub in all lanes. Contacts are an array of their own, as what lies
// beside them would have to be in memory, too.
typedef LimbContact LimbContacts[NL][LIMB_CONTACTS ? LIMB_CONTACTS : 1];
struct Constraints {
    int contacts[NL];
    JointRows<LD> limb[NL];
    JointRows<NH> hub;
};

FN Line line_at(const LimbContacts& contact, const Constraints& K, const Hub& H, const Limb* limb, real step, real q1, real q2) {
    Line o{0, 0, 0}, hub{0, 0, 0};
    for (int l = 0; l < NL; l++) {
        UNROLLED for (int d = 0; d < LD; d++) add_joint_rows(o, K.limb[l], limb[l].s, d, step);
        ROLLED for (int c = 0; c < K.contacts[l]; c++) {
            const LimbContact& k = contact[l][c];
            for (int i = 0; i < 4; i++) {
                real f = (i % 2 ? -1 : 1) * k.friction[i / 2];
                add_push(o, k.D, k.e[0] + f * k.e[1 + i / 2], k.js[0] + f * k.js[1 + i / 2], step);
            }
        }
    }
    UNROLLED for (int h = FIRST_HUB_ROW; h < NH; h++) add_joint_rows(hub, K.hub, H.s, h, step);
    return Line{SUM(o.value) + hub.value + step * q1 + (real)0.5 * step * step * q2,
                SUM(o.slope) + hub.slope + q1 + step * q2, SUM(o.curvature) + hub.curvature + q2};
}

// As `line_search` of newton.h, in which the worlds of a warp stay together.
FN real line_search(const LimbContacts& contact, const Constraints& K, const Hub& H, const Limb* limb, real q1, real q2, real accuracy, bool found, real& gain) {
    real low = 0, high = -1, step = 1, best = 0;
    gain = 0;
    ROLLED for (int i = 0; i < LINE_STEPS; i++) {
        if (!any_in_warp(!found)) break;
        Line line = line_at(contact, K, H, limb, step, q1, q2);
        if (found) continue;
        if (-line.value > gain) gain = -line.value, best = step;
        if (FABS(line.slope) <= accuracy) {
            found = true;
            continue;
        }
        if (line.slope < 0) low = step;
        else high = step;
        real next = step - line.slope / line.curvature;
        if (high < 0) next = next > low && line.curvature > 0 ? next : 2 * low;
        else if (!(next > low && next < high)) next = (real)0.5 * (low + high);
        found = next == step;
        step = next;
    }
    return best;
}

// Accelerations under the constraints, from those in `a`, and then in `s` those of the implicit step. Returns the number of
// iterations.
FN int constrained_acceleration(Hub& H, Limb* limb, LimbContacts& contact, Constraints& K, bool has_rows) {
    const real scale = (real)1 / (MEAN_INERTIA * NV);
    multiply(H, limb, H.a, &Limb::a, H.Ma, &Limb::Ma);
    bool done = false;
    int iterations = 0;
    ROLLED for (;;) {
        bool last = !any_in_warp(!done);
        real pull[NH + 1] = {}, limb_weight[NL][LD], hub_weight[NH + 1], norm = 0;
        if (!last) {
            for (int l = 0; l < NL; l++) {
                Limb& L = limb[l];
                UNROLLED for (int d = 0; d < LD; d++) L.g[d] = L.Ma[d] - L.smooth[d] - row_force(K.limb[l], d, limb_weight[l][d]);
                ROLLED for (int c = 0; c < K.contacts[l]; c++) {
                    const LimbContact& o = contact[l][c];
                    Vec f = contact_force(o);
                    UNROLLED for (int h = 0; h < NH; h++) pull[h] += o.J[0][h] * f.x + o.J[1][h] * f.y + o.J[2][h] * f.z;
                    UNROLLED for (int d = 0; d < LD; d++)
                        L.g[d] -= o.J[0][NH + d] * f.x + o.J[1][NH + d] * f.y + o.J[2][NH + d] * f.z;
                }
                UNROLLED for (int d = 0; d < LD; d++) norm += L.g[d] * L.g[d];
            }
            norm = SUM(norm);
            UNROLLED for (int h = 0; h < NH; h++) {
                H.g[h] = H.Ma[h] - H.smooth[h] - SUM(pull[h]);
                if (h < FIRST_HUB_ROW) hub_weight[h] = 0;
                else H.g[h] -= row_force(K.hub, h, hub_weight[h]);
                norm += H.g[h] * H.g[h];
            }
            if (iterations >= MAX_ITERATIONS || (iterations && scale * SQRT(norm) < TOLERANCE)) done = true;
            last = !any_in_warp(!done);
        }
        // Solve (M + J' D J) s = -g, and at last (M - h dF/dv) s = M a.
        real F[PACKED_SIZE(NH)] = {}, z[NH + 1] = {};
        real A[NL][PACKED_SIZE(LD)], W[NL][LD * NH + 1], y[NL][LD];
        for (int l = 0; l < NL; l++) {
            const Limb& L = limb[l];
            UNROLLED for (int k = 0; k < PACKED_SIZE(LD); k++) A[l][k] = L.A[k];
            UNROLLED for (int k = 0; k < LD * NH; k++) W[l][k] = L.B[k];
            UNROLLED for (int d = 0; d < LD; d++) {
                A[l][PACKED(d, d)] += last ? L.implicit[d] : limb_weight[l][d];
                y[l][d] = last ? L.Ma[d] : -L.g[d];
            }
            if (!last)
                ROLLED for (int c = 0; c < K.contacts[l]; c++) {
                    const LimbContact& o = contact[l][c];
                    real D[4];
                    for (int i = 0; i < 4; i++)
                        D[i] = o.e[0] + (i % 2 ? -1 : 1) * o.friction[i / 2] * o.e[1 + i / 2] < 0 ? o.D : 0;
                    const real f1 = o.friction[0], f2 = o.friction[1], nn = D[0] + D[1] + D[2] + D[3];
                    const real n1 = f1 * (D[0] - D[1]), n2 = f2 * (D[2] - D[3]), t1 = f1 * f1 * (D[0] + D[1]), t2 = f2 * f2 * (D[2] + D[3]);
                    if (nn == 0) continue;
                    UNROLLED for (int i = 0; i < COLUMNS; i++) {
                        const real p0 = nn * o.J[0][i] + n1 * o.J[1][i] + n2 * o.J[2][i], p1 = n1 * o.J[0][i] + t1 * o.J[1][i];
                        const real p2 = n2 * o.J[0][i] + t2 * o.J[2][i];
                        UNROLLED for (int k = 0; k <= i; k++) {
                            real x = p0 * o.J[0][k] + p1 * o.J[1][k] + p2 * o.J[2][k];
                            if (i < NH) F[PACKED(i, k)] += x;
                            else if (k < NH) W[l][(i - NH) * NH + k] += x;
                            else A[l][PACKED(i - NH, k - NH)] += x;
                        }
                    }
                }
            // A = T T', W = T^-1 B, y = T^-1 y; T's diagonal is kept as its inverse.
            UNROLLED for (int d = 0; d < LD; d++) {
                UNROLLED for (int e = 0; e < d; e++) {
                    real x = A[l][PACKED(d, e)];
                    UNROLLED for (int k = 0; k < e; k++) x -= A[l][PACKED(d, k)] * A[l][PACKED(e, k)];
                    x *= A[l][PACKED(e, e)];
                    A[l][PACKED(d, e)] = x;
                    y[l][d] -= x * y[l][e];
                    UNROLLED for (int h = 0; h < NH; h++) W[l][d * NH + h] -= x * W[l][e * NH + h];
                }
                real square = A[l][PACKED(d, d)];
                UNROLLED for (int k = 0; k < d; k++) square -= A[l][PACKED(d, k)] * A[l][PACKED(d, k)];
                const real inverse = RSQRT(larger(square, (real)1e-30));
                A[l][PACKED(d, d)] = inverse;
                y[l][d] *= inverse;
                UNROLLED for (int h = 0; h < NH; h++) {
                    W[l][d * NH + h] *= inverse;
                    z[h] -= W[l][d * NH + h] * y[l][d];
                }
                UNROLLED for (int h = 0; h < NH; h++)
                    UNROLLED for (int k = 0; k <= h; k++) F[PACKED(h, k)] -= W[l][d * NH + h] * W[l][d * NH + k];
            }
        }
        UNROLLED for (int h = 0; h < NH; h++) {
            UNROLLED for (int k = 0; k <= h; k++) F[PACKED(h, k)] = H.C[PACKED(h, k)] + SUM(F[PACKED(h, k)]);
            F[PACKED(h, h)] += last ? H.implicit[h] : hub_weight[h];
            z[h] = SUM(z[h]) + (last ? H.Ma[h] : -H.g[h]);
        }
        UNROLLED for (int h = 0; h < NH; h++) {
            UNROLLED for (int k = 0; k < h; k++) {
                real x = F[PACKED(h, k)];
                UNROLLED for (int i = 0; i < k; i++) x -= F[PACKED(h, i)] * F[PACKED(k, i)];
                F[PACKED(h, k)] = x *= F[PACKED(k, k)];
                z[h] -= x * z[k];
            }
            real square = F[PACKED(h, h)];
            UNROLLED for (int k = 0; k < h; k++) square -= F[PACKED(h, k)] * F[PACKED(h, k)];
            F[PACKED(h, h)] = RSQRT(larger(square, (real)1e-30));
            z[h] *= F[PACKED(h, h)];
        }
        UNROLLED for (int h = NH - 1; h >= 0; h--) {
            UNROLLED for (int k = h + 1; k < NH; k++) z[h] -= F[PACKED(k, h)] * H.s[k];
            H.s[h] = z[h] * F[PACKED(h, h)];
        }
        for (int l = 0; l < NL; l++)
            UNROLLED for (int d = LD - 1; d >= 0; d--) {
                real x = y[l][d];
                UNROLLED for (int h = 0; h < NH; h++) x -= W[l][d * NH + h] * H.s[h];
                UNROLLED for (int e = d + 1; e < LD; e++) x -= A[l][PACKED(e, d)] * limb[l].s[e];
                limb[l].s[d] = x * A[l][PACKED(d, d)];
            }
        if (last) break;
        multiply(H, limb, H.s, &Limb::s, H.Ms, &Limb::Ms);
        real q1 = 0, q2 = 0, fall = 0;
        for (int l = 0; l < NL; l++) {
            Limb& L = limb[l];
            UNROLLED for (int d = 0; d < LD; d++) {
                q1 += L.s[d] * (L.Ma[d] - L.smooth[d]), q2 += L.s[d] * L.Ms[d], fall -= L.s[d] * L.g[d];
                K.limb[l].js[d] = K.limb[l].sign[d] * L.s[d];
            }
            ROLLED for (int c = 0; c < K.contacts[l]; c++) {
                LimbContact& o = contact[l][c];
                real js[3] = {0, 0, 0};
                for (int k = 0; k < 3; k++) {
                    UNROLLED for (int h = 0; h < NH; h++) js[k] += o.J[k][h] * H.s[h];
                    UNROLLED for (int d = 0; d < LD; d++) js[k] += o.J[k][NH + d] * L.s[d];
                    o.js[k] = js[k];
                }
            }
        }
        q1 = SUM(q1), q2 = SUM(q2), fall = SUM(fall);
        UNROLLED for (int h = 0; h < NH; h++) {
            q1 += H.s[h] * (H.Ma[h] - H.smooth[h]), q2 += H.s[h] * H.Ms[h], fall -= H.s[h] * H.g[h];
            if (h >= FIRST_HUB_ROW) K.hub.js[h] = K.hub.sign[h] * H.s[h];
        }
        real gain, step = line_search(contact, K, H, limb, q1, q2, LINE_TOLERANCE * (2 * FABS(q1) + fall), done || !has_rows, gain);
        if (!has_rows) step = 1, gain = (real)0.5 * fall;
        if (done) continue;
        UNROLLED for (int h = 0; h < NH; h++) {
            H.a[h] += step * H.s[h], H.Ma[h] += step * H.Ms[h];
            if (h >= FIRST_HUB_ROW) advance_rows(K.hub, H.s, h, step);
        }
        for (int l = 0; l < NL; l++) {
            Limb& L = limb[l];
            UNROLLED for (int d = 0; d < LD; d++) {
                L.a[d] += step * L.s[d], L.Ma[d] += step * L.Ms[d];
                advance_rows(K.limb[l], L.s, d, step);
            }
            ROLLED for (int c = 0; c < K.contacts[l]; c++)
                for (int k = 0; k < 3; k++) contact[l][c].e[k] += step * contact[l][c].js[k];
        }
        if (step != 0) iterations++;
        if (step == 0 || scale * gain < TOLERANCE) done = true;
    }
    return iterations;
}

}  // namespace fused
