// Finds the Gaussians that may be visible on a tile, as unsorted keys.
#pragma once

#include "order.h"
#include "tile.h"

namespace splatrl {

// A node of a part's tree: its cluster in the low bits, its part in the high ones.
struct Node {
    static constexpr int CLUSTER_BITS = 25;
    static_assert(VIEWS <= 1 << (32 - CLUSTER_BITS), "a part's number must fit in the high bits of a node");
    uint32_t word;

    INLINE_MEMBER uint32_t cluster() const { return WITH_PARTS ? word & ((1u << CLUSTER_BITS) - 1) : word; }
    INLINE_MEMBER int part() const { return WITH_PARTS ? int(word >> CLUSTER_BITS) : 0; }
    INLINE_MEMBER uint32_t with(uint32_t cluster) const { return word - this->cluster() + cluster; }
};

// Write the roots of all that is to be drawn to the start of `nodes`.
SPLAT_INLINE void plant(const Views& views, Shared& shared, uint32_t* nodes) {
    if (thread() == 0) nodes[0] = 0, shared.frontier[0] = !WITH_PARTS, shared.frontier[1] = 0, shared.accepted = 0;
    __syncthreads();
    if (!WITH_PARTS) return;
    for (int part = thread(); part < views.parts; part += THREADS) {
        const Place& place = place_of(views, shared.row, part);
        if (place.size == 0) continue;
        nodes[atomicAdd(&shared.frontier[0], 1u)] = uint32_t(part) << Node::CLUSTER_BITS | place.root;
    }
    __syncthreads();
}

// Descend the trees one level at a time, in `nodes` [3, capacity]: two rows take turns to hold a level, and the third
// receives the nodes to draw.
SPLAT_INLINE void cull(const SceneArrays& scene, const Views& views, Shared& shared, uint32_t* nodes, int capacity) {
    uint32_t* accepted = nodes + 2 * size_t(capacity);
    plant(views, shared, nodes);
    for (int side = 0; shared.frontier[side] > 0; side ^= 1) {
        const uint32_t* here = nodes + size_t(side) * capacity;
        uint32_t* below = nodes + size_t(side ^ 1) * capacity;
        for (uint32_t i = thread(); i < shared.frontier[side]; i += THREADS) {
            PASS(node);
            const Node at{here[i]};
            const Cluster node = scene.clusters[at.cluster()];
            const View& view = shared.views[at.part()];
            if (misses(view.frustum, view.camera, node.bounds)) continue;
            if (node.error > 0.0f && !within_tolerance(view.frustum, view.camera, node, scene.tolerance)) {
                const uint32_t second = scene.clusters[at.cluster() + 1].skip, children = second < node.skip ? 2 : 1;
                const uint32_t first = atomicAdd(&shared.frontier[side ^ 1], children);
                below[first] = at.word + 1;
                if (children == 2) below[first + 1] = at.with(second);
            } else if (node.groups > 0) {
                accepted[atomicAdd(&shared.accepted, 1u)] = at.word;
            }
        }
        __syncthreads();
        if (thread() == 0) shared.frontier[side] = 0;
        __syncthreads();
    }
}

// Make a key of an index and 35 bits of depth, taken from the bits of its double-precision value: 5 of exponent, from
// 2^-7 m to 2^25 m, and 30 of mantissa, which is a nanometre at one metre. The highest bit of a key stays free, so that
// sums of keys do not overflow.
SPLAT_INLINE Key key_of(double depth, uint32_t index) {
    constexpr int DEPTH_BITS = 63 - INDEX_BITS, EXPONENT_BITS = 5, MANTISSA_BITS = 52;
    constexpr Key NEAREST = Key(1023 - 7) << MANTISSA_BITS, FARTHEST = (Key(1) << DEPTH_BITS) - 1;
    const Key bits = bits_of(depth);
    const Key steps = bits > NEAREST ? (bits - NEAREST) >> (EXPONENT_BITS + MANTISSA_BITS - DEPTH_BITS) : 0;
    return (steps < FARTHEST ? steps : FARTHEST) << INDEX_BITS | index;
}

// The key of a Gaussian of a part, given its sphere and its index in the model; NO_KEY if it cannot be visible on the
// tile. Depths are computed in double precision, as on the CPU, because the order of two Gaussians must not depend on
// rounding.
SPLAT_INLINE Key candidate(const Shared& shared, int part, const float4& sphere, uint32_t index) {
    const View& view = shared.views[part];
    const uint32_t reaches = __float_as_uint(sphere.w);
    if (reaches == 0) return NO_KEY;
    const float center[3] = {sphere.x, sphere.y, sphere.z};
    const float* position = view.camera.position;
    const float reach = low_half(reaches), reach_scale = high_half(reaches);
    if (misses(view.frustum, position, center, reach, reach_scale)) return NO_KEY;
    double depth = 0.0;
    for (int axis = 0; axis < 3; ++axis)
        depth += double(view.frustum.forward[axis]) * (double(center[axis]) - double(position[axis]));
    const uint32_t base = WITH_PARTS ? shared.bases[part] : 0;
    return depth > 0.0 ? key_of(depth, base + index) : NO_KEY;
}

// Whether a group of a cluster may be visible on the tile: each of sixteen lanes tests its own `group`.
SPLAT_INLINE bool group_in_view(const SceneArrays& scene, const View& view, uint32_t cluster, uint32_t group) {
    const GroupBounds& bounds = scene.group_bounds[cluster];
    const float center[3] = {bounds.members[0][group], bounds.members[1][group], bounds.members[2][group]};
    return !(missed_by<float>(view.frustum, view.camera.position, center, bounds.members[3][group],
                              bounds.members[4][group], bounds.members[5][group]) > 0.0f);
}

// Append the keys of the lanes that have one, as far as there is room. Keys for which there is none are counted, too.
template <int NUMBER>
SPLAT_INLINE void append(Shared& shared, Key* keys, uint32_t room, const Key (&some)[NUMBER]) {
    uint32_t found[NUMBER], all = 0;
#pragma unroll
    for (int i = 0; i < NUMBER; ++i) {
        found[i] = __ballot_sync(ALL_LANES, some[i] != NO_KEY);
        all += uint32_t(__popc(found[i]));
    }
    if (all == 0) return;
    uint32_t first = 0;
    if (lane() == 0) first = atomicAdd(&shared.count, all);
    first = __shfl_sync(ALL_LANES, first, 0);
#pragma unroll
    for (int i = 0; i < NUMBER; ++i) {
        const uint32_t at = first + rank_in(found[i]);
        if (some[i] != NO_KEY && at < room) keys[at] = some[i];
        first += uint32_t(__popc(found[i]));
    }
}

// Write the keys of all Gaussians that may be visible, from the nodes that `cull` left. Half a warp takes a node: it
// first tests its groups, then the sixteen Gaussians of each group in view, two groups at a time, so that it waits for
// memory only once for both.
SPLAT_INLINE void find_candidates(const SceneArrays& scene, const Workspace& workspace, Shared& shared,
                                  const uint32_t* nodes, Key* keys) {
    const uint32_t* accepted = nodes + 2 * size_t(workspace.node_capacity);
    if (thread() == 0) shared.count = 0;
    __syncthreads();
    constexpr int AT_ONCE = 2;
    const uint32_t half = lane() / GROUP, member = lane() % GROUP;
    Key low = NO_KEY, high = 0;
    for (uint32_t first = 2 * warp(); first < shared.accepted; first += 2 * WARPS) {
        uint32_t first_group = 0;
        int part = 0;
        bool seen = false;
        if (first + half < shared.accepted) {
            PASS(groups);
            const Node node{accepted[first + half]};
            const uint32_t at = node.cluster();
            part = node.part(), first_group = scene.clusters[at].first_group;
            seen = member < scene.clusters[at].groups && group_in_view(scene, shared.views[part], at, member);
        }
        uint32_t left = __ballot_sync(ALL_LANES, seen) >> (half * GROUP) & 0xffffu;
        while (__any_sync(ALL_LANES, left != 0)) {
            float4 spheres[AT_ONCE];
            uint32_t indices[AT_ONCE];
#pragma unroll
            for (int i = 0; i < AT_ONCE; ++i) {
                if (left != 0) { PASS(test); }
                const uint32_t slot = (first_group + __ffs(left) - 1) * GROUP + member;
                spheres[i] = left != 0 ? scene.spheres[slot] : float4{0.0f, 0.0f, 0.0f, 0.0f};  // never visible
                indices[i] = left != 0 ? scene.indices[slot] : 0;
                left &= left - 1;
            }
            Key some[AT_ONCE];
#pragma unroll
            for (int i = 0; i < AT_ONCE; ++i) {
                const Key key = candidate(shared, part, spheres[i], indices[i]);
                if (key != NO_KEY) low = key < low ? key : low, high = key > high ? key : high;
                some[i] = key;
            }
            append(shared, keys, uint32_t(workspace.key_capacity), some);
        }
    }
    find_range(shared, low, high);
}

}  // namespace splatrl
