// One depth order for the whole image, nearest first; equal depths in the order of the scene's own indices.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Put runs of equal depth into the order of their original index. Such runs are rare and short.
static void order_ties(uint64_t* keys, uint32_t count, const uint32_t* identity) {
    for (uint32_t i = 1; i < count; ++i) {
        const uint64_t key = keys[i];
        uint32_t j = i;
        while (j > 0 && keys[j - 1] >> 32 == key >> 32 && identity[uint32_t(keys[j - 1])] > identity[uint32_t(key)]) {
            keys[j] = keys[j - 1];
            --j;
        }
        keys[j] = key;
    }
}

// Radix sort of the depths, least significant digit first, over no more bits than they differ in.
// Returns the sorted keys: `keys` or `spare`.
static uint64_t* sort_by_depth(uint64_t* keys, uint64_t* spare, uint32_t count, const uint32_t* identity) {
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
    order_ties(keys, count, identity);
    return keys;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
