// Depth of the pixels of photos by plane sweep (Collins 1996), smoothed along paths (Hirschmüller 2008).
#pragma once

#include <cstddef>
#include <cstdint>

#include "isa.h"

namespace splatrl {

constexpr int STEREO_RADIUS = 2;  // of the window that is compared, 5×5 pixels
constexpr int STEREO_BEST = 3;    // of the neighbours, those that agree best count: others may see something in front

struct StereoPhotos {
    const float* grey;              // [photos, height, width]
    const float* camera_to_world;   // [photos, 4, 4]
    const float* K;                 // [3, 3]
    int width, height;

    size_t area() const { return size_t(width) * size_t(height); }
};

// One photo and what it is compared with.
struct StereoTask {
    size_t photo;
    const int64_t* neighbours;  // [neighbour_count], photos
    size_t neighbour_count;
    float low, high;            // range of inverse depths
    int depths;                 // how many there are from low to high, a multiple of sixteen
    const float* soundings;     // [sounding_count, 3]: column, row, inverse depth of places that are known
    size_t sounding_count;
};

// What matching keeps for each pixel: the photo's own windows, a neighbour's view, sums, and lines in between.
enum StereoPlane {
    OWN_MEAN, OWN_VARIANCE, WARPED, OUTSIDE, SUM, SUM_OF_SQUARES, SUM_OF_PRODUCTS, LINE, SQUARES, PRODUCTS, SHARE,
    STEREO_PLANES
};

struct StereoScratch {
    float* best;      // [STEREO_BEST, depths, area]
    float* volume;    // [area, depths]
    float* total;     // [area, depths]
    float* planes;    // [STEREO_PLANES, area]
};

struct StereoKernels {
    // Inverse depths [height, width] of a photo.
    void (*sweep)(const StereoPhotos&, const StereoTask&, const StereoScratch&, float* out);
    // From inverse depths [photos, height, width] the mean of each with those of the neighbours that agree to within a
    // share, or 0 where fewer than `least` do.
    void (*agree)(const StereoPhotos&, const StereoTask&, const float* inverse, float tolerance, int least, float* out);
};

namespace portable { extern const StereoKernels stereo_kernels; }
namespace avx2 { extern const StereoKernels stereo_kernels; }
namespace avx512 { extern const StereoKernels stereo_kernels; }

const StereoKernels& stereo_kernels_of(Isa isa);

}  // namespace splatrl
