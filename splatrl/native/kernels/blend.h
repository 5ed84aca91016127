// From sorted splats to a frame: slabs of them are dealt to the blocks that they touch, then each block is blended
// with its pixels in registers. Blocks that are finished take no more splats.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Items whose splats are fetched ahead: enough for the second-level cache to answer. What is fetched past the end of a
// list is never used.
constexpr uint32_t AHEAD = 12;
static_assert(AHEAD <= SPARE, "the arrays have room to read ahead");

LANE_INLINE void start_frame(const Scratch& scratch, uint32_t blocks) {
    for (uint32_t block = 0; block < blocks; ++block) {
        float* channels = scratch.frame + size_t(block) * CHANNELS * LANES;
        for (int channel = 0; channel < CHANNELS; ++channel)
            store(channels + channel * LANES, lanes(channel == TRANSMITTANCE ? 1.0f : 0.0f));
        scratch.finished[block] = 0;
    }
}

// Lanes outside the image start finished.
LANE_INLINE void close_margins(const Scratch& scratch, const Camera& camera, int across, int down) {
    for (int row = 0; row < down; ++row)
        for (int column = 0; column < across; ++column) {
            if ((row + 1) * BLOCK <= camera.height && (column + 1) * BLOCK <= camera.width) continue;
            float* transmittance =
                scratch.frame + (size_t(row * across + column) * CHANNELS + TRANSMITTANCE) * LANES;
            for (int lane = 0; lane < LANES; ++lane)
                if (row * BLOCK + lane / BLOCK >= camera.height || column * BLOCK + lane % BLOCK >= camera.width)
                    transmittance[lane] = 0.0f;
        }
}

// Write the pairs of a slab: splats from `next` on, until they are all dealt or the pairs are full.
// Nearly all patches are at most 2×2 blocks: those are written without a branch, and counted where they exist.
LANE_INLINE uint32_t emit_pairs(const Scratch& scratch, const uint64_t* keys, uint32_t count, uint32_t row,
                                uint32_t& next) {
    const uint8_t* finished = scratch.finished;
    Pair* pairs = scratch.pairs;
    uint32_t written = 0;
    for (; next < count; ++next) {
        const uint32_t splat = uint32_t(keys[next]);
        __builtin_prefetch(&scratch.patches[uint32_t(keys[next + AHEAD])]);
        const Patch patch = scratch.patches[splat];
        const uint32_t first = patch.first, across = patch.across, down = patch.down;
        if (written + across * down > scratch.pair_capacity) break;
        if (across <= 2 && down <= 2) {
            const uint32_t right = across - 1, below = (down - 1) * row;
            pairs[written] = {first, splat};
            written += !finished[first];
            pairs[written] = {first + right, splat};
            written += right & !finished[first + right];
            pairs[written] = {first + below, splat};
            written += (down - 1) & !finished[first + below];
            pairs[written] = {first + below + right, splat};
            written += right & (down - 1) & !finished[first + below + right];
            continue;
        }
        for (uint32_t line = first; line < first + down * row; line += row)
            for (uint32_t block = line; block < line + across; ++block) {
                pairs[written] = {block, splat};
                written += !finished[block];
            }
    }
    return written;
}

// Deal the pairs to the lists of their blocks, keeping their order.
LANE_INLINE void deal(const Scratch& scratch, uint32_t pairs, uint32_t blocks) {
    uint32_t* ends = scratch.list_ends;
    for (uint32_t block = 0; block <= blocks; ++block) ends[block] = 0;
    for (uint32_t i = 0; i < pairs; ++i) ++ends[scratch.pairs[i].block + 1];
    for (uint32_t block = 0; block < blocks; ++block) ends[block + 1] += ends[block];
    for (uint32_t i = 0; i < pairs; ++i) scratch.lists[ends[scratch.pairs[i].block]++] = scratch.pairs[i].splat;
}

// Blend a list of splats over one block. Returns whether all its pixels are finished.
template <bool WITH_DEPTH>
LANE_INLINE bool blend_block(const Scratch& scratch, const uint32_t* item, const uint32_t* end, float left, float top,
                             float* channels) {
    alignas(64) float columns[LANES], rows[LANES];
    for (int lane = 0; lane < LANES; ++lane) {
        columns[lane] = left + float(lane % BLOCK) + 0.5f;
        rows[lane] = top + float(lane / BLOCK) + 0.5f;
    }
    const Lanes x = load(columns), y = load(rows);
    Lanes red = load(channels + RED * LANES), green = load(channels + GREEN * LANES);
    Lanes blue = load(channels + BLUE * LANES), alpha = load(channels + ALPHA * LANES);
    Lanes depth = load(channels + DEPTH * LANES), transmittance = load(channels + TRANSMITTANCE * LANES);
    for (uint32_t counter = 1; item < end; ++item, ++counter) {
        __builtin_prefetch(&scratch.splats[item[AHEAD]]);
        const Splat& splat = scratch.splats[*item];
        const Lanes opacity =
            alpha_at(x - splat.x, y - splat.y, splat.l11, splat.l12, splat.l22, splat.log2_opacity);
        const Lanes share = blend_share(opacity, transmittance);
        red = red + share * splat.red;
        green = green + share * splat.green;
        blue = blue + share * splat.blue;
        alpha = alpha + share;
        if (WITH_DEPTH) depth = depth + share * splat.depth;
        if (counter % 4 == 0 && bits_above(transmittance, lanes(MIN_TRANSMITTANCE)) == 0) break;
    }
    const bool finished = bits_above(transmittance, lanes(MIN_TRANSMITTANCE)) == 0;
    store(channels + RED * LANES, red);
    store(channels + GREEN * LANES, green);
    store(channels + BLUE * LANES, blue);
    store(channels + ALPHA * LANES, alpha);
    store(channels + DEPTH * LANES, depth);
    store(channels + TRANSMITTANCE * LANES, transmittance);
    return finished;
}

template <bool WITH_DEPTH>
static void blend_frame(const Camera& camera, const uint64_t* keys, uint32_t count, const Scratch& scratch) {
    const int across = (camera.width + BLOCK - 1) / BLOCK, down = (camera.height + BLOCK - 1) / BLOCK;
    const uint32_t blocks = uint32_t(across * down);
    start_frame(scratch, blocks);
    close_margins(scratch, camera, across, down);
    for (uint32_t next = 0; next < count;) {
        const uint32_t pairs = emit_pairs(scratch, keys, count, uint32_t(across), next);
        deal(scratch, pairs, blocks);
        const uint32_t* item = scratch.lists;
        for (uint32_t block = 0; block < blocks; ++block) {
            const uint32_t* end = scratch.lists + scratch.list_ends[block];
            if (item == end) continue;
            const float left = float(int(block) % across * BLOCK), top = float(int(block) / across * BLOCK);
            float* channels = scratch.frame + size_t(block) * CHANNELS * LANES;
            scratch.finished[block] = blend_block<WITH_DEPTH>(scratch, item, end, left, top, channels);
            item = end;
        }
    }
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
