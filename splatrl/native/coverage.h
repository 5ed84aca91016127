// Which cells of a small tile, 4×2 pixels each, a splat covers.
#pragma once

#include <cstdint>

#include "passes.h"
#include "scalars.h"
#include "splat.h"

namespace splatrl {

constexpr int SMALL_TILE = 32;                    // width and height of a tile, pixels
constexpr int CELL_WIDTH = 4, CELL_HEIGHT = 2;    // 8 pixels: a quarter of the lanes of a warp
constexpr int CELLS_ACROSS = SMALL_TILE / CELL_WIDTH, CELLS_DOWN = SMALL_TILE / CELL_HEIGHT;
constexpr int CELLS = CELLS_ACROSS * CELLS_DOWN;  // per tile
constexpr int BANDS = 4, BAND_ROWS = CELLS_DOWN / BANDS;  // rows of cells per band

// A warp owns a patch of 2×2 cells in each of four bands, and each quarter-warp owns one cell of each patch, since
// adjacent cells have about the same work. The patches of each band are rotated against those of the others, so that
// splats that crowd in one place of a tile, however narrow, are spread over all warps.
constexpr int PATCHES_ACROSS = CELLS_ACROSS / 2, PATCHES_DOWN = BAND_ROWS / 2;  // per band
SPLAT_INLINE int turn_across(int band) { return band % 2 * (PATCHES_ACROSS / 2) + band / 2; }
SPLAT_INLINE int turn_down(int band) { return band / 2; }

// The number of a cell. Cells are numbered by quarter-warp, so that those of each are contiguous.
SPLAT_INLINE int cell_number(int column, int row) {
    const int band = row / BAND_ROWS, across = (column / 2 + turn_across(band)) % PATCHES_ACROSS;
    const int down = (row % BAND_ROWS / 2 + turn_down(band)) % PATCHES_DOWN;
    const int quarter = (down * PATCHES_ACROSS + across) * 4 + row % 2 * 2 + column % 2;
    return quarter * BANDS + band;
}

// The column of the cell that a quarter-warp owns in a band.
SPLAT_INLINE int column_of(int quarter, int band) {
    const int across = quarter / 4 % PATCHES_ACROSS;
    return (across + PATCHES_ACROSS - turn_across(band)) % PATCHES_ACROSS * 2 + quarter % 2;
}
// The row of the cell that a quarter-warp owns in a band.
SPLAT_INLINE int row_of(int quarter, int band) {
    const int down = quarter / 4 / PATCHES_ACROSS;
    return band * BAND_ROWS + (down + PATCHES_DOWN - turn_down(band)) % PATCHES_DOWN * 2 + quarter % 4 / 2;
}

// A range of pixels or lines of a tile, both ends included; empty if last < first.
struct Stretch {
    int first, last;

    INLINE_MEMBER bool empty() const { return last < first; }
};

// The pixels whose centres, at half-integers, are from `low` to `high`; possibly one more on either side, never fewer.
SPLAT_INLINE Stretch stretch_of(float low, float high) {
    constexpr float SLACK = 1e-3f;  // pixels: covers the rounding errors of the arguments
    constexpr float MOST = float(SMALL_TILE);
    const float from = min(max(low - (0.5f + SLACK), 0.0f), MOST);
    const float until = min(max(high + (0.5f + SLACK), 0.0f), MOST);
    return {SMALL_TILE - int(MOST - from), int(until) - 1};  // `from` rounded up, `until` rounded down
}

// Whether a splat may be visible on a tile: not too faint, not too near, and with a pixel in its bounding box.
SPLAT_INLINE bool may_show(const Footprint<float>& print, const Tile& tile, float log2_invisible) {
    const float x = print.x - float(tile.left), y = print.y - float(tile.top);
    return print.log2_opacity > log2_invisible && print.depth >= NEAR_DEPTH &&
           !stretch_of(x - print.extent_x, x + print.extent_x).empty() &&
           !stretch_of(y - print.extent_y, y + print.extent_y).empty();
}

// The ellipse in which a splat is visible, relative to the corner of a tile.
struct Ellipse {
    float x, y, squared_reach;  // squared_reach: upper bound of u² + v²
    float l22, slant, inverse_l11;

    INLINE_MEMBER Ellipse(float x, float y, float l11, float l12, float l22, float squared_reach)
        : x(x), y(y), squared_reach(squared_reach * 1.0002f + 1e-6f), l22(l22), inverse_l11(reciprocal(l11)) {
        slant = l12 * inverse_l11;
    }

    INLINE_MEMBER Stretch lines() const {
        const float half = square_root(squared_reach) * reciprocal(l22);
        return stretch_of(y - half, y + half);
    }

    // The pixels that it covers in a row of cells.
    INLINE_MEMBER Stretch pixels(int row) const {
        float left = float(SMALL_TILE), right = 0.0f;
        for (int line = 0; line < CELL_HEIGHT; ++line) {
            const float dy = float(CELL_HEIGHT * row + line) + 0.5f - y, v = l22 * dy, middle = x - slant * dy;
            const float half = square_root(max(squared_reach - v * v, 0.0f)) * inverse_l11;
            left = min(left, middle - half), right = max(right, middle + half);
        }
        return stretch_of(left, right);
    }
};

// Call show(number) for each cell on which an ellipse may be visible.
template <class Show>
SPLAT_INLINE void for_each_cell(const Ellipse& ellipse, const Show& show) {
    const Stretch lines = ellipse.lines();
    if (lines.empty()) return;
    for (int row = lines.first / CELL_HEIGHT; row <= lines.last / CELL_HEIGHT; ++row) {
        PASS(row);
        const Stretch pixels = ellipse.pixels(row);
        if (pixels.empty()) continue;
        for (int column = pixels.first / CELL_WIDTH; column <= pixels.last / CELL_WIDTH; ++column) {
            PASS(cell);
            show(cell_number(column, row));
        }
    }
}

}  // namespace splatrl
