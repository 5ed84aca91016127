// The models of a renderer and the placement of a row's parts: the data that place.cu passes to render.cu.
#pragma once

#include "platform.h"

namespace splatrl {

// One of a renderer's models, which are stored one after another in SceneArrays (tile.h).
struct Model {
    uint32_t root;         // first cluster of its tree
    uint32_t first_index;  // start of its indices in SceneArrays::shapes and colors
    uint32_t size;         // number of indices, including those of merged Gaussians
    uint32_t gaussians;    // number of Gaussians without merged ones: the most candidates that it can give
};

// A part, as the camera of its row sees it.
struct alignas(16) Place {
    float camera_to_model[12];  // upper three rows
    uint32_t root;
    uint32_t base;              // its first index in the row, after those of the parts before it
    uint32_t shift;             // from an index in the row to one in SceneArrays::shapes and colors, modulo 2^32
    uint32_t size;              // size of its model; 0 if the part is not drawn
};

}  // namespace splatrl
