// Plain data that the portable part of the fit and its kernels share.
#pragma once

#include <cstddef>
#include <cstdint>

#include "splat.h"

namespace splatrl {

constexpr int FIT_BLOCK = 4;   // a block is 4×4 pixels: the lanes of a vector
constexpr int FIT_LANES = FIT_BLOCK * FIT_BLOCK;
constexpr int FIT_HARMONICS = 16;  // at degree 3
constexpr int SSIM_RADIUS = 5;  // of the window, which has 11×11 pixels

// Rows of the parameters; each has `stride` floats, one per Gaussian. Harmonics are last, by coefficient, then colour.
enum FitRow { FIT_MEAN = 0, FIT_LOG_SCALE = 3, FIT_QUAT = 6, FIT_LOGIT = 10, FIT_SH = 11 };

struct FitModel {
    const float* values;  // [rows, stride], aligned to 64 bytes
    size_t stride;        // a multiple of sixteen
    uint32_t count;       // Gaussians that are drawn; columns behind them, up to the stride, are not
    int degree;           // of the harmonics, 0 to 3
    float near;           // Gaussians at smaller depths are not drawn
};

// A visible Gaussian as blending reads it.
struct alignas(64) FitSplat {
    float x, y, l11, l12, l22, log2_opacity;
    float red, green, blue, depth;
    float extent_x, extent_y;
    uint32_t source;              // index of the Gaussian in the model
    int32_t first_row, last_row;  // rows of blocks that it touches
    uint32_t unused;
};

// The moments of a splat over all pixels: of v = dL / d ln(alpha), up to second order, and of its blending weight,
// which give the gradients of its colour and depth.
enum FitMoment { M_V, M_VX, M_VY, M_VXX, M_VXY, M_VYY, M_RED, M_GREEN, M_BLUE, M_DEPTH, FIT_MOMENTS = 16 };

// F_AGREEMENT is how much of a pixel lies at its known depth: the sum of each splat's blending weight times
// max(0, 1 - |depth / known depth - 1|). Anything in front of a known surface lowers it, as does anything behind.
enum FitChannel { F_RED, F_GREEN, F_BLUE, F_AGREEMENT, F_ALPHA, FIT_CHANNELS };

// The blocks of an image, and the layout of its planes in memory: [rows of whole blocks, stride].
struct FitGrid {
    int width, height, across, down, stride;

    size_t area() const { return size_t(down) * FIT_BLOCK * size_t(stride); }
    size_t blocks() const { return size_t(across) * size_t(down); }
};

struct FitScratch {
    FitSplat* projected;   // [capacity + 16] visible splats, in the order of the model
    FitSplat* splats;      // [capacity + 16] the same, nearest first
    uint32_t* ranks;       // [capacity] position of each Gaussian in `splats`; ~0 if it is not visible
    uint64_t *keys, *sorted;  // [capacity]: depth in the high half, position in `projected` in the low half
    float* moments;        // [capacity, FIT_MOMENTS]
    uint32_t* starts;      // [blocks + 1] where the list of each block begins
    uint32_t* taken;       // [blocks] number of splats of its list that were blended
    uint32_t* spans;       // [rows of blocks of all splats]: the first and the last block that a splat touches in a row
    uint32_t* list;        // [splat-block pairs]
    float* known;          // [area] inverse depths; 0 where unknown, negative where a pixel is not compared
    float* image;          // [FIT_CHANNELS, area]
    float* slopes;         // [FIT_CHANNELS, area]: gradient of the loss by the image
    float* maps;           // [10, area] intermediate maps of the structural similarity
};

struct FitTarget {
    const uint8_t* pixels;          // [height, width, 3]
    const float* exposure;          // [3, 2]: gain and offset of each channel
    float ssim_weight, depth_weight;
};

// The loss, its terms, and its gradients by the exposure and the pose.
struct FitLoss {
    float total, l1, ssim, depth;
    float exposure[6], pose[6];
};

// One step of Adam over Gaussians [first, last), both multiples of sixteen.
struct FitUpdate {
    float* values;                    // [rows, stride]
    const float* gradients;           // [views, rows, stride]
    size_t views;
    float *first_moments, *second_moments;  // [rows, stride]
    const float* rates;               // [rows]
    size_t rows, stride;
    float beta1, beta2, epsilon, correction1, correction2;
    float opacity_slope, scale_slope;  // regularisers: gradients by each opacity, and by each standard deviation
    float noise;                       // strength of the noise; 0 adds none
    uint64_t seed;
};

struct FitKernels {
    // Project and sort. Returns the number of visible Gaussians, and sets `rows` to the rows of blocks that they touch.
    uint32_t (*project)(const FitModel&, const Camera&, const FitGrid&, const FitScratch&, size_t* rows);
    // Write the spans, and where each block's list begins. Returns the total length of the lists.
    size_t (*count_pairs)(const FitGrid&, const FitScratch&, uint32_t visible);
    void (*fill_lists)(const FitGrid&, const FitScratch&, uint32_t visible);
    void (*blend)(const FitGrid&, const FitScratch&);
    FitLoss (*loss)(const FitGrid&, const FitScratch&, const FitTarget&);
    // Write the gradients of the parameters and of the pose: a rotation about the camera's position, then a
    // translation, both along the world's axes.
    void (*backward)(const FitModel&, const Camera&, const FitGrid&, const FitScratch&, uint32_t visible, float* out,
                     float* pose);
    void (*update)(const FitUpdate&, size_t first, size_t last);
};

namespace portable { extern const FitKernels fit_kernels; }
namespace avx2 { extern const FitKernels fit_kernels; }
namespace avx512 { extern const FitKernels fit_kernels; }

}  // namespace splatrl
