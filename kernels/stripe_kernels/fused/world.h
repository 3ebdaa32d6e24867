// SPDX-License-Identifier: Apache-2.0
// World: the state of a world in a step, and the fields of its constraint rows and contacts. The generated part defines the
// sizes N... and the tables of the topology.

namespace fused {

// Of an elliptic contact's rows the first is its normal.
enum RowKind { EQUALITY, FRICTION_LOSS, INEQUALITY, ELLIPTIC };

#if WRENCH_ROWS
// A row of the constraints, see wrench_rows.h.
enum RowField {
    R_WRENCH = 0,  // of a contact's row: torque and force
    R_DOF = 0,     // of a joint's row: degree of freedom, sign and friction loss
    R_SIGN,
    R_LOSS,
    R_D = 6,
    R_E,
    R_JS,
    R_F,
    R_WEIGHT,
    R_KIND,
    ROW_SIZE = 13,  // an odd number, so that few lanes that read a field share a bank of the shared memory
};
#else
// A row of the constraints: its Jacobian, and ROW_SIZE - NV numbers.
enum RowField {
    R_D = NV,       // 1/R
    R_E,            // J a - reference acceleration; at first the stiffness' part of the reference
    R_JS,           // J s; at first the damping
    R_F,            // force
    R_LOSS,         // friction loss; of a cone's rows their contact
    R_CONTACT = R_LOSS,
    R_WEIGHT,       // in the Hessian
    R_KIND,
    // Lanes read Jacobians as fours. An odd number of them, so that few lanes that read a field share a bank of the shared
    // memory.
    ROW_SIZE = 4 * ((R_KIND + 4) / 4 | 1),
};
#endif

// Two bodies or sites that an equality connects at a point or welds together, see attachments.h.
enum AttachmentField {
    A_POINT = 0,      // on each body, relative to the origin of its tree [m]
    A_TURN = 6,       // of a weld: orientation of the second frame
    A_RELATIVE = 10,  // and that of the first one in it, times half of the torque scale
    A_E = 14,         // of each row what its reference acceleration has beside the damping
    A_D = 20,         // 1/R of the rows of translations, and of those of rotations
    A_DAMPING = 22,
    A_ROW = 23,       // its first row, -1 where the equality is not active
    ATTACHMENT_SIZE = 24,
};

// State of a world. Arrays that are not needed at the same time share their place, so that many worlds fit into the shared
// memory of a multiprocessor.
struct World {
    real q[NQ];                          // positions
    alignas(16) real v[NV];              // velocities
    alignas(16) real a[NV];              // accelerations (at first the warm start)
    int has_kinematic, is_pushed;        // whether a body is kinematic, and whether external wrenches act
    real origin[NTREES * 3];             // of each tree: where its root body is, in the world [m]; tree 0 is the world
    alignas(2 * sizeof(real)) real S[NV * 6];  // motion of each degree of freedom
#if IN_REGISTERS
    alignas(16) real M[NV * LD];         // mass matrix in the lower triangle; above the diagonal the factor in use
#else
    real M[NV * LD], H[NV * LD];         // mass matrix; the factor in use
#endif
    real smooth[NV];                     // forces but for those of constraints
    real slope[NU];                      // derivatives of the actuators' forces by the actuators' velocities
    alignas(16) real s[NV];              // search direction
    real Ma[NV];                         // M a
    union {
        real g[NV];                      // gradient, until the search direction is known
        real Ms[NV];                     // M s
    };
    union {
        struct {                         // until contacts and all other forces are known
            real pos[NB * 3], quat[NB * 4];  // body frames relative to the origin of their tree
            union {
                struct {
                    real V[NB * 6], A[NB * 6];  // velocities; accelerations without those of the joints
                    real X[NB * 16];            // spatial inertia (10) and force (6) of each body, then of its subtree
                    real U[NV * 6];             // force of a subtree for a unit acceleration of a degree of freedom
                    real drive[NU];             // forces of the actuators
                };
                float turned[NTURNED];          // between steps: free joints and balls as Newton has them
                struct {                        // from then on
                    alignas(16) real balls[GEOMS_PLACED ? NGEOMS * 4 : 1];  // around geoms: position, and radius with margin
                    real geoms[GEOMS_PLACED ? NGEOMS * 12 : 1];  // position and axes, if geoms are in many pairs
                    unsigned short near_pairs[2 * LANES];        // that may touch
#if HAS_SEARCHES
                    Search search[SEARCHES];    // for contacts with height fields and meshes
                    Found found[TOUCHES];       // their candidates that touch
#if HAS_FIELDS
                    Patch patches[NFIELDS];     // of the fields, as seen from their centres
#endif
                    unsigned near_geoms[(NSEARCHED_GEOMS + LANES - 1) / LANES];  // of which geoms: a bit for each lane
                    unsigned short near_parts[NCONTACT_PAIRS - FIRST_SEARCHED_PAIR];  // and their pairs
                    unsigned short complete;  // searches of which all touches are listed, where there are too many
#endif
                };
            };
        };
        alignas(16) real rows[SHARED_ROWS * ROW_SIZE];  // from then on: the constraints, see RowField
#if WRENCH_ROWS
        struct {
            alignas(16) real before_contacts[CONTACTS_AT];  // rows, or what is needed until contacts are known
            real contacts[SHARED_CONTACTS * CONTACT_SIZE];  // see ContactField
        };
    };
#else
    };
    alignas(16) real contacts[SHARED_CONTACTS * CONTACT_SIZE];  // see ContactField
#endif
#if NATTACHMENTS
    real attachments[NATTACHMENTS * ATTACHMENT_SIZE];  // see AttachmentField
#endif
#if WRENCH_ROWS
    alignas(16) real stiffness[36];      // of a group of contacts
#endif
    real* spill;                         // memory of the device for the rows and contacts beyond these
};

