// Places the parts of each row: finds the row's camera in the frame of each part, and which of the row's indices belong
// to the part. A warp takes a row. This runs once per batch, so that all tiles of a row share it.
#include "platform.h"

#include "places.h"
#include "rigid.h"

namespace splatrl {

// The inputs of a batch: parts [batch, parts] and the cameras of their rows.
struct Asked {
    const Model* models;           // [models]
    const int64_t* model;          // [batch, parts], -1 for none
    const float* model_to_world;   // [batch, parts, 4, 4]
    const float* camera_to_world;  // [batch, 4, 4]
    const uint8_t* only;           // [batch] whether to draw each row; null for all
    int* fault;                    // lowest row with something that cannot be drawn
    int parts, model_count;
    uint32_t most_indices, most_gaussians;  // per row
};

// The model of a part. A part that cannot be drawn sets `wrong`, and is left out.
SPLAT_INLINE Model model_of(const Asked& asked, size_t at, bool& wrong) {
    const int64_t model = asked.model[at];
    if (model == -1) return {};
    const bool right = model >= 0 && model < asked.model_count && is_pose(asked.model_to_world + 16 * at);
    wrong |= !right;
    return right ? asked.models[model] : Model{};
}

// Sum over the lanes of a warp.
SPLAT_INLINE uint32_t sum_of(uint32_t value) {
    for (int by = WARP / 2; by > 0; by /= 2) value += __shfl_xor_sync(ALL_LANES, value, by);
    return value;
}

// Inclusive prefix sum over the lanes of a warp.
SPLAT_INLINE uint32_t sum_upto(uint32_t value) {
    for (int by = 1; by < WARP; by *= 2) {
        const uint32_t before = __shfl_up_sync(ALL_LANES, value, by);
        if (lane() >= by) value += before;
    }
    return value;
}

// Express the camera in the frame of a model, in double precision and rounded once: rotationᵀ · (camera - position).
SPLAT_INLINE void express_camera(const float* model_to_world, const float* camera_to_world, float* camera_to_model) {
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 4; ++column) {
            double sum = 0.0;
            for (int axis = 0; axis < 3; ++axis) {
                const double from = column == 3 ? double(model_to_world[4 * axis + 3]) : 0.0;
                sum += double(model_to_world[4 * axis + row]) * (double(camera_to_world[4 * axis + column]) - from);
            }
            camera_to_model[4 * row + column] = float(sum);
        }
}

// Whether a row fits. If its parts have more Gaussians than a key can number or a tile can hold, none of them is drawn.
SPLAT_INLINE bool fits(const Asked& asked, size_t row, bool& wrong) {
    uint32_t indices = 0, gaussians = 0;
    for (int part = lane(); part < asked.parts; part += WARP) {
        const Model model = model_of(asked, row * asked.parts + part, wrong);
        indices += model.size, gaussians += model.gaussians;
    }
    const bool all = sum_of(indices) <= asked.most_indices && sum_of(gaussians) <= asked.most_gaussians;
    wrong |= !all;
    return all;
}

SPLAT_INLINE void place_row(const Asked& asked, size_t row, Place* places) {
    bool wrong = false;
    const bool shown = fits(asked, row, wrong);
    uint32_t base = 0;
    for (int first = 0; first < asked.parts; first += WARP) {
        const int part = first + lane();
        const size_t at = row * asked.parts + part;
        const Model model = part < asked.parts && shown ? model_of(asked, at, wrong) : Model{};
        const uint32_t upto = sum_upto(model.size);
        if (part < asked.parts) {
            Place place{};
            if (model.size > 0)
                express_camera(asked.model_to_world + 16 * at, asked.camera_to_world + 16 * row, place.camera_to_model);
            place.root = model.root, place.size = model.size;
            place.base = base + upto - model.size;
            place.shift = model.first_index - place.base;
            places[at] = place;
        }
        base += __shfl_sync(ALL_LANES, upto, WARP - 1);
    }
    if (__any_sync(ALL_LANES, wrong) && lane() == 0) atomicMin(asked.fault, int(row));
}

}  // namespace splatrl

extern "C" __global__ void __launch_bounds__(WARP) place_parts(splatrl::Asked asked, splatrl::Place* places) {
    if (asked.only == nullptr || asked.only[blockIdx.x] != 0) splatrl::place_row(asked, blockIdx.x, places);
}
