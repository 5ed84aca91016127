// The Gaussians that may show on a tile, as keys in no order.
#pragma once

#include "order.h"
#include "tile.h"

namespace splatrl {

// Go down the tree, a level at a time, from `nodes` [3, capacity]. Leaves the nodes to draw in the third part.
SPLAT_INLINE void cull(const SceneArrays& scene, Shared& shared, uint32_t* nodes, int capacity) {
    uint32_t* accepted = nodes + 2 * size_t(capacity);
    if (thread() == 0) nodes[0] = 0, shared.frontier[0] = 1, shared.frontier[1] = 0, shared.accepted = 0;
    __syncthreads();
    for (int side = 0; shared.frontier[side] > 0; side ^= 1) {
        const uint32_t* here = nodes + size_t(side) * capacity;
        uint32_t* below = nodes + size_t(side ^ 1) * capacity;
        for (uint32_t i = thread(); i < shared.frontier[side]; i += THREADS) {
            const uint32_t at = here[i];
            const Cluster node = scene.clusters[at];
            if (misses(shared.frustum, shared.camera, node.bounds)) continue;
            if (node.error > 0.0f && !within_tolerance(shared.frustum, shared.camera, node, scene.tolerance)) {
                const uint32_t first = atomicAdd(&shared.frontier[side ^ 1], 2u);
                below[first] = at + 1;
                below[first + 1] = scene.clusters[at + 1].skip;
            } else if (node.groups > 0) {
                accepted[atomicAdd(&shared.accepted, 1u)] = at;
            }
        }
        __syncthreads();
        if (thread() == 0) shared.frontier[side] = 0;
        __syncthreads();
    }
}

// 39 bits of depth, from the bits of its double-precision value: 34 of the mantissa, from 2^-7 m to 2^25 m. The highest
// bit of a key stays free, so that sums of keys do not overflow.
SPLAT_INLINE Key key_of(double depth, uint32_t index) {
    constexpr Key NEAREST = Key(1023 - 7) << 52, FARTHEST = (Key(1) << (63 - INDEX_BITS)) - 1;
    const Key bits = bits_of(depth);
    const Key steps = bits > NEAREST ? (bits - NEAREST) >> 18 : 0;
    return (steps < FARTHEST ? steps : FARTHEST) << INDEX_BITS | index;
}

// The key of the Gaussian in a slot; NO_KEY where it cannot show on the tile. The order of two Gaussians must not hang on
// a rounding: depths are computed in double precision, as on the CPU.
SPLAT_INLINE Key candidate(const SceneArrays& scene, const Shared& shared, uint32_t slot) {
    const float4 sphere = scene.spheres[slot];
    const uint32_t reaches = __float_as_uint(sphere.w);
    if (reaches == 0) return NO_KEY;
    const float center[3] = {sphere.x, sphere.y, sphere.z};
    const float* position = shared.camera.position;
    const float reach = half_to_float(uint16_t(reaches)), reach_scale = half_to_float(uint16_t(reaches >> 16));
    if (misses(shared.frustum, position, center, reach, reach_scale)) return NO_KEY;
    double depth = 0.0;
    for (int axis = 0; axis < 3; ++axis)
        depth += double(shared.frustum.forward[axis]) * (double(center[axis]) - double(position[axis]));
    return depth > 0.0 ? key_of(depth, scene.indices[slot]) : NO_KEY;
}

// Which of the sixteen groups of a cluster may show on the tile; `group` is this lane's.
SPLAT_INLINE bool group_in_view(const SceneArrays& scene, const Shared& shared, uint32_t cluster, uint32_t group) {
    const GroupBounds& bounds = scene.group_bounds[cluster];
    const float center[3] = {bounds.members[0][group], bounds.members[1][group], bounds.members[2][group]};
    return !(missed_by<float>(shared.frustum, shared.camera.position, center, bounds.members[3][group],
                              bounds.members[4][group], bounds.members[5][group]) > 0.0f);
}

// Append the keys of the lanes that have one.
SPLAT_INLINE void append(Shared& shared, Key* keys, Key key) {
    const uint32_t found = __ballot_sync(ALL_LANES, key != NO_KEY);
    if (found == 0) return;
    uint32_t base = 0;
    if (lane() == 0) base = atomicAdd(&shared.count, uint32_t(__popc(found)));
    base = __shfl_sync(ALL_LANES, base, 0);
    if (key != NO_KEY) keys[base + rank_in(found)] = key;
}

// The keys of all that may show, from the nodes that `cull` left. Half a warp takes a node: first its groups, then
// the sixteen Gaussians of each group in view.
SPLAT_INLINE void find_candidates(const SceneArrays& scene, Shared& shared, const uint32_t* nodes, int capacity,
                                  Key* keys) {
    const uint32_t* accepted = nodes + 2 * size_t(capacity);
    if (thread() == 0) shared.count = 0;
    __syncthreads();
    const uint32_t half = lane() / GROUP, member = lane() % GROUP;
    Key low = NO_KEY, high = 0;
    for (uint32_t first = 2 * warp(); first < shared.accepted; first += 2 * WARPS) {
        uint32_t first_group = 0;
        bool seen = false;
        if (first + half < shared.accepted) {
            const uint32_t at = accepted[first + half];
            first_group = scene.clusters[at].first_group;
            seen = member < scene.clusters[at].groups && group_in_view(scene, shared, at, member);
        }
        uint32_t left = __ballot_sync(ALL_LANES, seen) >> (half * GROUP) & 0xffffu;
        while (__any_sync(ALL_LANES, left != 0)) {
            Key key = NO_KEY;
            if (left != 0) key = candidate(scene, shared, (first_group + __ffs(left) - 1) * GROUP + member);
            left &= left - 1;
            append(shared, keys, key);
            if (key != NO_KEY) low = key < low ? key : low, high = key > high ? key : high;
        }
    }
    find_range(shared, low, high);
}

}  // namespace splatrl
