// Sorts splats by depth and builds, for each block of 4×4 pixels, the list of splats that are visible on it, nearest
// first.
#pragma once

#include "fit_kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Radix sort by depth, least significant digit first; splats of equal depth keep the order of the model.
static void sort_splats(const FitScratch& scratch, uint32_t count) {
    constexpr int DIGIT = 11, VALUES = 1 << DIGIT, PASSES = 3;
    uint32_t starts[PASSES][VALUES] = {};
    for (uint32_t i = 0; i < count; ++i)
        for (int pass = 0; pass < PASSES; ++pass) ++starts[pass][(scratch.keys[i] >> (32 + DIGIT * pass)) % VALUES];
    uint64_t *from = scratch.keys, *to = scratch.sorted;
    for (int pass = 0; pass < PASSES; ++pass) {
        uint32_t sum = 0;
        for (int value = 0; value < VALUES; ++value) {
            const uint32_t here = starts[pass][value];
            starts[pass][value] = sum;
            sum += here;
        }
        for (uint32_t i = 0; i < count; ++i) to[starts[pass][(from[i] >> (32 + DIGIT * pass)) % VALUES]++] = from[i];
        uint64_t* other = from;
        from = to, to = other;
    }
    for (uint32_t i = 0; i < count; ++i) {
        if (i + 16 < count) __builtin_prefetch(&scratch.projected[uint32_t(from[i + 16])]);
        scratch.splats[i] = scratch.projected[uint32_t(from[i])];
        scratch.ranks[scratch.splats[i].source] = i;
    }
}

// The ellipse in which a splat is visible, relative to its centre: |l11 dx + l12 dy|² + |l22 dy|² <= reach².
struct Ellipse {
    float reach, tilt, inverse_l11, squared_l22, peak_y;

    explicit Ellipse(const FitSplat& s)
        : reach(__builtin_sqrtf(s.log2_opacity - LOG2_INVISIBLE_ANTIALIASED) * 1.0001f), tilt(s.l12),
          inverse_l11(1.0f / s.l11), squared_l22(s.l22 * s.l22),
          peak_y(-s.l12 * reach / (s.l22 * __builtin_sqrtf(s.l12 * s.l12 + s.l22 * s.l22))) {}

    float half(float dy) const {
        const float squared = reach * reach - squared_l22 * dy * dy;
        return squared > 0.0f ? __builtin_sqrtf(squared) : 0.0f;
    }
    // Largest dx of the ellipse for dy in [low, high].
    float right(float low, float high) const {
        const float dy = peak_y < low ? low : peak_y > high ? high : peak_y;
        return (half(dy) - tilt * dy) * inverse_l11;
    }
    // Smallest dx of the ellipse for dy in [low, high].
    float left(float low, float high) const {
        const float dy = -peak_y < low ? low : -peak_y > high ? high : -peak_y;
        return (-half(dy) - tilt * dy) * inverse_l11;
    }
};

constexpr uint32_t NO_SPAN = 1;  // an empty span: its first block, 1, comes after its last, 0

LANE_INLINE uint32_t span_of(float left, float right, int width) {
    const float low = left - 0.501f, high = right - 0.499f;  // a thousandth of a pixel of slack for rounding
    const int first = low <= 0.0f ? 0 : low >= float(width) ? width : int(__builtin_ceilf(low));
    const int last = high < 0.0f ? -1 : high >= float(width - 1) ? width - 1 : int(high);
    if (first > last) return NO_SPAN;
    return uint32_t(first / FIT_BLOCK) | uint32_t(last / FIT_BLOCK) << 16;
}

static size_t count_all(const FitGrid& grid, const FitScratch& scratch, uint32_t visible) {
    for (size_t block = 0; block <= grid.blocks(); ++block) scratch.starts[block] = 0;
    uint32_t* span = scratch.spans;
    for (uint32_t i = 0; i < visible; ++i) {
        const FitSplat& splat = scratch.splats[i];
        const Ellipse ellipse(splat);
        for (int row = splat.first_row; row <= splat.last_row; ++row) {
            const float low = float(row * FIT_BLOCK) + 0.499f - splat.y;
            const float high = low + float(FIT_BLOCK) - 0.998f;
            *span = span_of(splat.x + ellipse.left(low, high), splat.x + ellipse.right(low, high), grid.width);
            const uint32_t first = *span & 0xffff, last = *span >> 16;
            ++span;
            uint32_t* starts = scratch.starts + size_t(row) * size_t(grid.across);
            for (uint32_t block = first; block <= last && block < uint32_t(grid.across); ++block) ++starts[block];
        }
    }
    uint32_t sum = 0;
    for (size_t block = 0; block <= grid.blocks(); ++block) {
        const uint32_t here = scratch.starts[block];
        scratch.starts[block] = sum;
        sum += here;
    }
    return sum;
}

static void fill_all(const FitGrid& grid, const FitScratch& scratch, uint32_t visible) {
    const uint32_t* span = scratch.spans;
    for (uint32_t i = 0; i < visible; ++i)
        for (int row = scratch.splats[i].first_row; row <= scratch.splats[i].last_row; ++row, ++span) {
            uint32_t* starts = scratch.starts + size_t(row) * size_t(grid.across);
            for (uint32_t block = *span & 0xffff; block <= *span >> 16; ++block) scratch.list[starts[block]++] = i;
        }
    for (size_t block = grid.blocks(); block > 0; --block) scratch.starts[block] = scratch.starts[block - 1];
    scratch.starts[0] = 0;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
