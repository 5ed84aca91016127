// Blending of blocks of 4×4 pixels, front to back, and its backward: a lane a pixel, then a lane a splat.
#pragma once

#include "fit_kernel.h"
#include "kernels/fit_turn.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr float LOG2_MAX_ALPHA = -0.00144341686f;
constexpr uint32_t FIT_AHEAD = 4;

struct FitBlock {
    Lanes x, y;
    size_t place;  // of its first pixel in a plane
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

LANE_INLINE Lanes exponent_at(const FitSplat& splat, const Lanes& dx, const Lanes& dy) {
    const Lanes u = dx * splat.l11 + dy * splat.l12, v = dy * splat.l22;
    return splat.log2_opacity - u * u - v * v;
}

LANE_INLINE Lanes alpha_of(const Lanes& exponent) {
    return select_if_at_least(exponent, LOG2_INVISIBLE_ANTIALIASED, min(exp2(exponent), MAX_ALPHA));
}

static void blend_all(const FitGrid& grid, const FitScratch& scratch) {
    for (size_t block = 0; block < grid.blocks(); ++block) {
        const FitBlock at = block_at(grid, scratch, block);
        Lanes sums[FIT_CHANNELS];
        for (Lanes& sum : sums) sum = lanes(0.0f);
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
                sums[F_DEPTH] = add_product_where(counted, sums[F_DEPTH], share, splat.depth);
                sums[F_ALPHA] = add_product_where(counted, sums[F_ALPHA], share, 1.0f);
            }
            if (bits_above(transmittance, lanes(MIN_TRANSMITTANCE)) == 0) break;
        }
        scratch.taken[block] = uint32_t(item - at.list);
        for (int c = 0; c < FIT_CHANNELS; ++c)
            write_block(scratch.image + size_t(c) * grid.area(), grid, at.place, sums[c]);
    }
}

// What the pixels of a block carry through the backward.
struct FitBehind {
    Lanes slopes[FIT_CHANNELS], total, before, transmittance;
};

// v = dL / d ln(alpha) of one splat at the pixels, and its share; moves on behind it.
LANE_INLINE void step_back(const FitSplat& splat, const FitBlock& at, FitBehind& behind, Lanes& v, Lanes& share) {
    const Lanes exponent = exponent_at(splat, at.x - splat.x, at.y - splat.y);
    const Lanes alpha = alpha_of(exponent);
    const Lanes let_through = behind.transmittance * alpha;
    behind.transmittance = behind.transmittance - let_through;
    share = select_if_at_least(behind.transmittance, MIN_TRANSMITTANCE, let_through);
    const Lanes worth = behind.slopes[F_RED] * splat.red + behind.slopes[F_GREEN] * splat.green +
                        behind.slopes[F_BLUE] * splat.blue + behind.slopes[F_DEPTH] * splat.depth +
                        behind.slopes[F_ALPHA];
    const Lanes gain = share * worth;
    behind.before = behind.before + gain;
    const Lanes hidden = (behind.total - behind.before) * alpha * reciprocal(1.0f - alpha);
    const Lanes slope = select_if_at_least(behind.transmittance, MIN_TRANSMITTANCE, gain - hidden);
    v = select_if_at_least(-exponent, -LOG2_MAX_ALPHA, slope);
}

// The moments of sixteen splats over a block: `turned_v` and `turned_share` are [pixels, splats].
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
    for (int c = 0; c < F_ALPHA; ++c) out[M_RED + c] = lanes(0.0f);
    for (int pixel = 0; pixel < LANES; ++pixel) {
        const Lanes share = load(turned_share + pixel * LANES);
        for (int c = 0; c < F_ALPHA; ++c) out[M_RED + c] = out[M_RED + c] + share * slopes[c * LANES + pixel];
    }
}

// From the centre of the block to the centre of each splat: (ox, oy) is from the splat to the block.
LANE_INLINE void recentre(const Lanes& ox, const Lanes& oy, Lanes* m) {
    const Lanes vx = m[M_VX] + ox * m[M_V], vy = m[M_VY] + oy * m[M_V];
    m[M_VXX] = m[M_VXX] + ox * (m[M_VX] + vx);
    m[M_VXY] = m[M_VXY] + ox * m[M_VY] + oy * vx;
    m[M_VYY] = m[M_VYY] + oy * (m[M_VY] + vy);
    m[M_VX] = vx, m[M_VY] = vy;
}

// Up to sixteen splats of a block's list.
LANE_INLINE void block_batch(const FitScratch& scratch, const FitBlock& at, const uint32_t* item, int count,
                             const float* slopes, FitBehind& behind) {
    alignas(64) float v[LANES * LANES], share[LANES * LANES], turned_v[LANES * LANES], turned_share[LANES * LANES];
    alignas(64) float x[LANES] = {}, y[LANES] = {};
    for (int i = 0; i < count; ++i) {
        __builtin_prefetch(scratch.moments + size_t(item[i]) * FIT_MOMENTS, 1);
        const FitSplat& splat = scratch.splats[item[i]];
        x[i] = splat.x, y[i] = splat.y;
        Lanes slope, weight;
        step_back(splat, at, behind, slope, weight);
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
        alignas(64) float slopes[FIT_CHANNELS * LANES];
        for (int c = 0; c < FIT_CHANNELS; ++c) {
            behind.slopes[c] = read_block(scratch.slopes + size_t(c) * grid.area(), grid, at.place);
            store(slopes + LANES * c, behind.slopes[c]);
            const Lanes value = read_block(scratch.image + size_t(c) * grid.area(), grid, at.place);
            behind.total = behind.total + behind.slopes[c] * value;
        }
        const uint32_t taken = scratch.taken[block];
        for (uint32_t first = 0; first < taken; first += LANES)
            block_batch(scratch, at, at.list + first, int(taken - first < LANES ? taken - first : LANES), slopes,
                        behind);
    }
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
