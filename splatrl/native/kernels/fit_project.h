// From parameters to splats, and from the moments of splats back to the slopes of parameters, sixteen at a time.
#pragma once

#include "fit_kernel.h"
#include "kernels/fit_turn.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr float LOG2_E = 1.44269504f;

LANE_INLINE Lanes row_of(const FitModel& model, int row, size_t first) {
    return load(model.values + size_t(row) * model.stride + first);
}

LANE_INLINE Lanes dot(const Lanes* a, const Lanes* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

LANE_INLINE void cross(const Lanes* a, const Lanes* b, Lanes* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

// Sixteen Gaussians, activated.
struct Activated {
    Vector<Lanes> offset;  // from the camera, world axes
    Lanes quat[4], inverse_norm;
    Lanes rotation[9], scales[3], axes[9];
    Lanes opacity, log2_opacity;
};

LANE_INLINE void rotation_of(const Lanes* q, Lanes* out) {
    const Lanes &w = q[0], &x = q[1], &y = q[2], &z = q[3];
    out[0] = 1.0f - 2.0f * (y * y + z * z), out[1] = 2.0f * (x * y - w * z), out[2] = 2.0f * (x * z + w * y);
    out[3] = 2.0f * (x * y + w * z), out[4] = 1.0f - 2.0f * (x * x + z * z), out[5] = 2.0f * (y * z - w * x);
    out[6] = 2.0f * (x * z - w * y), out[7] = 2.0f * (y * z + w * x), out[8] = 1.0f - 2.0f * (x * x + y * y);
}

LANE_INLINE Activated activate(const FitModel& model, const Camera& camera, size_t first) {
    Activated out;
    out.offset = {row_of(model, FIT_MEAN, first) - camera.position[0],
                  row_of(model, FIT_MEAN + 1, first) - camera.position[1],
                  row_of(model, FIT_MEAN + 2, first) - camera.position[2]};
    Lanes squared = lanes(0.0f);
    for (int i = 0; i < 4; ++i) {
        out.quat[i] = row_of(model, FIT_QUAT + i, first);
        squared = squared + out.quat[i] * out.quat[i];
    }
    out.inverse_norm = reciprocal_sqrt(max(squared, 1e-30f));
    for (int i = 0; i < 4; ++i) out.quat[i] = out.quat[i] * out.inverse_norm;
    rotation_of(out.quat, out.rotation);
    for (int axis = 0; axis < 3; ++axis) {
        out.scales[axis] = exp2(max(min(row_of(model, FIT_LOG_SCALE + axis, first) * LOG2_E, 60.0f), -60.0f));
        for (int i = 0; i < 3; ++i) out.axes[3 * i + axis] = out.rotation[3 * i + axis] * out.scales[axis];
    }
    const Lanes odds = exp2(max(min(row_of(model, FIT_LOGIT, first) * -LOG2_E, 60.0f), -60.0f)) + 1.0f;
    out.opacity = reciprocal(odds);
    out.log2_opacity = -log2(odds);
    return out;
}

LANE_INLINE Lanes inverse_length(const Vector<Lanes>& a) {
    return reciprocal_sqrt(max(a.x * a.x + a.y * a.y + a.z * a.z, 1e-30f));
}

// Colours before they are clamped at 0.
LANE_INLINE void raw_colors(const FitModel& model, size_t first, const Lanes* basis, Lanes* rgb) {
    const int harmonics = (model.degree + 1) * (model.degree + 1);
    for (int channel = 0; channel < 3; ++channel) {
        rgb[channel] = lanes(0.5f);
        for (int i = 0; i < harmonics; ++i)
            rgb[channel] = rgb[channel] + basis[i] * row_of(model, FIT_SH + 3 * i + channel, first);
    }
}

LANE_INLINE void basis_of(const FitModel& model, const Vector<Lanes>& offset, Lanes inverse, Lanes* basis) {
    sh_basis(model.degree, offset.x * inverse, offset.y * inverse, offset.z * inverse, basis);
}

// Keep those of sixteen projected splats that show; returns how many there are then.
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
                                                            gaussians.log2_opacity, Merging<Lanes>{});
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