#if WRENCH_ROWS
static_assert(__builtin_offsetof(World, contacts) >= __builtin_offsetof(World, near_pairs) + 4 * LANES, "contacts");
#if HAS_SEARCHES
static_assert(__builtin_offsetof(World, contacts) >= __builtin_offsetof(World, complete) + 2, "contacts");
#endif
#endif

FN real* body_velocities(World& w) { return w.X; }  // after the steps: see `keep_velocity`
// What joints are driven with in each step: in the device's memory, where the many lanes of a world read neighbouring numbers.
// Shared memory is needed for constraint rows.
#define APPLIED(w, id, i) IN_ROW(qfrc_applied, id, i)
#define CONTROL(w, id, u) IN_ROW(ctrl, id, u)
#define EFFORT(w, id, i) IN_ROW(qfrc_actuator, id, i)

#if IN_SHARED && defined(__CUDA_ARCH__)
// The world of this thread. Functions that are not inlined ask again: how an address in shared memory came about tells the
// compiler that it is one.
FN World& in_place() {
    extern __shared__ char dynamic_smem_base[];
    return ((World*)(dynamic_smem_base + sizeof(Tables)))[threadIdx.x / LANES];
}
FN World& in_place(World&) { return in_place(); }
#else
FN World& in_place(World& w) { return w; }
#endif

struct alignas(16) Four {
    real x[4];
};
#if !WRENCH_ROWS
// J x, with both aligned for fours.
FN real product(const real* J, const real* x) {
    real sum = 0;
#if IN_REGISTERS
#pragma unroll
    for (int g = 0; g < NFOURS; g++) {
        Four a = ((const Four*)J)[g], b = ((const Four*)x)[g];
#pragma unroll
        for (int k = 0; k < 4; k++)
            if (4 * g + k < NV) sum += a.x[k] * b.x[k];
    }
#else
    for (int k = 0; k < NV; k++) sum += J[k] * x[k];
#endif
    return sum;
}
#endif

#if IN_REGISTERS
FN real mass_matrix(const World& w, int i, int j) { return i > j ? w.M[i * LD + j] : w.M[j * LD + i]; }
#else
FN real mass_matrix(const World& w, int i, int j) { return w.M[i * LD + j]; }
#endif
#if HAS_FIELDS
// The field of a pair as seen from a point in its frame.
FN Patch patch_of(const World& w, int pair, Vec at) {
    Patch p = w.patches[NFIELDS > 1 ? ground_number(pair) : 0];
    p.geom = at;
    return p;
}
#endif

// Rows and contacts. `FITS` says that all are in the state, rather than some in the spill memory.
template <bool FITS>
FN real* row_of(World& w, int r) {
    if (FITS || MAX_ROWS <= SHARED_ROWS || r < SHARED_ROWS) return w.rows + r * ROW_SIZE;
    return w.spill + (r - SHARED_ROWS) * ROW_SIZE;
}
template <bool FITS>
FN const real* row_of(const World& w, int r) {
    return row_of<FITS>(const_cast<World&>(w), r);
}
FN real* row(World& w, int r) { return row_of<false>(w, r); }
template <bool FITS>
FN real* contact_of(World& w, int c) {
    if (FITS || MAX_CONTACTS <= SHARED_CONTACTS || c < SHARED_CONTACTS) return w.contacts + c * CONTACT_SIZE;
    return w.spill + (MAX_ROWS - SHARED_ROWS) * ROW_SIZE + (c - SHARED_CONTACTS) * CONTACT_SIZE;
}
template <bool FITS>
FN const real* contact_of(const World& w, int c) {
    return contact_of<FITS>(const_cast<World&>(w), c);
}
FN real* contact(World& w, int c) { return contact_of<false>(w, c); }

}  // namespace fused
