// SPDX-License-Identifier: Apache-2.0
// Algebra: vectors, quaternions (w, x, y, z), spatial vectors and inertias, and the lanes that share a world.

#ifdef FUSED_DOUBLE
typedef double real;
#define SQRT sqrt
#define RSQRT(x) (1 / sqrt(x))
#define QUOTIENT(a, b) ((a) / (b))
#define RECIPROCAL(x) (1 / (x))
#define SINCOS(x, s, c) s = sin(x), c = cos(x)
#define POW pow
#define FABS fabs
#define ATAN2 atan2
#define PARALLEL 1e-15
#else
typedef float real;
#define SQRT sqrtf
#ifdef __CUDA_ARCH__
#define QUOTIENT __fdividef  // to 2 units in the last place
#define RECIPROCAL reciprocal
#define RSQRT rsqrtf
#define SINCOS(x, s, c) sincosf(x, &s, &c)
#else
#define QUOTIENT(a, b) ((a) / (b))
#define RECIPROCAL(x) (1 / (x))
#define RSQRT(x) (1 / sqrtf(x))
#define SINCOS(x, s, c) s = sinf(x), c = cosf(x)
#endif
#define POW powf
#define FABS fabsf
#define ATAN2 atan2f
#define PARALLEL 1e-10f
#endif

#ifdef __CUDA_ARCH__
#if LIMBS  // else parameters, which a GPU has at hand as constants, are copied for functions that are not inlined
#define FN static __device__ __forceinline__
#else
#define FN static __device__ inline
#endif
#define FN_METHOD __device__
#define COLD static __device__ __noinline__  // seldom run: out of the way of what is
#define ONE_COPY COLD                        // used in several places: instructions must be fetched, too
// A loop that stays one: a world goes through the code once in a step, so that fetching instructions takes longer than what
// is saved by copies of them.
#define ROLLED _Pragma("unroll 1")
#define UNROLLED _Pragma("unroll")
#define TABLE static __device__ const  // lanes read different elements, which constant memory would serve one by one
#else
#define FN static inline
#define FN_METHOD
#define COLD static
#define ONE_COPY FN
#define ROLLED
#define UNROLLED
#define TABLE static const
#endif

// A world is computed by LANES lanes of a warp, which other worlds may share, or by one thread. EACH spreads a loop over the
// lanes; after it, SYNC makes what they wrote visible to each other. SUM adds over the lanes and gives all of them the result,
// in a fixed order.
#define EACH(i, n) ROLLED for (int i = lane; i < (n); i += LANES)
#if LANES > 1
#ifdef __CUDA_ARCH__
// The lanes of this world, of those of the warp; all of them in a form whose worlds stay together.
FN unsigned own_lanes() {
    return LIMBS || LANES == 32 ? 0xffffffffu : ((1u << LANES % 32) - 1) << (threadIdx.x % 32 / LANES * LANES);
}
#else
FN unsigned own_lanes() { return 0; }
#endif
#define SYNC() __syncwarp(own_lanes())
#define SYNC_WARP() __syncwarp(0xffffffffu)  // what lanes of other worlds wrote, too
// Whether something holds in any lane.
#define ANY(x) __any_sync(own_lanes(), x)
// In which lanes something holds: a bit for each.
#define BALLOT(holds) (__ballot_sync(own_lanes(), holds) >> (LANES == 32 ? 0 : threadIdx.x % 32 / LANES * LANES))
// 1 / x to 1 unit in the last place, for x that are not tiny.
FN float reciprocal(float x) {
#ifdef __CUDACC__
    asm("rcp.approx.ftz.f32 %0, %0;" : "+f"(x));
    return x;
#else
    return 1 / x;
#endif
}
// What another lane has, by its number in the world.
FN real from_lane(real x, int lane) { return __shfl_sync(own_lanes(), x, lane, LANES); }
// Sum of `mine` over the lanes before this one, and over all lanes.
#define BEFORE(mine, before, all)                                         \
    {                                                                     \
        int sum_ = mine;                                                  \
        for (int o = 1; o < LANES; o <<= 1) {                             \
            int other_ = __shfl_up_sync(own_lanes(), sum_, o, LANES);     \
            if (lane >= o) sum_ += other_;                                \
        }                                                                 \
        before = sum_ - mine;                                             \
        all = __shfl_sync(own_lanes(), sum_, LANES - 1, LANES);           \
    }
