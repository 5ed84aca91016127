// Front-to-back blending of a tile: one block per tile, one thread per pixel.
#pragma once

#include "fit_views.h"
#include "kernels/fit_pixel.h"

namespace splatrl {

constexpr int FIT_SLAB = FIT_THREADS;  // splats that a block loads at once

struct FitBlending {
    FitSplat splats[FIT_SLAB];
    int taken;
};

// Copy what blending needs of a splat: all members before `source`.
SPLAT_INLINE void copy_splat(const FitSplat& from, FitSplat& to) {
    const float4* source = reinterpret_cast<const float4*>(&from);
    float4* target = reinterpret_cast<float4*>(&to);
    for (int i = 0; i < 3; ++i) target[i] = source[i];
}

// Draw a tile into image [views, FIT_CHANNELS, height, width].
SPLAT_INLINE void blend_tile(const FitViews& views, const FitPairs& pairs, int tile, FitBlending& shared,
                             float* image) {
    using namespace one_lane;
    const FitPlace place(views, tile, patch_column(), patch_row());
    const float x = float(place.x) + 0.5f, y = float(place.y) + 0.5f;
    const float known = place.inside ? views.known[size_t(views.photos[place.view]) * views.area() + place.at] : 0.0f;
    const int64_t begin = pairs.starts[tile];
    const int count = int(pairs.starts[tile + 1] - begin);
    float sums[FIT_CHANNELS] = {}, transmittance = 1.0f;
    bool active = place.inside;
    int seen = 0;  // how many splats this pixel has gone through
    if (thread() == 0) shared.taken = 0;
    for (int first = 0; first < count; first += FIT_SLAB) {
        if (!__syncthreads_or(active)) break;
        const int here = count - first < FIT_SLAB ? count - first : FIT_SLAB;
        if (thread() < here)
            copy_splat(pairs.splats[pairs.owners[pairs.order[begin + first + thread()]]], shared.splats[thread()]);
        __syncthreads();
        for (int i = 0; i < here && active; ++i) {
            const FitSplat& splat = shared.splats[i];
            const float share = transmittance * alpha_of(exponent_at(splat, x - splat.x, y - splat.y));
            transmittance -= share;
            active = transmittance > MIN_TRANSMITTANCE;
            seen = first + i + 1;
            if (!active) break;
            sums[F_RED] += share * splat.red;
            sums[F_GREEN] += share * splat.green;
            sums[F_BLUE] += share * splat.blue;
            sums[F_AGREEMENT] += share * agreement(splat.depth, known);
            sums[F_ALPHA] += share;
        }
    }
    __syncthreads();
    atomicMax(&shared.taken, seen);
    __syncthreads();
    if (thread() == 0) pairs.taken[tile] = shared.taken;
    if (!place.inside) return;
    for (int c = 0; c < FIT_CHANNELS; ++c)
        image[(size_t(place.view) * FIT_CHANNELS + size_t(c)) * views.area() + place.at] = sums[c];
}

}  // namespace splatrl
