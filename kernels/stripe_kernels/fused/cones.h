// SPDX-License-Identifier: Apache-2.0
// Cones: elliptic contacts in the Newton solver.
//
// The rows of such a contact are scaled, the normal one by mu and the others by their friction coefficients: its cost is then
// that of a round cone, and all rows have the same D. With N the normal coordinate, U the others and T = |U| it is
//
//     0                                     where N >= mu T
//     D/2 (N^2 + T^2)                       where mu N + T <= 0
//     D/2 (N - mu T)^2 / (1 + mu^2)         between: on the surface of the cone
//
// Source: MuJoCo's documentation, chapter "Computation", section "Friction cones"; the scaling follows from its formulas.

#if ELLIPTIC_CONES
namespace fused {

FN bool is_cone(const real* C) { return C[C_DIM] > 1; }

enum Zone { NO_FORCE, ALL_ROWS, SURFACE };
FN Zone zone_at(real mu, real N, real T) { return N >= mu * T ? NO_FORCE : mu * N + T <= 0 ? ALL_ROWS : SURFACE; }

// Force of row `i` of a cone, and its weight in the Hessian. On the surface the Hessian is
//     scale (P P' + k (I - Q Q')),  P = (1, -mu U/T),  Q = U/T,  k = mu (mu - N/T),  scale = D / (1 + mu^2)
// for which R_JS has Q, until J s is known, and the contact scale and scale k.
template <bool FITS>
FN void update_cone_row(World& w, real* o, int i) {
    real* C = contact_of<FITS>(w, (int)o[R_CONTACT]);
    const int first = (int)C[C_ROW], dim = (int)C[C_DIM];
    const real mu = C[C_MU], N = row_of<FITS>(w, first)[R_E], D = o[R_D];
    real square = 0;
    UNROLLED for (int k = 1; k < 6; k++) {
        const real u = k < dim ? row_of<FITS>(w, first + k)[R_E] : 0;
        square += u * u;
    }
    const real inverse = RSQRT(larger(square, (real)1e-30)), T = square * inverse;
    const Zone zone = zone_at(mu, N, T);
    const bool quadratic = zone == ALL_ROWS;
    o[R_WEIGHT] = quadratic ? D : 0, o[R_F] = quadratic ? -D * o[R_E] : 0;
    const real scale = zone == SURFACE ? QUOTIENT(D, 1 + mu * mu) : 0;
    if (zone == SURFACE) {
        const real push = -scale * (N - mu * T), q = o[R_E] * inverse;
        o[R_F] = i == first ? push : -mu * push * q, o[R_JS] = q;
    }
    if (i == first) C[C_CONE] = scale, C[C_CONE + 1] = zone == SURFACE ? scale * mu * (mu - N * inverse) : 0;
}

// What the cost of a contact along the search direction needs: U U, U V and V V, where V is J s.
template <bool FITS>
FN void prepare_line(World& w, int contacts, int lane) {
    EACH(c, contacts) {
        real* C = contact_of<FITS>(w, c);
        if (!is_cone(C)) continue;
        real uu = 0, uv = 0, vv = 0;
        UNROLLED for (int k = 1; k < 6; k++) {
            if (k >= (int)C[C_DIM]) break;
            const real *o = row_of<FITS>(w, (int)C[C_ROW] + k), u = o[R_E], v = o[R_JS];
            uu += u * u, uv += u * v, vv += v * v;
        }
        C[C_CONE] = uu, C[C_CONE + 1] = uv, C[C_CONE + 2] = vv;
    }
}

// Add slope and curvature of the costs of all cones at a step along the search direction.
template <bool FITS>
FN void add_cones(const World& w, int contacts, real step, real& slope, real& curvature, int lane) {
    EACH(c, contacts) {
        const real* C = contact_of<FITS>(w, c);
        if (!is_cone(C)) continue;
        const real *normal = row_of<FITS>(w, (int)C[C_ROW]), mu = C[C_MU], D = normal[R_D], N1 = normal[R_JS];
        const real uu = C[C_CONE], uv = C[C_CONE + 1], vv = C[C_CONE + 2], N = normal[R_E] + step * N1;
        const real along = uv + step * vv, square = uu + step * (uv + along);
        const real inverse = RSQRT(larger(square, (real)1e-30)), T = square * inverse;
        const Zone zone = zone_at(mu, N, T);
        if (zone == ALL_ROWS) slope += D * (N * N1 + along), curvature += D * (N1 * N1 + vv);
        if (zone == SURFACE) {
            const real scale = QUOTIENT(D, 1 + mu * mu), push = N - mu * T, t = along * inverse, p = N1 - mu * t;
            slope += scale * push * p, curvature += scale * (p * p - push * mu * (vv - t * t) * inverse);
        }
    }
}

// Forces of rows as they are without the scaling.
FN void unscale_forces(World& w, int contacts, int lane) {
    EACH(c, contacts) {
        const real* C = contact(w, c);
        if (!is_cone(C)) continue;
        for (int i = 0; i < (int)C[C_DIM]; i++) row(w, (int)C[C_ROW] + i)[R_F] *= i ? C[C_FRICTION + i - 1] : C[C_MU];
    }
    SYNC();
}

}  // namespace fused
#endif
