// Data that the stages of fit.cu pass to each other.
#pragma once

#include "platform.h"

#include "fit_kernel.h"
#include "splat.h"

namespace splatrl {

constexpr int FIT_TILE = 16;  // width and height of a tile, pixels; a block has one thread per pixel
constexpr int FIT_THREADS = FIT_TILE * FIT_TILE, FIT_WARPS = FIT_THREADS / WARP;

// Views that are drawn together, of one model and at one size. What they are compared with is stored photo by photo.
struct FitViews {
    const float* camera_to_world;  // [views, 4, 4]
    const float* K;                // [views, 3, 3]
    const int64_t* photos;         // [views] the photo that each is compared with
    const float* known;            // [photos, height, width] inverse depths, 0 if unknown, below 0 if not compared
    int views, width, height;

    INLINE_MEMBER int across() const { return (width + FIT_TILE - 1) / FIT_TILE; }
    INLINE_MEMBER int tiles() const { return across() * ((height + FIT_TILE - 1) / FIT_TILE); }
    INLINE_MEMBER size_t area() const { return size_t(width) * size_t(height); }
    INLINE_MEMBER Camera camera(int view) const {
        return camera_of(camera_to_world + 16 * view, K + 9 * view, width, height);
    }
};

// Pairs of a splat and a tile on which it is visible: listed splat by splat, then sorted by tile and depth.
struct FitPairs {
    FitSplat* splats;        // [views, stride]; invisible ones are not set
    int* counts;             // [views, stride] number of pairs of each splat
    const int64_t* ends;     // [views, stride] index after the last pair of each splat
    int64_t* keys;           // [pairs] tile, counted over all views, in the high half, depth in the low half
    int* owners;             // [pairs] the splat of each
    const int64_t* order;    // [pairs] pairs by tile, nearest first; equal ones in the order of the model
    const int64_t* starts;   // [views · tiles + 1] where the pairs of each tile begin in `order`
    int* taken;              // [views, tiles] how many pairs of each tile were blended
};

// A pixel of a tile.
struct FitPlace {
    int view, x, y;
    bool inside;
    size_t at;  // offset in a plane

    INLINE_MEMBER FitPlace(const FitViews& views, int tile, int column, int row) {
        view = tile / views.tiles();
        const int number = tile % views.tiles();
        x = number % views.across() * FIT_TILE + column, y = number / views.across() * FIT_TILE + row;
        inside = x < views.width && y < views.height;
        at = inside ? size_t(y) * size_t(views.width) + size_t(x) : 0;
    }
};

// Column of a thread's pixel in its tile. A warp covers 8×4 pixels.
SPLAT_INLINE int patch_column() { return warp() % 2 * 8 + lane() % 8; }
// Row of a thread's pixel in its tile.
SPLAT_INLINE int patch_row() { return warp() / 2 * 4 + lane() / 8; }

// Sum N values over the threads of a block, to `out`, which belongs to this block alone.
template <int N>
SPLAT_INLINE void add_up(const float* values, float (*sums)[N], float* out) {
    for (int i = 0; i < N; ++i) {
        float sum = values[i];
        for (int by = WARP / 2; by > 0; by /= 2) sum += __shfl_xor_sync(ALL_LANES, sum, by);
        if (lane() == 0) sums[warp()][i] = sum;
    }
    __syncthreads();
    if (thread() < N) {
        float sum = 0.0f;
        for (int i = 0; i < FIT_WARPS; ++i) sum += sums[i][thread()];
        out[thread()] = sum;
    }
}

}  // namespace splatrl
