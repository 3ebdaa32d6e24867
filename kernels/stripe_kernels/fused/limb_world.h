// SPDX-License-Identifier: Apache-2.0
// Limb world: the state of a world in a step of the form for a hub with limbs.
//
// A robot that walks is a hub, its trunk, with limbs: chains that hang on the hub and touch nothing that moves. Then the
// limbs' degrees of freedom are coupled through the hub's alone, and a lane computes a limb: few lanes share a world, and
// what a lane knows of its limb is in its registers. Bodies and the state are in shared memory.
//
// The generated part defines NSLOTS, the limbs up to a power of two, LIMB_DOFS, those of the longest limb, HUB_DOFS,
// HUB_BODIES, NPLANES and tables: of slots without a limb the size is 0.

namespace fused {

enum {
    NL = NSLOTS / LANES,  // limbs of a lane: all in the form of a thread a world
    LD = LIMB_DOFS,
    NH = HUB_DOFS,
    COLUMNS = NH + LD,    // degrees of freedom that a contact of a limb, or of the hub, may move
    FIRST_HUB_ROW = HUB_IS_FREE && !LOSSES ? 6 : 0,  // those of the hub before it have no rows: nothing limits a free joint
};

// Bodies that move as one: a link, and what is welded to it.
struct LinkParameters {
    real inertia[10];  // in the frame of the link, about its origin, as of `operator_inertia`
    real special;      // 1 if gravity compensation or an external wrench acts on one of them, 0 if not
};
// What a degree of freedom has beside the bodies that it moves.
struct DofParts {
    real armature, smooth, implicit;
    real sign, D, e;  // of its limit
#if LOSSES
    real loss, loss_D, loss_e;
#endif
};

enum {
    SOME_HUB = HUB_BODIES ? HUB_BODIES : 1,
    LINK_SIZE = 11,
    PARTS_SIZE = LOSSES ? 9 : 6,
    LINKS_SIZE = PARTS_SIZE * (NH ? NH : 1) + LINK_SIZE * (SOME_HUB + NSLOTS * LD) + 6 * (NPLANES ? NPLANES : 1) + 12 * NGROUNDS,
    BODIES_SIZE = 7 * NB + 6 * (NH ? NH : 1) + 12 * SOME_HUB,
    DRIVES_SIZE = 5 * NV + NQ,
    WORLD_SIZE = NQ + 4 * NV + NU + NTURNED + 3 * NTREES + (BODIES_SIZE > DRIVES_SIZE ? BODIES_SIZE : DRIVES_SIZE) + 2 +
                 (LINKS_SIZE > 6 * NB ? LINKS_SIZE : 6 * NB),
};
struct World {
    real q[NQ];                     // positions
    real v[NV];                     // velocities
    real a[NV];                     // accelerations (at first the warm start)
    real applied[NV], ctrl[NU];     // forces on joints from outside, controls
    real effort[NV];                // forces of actuators on joints
    float turned[NTURNED];          // free joints and balls as Newton has them
    int has_kinematic, is_pushed;   // whether a body is kinematic, and whether external wrenches act
    real origin[NTREES * 3];        // of each tree: where its root body is, in the world [m]; tree 0 is the world
    union {
        struct {
            real pos[NB * 3], quat[NB * 4];  // body frames relative to the origin of their tree
            real S[6 * (NH ? NH : 1)];       // motion of each degree of freedom of the hub
            real hub[12 * SOME_HUB];         // velocity, and acceleration without that of the joints, of its bodies
        };
        real drive_rows[DRIVES_SIZE];  // between steps: what efforts of drives follow from, see per_step.h
    };
    union {
        struct {  // in all steps
            LinkParameters hub_link[SOME_HUB], link[NSLOTS * LD];  // of the hub's bodies; of limbs at the last freedom of a body
            real planes[6 * (NPLANES ? NPLANES : 1)];  // a point and the normal of each plane, in the world
#if NGROUNDS
            real grounds[12 * NGROUNDS];  // position and axes of height fields and meshes, relative to the origin of their tree
#endif
            DofParts hub_parts[NH ? NH : 1];
        };
        real velocities[6 * NB];  // after them: see `keep_velocity`
    };
    real gap[1 + WORLD_SIZE % 2];   // an odd size in all: lanes that read the same of their worlds share no bank
};

FN real* body_velocities(World& w) { return w.velocities; }
// What joints are driven with in each step: few lanes share a world, so that they keep it at hand.
#define APPLIED(w, id, i) ((w).applied[i])
#define CONTROL(w, id, u) ((w).ctrl[u])
#define EFFORT(w, id, i) ((w).effort[i])

#if IN_SHARED && defined(__CUDA_ARCH__)
FN World& in_place() {
    extern __shared__ char dynamic_smem_base[];
    return ((World*)(dynamic_smem_base + sizeof(Tables)))[threadIdx.x / LANES];
}
#endif

// The limb of a lane with the number `l` among its own.
FN int slot_of(int l, int lane) { return lane + l * LANES; }

// Whether something holds in any lane of the warp: its worlds stay together, as all lanes take part when they tell each
// other something.
#ifdef __CUDA_ARCH__
FN bool any_in_warp(bool holds) { return __any_sync(0xffffffffu, holds); }
#else
FN bool any_in_warp(bool holds) { return holds; }
#endif
// Whether all lanes of a warp search for the touches of parts on height fields and meshes together.
#ifdef __CUDA_ARCH__
#define WARP_SEARCHES HAS_SEARCHES
#else
#define WARP_SEARCHES 0
#endif
// Whether something holds in any lane of this world.
#define IN_ANY(x) ((BALLOT((x) != 0) & (1u << LANES % 32) - 1) != 0)

// Place in the lower triangle of a symmetric matrix, whose rows lie one after another.
#define PACKED(i, j) ((i) * ((i) + 1) / 2 + (j))
#define PACKED_SIZE(n) ((n) ? (n) * ((n) + 1) / 2 : 1)

struct Hub {
    real C[PACKED_SIZE(NH)];  // mass matrix of its degrees of freedom
    real a[NH + 1], Ma[NH + 1];
    real smooth[NH + 1];      // forces but for those of constraints
    real implicit[NH + 1];    // what the implicit step has beside the mass matrix
    real g[NH + 1], s[NH + 1], Ms[NH + 1];  // gradient, search direction, M s
};
struct Limb {
    Spatial S[LD];
    real A[PACKED_SIZE(LD)];  // mass matrix of its degrees of freedom
    real B[LD * NH + 1];      // and that with the hub, a row for each of its own
    real a[LD], Ma[LD], smooth[LD], implicit[LD], g[LD], s[LD], Ms[LD];
};

// Rows of single degrees of freedom: a limit, and friction loss.
template <int N>
struct JointRows {
    real sign[N + 1], D[N + 1], e[N + 1], js[N + 1];      // of limits; no limit where the sign is 0
#if LOSSES
    real loss[N + 1], loss_D[N + 1], loss_e[N + 1];       // J is 1, and so J s is s
#endif
};

struct LimbContact {
    real J[3][COLUMNS];  // motion of the point along the normal and two tangents, for the hub's and the limb's freedom
    real e[3], js[3];    // J a - reference acceleration; J s
    real D, friction[2];
    int rows;
#if CONTACT_FORCES
    int pair;
#if HAS_MESHES  // else another number would be one too many for the registers of a GPU
    int geom;  // the first one
#endif
    Vec normal, tangent;
#endif
};

}  // namespace fused
