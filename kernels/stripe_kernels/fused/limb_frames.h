// SPDX-License-Identifier: Apache-2.0
// Limb frames: poses of bodies in the form for a hub with limbs.

namespace fused {

struct Frame {
    Vec x;
    Quat turn;
};
FN Frame frame_of(const World& w, int b) { return Frame{load(w.pos + 3 * b), load_quat(w.quat + 4 * b)}; }
FN void set_frame(World& w, int b, Frame f) { store(w.pos + 3 * b, f.x), store_quat(w.quat + 4 * b, f.turn); }
// A body on its parent, before its joints move it.
FN Frame hang(Frame parent, const Parameters& P, int b) {
    return Frame{parent.x + rotate(parent.turn, load(P.body_pos() + 3 * b)), parent.turn * load_quat(P.body_quat() + 4 * b)};
}

}  // namespace fused
