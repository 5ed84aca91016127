// Depth maps of photos by plane sweep (Collins 1996), smoothed along paths (Hirschmüller 2008).
#pragma once

#include <cstddef>
#include <cstdint>

#include "isa.h"

namespace splatrl {

constexpr int STEREO_RADIUS = 2;  // of the windows that are compared, 5×5 pixels
constexpr int STEREO_BEST = 3;    // best-matching neighbours that count; in others the point may be occluded

struct StereoPhotos {
    const float* grey;              // [photos, height, width]
    const float* camera_to_world;   // [photos, 4, 4]
    const float* K;                 // [3, 3]
    int width, height;

    size_t area() const { return size_t(width) * size_t(height); }
};

// One photo and the neighbours that it is compared with.
struct StereoTask {
    size_t photo;
    const int64_t* neighbours;  // [neighbour_count] indices of photos
    size_t neighbour_count;
    float low, high;            // range of inverse depths
    int depths;                 // number of levels from low to high, a multiple of sixteen
    const float* soundings;     // [sounding_count, 3]: column, row and inverse depth of points whose depth is known
    size_t sounding_count;
};

// Planes that matching keeps per pixel: statistics of the photo's own windows, the warped neighbour, window sums, the
// intermediate rows of those sums, and one over the number of pixels in each window.
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
    // Estimate the inverse depths [height, width] of a photo.
    void (*sweep)(const StereoPhotos&, const StereoTask&, const StereoScratch&, float* out);
    // Given inverse depths [photos, height, width], average each of the photo's own with those of the neighbours that
    // agree within a relative tolerance; 0 where fewer than `least` do.
    void (*agree)(const StereoPhotos&, const StereoTask&, const float* inverse, float tolerance, int least, float* out);
};

namespace portable { extern const StereoKernels stereo_kernels; }
namespace avx2 { extern const StereoKernels stereo_kernels; }
namespace avx512 { extern const StereoKernels stereo_kernels; }

const StereoKernels& stereo_kernels_of(Isa isa);

}  // namespace splatrl
