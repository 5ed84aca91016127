// Backward pass: from the gradients of images to the moments of the splats of each tile, and on to the gradients of the
// parameters.
//
// A block takes a tile, and sixteen splats at a time: first each thread goes through them for its pixel, front to back;
// then each thread sums up a row of pixels for one of them. Every pair of a splat and a tile has its own place for its
// moments, and a Gaussian adds up those of its pairs in their order, so nothing depends on the order in which threads
// run.
#pragma once

#include "fit_images.h"
#include "kernels/fit_unproject.h"

namespace splatrl {

constexpr int FIT_BATCH = 16, FIT_FEW = 32;  // splats that are summed up, and that are loaded, at once
constexpr int FIT_PAIR_MOMENTS = M_DEPTH + 1;
constexpr int FIT_COLUMN_PITCH = FIT_BATCH + 1, FIT_ROW_PITCH = 280;  // these avoid bank conflicts in shared memory
static_assert(FIT_ROW_PITCH >= FIT_TILE * FIT_COLUMN_PITCH, "the pitch must be at least the length of a row of pixels");

struct FitBacking {
    float v[FIT_TILE * FIT_ROW_PITCH], share[FIT_TILE * FIT_ROW_PITCH];  // of each pixel and splat
    float4 slopes[FIT_THREADS];                                         // by red, green, blue and agreement
    float known[FIT_THREADS];
    float sums[FIT_WARPS][FIT_BATCH][FIT_PAIR_MOMENTS];
    FitSplat splats[FIT_FEW];
    int64_t pairs[FIT_FEW];
};

// Compute the moments of splat `number` of a batch over one row of a tile's pixels.
SPLAT_INLINE void row_moments(const FitBacking& shared, const FitSplat& splat, int row, int number, float left, float y,
                              float* m) {
    for (int i = 0; i < FIT_PAIR_MOMENTS; ++i) m[i] = 0.0f;
    float by_x = 0.0f, by_xx = 0.0f;  // about the middle of the row
    for (int column = 0; column < FIT_TILE; ++column) {
        const int at = row * FIT_ROW_PITCH + column * FIT_COLUMN_PITCH + number, pixel = row * FIT_TILE + column;
        const float v = shared.v[at], share = shared.share[at], x = float(column) - 7.5f;
        const float4 slopes = shared.slopes[pixel];
        m[M_V] += v, by_x += v * x, by_xx += v * (x * x);
        m[M_RED] += share * slopes.x, m[M_GREEN] += share * slopes.y, m[M_BLUE] += share * slopes.z;
        const float known = shared.known[pixel];
        if (known > 0.0f) {  // derivative of the agreement with respect to the depth
            const float away = splat.depth * known - 1.0f, steep = share * (known * slopes.w);
            if (away >= 0.0f && away <= 1.0f) m[M_DEPTH] -= steep;
            if (away < 0.0f && away >= -1.0f) m[M_DEPTH] += steep;
        }
    }
    const float ox = left + 8.0f - splat.x, oy = y - splat.y;  // from the splat to the middle of the row
    m[M_VX] = by_x + ox * m[M_V];
    m[M_VXX] = by_xx + ox * (by_x + m[M_VX]);
    m[M_VY] = oy * m[M_V], m[M_VXY] = oy * m[M_VX], m[M_VYY] = oy * m[M_VY];
}

// Write the moments of a tile's pairs to `moments` [pairs, FIT_PAIR_MOMENTS].
SPLAT_INLINE void blend_back(const FitViews& views, const FitPairs& pairs, int tile, const float* image,
                             const float* slopes, float* moments, FitBacking& shared) {
    using namespace one_lane;
    const int column = patch_column(), row = patch_row();
    const FitPlace place(views, tile, column, row), corner(views, tile, 0, 0);
    const float x = float(place.x) + 0.5f, y = float(place.y) + 0.5f;
    FitBehind behind{};
    behind.transmittance = 1.0f;
    if (place.inside) {
        behind.known = views.known[size_t(views.photos[place.view]) * views.area() + place.at];
        for (int c = 0; c < FIT_CHANNELS; ++c) {
            const size_t at = (size_t(place.view) * FIT_CHANNELS + size_t(c)) * views.area() + place.at;
            behind.slopes[c] = slopes[at];
            behind.total += slopes[at] * image[at];
        }
    }
    const int pixel = row * FIT_TILE + column;
    shared.slopes[pixel] = {behind.slopes[F_RED], behind.slopes[F_GREEN], behind.slopes[F_BLUE],
                            behind.slopes[F_AGREEMENT]};
    shared.known[pixel] = behind.known;
    const int own_row = warp() / 2 * 4 + warp() % 2 + lane() / FIT_BATCH * 2, own_splat = lane() % FIT_BATCH;
    const int64_t begin = pairs.starts[tile];
    const int count = pairs.taken[tile];
    for (int first = 0; first < count; first += FIT_BATCH) {
        const int loaded = first % FIT_FEW;
        if (loaded == 0) {
            __syncthreads();
            if (thread() < FIT_FEW && first + thread() < count) {
                const int64_t pair = pairs.order[begin + first + thread()];
                shared.pairs[thread()] = pair;
                copy_splat(pairs.splats[pairs.owners[pair]], shared.splats[thread()]);
            }
            __syncthreads();
        }
        const int here = count - first < FIT_BATCH ? count - first : FIT_BATCH;
        for (int i = 0; i < FIT_BATCH; ++i) {
            float v = 0.0f, share = 0.0f;
            if (i < here && behind.transmittance > MIN_TRANSMITTANCE)
                step_back<true>(shared.splats[loaded + i], x, y, behind, v, share);
            const int at = row * FIT_ROW_PITCH + column * FIT_COLUMN_PITCH + i;
            shared.v[at] = v, shared.share[at] = share;
        }
        __syncthreads();
        float m[FIT_PAIR_MOMENTS];
        row_moments(shared, shared.splats[loaded + own_splat], own_row, own_splat, float(corner.x),
                    float(corner.y + own_row) + 0.5f, m);
        for (int i = 0; i < FIT_PAIR_MOMENTS; ++i) {
            m[i] += __shfl_xor_sync(ALL_LANES, m[i], FIT_BATCH);
            if (lane() < FIT_BATCH) shared.sums[warp()][own_splat][i] = m[i];
        }
        __syncthreads();
        const int splat = thread() / FIT_PAIR_MOMENTS, moment = thread() % FIT_PAIR_MOMENTS;
        if (splat < here) {
            float sum = 0.0f;
            for (int i = 0; i < FIT_WARPS; ++i) sum += shared.sums[i][splat][moment];
            moments[shared.pairs[loaded + splat] * FIT_PAIR_MOMENTS + moment] = sum;
        }
    }
}

// Write the gradients of one Gaussian's parameters from one view to `out` [rows, stride]; adds to those of the pose.
SPLAT_INLINE void pull_gaussian(const FitModel& model, const FitViews& views, const FitPairs& pairs, int view,
                                int index, const float* moments, float* out, one_lane::PoseSlopes& pose) {
    using namespace one_lane;
    const size_t splat = size_t(view) * model.stride + size_t(index);
    const int count = index < int(model.count) ? pairs.counts[splat] : 0;
    if (count == 0) {
        const int rows = FIT_SH + 3 * (model.degree + 1) * (model.degree + 1);
        for (int row = 0; row < rows; ++row) out[size_t(row) * model.stride + size_t(index)] = 0.0f;
        return;
    }
    float sums[FIT_MOMENTS] = {};
    const float* from = moments + (pairs.ends[splat] - count) * FIT_PAIR_MOMENTS;
    for (int pair = 0; pair < count; ++pair)
        for (int i = 0; i < FIT_PAIR_MOMENTS; ++i) sums[i] += from[pair * FIT_PAIR_MOMENTS + i];
    unproject(model, views.camera(view), size_t(index), sums, out, pose);
}

}  // namespace splatrl
