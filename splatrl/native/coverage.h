// Where a splat shows on a small tile: cells of 4×2 pixels.
#pragma once

#include <cstdint>

#include "passes.h"
#include "scalars.h"
#include "splat.h"

namespace splatrl {

constexpr int SMALL_TILE = 32;                    // width and height of a tile, pixels
constexpr int CELL_WIDTH = 4, CELL_HEIGHT = 2;    // 8 pixels: a quarter of the lanes of a warp
constexpr int CELLS_ACROSS = SMALL_TILE / CELL_WIDTH, CELLS_DOWN = SMALL_TILE / CELL_HEIGHT;
constexpr int CELLS = CELLS_ACROSS * CELLS_DOWN;  // of a tile
constexpr uint32_t BLOCK_CELLS = 4;               // 4×4 cells, 16×8 pixels, belong to one warp

// Cells are numbered warp by warp; those of a warp by where they are in a patch of 2×2 cells, and then patch by patch,
// so that one quarter of its lanes finds its cells of all four patches side by side.
SPLAT_INLINE uint32_t cell_number(uint32_t column, uint32_t row) {
    const uint32_t warp = row / BLOCK_CELLS * (CELLS_ACROSS / BLOCK_CELLS) + column / BLOCK_CELLS;
    const uint32_t quarter = row % 2 * 2 + column % 2, patch = row / 2 % 2 * 2 + column / 2 % 2;
    return (warp * 4 + quarter) * 4 + patch;
}

// Pixels or lines of a tile, first to last; none where last < first.
struct Stretch {
    int first, last;

    INLINE_MEMBER bool empty() const { return last < first; }
};

// Those whose centres, at halves, are within `half` of `middle`; perhaps one more on either side, never fewer.
SPLAT_INLINE Stretch stretch_of(float middle, float half) {
    constexpr float SLACK = 1e-3f;  // pixels: covers the rounding of what is asked
    constexpr float MOST = float(SMALL_TILE);
    const float from = min(max(middle - half - (0.5f + SLACK), 0.0f), MOST);
    const float until = min(max(middle + half + (0.5f + SLACK), 0.0f), MOST);
    return {SMALL_TILE - int(MOST - from), int(until) - 1};  // rounded up, and down
}

// Whether a splat may show on a tile: whether there is a pixel in its box.
SPLAT_INLINE bool may_show(const Footprint<float>& print, const Tile& tile, float log2_invisible) {
    return print.log2_opacity > log2_invisible && print.depth >= NEAR_DEPTH &&
           !stretch_of(print.x - float(tile.left), print.extent_x).empty() &&
           !stretch_of(print.y - float(tile.top), print.extent_y).empty();
}

// The ellipse in which a splat is visible, seen from the corner of a tile.
struct Ellipse {
    float x, y, squared_reach;  // of u² + v²
    float l22, slant, inverse_l11;

    INLINE_MEMBER Ellipse(float x, float y, float l11, float l12, float l22, float squared_reach)
        : x(x), y(y), squared_reach(squared_reach * 1.0002f + 1e-6f), l22(l22), inverse_l11(reciprocal(l11)) {
        slant = l12 * inverse_l11;
    }

    INLINE_MEMBER Stretch lines() const { return stretch_of(y, square_root(squared_reach) * reciprocal(l22)); }

    // Its pixels in a line.
    INLINE_MEMBER Stretch pixels(int line) const {
        const float dy = float(line) + 0.5f - y, v = l22 * dy;
        return stretch_of(x - slant * dy, square_root(max(squared_reach - v * v, 0.0f)) * inverse_l11);
    }
};

// Call show(number) for each cell on which an ellipse may show.
template <class Show>
SPLAT_INLINE void for_each_cell(const Ellipse& ellipse, const Show& show) {
    const Stretch lines = ellipse.lines();
    if (lines.empty()) return;
    for (int row = lines.first / CELL_HEIGHT; row <= lines.last / CELL_HEIGHT; ++row) {
        PASS(row);
        const Stretch upper = ellipse.pixels(CELL_HEIGHT * row), lower = ellipse.pixels(CELL_HEIGHT * row + 1);
        const int first = upper.first < lower.first ? upper.first : lower.first;
        const int last = upper.last > lower.last ? upper.last : lower.last;
        for (int column = first / CELL_WIDTH; first <= last && column <= last / CELL_WIDTH; ++column) {
            PASS(cell);
            show(cell_number(uint32_t(column), uint32_t(row)));
        }
    }
}

}  // namespace splatrl
