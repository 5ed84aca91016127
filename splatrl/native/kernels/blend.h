// Blends sorted splats into a tile, slab by slab. The splats of a slab are copied in nearest-first order and assigned
// to the lists of the blocks that they touch; then each block is blended with its pixels in registers. Finished blocks
// are skipped.
#pragma once

#include <type_traits>

#include "kernel.h"
#include "lanes.h"
#include "pack.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Prefetch distances, in items: FETCH hides the latency of memory, AHEAD that of the caches. What is fetched past the
// end of a list is never used.
constexpr uint32_t FETCH = 64, AHEAD = 4;
static_assert(FETCH <= SPARE && AHEAD <= SPARE, "prefetches must stay within the spare items of the arrays");

// A block is tested for finished pixels after every ROUND splats. Lists are padded with the splat NOWHERE, which is
// invisible everywhere.
constexpr uint32_t ROUND = 2, NOWHERE = SLAB;

// The list of splats on each block, and which blocks are finished.
struct Blocks {
    uint16_t* lists;
    uint16_t* ends[LISTS];  // end of each list
    bool finished[BLOCKS];

    uint16_t* list(int block) const { return lists + block * LIST; }

    void empty() {
        for (int block = 0; block < LISTS; ++block) ends[block] = list(block);
    }

    // Branch-free append: with a count of 1 the splat stays, with 0 the next one overwrites it.
    void add(uint32_t block, uint32_t splat, uint32_t count) {
        *ends[block] = uint16_t(splat);
        ends[block] += count;
    }
};

// Initialise the pixels of a tile, with nothing drawn yet. Pixels outside the tile count as finished.
template <bool WITH_DEPTH>
LANE_INLINE void start_tile(const Scratch& scratch, Blocks& blocks, const Tile& tile, const float* background) {
    float* pixels = scratch.pixels;
    scratch.slab[NOWHERE] = {};
    scratch.slab[NOWHERE].splat.log2_opacity = -1e30f;
    blocks.lists = scratch.lists;
    const Lanes start[CHANNELS] = {lanes(background[RED]), lanes(background[GREEN]), lanes(background[BLUE]),
                                   lanes(1.0f),            lanes(0.0f),              lanes(0.0f)};
    blocks.empty();
    for (int block = 0; block < BLOCKS; ++block) {
        const int left = tile.left + block % ACROSS * BLOCK, top = tile.top + block / ACROSS * BLOCK;
        blocks.finished[block] = left >= tile.right || top >= tile.bottom;
        if (blocks.finished[block]) continue;
        float* channels = pixels + block * CHANNELS * LANES;
        for (int channel = 0; channel < (WITH_DEPTH ? CHANNELS : DEPTH); ++channel)
            store(channels + channel * LANES, start[channel]);
        if (left + BLOCK <= tile.right && top + BLOCK <= tile.bottom) continue;
        for (int lane = 0; lane < LANES; ++lane)
            if (left + lane % BLOCK >= tile.right || top + lane / BLOCK >= tile.bottom)
                channels[TRANSMITTANCE * LANES + lane] = 0.0f;
    }
}

// Copy the splats of a slab, nearest first, with their colours in single precision, and append each to the lists of its
// blocks. `peaks` holds the peak of every splat, or is null where all have MAX_ALPHA.
template <bool WITH_DEPTH, bool PEAKED>
LANE_INLINE void deal(const Scratch& scratch, const float* peaks, const uint64_t* keys, uint32_t count,
                      Blocks& blocks) {
    const Splat* splats = scratch.splats;
    SlabSplat* slab = scratch.slab;
    for (uint32_t i = 0; i < count; ++i) {
        const uint32_t from = uint32_t(keys[i]);
        const Splat& splat = splats[from];
        __builtin_prefetch(&splats[uint32_t(keys[i + FETCH])]);
        slab[i].splat = splat;
        store_four_halves(&slab[i].red, &splat.red);
        if (PEAKED) slab[i].peak = peaks == nullptr ? MAX_ALPHA : peaks[from];
        if (WITH_DEPTH) {
            const uint32_t depth_bits = uint32_t(keys[i] >> 32);
            std::memcpy(&slab[i].depth, &depth_bits, sizeof(depth_bits));
        }
        const uint32_t patch = splat.patch, first = patch % BLOCKS;
        const uint32_t right = patch >> RIGHT & (ACROSS - 1), down = patch >> DOWN;
        if (!(patch & LARGE)) {
            blocks.add(first, i, 1);
            blocks.add(first + 1, i, right);
            blocks.add(first + ACROSS, i, down);
            blocks.add(first + ACROSS + 1, i, right & down);
            continue;
        }
        if (right <= 2 && down <= 2) {
            for (uint32_t y = 0; y <= 2; ++y)
                for (uint32_t x = 0; x <= 2; ++x) blocks.add(first + y * ACROSS + x, i, (x <= right) & (y <= down));
            continue;
        }
        for (uint32_t line = first; line <= first + down * ACROSS; line += ACROSS)
            for (uint32_t block = line; block <= line + right; ++block) blocks.add(block, i, 1);
    }
}

