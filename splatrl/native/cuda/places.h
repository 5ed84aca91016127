// The models of a renderer, and where the parts of a row stand: what place.cu passes to render.cu.
#pragma once

#include "platform.h"

namespace splatrl {

// One of a renderer's models, which lie one after another in SceneArrays (tile.h).
struct Model {
    uint32_t root;         // the first cluster of its tree
    uint32_t first_index;  // where its indices begin in SceneArrays::slots
    uint32_t size;         // how many indices it has, including those of merged Gaussians
    uint32_t gaussians;    // merged ones not counted: the most candidates that it gives
};

// A part, as the camera of its row sees it.
struct alignas(16) Place {
    float camera_to_model[12];  // the upper three rows
    uint32_t root;
    uint32_t base;              // the first of its indices in the row, after those of the parts before it
    uint32_t shift;             // from an index in the row to one in SceneArrays::slots, modulo 2^32
    uint32_t size;              // the size of its model; 0 where nothing of it shows
};

}  // namespace splatrl
