// One depth order for the whole image, nearest first; equal depths in the order of the scene's own indices.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Whether splat `a` is blended before splat `b`: by depth in double precision, then in the order of the scene.
LANE_INLINE bool before(const Scratch& scratch, uint64_t a, uint64_t b) {
    const double depth_a = scratch.depths[uint32_t(a)], depth_b = scratch.depths[uint32_t(b)];
    if (depth_a != depth_b) return depth_a < depth_b;
    return scratch.identity[uint32_t(a)] < scratch.identity[uint32_t(b)];
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

// Single precision leaves many ties where Gaussians lie on a grid, as in quantised files.
static void order_ties(const Scratch& scratch, uint64_t* keys, uint32_t count) {
    for (uint32_t first = 0, next = 1; next <= count; ++next) {
        if (next < count && keys[next] >> 32 == keys[first] >> 32) continue;
        if (next - first > 1) order_run(scratch, keys + first, next - first);
        first = next;
    }
}

// Radix sort of the depths, least significant digit first, over no more bits than they differ in.
// Returns the sorted keys, in one of the two arrays of `scratch`.
static const uint64_t* sort_by_depth(const Scratch& scratch, uint32_t count) {
    uint64_t *keys = scratch.keys, *spare = scratch.sorted;
    constexpr int MAX_DIGIT = 11;
    uint32_t low = ~0u, high = 0;
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t depth = uint32_t(keys[i] >> 32);
        low = depth < low ? depth : low;
        high = depth > high ? depth : high;
    }
    const int bits = count > 1 && high > low ? 32 - __builtin_clz(high - low) : 0;
    const int passes = (bits + MAX_DIGIT - 1) / MAX_DIGIT;
    const int digit = passes > 0 ? (bits + passes - 1) / passes : 0;
    for (int pass = 0; pass < passes; ++pass) {
        uint32_t starts[1 << MAX_DIGIT] = {};
        const int shift = pass * digit;
        const uint32_t mask = (1u << digit) - 1;
        for (uint32_t i = 0; i < count; ++i) ++starts[(uint32_t(keys[i] >> 32) - low) >> shift & mask];
        uint32_t sum = 0;
        for (uint32_t value = 0; value <= mask; ++value) {
            const uint32_t here = starts[value];
            starts[value] = sum;
            sum += here;
        }
        for (uint32_t i = 0; i < count; ++i)
            spare[starts[(uint32_t(keys[i] >> 32) - low) >> shift & mask]++] = keys[i];
        uint64_t* swapped = keys;
        keys = spare;
        spare = swapped;
    }
    order_ties(scratch, keys, count);
    return keys;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
