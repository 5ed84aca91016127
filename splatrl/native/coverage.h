// Where a splat shows on a small tile: patches of 8×4 pixels, one for each bit of a word.
#pragma once

#include <cstdint>

#include "scalars.h"
#include "splat.h"

namespace splatrl {

constexpr int PATCH_WIDTH = 8, PATCH_HEIGHT = 4;       // 32 pixels: the lanes of a warp
constexpr int PATCHES_ACROSS = 4, PATCHES_DOWN = 8;    // of a tile
constexpr int SMALL_TILE = 32;                         // width and height, pixels
static_assert(PATCHES_ACROSS * PATCH_WIDTH == SMALL_TILE && PATCHES_DOWN * PATCH_HEIGHT == SMALL_TILE, "whole patches");

// Bits come in quads: those of 2×2 patches are consecutive, so that each quad belongs to one warp.
SPLAT_INLINE int patch_bit(int column, int row) {
    return row / 2 * (PATCHES_ACROSS / 2) * 4 + column / 2 * 4 + row % 2 * 2 + column % 2;
}

// The ellipse in which a splat is visible, by its right edge: dx = center ± half where dy is known.
struct Ellipse {
    float squared_reach;     // of u² + v²
    float l12, l22, inverse_l11;
    float height, tip;       // the largest dy; and dy where dx is largest

    INLINE_MEMBER void of(const Footprint<float>& print, float log2_invisible) {
        squared_reach = max(print.log2_opacity - log2_invisible, 0.0f) * 1.0002f + 1e-6f;
        l12 = print.l12, l22 = print.l22, inverse_l11 = reciprocal(print.l11);
        const float inverse_l22 = reciprocal(l22), slope = l12 * inverse_l22;
        height = square_root(squared_reach) * inverse_l22;
        tip = -height * slope * reciprocal_sqrt(1.0f + slope * slope);
    }

    // The largest dx for dy in [low, high], which meets [-height, height]; the boundary is concave.
    INLINE_MEMBER float right(float low, float high) const { return edge(min(max(tip, low), high), 1.0f); }
    INLINE_MEMBER float left(float low, float high) const { return edge(min(max(-tip, low), high), -1.0f); }

private:
    INLINE_MEMBER float edge(float dy, float side) const {
        const float v = l22 * dy;
        return (side * square_root(max(squared_reach - v * v, 0.0f)) - l12 * dy) * inverse_l11;
    }
};

// The patches of a tile on which a splat shows at the centre of some pixel; perhaps a few more, never fewer. Only
// pixels from (left, top) up to (right, bottom), exclusive, count.
SPLAT_INLINE uint32_t covered_patches(const Footprint<float>& print, const Tile& tile, float log2_invisible) {
    if (!(print.log2_opacity > log2_invisible && print.depth >= NEAR_DEPTH)) return 0;
    Ellipse ellipse;
    ellipse.of(print, log2_invisible);
    constexpr float SLACK = 1e-3f;  // pixels: covers the rounding here
    const float first = max(print.x - print.extent_x, float(tile.left));
    const float last = min(print.x + print.extent_x, float(tile.right));
    const float above = print.y - print.extent_y, below = print.y + print.extent_y;
    if (!(first <= last && above <= float(tile.bottom) && below >= float(tile.top))) return 0;
    uint32_t mask = 0;
    const int top_row = int(max(above - float(tile.top), 0.0f)) / PATCH_HEIGHT;
    const int bottom_row = int(min(below - float(tile.top), float(SMALL_TILE - 1))) / PATCH_HEIGHT;
    for (int row = top_row; row <= bottom_row; ++row) {
        const float top = float(tile.top + row * PATCH_HEIGHT) + 0.5f - SLACK;  // centres of the first and last line
        const float bottom = min(top + float(PATCH_HEIGHT - 1), float(tile.bottom) - 0.5f) + 2.0f * SLACK;
        const float low = max(top - print.y, -ellipse.height), high = min(bottom - print.y, ellipse.height);
        if (!(low <= high)) continue;
        const float reach_left = max(print.x + ellipse.left(low, high), first) - SLACK;
        const float reach_right = min(print.x + ellipse.right(low, high), last) + SLACK;
        uint32_t columns = 0;
        for (int column = 0; column < PATCHES_ACROSS; ++column) {
            const float west = float(tile.left + column * PATCH_WIDTH) + 0.5f;  // centres of the first and last column
            const float east = min(west + float(PATCH_WIDTH - 1), float(tile.right) - 0.5f);
            if (reach_left <= east && reach_right >= west) columns |= 1u << patch_bit(column, 0);
        }
        mask |= columns << patch_bit(0, row);
    }
    return mask;
}

}  // namespace splatrl
