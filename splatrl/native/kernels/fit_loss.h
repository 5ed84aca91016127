// The loss between a rendered view and its photo, and its gradient: L1, structural similarity (SSIM, Wang et al. 2004)
// and known depths.
#pragma once

#include "fit_kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

constexpr float SSIM_C1 = 0.0001f, SSIM_C2 = 0.0009f;
constexpr float WINDOW[SSIM_RADIUS + 1] = {0.26601171f, 0.21300554f, 0.10936069f,
                                           0.03600077f, 0.00759874f, 0.00102838f};  // Gaussian, sigma = 1.5 pixels
constexpr int SSIM_EDGE = 16;  // zeros that pad a row on either side

// Window means of one channel: of the view x, the photo t, and their products.
enum FitMap { P_X, P_T, P_XX, P_TT, P_XT, P_MAPS };

// Apply the window along a row; `in` is padded with SSIM_EDGE zeros before and after.
LANE_INLINE void smooth_row(const float* __restrict in, float* __restrict out, int width) {
    for (int i = 0; i < width; ++i) {
        float sum = WINDOW[0] * in[i];
        for (int k = 1; k <= SSIM_RADIUS; ++k) sum += WINDOW[k] * (in[i - k] + in[i + k]);
        out[i] = sum;
    }
}

// Apply the window along the columns, for row y; rows outside the image count as zeros.
LANE_INLINE void smooth_column(const float* plane, const FitGrid& grid, int y, float* __restrict out) {
    const float* rows[2 * SSIM_RADIUS + 1];
    alignas(64) static constexpr float NOTHING[1 << 14] = {};
    for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; ++k)
        rows[k + SSIM_RADIUS] =
            y + k < 0 || y + k >= grid.height ? NOTHING : plane + size_t(y + k) * size_t(grid.stride);
    for (int i = 0; i < grid.width; ++i) {
        float sum = WINDOW[0] * rows[SSIM_RADIUS][i];
        for (int k = 1; k <= SSIM_RADIUS; ++k) sum += WINDOW[k] * (rows[SSIM_RADIUS - k][i] + rows[SSIM_RADIUS + k][i]);
        out[i] = sum;
    }
}

constexpr int FIT_WIDEST = 1 << 13;  // maximum width of an image, pixels

struct FitRows {
    alignas(64) float lines[P_MAPS][FIT_WIDEST + 2 * SSIM_EDGE];
};

// Fill the maps P_X … P_XT, smoothed along rows, and maps 8 (view, with its exposure) and 9 (photo) with the values
// themselves. At ignored pixels the photo takes the value of the view.
static void smooth_products(const FitGrid& grid, const float* view, const float* known, const FitTarget& target,
                            int channel, float* maps, FitRows& rows) {
    const float gain = target.exposure[2 * channel], offset = target.exposure[2 * channel + 1];
    std::memset(rows.lines, 0, sizeof(rows.lines));
    for (int y = 0; y < grid.height; ++y) {
        const size_t line = size_t(y) * size_t(grid.stride);
        const uint8_t* photo = target.pixels + (size_t(y) * size_t(grid.width)) * 3 + channel;
        float *x = rows.lines[P_X] + SSIM_EDGE, *t = rows.lines[P_T] + SSIM_EDGE;
        float *xx = rows.lines[P_XX] + SSIM_EDGE, *tt = rows.lines[P_TT] + SSIM_EDGE,
            *xt = rows.lines[P_XT] + SSIM_EDGE;
        for (int i = 0; i < grid.width; ++i) {
            x[i] = gain * view[line + i] + offset;
            t[i] = known[line + i] < 0.0f ? x[i] : float(photo[3 * i]) * (1.0f / 255.0f);
            xx[i] = x[i] * x[i], tt[i] = t[i] * t[i], xt[i] = x[i] * t[i];
        }
        for (int map = 0; map < P_MAPS; ++map)
            smooth_row(rows.lines[map] + SSIM_EDGE, maps + size_t(map) * grid.area() + line, grid.width);
        std::memcpy(maps + 8 * grid.area() + line, x, 4 * size_t(grid.width));
        std::memcpy(maps + 9 * grid.area() + line, t, 4 * size_t(grid.width));
    }
}