// Number of lanes before this one, and of all, in which something holds.
#define RANK(holds, before, all)                                              \
    {                                                                         \
        unsigned votes_ = BALLOT(holds);                                      \
        before = __popc(votes_ & ((1u << lane) - 1)), all = __popc(votes_);   \
    }
// The lowest of the lanes that a ballot names.
FN int first_lane(unsigned votes) { return __popc((votes & (0u - votes)) - 1); }
FN real SUM(real x) {
    for (int o = LANES / 2; o; o >>= 1) x += __shfl_xor_sync(own_lanes(), x, o, LANES);
    return x;
}
// SUM of each of N numbers, which wait for each other's lanes together.
template <int N>
FN void sum_each(real* x) {
    UNROLLED for (int o = LANES / 2; o; o >>= 1) {
        real other[N];
        UNROLLED for (int k = 0; k < N; k++) other[k] = __shfl_xor_sync(own_lanes(), x[k], o, LANES);
        UNROLLED for (int k = 0; k < N; k++) x[k] += other[k];
    }
}
#else
#define SYNC()
#define SYNC_WARP()
#define ANY(x) (x)
#define BALLOT(holds) (holds)
#define BEFORE(mine, before, all)
#define RANK(holds, before, all) before = 0, all = holds
FN int first_lane(unsigned) { return 0; }
FN real SUM(real x) { return x; }
template <int N>
FN void sum_each(real*) {}
#endif

