// One depth order for the whole image, nearest first; equal depths in the order of the scene's own indices.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Whether splat `a` is blended before splat `b`: by depth in double precision, then in the order of the scene.
LANE_INLINE bool before(const Scratch& scratch, uint64_t a, uint64_t b) {
    if (a >> 32 != b >> 32) return a < b;
    const Splat &first = scratch.splats[uint32_t(a)], &second = scratch.splats[uint32_t(b)];
    if (first.depth_rest != second.depth_rest) return first.depth_rest < second.depth_rest;
    return first.original_index < second.original_index;
}

static void sift_down(const Scratch& scratch, uint64_t* heap, uint32_t root, uint32_t count) {
    const uint64_t key = heap[root];
    for (uint32_t child = 2 * root + 1; child < count; child = 2 * root + 1) {
        if (child + 1 < count && before(scratch, heap[child], heap[child + 1])) ++child;
        if (!before(scratch, key, heap[child])) break;
        heap[root] = heap[child];
        root = child;
    }
    heap[root] = key;
}

// Order keys whose depths are the same number of single precision: insertion for the usual few, a heap for walls.
static void order_run(const Scratch& scratch, uint64_t* run, uint32_t count) {
    if (count > 24) {
        for (uint32_t root = count / 2; root-- > 0;) sift_down(scratch, run, root, count);
        for (uint32_t last = count - 1; last > 0; --last) {
            const uint64_t farthest = run[0];
            run[0] = run[last];
            run[last] = farthest;
            sift_down(scratch, run, 0, last);
        }
        return;
    }
    for (uint32_t i = 1; i < count; ++i) {
        const uint64_t key = run[i];
        uint32_t j = i;
        for (; j > 0 && before(scratch, key, run[j - 1]); --j) run[j] = run[j - 1];
        run[j] = key;
    }
}

// Order runs of keys that agree in the bits that were sorted by. Single precision alone leaves many where Gaussians
// lie on a grid, as in quantised files.
static void order_ties(const Scratch& scratch, uint64_t* keys, uint32_t count, uint32_t low, int unsorted) {
    const auto digits = [low, unsorted](uint64_t key) { return (uint32_t(key >> 32) - low) >> unsorted; };
    for (uint32_t first = 0, next = 1; next <= count; ++next) {
        if (next < count && digits(keys[next]) == digits(keys[first])) continue;
        if (next - first > 1) order_run(scratch, keys + first, next - first);
        first = next;
    }
}

// Radix sort by the leading bits in which the depths differ, least significant digit first, then the ties.
// Returns the sorted keys, in `scratch.keys`.
static const uint64_t* sort_by_depth(const Scratch& scratch, uint32_t count) {
    constexpr int DIGIT = 11, VALUES = 1 << DIGIT;
    uint64_t *keys = scratch.keys, *sorted = scratch.sorted;
    uint32_t low = ~0u, high = 0;
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t depth = uint32_t(keys[i] >> 32);
        low = depth < low ? depth : low;
        high = depth > high ? depth : high;
    }
    const int bits = count > 1 && high > low ? 32 - __builtin_clz(high - low) : 0;
    const int unsorted = bits > 2 * DIGIT ? bits - 2 * DIGIT : 0;
    uint32_t starts[2][VALUES] = {};
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t value = (uint32_t(keys[i] >> 32) - low) >> unsorted;
        ++starts[0][value % VALUES];
        ++starts[1][value / VALUES];
    }
    uint32_t sums[2] = {};
    for (int value = 0; value < VALUES; ++value)
        for (int pass = 0; pass < 2; ++pass) {
            const uint32_t here = starts[pass][value];
            starts[pass][value] = sums[pass];
            sums[pass] += here;
        }
    for (uint32_t i = 0; i < count; ++i)
        sorted[starts[0][((uint32_t(keys[i] >> 32) - low) >> unsorted) % VALUES]++] = keys[i];
    for (uint32_t i = 0; i < count; ++i)
        keys[starts[1][((uint32_t(sorted[i] >> 32) - low) >> unsorted) / VALUES]++] = sorted[i];
    order_ties(scratch, keys, count, low, unsorted);
    return keys;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
