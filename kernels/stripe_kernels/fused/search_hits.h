// SPDX-License-Identifier: Apache-2.0
// Search hits: which touches of a search remain beside its hits, and what becomes of the best one.

#if HAS_SEARCHES
namespace fused {

// Whether a touch is still one beside the hits that there are, and then its order.
template <class Hits>
FN bool remains(const Search& s, const Hits* found, const Touch& hit, real& order) {
    if (s.ended) return false;
    if (!s.count) return true;
#if HAS_MESHES
    if (is_mesh_pair(s.pair)) return remains_on_mesh(s, found, hit, order);
#endif
    return s.kind == BALL_PART ? is_above_planes(s, found, hit.pos) : is_apart(s, found, hit.pos);
}

// Make a touch the next hit.
FN void accept(Search& s, int number, const Touch& hit) {
#if HAS_MESHES
    if (is_mesh_pair(s.pair)) {
        if (s.kind == BALL_PART) s.inside = hit.dist < -s.radius;
        if (hit.dist >= s.reach) {  // it only told that the centre is outside
            s.ended = true;
            return;
        }
    }
#endif
    s.hit[s.count++] = number;
    s.ended = s.inside || s.count == s.most;
}

}  // namespace fused
#endif
