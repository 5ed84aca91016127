// Front-to-back blending of blocks of 4×4 pixels, with one lane per pixel, and its backward pass, which then sums over
// pixels with one lane per splat.
#pragma once

#include "fit_kernel.h"
#include "kernels/fit_pixel.h"
#include "kernels/fit_turn.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr uint32_t FIT_AHEAD = 4;

struct FitBlock {
    Lanes x, y;
    size_t place;  // offset of its first pixel in a plane
    const uint32_t *list, *end;
};

LANE_INLINE FitBlock block_at(const FitGrid& grid, const FitScratch& scratch, size_t block) {
    alignas(64) static constexpr float COLUMNS[LANES] = {0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f,
                                                         0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f};
    alignas(64) static constexpr float ROWS[LANES] = {0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f,
                                                      2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, 3.5f, 3.5f};
    const int left = int(block % size_t(grid.across)) * FIT_BLOCK, top = int(block / size_t(grid.across)) * FIT_BLOCK;
    return {load(COLUMNS) + float(left), load(ROWS) + float(top), size_t(top) * size_t(grid.stride) + size_t(left),
            scratch.list + scratch.starts[block], scratch.list + scratch.starts[block + 1]};
}

LANE_INLINE void write_block(float* plane, const FitGrid& grid, size_t place, const Lanes& value) {
    alignas(64) float pixels[LANES];
    store(pixels, value);
    for (int row = 0; row < FIT_BLOCK; ++row)
        std::memcpy(plane + place + size_t(row) * size_t(grid.stride), pixels + FIT_BLOCK * row, 4 * FIT_BLOCK);
}

LANE_INLINE Lanes read_block(const float* plane, const FitGrid& grid, size_t place) {
    alignas(64) float pixels[LANES];
    for (int row = 0; row < FIT_BLOCK; ++row)
        std::memcpy(pixels + FIT_BLOCK * row, plane + place + size_t(row) * size_t(grid.stride), 4 * FIT_BLOCK);
    return load(pixels);
}

template <bool KNOWN>
LANE_INLINE void blend_block(const FitScratch& scratch, const FitBlock& at, const Lanes& known, size_t block,
                             Lanes* sums) {
    Lanes transmittance = lanes(1.0f);
    const uint32_t* item = at.list;
    while (item < at.end) {
        const uint32_t* stop = at.end - item > 16 ? item + 16 : at.end;
        for (; item < stop; ++item) {
            if (item + FIT_AHEAD < at.end) __builtin_prefetch(&scratch.splats[item[FIT_AHEAD]]);
            const FitSplat& splat = scratch.splats[*item];
            const Lanes share = transmittance * alpha_of(exponent_at(splat, at.x - splat.x, at.y - splat.y));
            transmittance = transmittance - share;
            const LaneMask counted = above(transmittance, MIN_TRANSMITTANCE);
            sums[F_RED] = add_product_where(counted, sums[F_RED], share, splat.red);
            sums[F_GREEN] = add_product_where(counted, sums[F_GREEN], share, splat.green);
            sums[F_BLUE] = add_product_where(counted, sums[F_BLUE], share, splat.blue);
            if (KNOWN)
                sums[F_AGREEMENT] =
                    add_product_where(counted, sums[F_AGREEMENT], share * agreement(splat.depth, known), 1.0f);
            sums[F_ALPHA] = add_product_where(counted, sums[F_ALPHA], share, 1.0f);
        }
        if (bits_above(transmittance, lanes(MIN_TRANSMITTANCE)) == 0) break;
    }
    scratch.taken[block] = uint32_t(item - at.list);
}

static void blend_all(const FitGrid& grid, const FitScratch& scratch) {
    for (size_t block = 0; block < grid.blocks(); ++block) {
        const FitBlock at = block_at(grid, scratch, block);
        const Lanes known = read_block(scratch.known, grid, at.place);
        Lanes sums[FIT_CHANNELS];
        for (Lanes& sum : sums) sum = lanes(0.0f);
        if (bits_above(known, lanes(0.0f)) != 0)
            blend_block<true>(scratch, at, known, block, sums);
        else
            blend_block<false>(scratch, at, known, block, sums);
        for (int c = 0; c < FIT_CHANNELS; ++c)
            write_block(scratch.image + size_t(c) * grid.area(), grid, at.place, sums[c]);
    }
}

// Sum the moments of sixteen splats over a block, about its centre: `turned_v` and `turned_share` are [pixels, splats].
LANE_INLINE void block_moments(const float* turned_v, const float* turned_share, const float* slopes, Lanes* out) {
    Lanes m[6];
    for (Lanes& moment : m) moment = lanes(0.0f);
    for (int row = 0; row < FIT_BLOCK; ++row) {
        const float y = float(row) - 1.5f;
        const float* line = turned_v + row * FIT_BLOCK * LANES;
        const Lanes v0 = load(line), v1 = load(line + LANES), v2 = load(line + 2 * LANES), v3 = load(line + 3 * LANES);
        const Lanes outer = v0 + v3, inner = v1 + v2;
        const Lanes flat = outer + inner, first = 1.5f * (v3 - v0) + 0.5f * (v2 - v1);
        m[M_V] = m[M_V] + flat;
        m[M_VX] = m[M_VX] + first;
        m[M_VY] = m[M_VY] + y * flat;
        m[M_VXX] = m[M_VXX] + (2.25f * outer + 0.25f * inner);
        m[M_VXY] = m[M_VXY] + y * first;
        m[M_VYY] = m[M_VYY] + (y * y) * flat;
    }
    for (int i = 0; i < 6; ++i) out[i] = m[i];
    for (int c = 0; c < 3; ++c) out[M_RED + c] = lanes(0.0f);
    for (int pixel = 0; pixel < LANES; ++pixel) {
        const Lanes share = load(turned_share + pixel * LANES);
        for (int c = 0; c < 3; ++c) out[M_RED + c] = out[M_RED + c] + share * slopes[c * LANES + pixel];
    }
}

