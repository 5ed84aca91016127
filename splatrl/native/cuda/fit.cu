// Fits Gaussians to photos on a GPU, using kernels/fit_*.h with one lane per thread.
//
// All views go through each stage together. Splats are projected (project_views) and paired with the tiles of 16×16
// pixels on which they are visible (list_tiles); PyTorch sorts the pairs by tile and depth. A block blends a tile
// (blend_views), compares one of its channels with the photo (curve_views, slope_views), and backpropagates through the
// blending (blend_views_back). Then the gradients of each Gaussian's parameters are computed (pull_views), and the
// parameters take a step (take_step). No sum depends on the order in which threads run.
//
// SH_DEGREE and the bytes of shared memory that each launch asks for are macros.
#include "platform.h"

#include "fit_compare.h"
#include "fit_lists.h"
#include "fit_slopes.h"
#include "kernels/fit_update.h"

namespace splatrl {

// The view and the Gaussian of a thread. Each block belongs to one view.
struct FitThread {
    int view, index;

    INLINE_MEMBER explicit FitThread(size_t stride) {
        const int blocks = int((stride + FIT_THREADS - 1) / FIT_THREADS);
        view = int(blockIdx.x) / blocks, index = int(blockIdx.x) % blocks * FIT_THREADS + thread();
    }
};

// The model with its degree as a compile-time constant.
SPLAT_INLINE FitModel of_degree(FitModel model) {
    model.degree = SH_DEGREE;
    return model;
}

struct FitPosing {
    float sums[FIT_WARPS][6];
};

static_assert(sizeof(FitBlending) <= BLEND_BYTES, "BLEND_BYTES is too small");
static_assert(sizeof(CurveWindows) <= COMPARE_BYTES && sizeof(SlopeWindows) <= COMPARE_BYTES,
              "COMPARE_BYTES is too small");
static_assert(sizeof(FitBacking) <= BACK_BYTES && sizeof(FitPosing) <= PULL_BYTES,
              "BACK_BYTES or PULL_BYTES is too small");

}  // namespace splatrl

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
project_views(splatrl::FitModel model, splatrl::FitViews views, splatrl::FitPairs pairs) {
    using namespace splatrl;
    const FitThread own(model.stride);
    if (own.index >= int(model.stride)) return;
    const size_t place = size_t(own.view) * model.stride + size_t(own.index);
    FitSplat splat;
    const bool there = own.index < int(model.count);
    const int count = there ? project_splat(of_degree(model), views, own.view, own.index, splat) : 0;
    pairs.counts[place] = count;
    if (count > 0) copy_splat(splat, pairs.splats[place]);
}

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
list_tiles(splatrl::FitModel model, splatrl::FitViews views, splatrl::FitPairs pairs) {
    using namespace splatrl;
    const FitThread own(model.stride);
    if (own.index >= int(model.count)) return;
    const size_t place = size_t(own.view) * model.stride + size_t(own.index);
    if (pairs.counts[place] > 0) list_pairs(views, pairs, own.view, place);
}

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
blend_views(splatrl::FitViews views, splatrl::FitPairs pairs, float* image) {
    DYNAMIC_SHARED(splatrl::FitBlending, shared);
    splatrl::blend_tile(views, pairs, int(blockIdx.x), shared, image);
}

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
curve_views(splatrl::FitViews views, splatrl::FitPhotos photos) {
    DYNAMIC_SHARED(splatrl::CurveWindows, shared);
    splatrl::find_curves(views, photos, int(blockIdx.x), shared);
}

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
slope_views(splatrl::FitViews views, splatrl::FitPhotos photos) {
    DYNAMIC_SHARED(splatrl::SlopeWindows, shared);
    splatrl::find_slopes(views, photos, int(blockIdx.x), shared);
}

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
blend_views_back(splatrl::FitViews views, splatrl::FitPairs pairs, const float* image, const float* slopes,
                 float* moments) {
    DYNAMIC_SHARED(splatrl::FitBacking, shared);
    splatrl::blend_back(views, pairs, int(blockIdx.x), image, slopes, moments, shared);
}

// gradients [views, rows, stride]; poses [views, blocks, 6]: the sum over each block's Gaussians.
extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS)
pull_views(splatrl::FitModel model, splatrl::FitViews views, splatrl::FitPairs pairs, const float* moments,
           float* gradients, float* poses) {
    using namespace splatrl;
    DYNAMIC_SHARED(FitPosing, shared);
    const FitThread own(model.stride);
    const size_t rows = size_t(FIT_SH + 3 * (SH_DEGREE + 1) * (SH_DEGREE + 1));
    one_lane::PoseSlopes pose{};
    if (own.index < int(model.stride))
        pull_gaussian(of_degree(model), views, pairs, own.view, own.index, moments,
                      gradients + size_t(own.view) * rows * model.stride, pose);
    const float slopes[6] = {pose.turn[0], pose.turn[1], pose.turn[2], pose.shift[0], pose.shift[1], pose.shift[2]};
    add_up<6>(slopes, shared.sums, poses + 6 * size_t(blockIdx.x));
}

extern "C" __global__ void __launch_bounds__(splatrl::FIT_THREADS) take_step(splatrl::FitUpdate update) {
    const size_t index = size_t(blockIdx.x) * splatrl::FIT_THREADS + threadIdx.x;
    if (index < update.stride) splatrl::one_lane::update_all(update, index, index + 1);
}
