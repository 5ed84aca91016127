// Projects Gaussians to splats, and lists the pairs of a splat and a tile on which it is visible.
#pragma once

#include "fit_views.h"
#include "kernels/fit_project.h"

namespace splatrl {

// The ellipse in which a splat is visible. Its edges at dy are dx = center ± half.
struct FitEllipse {
    float squared_reach;     // largest visible u² + v²
    float l12, l22, inverse_l11;
    float height, tip;       // the largest dy, and the dy at which dx is largest

    INLINE_MEMBER explicit FitEllipse(const FitSplat& splat) {
        squared_reach = max(splat.log2_opacity - LOG2_INVISIBLE_ANTIALIASED, 0.0f) * 1.0002f + 1e-6f;
        l12 = splat.l12, l22 = splat.l22, inverse_l11 = reciprocal(splat.l11);
        const float inverse_l22 = reciprocal(l22), slope = l12 * inverse_l22;
        height = square_root(squared_reach) * inverse_l22;
        tip = -height * slope * reciprocal_sqrt(1.0f + slope * slope);
    }

    // Largest dx for dy in [low, high], which must intersect [-height, height]. Clamping the dy of the tip suffices,
    // because the boundary is concave.
    INLINE_MEMBER float right(float low, float high) const { return edge(min(max(tip, low), high), 1.0f); }
    // Smallest dx for dy in [low, high], under the same condition.
    INLINE_MEMBER float left(float low, float high) const { return edge(min(max(-tip, low), high), -1.0f); }

private:
    INLINE_MEMBER float edge(float dy, float side) const {
        const float v = l22 * dy;
        return (side * square_root(max(squared_reach - v * v, 0.0f)) - l12 * dy) * inverse_l11;
    }
};

// Call `take` for each tile of a view in which a splat is visible at the centre of some pixel; perhaps for a few more.
template <class Take>
SPLAT_INLINE void for_tiles(const FitSplat& splat, const FitViews& views, Take take) {
    constexpr float SLACK = 1e-3f;  // pixels: covers the rounding here
    const float right_edge = float(views.width) - 0.5f, lower_edge = float(views.height) - 0.5f;
    const float above = splat.y - splat.extent_y, below = splat.y + splat.extent_y;
    if (!(above <= lower_edge && below >= 0.5f)) return;
    const FitEllipse ellipse(splat);
    const int first_row = int(max(above - 0.5f, 0.0f)) / FIT_TILE;
    const int last_row = int(min(below, lower_edge) - 0.5f) / FIT_TILE;
    for (int row = first_row; row <= last_row; ++row) {
        const float top = float(row * FIT_TILE) + 0.5f - SLACK;  // centres of the tile's first and last line
        const float bottom = min(top + float(FIT_TILE - 1), lower_edge) + 2.0f * SLACK;
        const float low = max(top - splat.y, -ellipse.height), high = min(bottom - splat.y, ellipse.height);
        if (!(low <= high)) continue;
        const float left = splat.x + ellipse.left(low, high) - SLACK;
        const float right = splat.x + ellipse.right(low, high) + SLACK;
        if (!(left <= right_edge && right >= 0.5f)) continue;
        const int first = int(ceilf(max(left - 0.5f, 0.0f))), last = int(min(right, right_edge) - 0.5f);
        if (first > last) continue;
        for (int column = first / FIT_TILE; column <= last / FIT_TILE; ++column) take(row * views.across() + column);
    }
}

// Project a Gaussian to a splat. Returns the number of tiles on which it is visible.
SPLAT_INLINE int project_splat(const FitModel& model, const FitViews& views, int view, int index, FitSplat& splat) {
    using namespace one_lane;
    const Camera camera = views.camera(view);
    const Activated at = activate(model, camera, size_t(index));
    const Footprint<float> print = project<true, false>(camera, at.offset, at.axes, at.log2_opacity, Merging<float>{},
                                                        LOG2_INVISIBLE_ANTIALIASED);
    if (!(print.depth >= model.near && print.log2_opacity > LOG2_INVISIBLE_ANTIALIASED)) return 0;
    float basis[FIT_HARMONICS], rgb[3];
    basis_of(model, at.offset, inverse_length(at.offset), basis);
    raw_colors(model, size_t(index), basis, rgb);
    splat.x = print.x, splat.y = print.y, splat.l11 = print.l11, splat.l12 = print.l12, splat.l22 = print.l22;
    splat.log2_opacity = print.log2_opacity;
    splat.red = max(rgb[0], 0.0f), splat.green = max(rgb[1], 0.0f), splat.blue = max(rgb[2], 0.0f);
    splat.depth = print.depth, splat.extent_x = print.extent_x, splat.extent_y = print.extent_y;
    splat.source = uint32_t(index);
    int count = 0;
    for_tiles(splat, views, [&](int) { ++count; });
    return count;
}

// Write the pairs of a splat to its own place in the lists. Nearer splats have smaller keys, because the bits of
// positive floats sort like the floats.
SPLAT_INLINE void list_pairs(const FitViews& views, const FitPairs& pairs, int view, size_t splat) {
    const int64_t end = pairs.ends[splat];
    int64_t at = end - pairs.counts[splat];
    const int64_t depth = int64_t(__float_as_uint(pairs.splats[splat].depth));
    for_tiles(pairs.splats[splat], views, [&](int tile) {
        if (at == end) return;
        pairs.owners[at] = int(splat);
        pairs.keys[at++] = int64_t(view * views.tiles() + tile) << 32 | depth;
    });
    for (; at < end; ++at) {  // if rounding gave fewer tiles than were counted: sorted behind all tiles
        pairs.owners[at] = int(splat);
        pairs.keys[at] = int64_t(views.views * views.tiles()) << 32;
    }
}

}  // namespace splatrl
