// The loss between rendered views and their photos, and its gradient, as in kernels/fit_loss.h: L1, structural
// similarity (Wang et al. 2004) and known depths. A block takes one channel of a tile, with the surrounding pixels that
// its windows reach.
#pragma once

#include "fit_views.h"

namespace splatrl {

constexpr int FIT_REACH = FIT_TILE + 2 * SSIM_RADIUS;  // width and height of a tile with its surroundings
constexpr int FIT_CURVES = 3;  // derivatives of SSIM with respect to the window's mean, second and mixed moment
enum FitSum { S_APART, S_GAIN, S_OFFSET, S_DEPTH, S_SIMILAR, FIT_SUMS };

struct FitPhotos {
    const uint8_t* pixels;   // [photos, height, width, 3]
    const float* exposure;   // [views, 3, 2]: gain and offset of each channel
    const float* image;      // [views, FIT_CHANNELS, height, width]
    float* curves;           // [views, 3, FIT_CURVES, height, width]
    float* slopes;           // [views, FIT_CHANNELS, height, width]
    float* sums;             // [views, tiles, 3, FIT_SUMS]; S_DEPTH is only in those of the first channel
    float ssim_weight, depth_weight;
};

// Maps of a tile with its surroundings, and maps that are smoothed along rows.
template <int MAPS, int SMOOTHED>
struct FitWindows {
    float around[MAPS][FIT_REACH][FIT_REACH + 1];
    float smooth[SMOOTHED][FIT_REACH][FIT_TILE + 1];
    float sums[FIT_WARPS][FIT_SUMS];
};

using CurveWindows = FitWindows<2, 5>;
using SlopeWindows = FitWindows<FIT_CURVES, FIT_CURVES>;

// The channel of a tile that a block takes.
struct FitPane {
    int tile, view, channel, left, top;  // left, top: the first pixel of the surroundings
    float gain, offset;

    INLINE_MEMBER FitPane(const FitViews& views, const FitPhotos& photos, int block) {
        tile = block / 3, channel = block % 3;
        const FitPlace corner(views, tile, 0, 0);
        view = corner.view, left = corner.x - SSIM_RADIUS, top = corner.y - SSIM_RADIUS;
        gain = photos.exposure[6 * view + 2 * channel], offset = photos.exposure[6 * view + 2 * channel + 1];
    }
    // Whether the photo's pixel there is compared.
    INLINE_MEMBER bool counts(const FitViews& views, size_t at) const {
        return views.known[size_t(views.photos[view]) * views.area() + at] >= 0.0f;
    }
    // The view's value, with the photo's exposure.
    INLINE_MEMBER float seen(const FitViews& views, const FitPhotos& photos, size_t at) const {
        return gain * photos.image[(size_t(view) * FIT_CHANNELS + size_t(channel)) * views.area() + at] + offset;
    }
    // The photo's value, or the view's where the photo's pixel is not compared.
    INLINE_MEMBER float photo(const FitViews& views, const FitPhotos& photos, size_t at) const {
        if (!counts(views, at)) return seen(views, photos, at);
        const size_t pixel = size_t(views.photos[view]) * views.area() + at;
        return float(photos.pixels[3 * pixel + size_t(channel)]) * (1.0f / 255.0f);
    }
    INLINE_MEMBER float* curve(const FitViews& views, const FitPhotos& photos, int number) const {
        return photos.curves + (size_t(view * 3 + channel) * FIT_CURVES + size_t(number)) * views.area();
    }
};

// Weight of the window `away` pixels from its middle: a Gaussian with a standard deviation of 1.5 pixels.
SPLAT_INLINE float window_at(int away) {
    const float weights[SSIM_RADIUS + 1] = {0.26601171f, 0.21300554f, 0.10936069f,
                                            0.03600077f, 0.00759874f, 0.00102838f};
    return weights[away < 0 ? -away : away];
}

// Call fill(row, column, inside, at) for the pixels of a tile and its surroundings: their place in `around`, whether
// they are in the image, and their offset in a plane.
template <class Fill>
SPLAT_INLINE void fill_around(const FitViews& views, const FitPane& pane, Fill fill) {
    for (int i = thread(); i < FIT_REACH * FIT_REACH; i += FIT_THREADS) {
        const int row = i / FIT_REACH, column = i % FIT_REACH, y = pane.top + row, x = pane.left + column;
        const bool inside = x >= 0 && y >= 0 && x < views.width && y < views.height;
        fill(row, column, inside, inside ? size_t(y) * size_t(views.width) + size_t(x) : 0);
    }
    __syncthreads();
}

// Apply the window along columns to a map that has been smoothed along rows, at this thread's pixel.
SPLAT_INLINE float smooth_down(const float (*map)[FIT_TILE + 1]) {
    float sum = 0.0f;
    for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; ++k)
        sum += window_at(k) * map[thread() / FIT_TILE + SSIM_RADIUS + k][thread() % FIT_TILE];
    return sum;
}

