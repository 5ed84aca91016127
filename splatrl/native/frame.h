// Converts the accumulated blocks of a tile to images.
#pragma once

#include <cstdint>

#include "kernel.h"

namespace splatrl {

// Images of one frame, row-major; a null pointer means that an image is not wanted.
struct Images {
    float* rgb;       // [height, width, 3]
    float* depth;     // [height, width] metres
    float* alpha;     // [height, width]
    uint8_t* pixels;  // [height, width, 3]
};

// Write the pixels of a tile. Compiled only once, without floating-point contraction, so `pixels` is the rounding of
// `rgb` on every instruction set.
void write_images(const float* blocks, int width, const Tile& tile, const Images& images);

}  // namespace splatrl