// Compute the derivatives of the similarity with respect to the window's mean, second moment and mixed moment, and
// smooth them along rows into maps 5, 6 and 7. Returns the sum of the similarity.
static double smooth_derivatives(const FitGrid& grid, float* maps, FitRows& rows) {
    float* const means[P_MAPS] = {rows.lines[0] + SSIM_EDGE, rows.lines[1] + SSIM_EDGE, rows.lines[2] + SSIM_EDGE,
                                  rows.lines[3] + SSIM_EDGE, rows.lines[4] + SSIM_EDGE};
    double total = 0.0;
    for (int y = 0; y < grid.height; ++y) {
        for (int map = 0; map < P_MAPS; ++map) smooth_column(maps + size_t(map) * grid.area(), grid, y, means[map]);
        float sums[LANES] = {};
        float* __restrict by_mean = means[P_X];
        float* __restrict by_square = means[P_XX];
        float* __restrict by_product = means[P_XT];
        float* __restrict value = means[P_TT];
        for (int i = 0; i < grid.width; ++i) {
            const float x = by_mean[i], t = means[P_T][i], xt = x * t, xx = x * x, tt = t * t;
            const float a1 = 2.0f * xt + SSIM_C1, a2 = 2.0f * (by_product[i] - xt) + SSIM_C2;
            const float b1 = xx + tt + SSIM_C1, b2 = by_square[i] - xx + value[i] - tt + SSIM_C2;
            const float inverse_b1 = 1.0f / b1, inverse_b2 = 1.0f / b2, inverse = inverse_b1 * inverse_b2;
            const float s = a1 * a2 * inverse;
            by_mean[i] = 2.0f * t * (a2 - a1) * inverse - 2.0f * x * s * (inverse_b1 - inverse_b2);
            by_square[i] = -s * inverse_b2;
            by_product[i] = 2.0f * a1 * inverse;
            value[i] = s;
        }
        for (int i = 0; i < grid.width; ++i) sums[i % LANES] += value[i];
        for (float sum : sums) total += double(sum);
        const size_t line = size_t(y) * size_t(grid.stride);
        smooth_row(by_mean, maps + 5 * grid.area() + line, grid.width);
        smooth_row(by_square, maps + 6 * grid.area() + line, grid.width);
        smooth_row(by_product, maps + 7 * grid.area() + line, grid.width);
    }
    return total;
}

// Write the gradient with respect to one channel of the view, and add the channel's part of the loss.
static void channel_slopes(const FitGrid& grid, const FitTarget& target, int channel, const float* view,
                           const float* known, float* maps, float* slopes, FitRows& rows, FitLoss& loss) {
    const float share = 1.0f / float(3 * grid.width * grid.height);
    const float flat = (1.0f - target.ssim_weight) * share, curved = -target.ssim_weight * share;
    const float gain = target.exposure[2 * channel];
    double unlike = 0.0, by_gain = 0.0, by_offset = 0.0;
    for (int y = 0; y < grid.height; ++y) {
        const size_t line = size_t(y) * size_t(grid.stride);
        float *mean = rows.lines[0], *square = rows.lines[1], *product = rows.lines[2];
        for (int map = 0; map < 3; ++map) smooth_column(maps + size_t(5 + map) * grid.area(), grid, y, rows.lines[map]);
        const float *x = maps + 8 * grid.area() + line, *t = maps + 9 * grid.area() + line;
        float sums[3][LANES] = {};
        float* __restrict out = slopes + line;
        for (int i = 0; i < grid.width; ++i) {
            const float away = x[i] - t[i];
            const float sign = away > 0.0f ? flat : away < 0.0f ? -flat : 0.0f;
            const float slope = sign + curved * (mean[i] + 2.0f * x[i] * square[i] + t[i] * product[i]);
            out[i] = known[line + i] < 0.0f ? 0.0f : slope;
        }
        for (int i = 0; i < grid.width; ++i) {
            sums[0][i % LANES] += __builtin_fabsf(x[i] - t[i]);
            sums[1][i % LANES] += out[i] * view[line + i];
            sums[2][i % LANES] += out[i];
        }
        for (int i = 0; i < grid.width; ++i) out[i] *= gain;
        for (int lane = 0; lane < LANES; ++lane)
            unlike += double(sums[0][lane]), by_gain += double(sums[1][lane]), by_offset += double(sums[2][lane]);
    }
    loss.l1 += float(unlike) * share;
    loss.exposure[2 * channel] = float(by_gain);
    loss.exposure[2 * channel + 1] = float(by_offset);
}

// Return the depth loss and write its gradient: one minus the agreement at pixels with known depth, averaged over all
// pixels.
static float depth_slopes(const FitGrid& grid, const FitTarget& target, const FitScratch& scratch) {
    const float share = 1.0f / float(grid.width * grid.height);
    const float *found = scratch.image + F_AGREEMENT * grid.area();
    float* slopes = scratch.slopes + F_AGREEMENT * grid.area();
    double sum = 0.0;
    for (int y = 0; y < grid.height; ++y)
        for (int x = 0; x < grid.width; ++x) {
            const size_t place = size_t(y) * size_t(grid.stride) + size_t(x);
            if (scratch.known[place] <= 0.0f) continue;
            sum += double(1.0f - found[place]);
            slopes[place] = -share * target.depth_weight;
        }
    return float(sum) * share;
}

static FitLoss loss_of(const FitGrid& grid, const FitScratch& scratch, const FitTarget& target) {
    FitLoss loss{};
    FitRows rows;
    double similarity = 0.0;
    std::memset(scratch.slopes, 0, FIT_CHANNELS * grid.area() * sizeof(float));
    for (int channel = 0; channel < 3; ++channel) {
        const float* view = scratch.image + size_t(channel) * grid.area();
        smooth_products(grid, view, scratch.known, target, channel, scratch.maps, rows);
        similarity += smooth_derivatives(grid, scratch.maps, rows);
        channel_slopes(grid, target, channel, view, scratch.known, scratch.maps,
                       scratch.slopes + size_t(channel) * grid.area(), rows, loss);
    }
    loss.ssim = float(similarity / double(3 * size_t(grid.width) * size_t(grid.height)));
    loss.depth = depth_slopes(grid, target, scratch);
    loss.total = (1.0f - target.ssim_weight) * loss.l1 + target.ssim_weight * (1.0f - loss.ssim) +
                 target.depth_weight * loss.depth;
    return loss;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