// Compute the similarity, and its derivatives with respect to the moments of the window at each pixel.
SPLAT_INLINE void find_curves(const FitViews& views, const FitPhotos& photos, int block, CurveWindows& shared) {
    constexpr float C1 = 0.0001f, C2 = 0.0009f;
    const FitPane pane(views, photos, block);
    fill_around(views, pane, [&](int row, int column, bool inside, size_t at) {
        shared.around[0][row][column] = inside ? pane.seen(views, photos, at) : 0.0f;
        shared.around[1][row][column] = inside ? pane.photo(views, photos, at) : 0.0f;
    });
    for (int i = thread(); i < FIT_REACH * FIT_TILE; i += FIT_THREADS) {
        const int row = i / FIT_TILE, column = i % FIT_TILE;
        float sums[5] = {};
        for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; ++k) {
            const float weight = window_at(k);
            const float x = shared.around[0][row][column + SSIM_RADIUS + k];
            const float t = shared.around[1][row][column + SSIM_RADIUS + k];
            sums[0] += weight * x, sums[1] += weight * t;
            sums[2] += weight * (x * x), sums[3] += weight * (t * t), sums[4] += weight * (x * t);
        }
        for (int map = 0; map < 5; ++map) shared.smooth[map][row][column] = sums[map];
    }
    __syncthreads();
    const FitPlace place(views, pane.tile, thread() % FIT_TILE, thread() / FIT_TILE);
    float similar = 0.0f;
    if (place.inside) {
        float m[5];
        for (int map = 0; map < 5; ++map) m[map] = smooth_down(shared.smooth[map]);
        const float x = m[0], t = m[1], xt = x * t, xx = x * x, tt = t * t;
        const float a1 = 2.0f * xt + C1, a2 = 2.0f * (m[4] - xt) + C2;
        const float b1 = xx + tt + C1, b2 = m[2] - xx + m[3] - tt + C2;
        const float inverse_b1 = 1.0f / b1, inverse_b2 = 1.0f / b2, inverse = inverse_b1 * inverse_b2;
        similar = a1 * a2 * inverse;
        pane.curve(views, photos, 0)[place.at] =
            2.0f * t * (a2 - a1) * inverse - 2.0f * x * similar * (inverse_b1 - inverse_b2);
        pane.curve(views, photos, 1)[place.at] = -similar * inverse_b2;
        pane.curve(views, photos, 2)[place.at] = 2.0f * a1 * inverse;
    }
    float(*sums)[1] = reinterpret_cast<float(*)[1]>(shared.sums);
    add_up<1>(&similar, sums, photos.sums + size_t(block) * FIT_SUMS + S_SIMILAR);
}

// Compute the gradient of the loss with respect to the image, and the parts of the loss.
SPLAT_INLINE void find_slopes(const FitViews& views, const FitPhotos& photos, int block, SlopeWindows& shared) {
    const FitPane pane(views, photos, block);
    fill_around(views, pane, [&](int row, int column, bool inside, size_t at) {
        for (int map = 0; map < FIT_CURVES; ++map)
            shared.around[map][row][column] = inside ? pane.curve(views, photos, map)[at] : 0.0f;
    });
    for (int i = thread(); i < FIT_REACH * FIT_TILE; i += FIT_THREADS) {
        const int row = i / FIT_TILE, column = i % FIT_TILE;
        for (int map = 0; map < FIT_CURVES; ++map) {
            float sum = 0.0f;
            for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; ++k)
                sum += window_at(k) * shared.around[map][row][column + SSIM_RADIUS + k];
            shared.smooth[map][row][column] = sum;
        }
    }
    __syncthreads();
    const FitPlace place(views, pane.tile, thread() % FIT_TILE, thread() / FIT_TILE);
    float sums[S_SIMILAR] = {};
    if (place.inside) {
        const float share = 1.0f / (3.0f * float(views.area()));
        const float flat = (1.0f - photos.ssim_weight) * share, curved = -photos.ssim_weight * share;
        const float x = pane.seen(views, photos, place.at), t = pane.photo(views, photos, place.at), away = x - t;
        const float by_curves = smooth_down(shared.smooth[0]) + 2.0f * x * smooth_down(shared.smooth[1]) +
                                t * smooth_down(shared.smooth[2]);
        const float compared = (away > 0.0f ? flat : away < 0.0f ? -flat : 0.0f) + curved * by_curves;
        const float slope = pane.counts(views, place.at) ? compared : 0.0f;
        const size_t first = size_t(place.view) * FIT_CHANNELS * views.area() + place.at;
        sums[S_APART] = fabsf(away);
        sums[S_GAIN] = slope * photos.image[first + size_t(pane.channel) * views.area()], sums[S_OFFSET] = slope;
        photos.slopes[first + size_t(pane.channel) * views.area()] = slope * pane.gain;
        if (pane.channel == 0) {
            const bool known = views.known[size_t(views.photos[place.view]) * views.area() + place.at] > 0.0f;
            photos.slopes[first + F_AGREEMENT * views.area()] = known ? -3.0f * share * photos.depth_weight : 0.0f;
            photos.slopes[first + F_ALPHA * views.area()] = 0.0f;
            if (known) sums[S_DEPTH] = 1.0f - photos.image[first + F_AGREEMENT * views.area()];
        }
    }
    float(*parts)[S_SIMILAR] = reinterpret_cast<float(*)[S_SIMILAR]>(shared.sums);
    add_up<S_SIMILAR>(sums, parts, photos.sums + size_t(block) * FIT_SUMS);
}

}  // namespace splatrl
