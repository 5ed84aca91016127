// Projects all Gaussians of a model to the splats of a view.
#pragma once

#include "kernels/fit_project.h"
#include "kernels/fit_turn.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Append those of sixteen projected splats that are visible; returns the new number of splats.
LANE_INLINE uint32_t keep_visible(const FitScratch& scratch, const FitGrid& grid, const float* records, size_t first,
                                  uint32_t lanes_drawn, float near, uint32_t count, size_t* rows) {
    for (int lane = 0; lane < LANES; ++lane) {
        FitSplat splat;
        std::memcpy(&splat, records + LANES * lane, sizeof(splat));
        scratch.ranks[first + lane] = ~0u;
        const bool shows = splat.depth >= near && splat.log2_opacity > LOG2_INVISIBLE_ANTIALIASED &&
                           splat.x + splat.extent_x > 0.5f && splat.y + splat.extent_y > 0.5f &&
                           splat.x - splat.extent_x < float(grid.width) - 0.5f &&
                           splat.y - splat.extent_y < float(grid.height) - 0.5f;
        if (!shows || (lanes_drawn >> lane & 1) == 0) continue;
        const float top = splat.y - splat.extent_y - 0.5f, bottom = splat.y + splat.extent_y - 0.5f;
        const int low = top <= 0.0f ? 0 : int(__builtin_ceilf(top));
        const int high = bottom >= float(grid.height - 1) ? grid.height - 1 : int(bottom);
        if (low > high) continue;
        splat.source = uint32_t(first) + uint32_t(lane);
        splat.first_row = low / FIT_BLOCK, splat.last_row = high / FIT_BLOCK;
        *rows += size_t(splat.last_row - splat.first_row + 1);
        uint32_t depth;
        std::memcpy(&depth, &splat.depth, sizeof(depth));
        scratch.keys[count] = uint64_t(depth) << 32 | count;
        scratch.projected[count++] = splat;
    }
    return count;
}

LANE_INLINE uint32_t project_all(const FitModel& model, const Camera& camera, const FitGrid& grid,
                                 const FitScratch& scratch, size_t* rows) {
    uint32_t count = 0;
    for (size_t first = 0; first < model.count; first += LANES) {
        const Activated gaussians = activate(model, camera, first);
        const Footprint<Lanes> print = project<true, false>(camera, gaussians.offset, gaussians.axes,
                                                            gaussians.log2_opacity, Merging<Lanes>{},
                                                            LOG2_INVISIBLE_ANTIALIASED);
        const float far_off = model.near;
        if (bits_above(print.depth + 1e-30f, lanes(far_off)) == 0) {
            for (int lane = 0; lane < LANES; ++lane) scratch.ranks[first + lane] = ~0u;
            continue;
        }
        Lanes basis[FIT_HARMONICS], rgb[3];
        basis_of(model, gaussians.offset, inverse_length(gaussians.offset), basis);
        raw_colors(model, first, basis, rgb);
        const Lanes values[12] = {print.x, print.y, print.l11, print.l12, print.l22, print.log2_opacity,
                                  max(rgb[0], 0.0f), max(rgb[1], 0.0f), max(rgb[2], 0.0f), print.depth,
                                  print.extent_x, print.extent_y};
        alignas(64) float columns[LANES * LANES] = {}, records[LANES * LANES];
        for (int i = 0; i < 12; ++i) store(columns + LANES * i, values[i]);
        turn(columns, records);
        const size_t left = model.count - first;
        const uint32_t drawn = left >= LANES ? 0xffffu : (1u << left) - 1;
        count = keep_visible(scratch, grid, records, first, drawn, model.near, count, rows);
    }
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
