// SPDX-License-Identifier: Apache-2.0
// Wrench solve: the linear system of a Newton iteration where contacts have no Jacobians (wrench_rows.h), in the registers of
// a world's lanes. Lane i has row ABOVE + i of A = M + J' D J. The first ABOVE rows are more than there are lanes: each has
// only as many numbers up to the diagonal, and the first lanes have one of them, too.

#if WRENCH_ROWS && IN_REGISTERS
namespace fused {

enum { ABOVE = NV > LANES ? NV - LANES : 0, ABOVE_SIZE = ABOVE ? ABOVE : 1 };

// Add the Hessian of the constraints to the rows of a lane: `r` with its diagonal, of the degree of freedom `own`, and
// `t`, of `above`.
template <bool FITS>
FN void add_constraints(World& w, int rows, int contacts, int own, int above, real* r, real& diagonal, real* t, int lane) {
    const int joint_rows = joint_rows_of<FITS>(w, rows, contacts);
    ROLLED for (int i = 0; i < joint_rows; i++) {
        const real *o = row_of<FITS>(w, i), weight = o[R_WEIGHT];
        if ((int)o[R_DOF] == own) diagonal += weight;
        UNROLLED for (int j = 0; j < ABOVE; j++) if ((int)o[R_DOF] == j && above == j) t[j] += weight;
    }
    ROLLED for (int c = 0; c < contacts;) {
        const Group g = group_of<FITS>(w, c, rows, contacts);
        c = g.next;
        add_up_stiffness<FITS>(w, g, lane);
        const Spatial s = sign_of(g, own) * motion_of(w, own), U = stiffness_times(w, s);
        const Spatial T = ABOVE ? stiffness_times(w, sign_of(g, above) * motion_of(w, above)) : U;
        diagonal += dot(s, U);
        const unsigned long long both = g.first | g.second;
        UNROLLED for (int j = 0; j < NV; j++) {
            if (!(both >> j & 1)) continue;  // the same for all lanes
            const Spatial other = motion_of(w, j);
            const real sign = g.second >> j & 1 ? 1 : -1;
            r[j] += sign * dot(other, U);
            if (j < ABOVE) t[j < ABOVE ? j : 0] += sign * dot(other, T);
        }
    }
}

// Solve A w.s = sign b, with b the field `right`, by A = L D L'. Columns of L D are kept above the diagonal of M, and the lanes
// read them as fours. They do not wait for 1/D, which takes as long to compute as they take to be there. What a lane has
// beyond the turn of its row is of no use, and is not masked.
template <bool FITS>
ONE_COPY void solve(World& of, int rows, int contacts, real (World::*right)[NV], real sign, int lane) {
    World& w = in_place(of);
    const bool has_row = ABOVE + lane < NV;
    const int own = has_row ? ABOVE + lane : 0, turn = has_row ? own : -1, above = lane < ABOVE ? lane : 0;
    real r[4 * NFOURS], t[ABOVE_SIZE];
    UNROLLED for (int g = 0; g < NFOURS; g++) {
        const Four four = ((const Four*)(w.M + own * LD))[g];
        UNROLLED for (int k = 0; k < 4; k++) r[4 * g + k] = four.x[k];
    }
    UNROLLED for (int j = 0; j < ABOVE; j++) t[j] = w.M[above * LD + j];
    real diagonal = w.M[own * LD + own], y = sign * (w.*right)[own], z = sign * (w.*right)[above];
    add_constraints<FITS>(w, rows, contacts, own, above, r, diagonal, t, lane);
    SYNC();  // all have read their rows
    real own_scale = 0, scales[ABOVE_SIZE] = {0};
    UNROLLED for (int j = 0; j < NV; j++) {
        const int from = j < ABOVE ? j : j - ABOVE;  // the lane whose row has its turn; those before are done
        if (turn > j) w.M[j * LD + turn] = r[j];
        if (lane > j && lane < ABOVE) w.M[j * LD + lane] = t[j < ABOVE ? j : 0];
        const real pivot = from_lane(j < ABOVE ? t[j < ABOVE ? j : 0] : diagonal, from), yj = from_lane(j < ABOVE ? z : y, from);
        const real scale = RECIPROCAL(larger(pivot, (real)1e-30)), l = r[j] * scale;
        y -= l * yj, diagonal -= l * r[j];
        if (j < ABOVE) scales[j < ABOVE ? j : 0] = scale;
        else if (own == j) own_scale = scale;
        w.s[j] = scale * yj;  // all lanes write the same
        SYNC();
        UNROLLED for (int g = (j + 1) / 4; g < NFOURS; g++) {
            const Four four = ((const Four*)(w.M + j * LD))[g];
            UNROLLED for (int k = 0; k < 4; k++)
                if (4 * g + k > j && 4 * g + k < NV) r[4 * g + k] -= l * four.x[k];
        }
        if (j + 1 < ABOVE) {
            const real m = t[j < ABOVE ? j : 0] * scale;
            if (lane > j) z -= m * yj;
            UNROLLED for (int k = j + 1; k < ABOVE; k++) t[k] -= m * w.M[j * LD + k];
        }
    }
    // x = D^-1 y - (L' - 1) x, with rows of L' in a lane.
    y = w.s[own];
    UNROLLED for (int g = 0; g < NFOURS; g++) {
        const Four four = ((const Four*)(w.M + own * LD))[g];
        UNROLLED for (int k = 0; k < 4; k++) r[4 * g + k] = own_scale * four.x[k];
    }
    UNROLLED for (int j = NV - 1; j >= ABOVE; j--) {
        const real x = from_lane(y, j - ABOVE);
        w.s[j] = x;
        y -= r[j] * x;
    }
    SYNC();
    if (ABOVE) {
        real x[ABOVE_SIZE], sums[ABOVE_SIZE] = {0};
        UNROLLED for (int j = 0; j < ABOVE; j++) x[j] = w.s[j], sums[j] = has_row ? w.M[j * LD + own] * w.s[own] : 0;
        sum_each<ABOVE_SIZE>(sums);
        UNROLLED for (int j = ABOVE - 1; j >= 0; j--) {
            UNROLLED for (int k = j + 1; k < ABOVE; k++) sums[j] += w.M[j * LD + k] * x[k];
            x[j] -= scales[j] * sums[j];
        }
        SYNC();
        UNROLLED for (int j = 0; j < ABOVE; j++) w.s[j] = x[j];
        SYNC();
    }
}

// M x into `product`, which may lie where the lanes have just read something else.
FN void multiply(const World& w, const real* x, real* product, int lane) {
    const bool has_row = ABOVE + lane < NV;
    const int own = has_row ? ABOVE + lane : 0;
    real sum = 0, sums[ABOVE_SIZE] = {0};
    UNROLLED for (int g = 0; g < NFOURS; g++) {
        const Four row = ((const Four*)(w.M + own * LD))[g], four = ((const Four*)x)[g];
        UNROLLED for (int k = 0; k < 4; k++) {
            const int j = 4 * g + k;
            if (j < NV) sum += (j <= own ? row.x[k] : w.M[j * LD + own]) * four.x[k];
            if (j < ABOVE) sums[j < ABOVE ? j : 0] = has_row ? row.x[k] * x[own] : 0;
        }
    }
    if (ABOVE) {
        sum_each<ABOVE_SIZE>(sums);
        UNROLLED for (int i = 0; i < ABOVE; i++)
            UNROLLED for (int j = 0; j < ABOVE; j++) sums[i] += mass_matrix(w, i, j) * x[j];
    }
    SYNC();
    UNROLLED for (int i = 0; i < ABOVE; i++) product[i] = sums[i];  // all lanes write the same
    if (has_row) product[own] = sum;
    SYNC();
}

}  // namespace fused
#endif
