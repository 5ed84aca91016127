// Sorts keys, one slab at a time.
#pragma once

#include "tile.h"

namespace splatrl {

// Number of bits of the integers below a power of two.
constexpr int bits_below(int power) { return power <= 1 ? 0 : 1 + bits_below(power / 2); }

// A range of keys, divided evenly into a number of buckets, which is a power of two.
template <int NUMBER>
struct CutInto {
    Key low, high;  // both inclusive
    int shift;

    INLINE_MEMBER CutInto(Key low, Key high) : low(low), high(high), shift(0) {
        constexpr int BUCKET_BITS = bits_below(NUMBER);
        static_assert(1 << BUCKET_BITS == NUMBER, "there must be one bucket for each value of BUCKET_BITS bits");
        const int bits = 64 - __clzll(high - low);
        shift = bits > BUCKET_BITS ? bits - BUCKET_BITS : 0;
    }
    INLINE_MEMBER int bucket(Key key) const { return int((key - low) >> shift); }
    INLINE_MEMBER Key begin(int bucket) const { return low + (Key(bucket) << shift); }
};

using Cut = CutInto<BUCKETS>;
using SlabCut = CutInto<SLAB_BUCKETS>;

// Replace each count by the sum of those before it (exclusive prefix sum). Returns the sum of all.
template <int NUMBER>
SPLAT_INLINE uint32_t sum_up(Shared& shared, uint32_t (&counts)[NUMBER]) {
    constexpr int OWN = NUMBER / THREADS;
    uint32_t own[OWN], total = 0;
    for (int i = 0; i < OWN; ++i) {
        own[i] = total;
        total += counts[thread() * OWN + i];
    }
    uint32_t upto = total;  // inclusive sum within the warp
    for (int by = 1; by < WARP; by *= 2) {
        const uint32_t before = __shfl_up_sync(ALL_LANES, upto, by);
        if (lane() >= by) upto += before;
    }
    if (lane() == WARP - 1) shared.sums[warp()] = upto;
    __syncthreads();
    uint32_t base = upto - total, all = 0;
    for (int i = 0; i < WARPS; ++i) {
        if (i < warp()) base += shared.sums[i];
        all += shared.sums[i];
    }
    for (int i = 0; i < OWN; ++i) counts[thread() * OWN + i] = base + own[i];
    __syncthreads();
    return all;
}

// Call use(key) for all keys. A thread loads a few at a time, so that it waits for memory only once for all of them.
template <class Use>
SPLAT_INLINE void for_each_key(const Key* keys, uint32_t count, const Use& use) {
    constexpr int AT_ONCE = 4;
    for (uint32_t first = thread(); first < count; first += AT_ONCE * THREADS) {
        Key some[AT_ONCE];
#pragma unroll
        for (int i = 0; i < AT_ONCE; ++i) {
            const uint32_t at = first + i * THREADS;
            some[i] = at < count ? keys[at] : NO_KEY;
        }
#pragma unroll
        for (int i = 0; i < AT_ONCE; ++i) {
            if (some[i] == NO_KEY) continue;
            PASS(key);
            use(some[i]);
        }
    }
}

// Histogram the keys in the range of a cut.
template <int NUMBER>
SPLAT_INLINE void count_keys(uint32_t (&counts)[NUMBER], const Key* keys, uint32_t count, const CutInto<NUMBER>& cut) {
    for (int i = thread(); i < NUMBER; i += THREADS) counts[i] = 0;
    __syncthreads();
    for_each_key(keys, count, [&](Key key) {
        if (key >= cut.low && key <= cut.high) atomicAdd(&counts[cut.bucket(key)], 1u);
    });
    __syncthreads();
}

// Copy keys from `from` to `to`, grouped by bucket, given their histogram, which is replaced by where each bucket ends.
template <int NUMBER>
SPLAT_INLINE void deal_to_buckets(Shared& shared, const Key* from, Key* to, uint32_t count,
                                  const CutInto<NUMBER>& cut, uint32_t (&ends)[NUMBER]) {
    sum_up(shared, ends);
    for_each_key(from, count, [&](Key key) { to[atomicAdd(&ends[cut.bucket(key)], 1u)] = key; });
}

// Sort all of shared.sorted, whatever its keys: a bitonic sort in which each thread holds adjacent keys and exchanges
// them within its registers, between lanes, or through shared memory.
SPLAT_INLINE void sort_by_exchange(Shared& shared) {
    constexpr int OWN = SLAB / THREADS;
    static_assert(OWN == 2, "each thread must hold exactly two keys");
    const int first = thread() * OWN;
    __syncthreads();
    Key mine[OWN] = {shared.sorted[first], shared.sorted[first + 1]};
    for (int size = 2; size <= SLAB; size *= 2)
        for (int apart = size / 2; apart > 0; apart /= 2) {
            Key other[OWN];
            if (apart >= OWN * WARP) {
                __syncthreads();
                for (int i = 0; i < OWN; ++i) shared.sorted[first + i] = mine[i];
                __syncthreads();
                for (int i = 0; i < OWN; ++i) other[i] = shared.sorted[(first + i) ^ apart];
            } else if (apart >= OWN) {
                for (int i = 0; i < OWN; ++i) other[i] = __shfl_xor_sync(ALL_LANES, mine[i], apart / OWN);
            } else {
                other[0] = mine[1], other[1] = mine[0];
            }
            for (int i = 0; i < OWN; ++i) {
                const bool smaller = (((first + i) & apart) == 0) == (((first + i) & size) == 0);
                mine[i] = (other[i] < mine[i]) == smaller ? other[i] : mine[i];
            }
        }
    __syncthreads();
    for (int i = 0; i < OWN; ++i) shared.sorted[first + i] = mine[i];
    __syncthreads();
}

// Write the smallest and the largest of the block's keys to shared.low and shared.high.
SPLAT_INLINE void find_range(Shared& shared, Key low, Key high) {
    if (thread() == 0) shared.low = NO_KEY, shared.high = 0;
    __syncthreads();
    for (int by = WARP / 2; by > 0; by /= 2) {
        const Key other_low = __shfl_xor_sync(ALL_LANES, low, by), other_high = __shfl_xor_sync(ALL_LANES, high, by);
        low = other_low < low ? other_low : low;
        high = other_high > high ? other_high : high;
    }
    if (lane() == 0) {
        atomicMin(&shared.low, low);
        atomicMax(&shared.high, high);
    }
    __syncthreads();
}

// Sort the first `count` keys of shared.sorted, which are within the cut and in shared.histogram, at most `crowd` of
// them in one bucket as far as this thread knows. They are grouped by its buckets, where each key finds its place by
// comparison with the others of its bucket; if a bucket holds too many for that, all are sorted by exchange.
SPLAT_INLINE void sort_slab(Shared& shared, uint32_t count, uint32_t crowd, const SlabCut& cut) {
    constexpr uint32_t CROWD = 48;
    const uint32_t* ends = shared.histogram;
    deal_to_buckets(shared, shared.sorted, shared.dealt, count, cut, shared.histogram);
    if (__syncthreads_or(crowd > CROWD)) {
        for (uint32_t i = count + thread(); i < SLAB; i += THREADS) shared.sorted[i] = NO_KEY;
        sort_by_exchange(shared);
        return;
    }
    for (uint32_t i = thread(); i < count; i += THREADS) {
        PASS(place);
        const Key key = shared.dealt[i];
        const int bucket = cut.bucket(key);
        const uint32_t first = bucket == 0 ? 0 : ends[bucket - 1], end = ends[bucket];
        uint32_t place = first;
        for (uint32_t other = first; other < end; ++other) {
            PASS(compare);
            place += shared.dealt[other] < key;
        }
        shared.sorted[place] = key;
    }
    __syncthreads();
}

// Index after the last of the ascending numbers in [first, end) that is at most `limit`; `first` if there is none. A
// binary search.
SPLAT_INLINE int behind_last(const uint32_t* numbers, int first, int end, uint32_t limit) {
    while (first < end) {
        const int middle = (first + end) / 2;
        if (numbers[middle] <= limit)
            first = middle + 1;
        else
            end = middle;
    }
    return first;
}

// The same as `behind_last`, by a whole warp, all of whose lanes get the answer: a linear search, which is fastest if
// the answer is close to `first`.
SPLAT_INLINE int behind_last_by_warp(const uint32_t* numbers, int first, int end, uint32_t limit) {
    for (; first < end; first += WARP) {
        const int at = first + lane();
        const uint32_t lanes = __ballot_sync(ALL_LANES, at < end && numbers[at] <= limit);
        if (lanes != ALL_LANES) return first + __popc(lanes);
    }
    return end;
}

// Find where to cut the keys in [from, last] so that those before the cut fit into a slab.
SPLAT_INLINE Key fitting_cut(Shared& shared, const Key* keys, uint32_t count, Key from, Key last) {
    for (;;) {
        const SlabCut cut(from, last);
        count_keys(shared.histogram, keys, count, cut);
        const uint32_t all = sum_up(shared, shared.histogram);
        if (all <= SLAB) return last + 1;
        const int whole = behind_last_by_warp(shared.histogram, 0, SLAB_BUCKETS, SLAB) - 1;  // all before it fit
        __syncthreads();
        if (whole > 0) return cut.begin(whole);
        last = cut.begin(1) - 1;
    }
}

// Copy the keys within a cut, at most SLAB of them, to shared.sorted, and histogram them into shared.histogram. Returns
// the largest number of keys that this thread found in one bucket. Their shapes are prefetched while they are sorted.
SPLAT_INLINE uint32_t gather(const SceneArrays& scene, Shared& shared, const Key* keys, uint32_t count,
                             const SlabCut& cut) {
    uint32_t most = 0;
    if (thread() == 0) shared.gathered = 0;
    for (int i = thread(); i < SLAB_BUCKETS; i += THREADS) shared.histogram[i] = 0;
    __syncthreads();
    for_each_key(keys, count, [&](Key key) {
        if (key < cut.low || key > cut.high) return;
        shared.sorted[atomicAdd(&shared.gathered, 1u)] = key;
        const uint32_t found = atomicAdd(&shared.histogram[cut.bucket(key)], 1u) + 1;
        most = found > most ? found : most;
        if (!WITH_PARTS) prefetch_to_shared_cache(scene.shapes + 3 * size_t(index_of(key)));
    });
    __syncthreads();
    return most;
}

// Start on the candidates of a tile, which are in the first row of `both` [2, capacity]. If they do not fit into one
// slab, they are grouped by bucket in the second row.
SPLAT_INLINE void begin_slabs(Shared& shared, Key* both, int capacity) {
    const uint32_t count = shared.count;
    Slabs slabs{both, count, 0, count, BUCKETS, 1, 0, shared.low, shared.high};
    if (count > SLAB) {
        const Cut cut(slabs.low, slabs.high);
        count_keys(shared.ends, both, count, cut);
        deal_to_buckets(shared, both, both + capacity, count, cut, shared.ends);
        slabs.keys = both + capacity, slabs.end = 0, slabs.bucket = 0;
    } else if (count > 0) {
        slabs.from = slabs.low, slabs.last = slabs.high;
    }
    if (thread() == 0) shared.slabs = slabs;
    __syncthreads();
}

// Advance to the next buckets, as many as fit into a slab, or to a single one that does not fit.
SPLAT_INLINE void take_buckets(const Shared& shared, Slabs& slabs) {
    const Cut cut(slabs.low, slabs.high);
    const int first = slabs.bucket, behind = behind_last_by_warp(shared.ends, first, BUCKETS, slabs.end + SLAB);
    slabs.bucket = behind > first ? behind : first + 1;
    slabs.begin = slabs.end, slabs.end = shared.ends[slabs.bucket - 1];
    slabs.from = cut.begin(first), slabs.last = cut.begin(slabs.bucket) - 1;
}

// Load the next slab, nearest first, into shared.sorted. Returns its size, 0 after the last one. The progress is kept
// in shared memory, because blending needs the registers.
SPLAT_INLINE uint32_t next_slab(const SceneArrays& scene, Shared& shared) {
    PASS(slab);
    Slabs slabs = shared.slabs;
    uint32_t some = 0;
    while (some == 0 && (slabs.from <= slabs.last || slabs.end < slabs.count)) {
        if (slabs.from > slabs.last) take_buckets(shared, slabs);
        const Key* keys = slabs.keys + slabs.begin;
        const uint32_t count = slabs.end - slabs.begin;
        const Key until = count <= SLAB ? slabs.last + 1 : fitting_cut(shared, keys, count, slabs.from, slabs.last);
        const SlabCut cut(slabs.from, until - 1);
        const uint32_t crowd = gather(scene, shared, keys, count, cut);
        some = shared.gathered;
        if (some > 0) sort_slab(shared, some, crowd, cut);
        slabs.from = until;
    }
    if (thread() == 0 && some > 0) shared.slabs = slabs;  // after the last slab, others may still be reading the state
    return some;
}

}  // namespace splatrl