namespace fused {

FN real smaller(real a, real b) { return a < b ? a : b; }
FN real larger(real a, real b) { return a > b ? a : b; }
FN real clamped(real x, real low, real high) { return x < low ? low : (x > high ? high : x); }

struct Vec {
    real x, y, z;
};
FN Vec operator+(Vec a, Vec b) { return Vec{a.x + b.x, a.y + b.y, a.z + b.z}; }
FN Vec operator-(Vec a, Vec b) { return Vec{a.x - b.x, a.y - b.y, a.z - b.z}; }
FN Vec operator*(real s, Vec b) { return Vec{s * b.x, s * b.y, s * b.z}; }
FN real dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
FN Vec cross(Vec a, Vec b) { return Vec{a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
FN Vec load(const real* p) { return Vec{p[0], p[1], p[2]}; }
FN void store(real* p, Vec v) { p[0] = v.x, p[1] = v.y, p[2] = v.z; }

struct Quat {
    real w, x, y, z;
};
FN Quat load_quat(const real* p) { return Quat{p[0], p[1], p[2], p[3]}; }
FN void store_quat(real* p, Quat q) { p[0] = q.w, p[1] = q.x, p[2] = q.y, p[3] = q.z; }
FN Quat operator*(Quat a, Quat b) {
    return Quat{a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z, a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
                a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}
FN Quat conjugate(Quat q) { return Quat{q.w, -q.x, -q.y, -q.z}; }
FN Quat normalized(Quat q) {
    real n = SQRT(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    if (n < (real)1e-15) return Quat{1, 0, 0, 0};
    real s = 1 / n;
    return Quat{s * q.w, s * q.x, s * q.y, s * q.z};
}
FN Quat turn(Vec axis, real angle) {
    real s, c;
    SINCOS((real)0.5 * angle, s, c);
    return Quat{c, s * axis.x, s * axis.y, s * axis.z};
}
FN Vec rotate(Quat q, Vec v) {
    Vec u{q.x, q.y, q.z}, t = 2 * cross(u, v);
    return v + q.w * t + cross(u, t);
}
// Rotation by the vector `w` [rad]: its direction is the axis, its length the angle.
FN Quat turn_by(Vec w) {
    real n = SQRT(dot(w, w));
    if (n < (real)1e-15) return Quat{1, 0, 0, 0};
    return turn((1 / n) * w, n);
}

struct Mat {  // rows
    Vec r0, r1, r2;
};
FN Mat matrix(Quat q) {
    return Mat{{1 - 2 * (q.y * q.y + q.z * q.z), 2 * (q.x * q.y - q.w * q.z), 2 * (q.x * q.z + q.w * q.y)},
               {2 * (q.x * q.y + q.w * q.z), 1 - 2 * (q.x * q.x + q.z * q.z), 2 * (q.y * q.z - q.w * q.x)},
               {2 * (q.x * q.z - q.w * q.y), 2 * (q.y * q.z + q.w * q.x), 1 - 2 * (q.x * q.x + q.y * q.y)}};
}
FN Mat load_matrix(const real* p) { return Mat{load(p), load(p + 3), load(p + 6)}; }
FN void store_matrix(real* p, Mat m) { store(p, m.r0), store(p + 3, m.r1), store(p + 6, m.r2); }
FN Vec operator*(Mat m, Vec v) { return Vec{dot(m.r0, v), dot(m.r1, v), dot(m.r2, v)}; }
FN Vec column(Mat m, int i) {
    return i == 0 ? Vec{m.r0.x, m.r1.x, m.r2.x} : i == 1 ? Vec{m.r0.y, m.r1.y, m.r2.y} : Vec{m.r0.z, m.r1.z, m.r2.z};
}
FN Mat transposed(Mat m) { return Mat{column(m, 0), column(m, 1), column(m, 2)}; }

// Spatial vectors (angular, linear) about a point, in the world's axes. Source: R. Featherstone, "Rigid Body Dynamics
// Algorithms", Springer, 2008, chapter 2.
struct Spatial {
    Vec a, l;
};
FN Spatial load_spatial(const real* p) { return Spatial{load(p), load(p + 3)}; }
FN void store_spatial(real* p, Spatial s) { store(p, s.a), store(p + 3, s.l); }
FN Spatial operator+(Spatial p, Spatial q) { return Spatial{p.a + q.a, p.l + q.l}; }
FN Spatial operator*(real s, Spatial p) { return Spatial{s * p.a, s * p.l}; }
FN real dot(Spatial p, Spatial q) { return dot(p.a, q.a) + dot(p.l, q.l); }
FN Spatial cross_motion(Spatial v, Spatial s) { return Spatial{cross(v.a, s.a), cross(v.a, s.l) + cross(v.l, s.a)}; }
FN Spatial cross_force(Spatial v, Spatial f) { return Spatial{cross(v.a, f.a) + cross(v.l, f.l), cross(v.a, f.l)}; }

// Spatial inertia about a point: mass, mass times centre of mass, and the rotational inertia about the point, as ten
// numbers: m, mc, xx, yy, zz, xy, xz, yz.
FN Spatial operator_inertia(const real* I, Spatial v) {
    Vec mc = load(I + 1);
    Vec turned{I[4] * v.a.x + I[7] * v.a.y + I[8] * v.a.z, I[7] * v.a.x + I[5] * v.a.y + I[9] * v.a.z,
               I[8] * v.a.x + I[9] * v.a.y + I[6] * v.a.z};
    return Spatial{turned + cross(mc, v.l), I[0] * v.l + cross(v.a, mc)};
}
// Of a body with principal moments of inertia `moments` in the axes of `R`, and its centre of mass at `c`.
FN void spatial_inertia(real* I, real mass, Vec moments, Mat R, Vec c) {
    Vec a0 = {moments.x * R.r0.x, moments.y * R.r0.y, moments.z * R.r0.z};  // rows of R diag(moments)
    Vec a1 = {moments.x * R.r1.x, moments.y * R.r1.y, moments.z * R.r1.z};
    Vec a2 = {moments.x * R.r2.x, moments.y * R.r2.y, moments.z * R.r2.z};
    real cc = dot(c, c);
    I[0] = mass;
    store(I + 1, mass * c);
    I[4] = dot(a0, R.r0) + mass * (cc - c.x * c.x);
    I[5] = dot(a1, R.r1) + mass * (cc - c.y * c.y);
    I[6] = dot(a2, R.r2) + mass * (cc - c.z * c.z);
    I[7] = dot(a0, R.r1) - mass * c.x * c.y;
    I[8] = dot(a0, R.r2) - mass * c.x * c.z;
    I[9] = dot(a1, R.r2) - mass * c.y * c.z;
}

}  // namespace fused
