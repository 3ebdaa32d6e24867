// SPDX-License-Identifier: Apache-2.0
// Contact fields: what is known of a contact, found here or given by the caller.

namespace fused {

enum { NFOURS = (NV + 3) / 4 };  // that hold a number for each degree of freedom

// A contact. Collision detection sets the first fields and the pair, or the number of a given contact, `complete_contacts`
// the others.
enum ContactField {
    C_POS = 0,        // point, relative to `origin_of` its bodies [m]
    C_NORMAL = 3,     // from the first to the second geom
    C_TANGENT = 6,    // the wanted one, zero for any; then the first of two
    C_DIST = 9,       // distance, negative inside [m]
    C_PAIR = 10,      // index among the pairs; less than 0 for given contact -1 - C_PAIR
    C_DIM = 11,
    C_BODY = 12,      // two bodies
    C_ROW = 14,       // its first row, -1 for none
    C_FRICTION = 15,  // two tangential, one torsional, two rolling coefficients
    C_DAMPING = 20,   // of the normal row, then of the others
    C_NEXT = 21,      // of a pyramid without Jacobians: the first contact behind its group, see wrench_rows.h
    C_STIFFNESS = 22, // stiffness' part of the normal row's reference acceleration
    C_R = 23,         // R of the normal row
    C_MU = 24,        // friction of the regularised cone
    C_GEOM = 25,      // of the meshes of its pair, -1 for the pair's own
    C_CONE = HAS_MESHES ? 26 : 25,  // see cones.h
    CONTACT_SIZE = ELLIPTIC_CONES ? C_CONE + 3 : C_CONE,
};

// A contact that the caller found: GIVEN_SIZE numbers.
enum GivenField {
    G_DIST = 0,
    G_POS = 1,      // in the world [m]
    G_FRAME = 4,    // normal and two tangents
    G_FRICTION = 13,
    G_SOLREF = 18,
    G_SOLREF_FRICTION = 20,
    G_SOLIMP = 22,
    G_MARGIN = 27,  // distance below which it is active [m]
    G_DIM = 28,
    G_GEOM = 29,    // two geoms
    GIVEN_SIZE = 31,
};

}  // namespace fused
