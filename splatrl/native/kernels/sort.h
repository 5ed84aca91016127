// Sorts splats nearest first, in one depth order for the whole image; equal depths in the order of parts, then by index
// within each.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Whether splat `a` is blended before splat `b`: by depth in double precision, then by part and index.
LANE_INLINE bool before(const uint64_t* ties, uint64_t a, uint64_t b) {
    return a >> 32 != b >> 32 ? a < b : ties[uint32_t(a)] < ties[uint32_t(b)];
}

static void sift_down(const uint64_t* ties, uint64_t* heap, uint32_t root, uint32_t count) {
    const uint64_t key = heap[root];
    for (uint32_t child = 2 * root + 1; child < count; child = 2 * root + 1) {
        if (child + 1 < count && before(ties, heap[child], heap[child + 1])) ++child;
        if (!before(ties, key, heap[child])) break;
        heap[root] = heap[child];
        root = child;
    }
    heap[root] = key;
}

// Heapsort, for long runs of equal depth, such as walls seen face-on.
static void order_by_heap(const uint64_t* ties, uint64_t* keys, uint32_t count) {
    for (uint32_t root = count / 2; root-- > 0;) sift_down(ties, keys, root, count);
    for (uint32_t last = count - 1; last > 0; --last) {
        const uint64_t farthest = keys[0];
        keys[0] = keys[last];
        keys[last] = farthest;
        sift_down(ties, keys, 0, last);
    }
}

// Sort runs of keys that agree in the bits sorted so far. Single precision alone leaves many where Gaussians lie on a
// grid, as in quantised files. `found` has room for `count` numbers.
static void order_ties(const uint64_t* ties, uint64_t* keys, uint32_t count, uint32_t low, int unsorted,
                       uint32_t* found) {
    constexpr uint32_t LONG = 24, FETCH_TIES = 16;
    uint32_t tied = 0;  // keys that agree with the one before them
    uint32_t last = count > 0 ? (uint32_t(keys[0] >> 32) - low) >> unsorted : 0;
    for (uint32_t i = 1; i < count; ++i) {
        const uint32_t digits = (uint32_t(keys[i] >> 32) - low) >> unsorted;
        found[tied] = i;
        tied += digits == last;
        last = digits;
    }
    for (uint32_t i = 0; i < tied; ++i) {
        if (i + FETCH_TIES < tied) {
            const uint64_t* ahead = keys + found[i + FETCH_TIES];
            __builtin_prefetch(&ties[uint32_t(ahead[-1])]);
            __builtin_prefetch(&ties[uint32_t(ahead[0])]);
        }
        const uint32_t at = found[i];
        uint32_t more = 1;
        while (i + more < tied && found[i + more] == at + more) ++more;
        if (more > LONG) {
            order_by_heap(ties, keys + at - 1, more + 1);
            i += more - 1;
            continue;
        }
        const uint32_t first = at - 1;
        if (more == 1) {  // the usual case; branch-free, because guessing which is nearer fails half the time
            const uint64_t a = keys[first], b = keys[at];
            const bool nearer = ties[uint32_t(b)] < ties[uint32_t(a)];
            const uint64_t turned = (a ^ b) & -uint64_t((b >> 32 < a >> 32) | ((b >> 32 == a >> 32) & nearer));
            keys[first] = a ^ turned, keys[at] = b ^ turned;
            continue;
        }
        for (uint32_t place = at; place < at + more; ++place) {
            const uint64_t key = keys[place];
            uint32_t j = place;
            for (; j > first && before(ties, key, keys[j - 1]); --j) keys[j] = keys[j - 1];
            keys[j] = key;
        }
        i += more - 1;
    }
}

// Move the keys that are nearer than `border` in front of the others, both in the order that they have. Returns how
// many are nearer.
static uint32_t bring_near(const Scratch& scratch, uint64_t* keys, uint32_t count, float border) {
    uint32_t bits;
    std::memcpy(&bits, &border, sizeof(bits));
    const uint64_t bound = uint64_t(bits) << 32;
    uint32_t near = 0, far = 0, i = 0;
#if defined(SPLATRL_AVX512)
    constexpr uint32_t KEYS = 8;  // whole vectors are stored, but never beyond what has been read
    const __m512i bounds = _mm512_set1_epi64(int64_t(bound));
    for (; i + KEYS <= count; i += KEYS) {
        const __m512i some = _mm512_loadu_si512(keys + i);
        const __mmask8 nearer = _mm512_cmplt_epu64_mask(some, bounds);
        _mm512_storeu_si512(keys + near, _mm512_maskz_compress_epi64(nearer, some));
        _mm512_storeu_si512(scratch.sorted + far, _mm512_maskz_compress_epi64(__mmask8(~nearer), some));
        const uint32_t these = uint32_t(__builtin_popcount(nearer));
        near += these, far += KEYS - these;
    }
#endif
    for (; i < count; ++i) {
        const uint64_t key = keys[i];
        keys[near] = scratch.sorted[far] = key;
        near += key < bound;
        far += key >= bound;
    }
    std::memcpy(keys + near, scratch.sorted, far * sizeof(uint64_t));
    return near;
}

// Radix sort by the leading bits in which the depths differ, least significant digit first. If RANKED, 22 bits are
// sorted and then the ties. Otherwise depths are resolved to one part in 130,000, in the same way on every tile, and
// keys that agree keep their order.
template <bool RANKED>
static void sort_by_depth(const Scratch& scratch, uint64_t* keys, uint32_t count) {
    constexpr int MOST = 11, VALUES = 1 << MOST, ALIKE = 6;
    uint64_t* sorted = scratch.sorted;
    uint32_t low = ~0u, high = 0;
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t depth = uint32_t(keys[i] >> 32);
        low = depth < low ? depth : low;
        high = depth > high ? depth : high;
    }
    if (!RANKED) low &= ~0u << ALIKE;
    const int bits = count > 1 && high > low ? 32 - __builtin_clz(high - low) : 0;
    const int alike = RANKED ? 0 : ALIKE, wanted = bits > alike ? bits - alike : 0;
    const int digit = RANKED || wanted > 2 * MOST ? MOST : (wanted + 1) / 2;
    const int unsorted = wanted > 2 * digit ? bits - 2 * digit : alike;
    const uint32_t values = 1u << digit, mask = values - 1;
    uint32_t starts[2][VALUES] = {};
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t value = (uint32_t(keys[i] >> 32) - low) >> unsorted;
        ++starts[0][value & mask];
        ++starts[1][value >> digit];
    }
    constexpr uint32_t LINE = 64 / sizeof(uint64_t);
    for (uint32_t i = 0; i < count; i += LINE) __builtin_prefetch(&sorted[i], 1);
    uint32_t sums[2] = {};
    for (uint32_t value = 0; value < values; ++value)
        for (int pass = 0; pass < 2; ++pass) {
            const uint32_t here = starts[pass][value];
            starts[pass][value] = sums[pass];
            sums[pass] += here;
        }
    for (uint32_t i = 0; i < count; ++i)
        sorted[starts[0][((uint32_t(keys[i] >> 32) - low) >> unsorted) & mask]++] = keys[i];
    for (uint32_t i = 0; i < count; ++i)
        keys[starts[1][((uint32_t(sorted[i] >> 32) - low) >> unsorted) >> digit]++] = sorted[i];
    if (RANKED) order_ties(scratch.ties, keys, count, low, unsorted, scratch.tied);
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
