// SPDX-License-Identifier: Apache-2.0
// Rows: arrays in the memory of the device that have a row for each world. The lanes of a warp read and write the rows of its
// worlds one after another, so that each access is to numbers that lie side by side: the few lanes of a world would take a
// part of 32 bytes each, of which a GPU always moves all.

namespace fused {

// The worlds whose rows these lanes handle together: `first` and those behind it, of which the first has the number `id`. Each
// lane begins at the number `start` of a row and goes on by `step`.
struct Rows {
    World* first;
    int id, worlds, start, step;
};
#if IN_SHARED && defined(__CUDA_ARCH__) && LANES < 32
enum { WORLDS_OF_WARP = 32 / LANES };
FN Rows rows_of(World& w, const Parameters& P, int lane) {
    const int own = threadIdx.x % 32 / LANES, id = P.id - own, left = P.num_worlds - id;
    const int worlds = left < WORLDS_OF_WARP ? left : WORLDS_OF_WARP;  // lanes without a world have left
    return Rows{&w - own, id, worlds, (int)threadIdx.x % 32, worlds * LANES};
}
#else
enum { WORLDS_OF_WARP = 1 };
FN Rows rows_of(World& w, const Parameters& P, int lane) { return Rows{&w, P.id, 1, lane, LANES}; }
#endif

#ifdef __CUDA_ARCH__
enum { IN_FLIGHT = 8, FEW_IN_FLIGHT = 4 };  // loads of a lane that wait for the memory together
#else
enum { IN_FLIGHT = 1, FEW_IN_FLIGHT = 1 };
#endif

// Whether a row has the number `i`, and these lanes handle a world with the index `k`.
FN bool is_in_rows(const Rows& r, int k, int i, int size) { return i < size && (k == 0 || k < r.worlds); }

// put(world, id, i, get(world, id, i)) for the numbers i < N of the row of each world, which has the number `id`. A lane has
// the same number of all worlds, so that what depends on the number alone is computed once.
template <int N, int AT_ONCE = IN_FLIGHT, class Get, class Put>
FN void read_rows(const Rows& r, Get get, Put put) {
    enum {
        WORLDS = AT_ONCE < WORLDS_OF_WARP ? AT_ONCE : WORLDS_OF_WARP,
        NEEDED = (N + WORLDS_OF_WARP * LANES - 1) / (WORLDS_OF_WARP * LANES),
        TURNS = NEEDED < AT_ONCE / WORLDS ? (NEEDED ? NEEDED : 1) : AT_ONCE / WORLDS,
    };
    ROLLED for (int at = r.start; at < N; at += TURNS * r.step)
        ROLLED for (int first = 0; first < WORLDS_OF_WARP; first += WORLDS) {
            real x[TURNS][WORLDS];
            UNROLLED for (int t = 0; t < TURNS; t++)
                UNROLLED for (int k = 0; k < WORLDS; k++) {
                    const int i = at + t * r.step, world = first + k;
                    x[t][k] = is_in_rows(r, world, i, N) ? get(r.first[world], r.id + world, i) : 0;
                }
            UNROLLED for (int t = 0; t < TURNS; t++)
                UNROLLED for (int k = 0; k < WORLDS; k++) {
                    const int i = at + t * r.step, world = first + k;
                    if (is_in_rows(r, world, i, N)) put(r.first[world], r.id + world, i, x[t][k]);
                }
        }
}
// put(world, id, i) for the same.
template <int N, class Put>
FN void write_rows(const Rows& r, Put put) {
    ROLLED for (int i = r.start; i < N; i += r.step)
        UNROLLED for (int k = 0; k < WORLDS_OF_WARP; k++)
            if (is_in_rows(r, k, i, N)) put(r.first[k], r.id + k, i);
}
// Number of a row of an array with a stride.
#define IN_ROW(name, id, i) (((real*)P.m.name)[(long long)(id) * P.m.name##_stride + (i)])

}  // namespace fused