// Blend a list of splats over one block, front to back. Returns whether all its pixels are finished. A splat
// contributes nothing to a pixel whose transmittance before it (with FIRM, after it) is at or below `finished`. The
// transmittance itself keeps falling, so a finished pixel stays finished; and if no pixel of the block is finished
// after a round, all contributions of the round count.
template <bool WITH_DEPTH, bool FIRM, bool PEAKED>
LANE_INLINE bool blend_block(const SlabSplat* slab, const uint16_t* item, const uint16_t* end, float left, float top,
                             const Row& row, float* channels) {
    alignas(64) static constexpr float COLUMNS[LANES] = {0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f,
                                                         0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f};
    alignas(64) static constexpr float ROWS[LANES] = {0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f,
                                                      2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, 3.5f, 3.5f};
    const Lanes x = load(COLUMNS) + left, y = load(ROWS) + top;
    Lanes red = load(channels + RED * LANES), green = load(channels + GREEN * LANES);
    Lanes blue = load(channels + BLUE * LANES), transmittance = load(channels + TRANSMITTANCE * LANES);
    Lanes depth = load(channels + DEPTH * LANES), alpha = load(channels + ALPHA * LANES);
    constexpr uint32_t ALL = (1u << LANES) - 1;
    const float finished = row.finished, log2_invisible = row.log2_invisible;
    const Lanes bound = lanes(finished);
    for (; item < end; item += ROUND) {
        Lanes shares[ROUND], seen[ROUND];
#pragma GCC unroll 2
        for (uint32_t i = 0; i < ROUND; ++i) {
            __builtin_prefetch(&slab[item[AHEAD + i]]);
            const SlabSplat& colors = slab[item[i]];
            const Splat& splat = colors.splat;
            const Lanes before = transmittance;
            const Lanes u = x * splat.l11 + (y * splat.l12 + splat.u0), v = y * splat.l22 + splat.v0;
            shares[i] = before * alpha_of<PEAKED>(u, v, splat.log2_opacity, colors.peak, log2_invisible);
            transmittance = before - shares[i];
            seen[i] = FIRM ? transmittance : before;
        }
        const auto add = [&](auto open) {
#pragma GCC unroll 2
            for (uint32_t i = 0; i < ROUND; ++i) {
                const SlabSplat& colors = slab[item[i]];
                const LaneMask counted = decltype(open)::value ? all_lanes() : above(seen[i], finished);
                red = add_product_where(counted, red, shares[i], colors.red);
                green = add_product_where(counted, green, shares[i], colors.green);
                blue = add_product_where(counted, blue, shares[i], colors.blue);
                if (WITH_DEPTH) {
                    depth = add_product_where(counted, depth, shares[i], colors.depth);
                    alpha = add_product_where(counted, alpha, shares[i], 1.0f);
                }
            }
        };
        if (bits_above(transmittance, bound) == ALL)
            add(std::true_type());
        else
            add(std::false_type());
    }
    store(channels + RED * LANES, red);
    store(channels + GREEN * LANES, green);
    store(channels + BLUE * LANES, blue);
    store(channels + TRANSMITTANCE * LANES, transmittance);
    if (WITH_DEPTH) {
        store(channels + DEPTH * LANES, depth);
        store(channels + ALPHA * LANES, alpha);
    }
    return bits_above(transmittance, bound) == 0;
}

// Blend the splats in the lists of the blocks, and empty the lists. Returns whether all blocks are finished; adds the
// number of blended pairs of a splat and a block to `blended`.
template <bool WITH_DEPTH, bool FIRM, bool PEAKED>
static OUT_OF_LINE bool blend_blocks(const Scratch& scratch, const Tile& tile, const Row& row, Blocks& blocks,
                                     uint32_t& blended) {
    bool all_finished = true;
    for (int block = 0; block < BLOCKS; ++block) {
        if (blocks.finished[block]) continue;
        uint16_t *item = blocks.list(block), *end = blocks.ends[block];
        if (item < end) {
            for (uint32_t i = 0; i + 1 < ROUND; ++i) end[i] = NOWHERE;
            blocks.finished[block] = blend_block<WITH_DEPTH, FIRM, PEAKED>(
                scratch.slab, item, end, float(tile.left + block % ACROSS * BLOCK),
                float(tile.top + block / ACROSS * BLOCK), row, scratch.pixels + block * CHANNELS * LANES);
            blended += uint32_t(end - item);
        }
        all_finished = all_finished && blocks.finished[block];
    }
    blocks.empty();
    return all_finished;
}

// Blend splats in the order of their keys. Returns the number of blended pairs of a splat and a block.
template <bool WITH_DEPTH, bool FIRM, bool PEAKED>
static uint32_t blend_splats(const Tile& tile, const Row& row, const uint64_t* keys, uint32_t count,
                             const Scratch& scratch, Blocks& blocks) {
    const float* peaks = row.count > 0 && row.parts->scene->tolerance > 0.0f ? scratch.peaks : nullptr;
    uint32_t blended = 0;
    for (uint32_t next = 0; next < count; next += SLAB) {
        deal<WITH_DEPTH, PEAKED>(scratch, peaks, keys + next, count - next < SLAB ? count - next : SLAB, blocks);
        if (blend_blocks<WITH_DEPTH, FIRM, PEAKED>(scratch, tile, row, blocks, blended)) break;
    }
    return blended;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