// dL / d depth of sixteen splats, through the depth agreement, summed over a block.
LANE_INLINE Lanes depth_moment(const float* turned_share, const float* slopes, const float* known,
                               const Lanes& depth) {
    Lanes sum = lanes(0.0f);
    for (int pixel = 0; pixel < LANES; ++pixel) {
        if (known[pixel] <= 0.0f) continue;
        const Lanes away = depth * known[pixel] - 1.0f;
        const Lanes nearer = select_if_at_least(away, 0.0f, lanes(2.0f)) - 1.0f;  // minus the sign of the derivative
        const Lanes counted = select_if_at_least(1.0f - max(away, -away), 0.0f, nearer);
        sum = sum - load(turned_share + pixel * LANES) * counted * (known[pixel] * slopes[F_AGREEMENT * LANES + pixel]);
    }
    return sum;
}

// Convert moments about the centre of the block to moments about the centre of each splat; (ox, oy) points from the
// splat to the block.
LANE_INLINE void recentre(const Lanes& ox, const Lanes& oy, Lanes* m) {
    const Lanes vx = m[M_VX] + ox * m[M_V], vy = m[M_VY] + oy * m[M_V];
    m[M_VXX] = m[M_VXX] + ox * (m[M_VX] + vx);
    m[M_VXY] = m[M_VXY] + ox * m[M_VY] + oy * vx;
    m[M_VYY] = m[M_VYY] + oy * (m[M_VY] + vy);
    m[M_VX] = vx, m[M_VY] = vy;
}

// Backpropagate through up to sixteen splats of a block's list, and add to their moments.
template <bool KNOWN>
LANE_INLINE void block_batch(const FitScratch& scratch, const FitBlock& at, const uint32_t* item, int count,
                             const float* slopes, FitBehind& behind) {
    alignas(64) float v[LANES * LANES], share[LANES * LANES], turned_v[LANES * LANES], turned_share[LANES * LANES];
    alignas(64) float x[LANES] = {}, y[LANES] = {}, depth[LANES] = {};
    for (int i = 0; i < count; ++i) {
        __builtin_prefetch(scratch.moments + size_t(item[i]) * FIT_MOMENTS, 1);
        const FitSplat& splat = scratch.splats[item[i]];
        x[i] = splat.x, y[i] = splat.y, depth[i] = splat.depth;
        Lanes slope, weight;
        step_back<KNOWN>(splat, at.x, at.y, behind, slope, weight);
        store(v + LANES * i, slope);
        store(share + LANES * i, weight);
    }
    for (int i = count; i < LANES; ++i) {
        store(v + LANES * i, lanes(0.0f));
        store(share + LANES * i, lanes(0.0f));
    }
    turn(v, turned_v);
    turn(share, turned_share);
    Lanes moments[FIT_MOMENTS];
    block_moments(turned_v, turned_share, slopes, moments);
    moments[M_DEPTH] = lanes(0.0f);
    if (KNOWN) {
        alignas(64) float known[LANES];
        store(known, behind.known);
        moments[M_DEPTH] = depth_moment(turned_share, slopes, known, load(depth));
    }
    const float middle_x = at.x.part[0][0] + 1.5f, middle_y = at.y.part[0][0] + 1.5f;
    recentre(middle_x - load(x), middle_y - load(y), moments);
    for (int i = 0; i <= M_DEPTH; ++i) store(v + LANES * i, moments[i]);
    for (int i = M_DEPTH + 1; i < LANES; ++i) store(v + LANES * i, lanes(0.0f));
    turn(v, turned_v);
    for (int i = 0; i < count; ++i) {
        float* line = scratch.moments + size_t(item[i]) * FIT_MOMENTS;
        store(line, load(line) + load(turned_v + LANES * i));
    }
}

static void blend_back(const FitGrid& grid, const FitScratch& scratch, uint32_t visible) {
    std::memset(scratch.moments, 0, size_t(visible) * FIT_MOMENTS * sizeof(float));
    for (size_t block = 0; block < grid.blocks(); ++block) {
        const FitBlock at = block_at(grid, scratch, block);
        FitBehind behind;
        behind.total = behind.before = lanes(0.0f);
        behind.transmittance = lanes(1.0f);
        behind.known = read_block(scratch.known, grid, at.place);
        alignas(64) float slopes[FIT_CHANNELS * LANES];
        for (int c = 0; c < FIT_CHANNELS; ++c) {
            behind.slopes[c] = read_block(scratch.slopes + size_t(c) * grid.area(), grid, at.place);
            store(slopes + LANES * c, behind.slopes[c]);
            const Lanes value = read_block(scratch.image + size_t(c) * grid.area(), grid, at.place);
            behind.total = behind.total + behind.slopes[c] * value;
        }
        const uint32_t taken = scratch.taken[block];
        const bool known = bits_above(behind.known, lanes(0.0f)) != 0;
        for (uint32_t first = 0; first < taken; first += LANES) {
            const int count = int(taken - first < LANES ? taken - first : LANES);
            if (known)
                block_batch<true>(scratch, at, at.list + first, count, slopes, behind);
            else
                block_batch<false>(scratch, at, at.list + first, count, slopes, behind);
        }
    }
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
