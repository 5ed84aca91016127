// Gradients of all parameters, from the moments of the splats of a view.
#pragma once

#include "kernels/fit_turn.h"
#include "kernels/fit_unproject.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Write the gradients of all Gaussians' parameters to `out`, and that of the pose, turn then shift, to `pose_out`.
// Sixteen Gaussians of which none is visible get zeros without being computed.
LANE_INLINE void unproject_all(const FitModel& model, const Camera& camera, const FitScratch& scratch, float* out,
                               float* pose_out) {
    alignas(64) static constexpr float NOTHING[FIT_MOMENTS] = {};
    const int rows = FIT_SH + 3 * (model.degree + 1) * (model.degree + 1);
    PoseSlopes pose;
    for (int i = 0; i < 3; ++i) pose.turn[i] = pose.shift[i] = lanes(0.0f);
    for (size_t first = 0; first < model.count; first += LANES) {
        alignas(64) float lines[LANES * LANES], columns[LANES * LANES];
        uint32_t visible = 0;
        for (int lane = 0; lane < LANES; ++lane) {
            const uint32_t rank = scratch.ranks[first + lane];
            visible |= ~rank;
            const float* from = rank == ~0u ? NOTHING : scratch.moments + size_t(rank) * FIT_MOMENTS;
            store(lines + LANES * lane, load(from));
        }
        if (visible == 0) {
            for (int row = 0; row < rows; ++row) store(out + size_t(row) * model.stride + first, lanes(0.0f));
            continue;
        }
        turn(lines, columns);
        Lanes moments[FIT_MOMENTS];
        for (int i = 0; i <= M_DEPTH; ++i) moments[i] = load(columns + LANES * i);
        unproject(model, camera, first, moments, out, pose);
    }
    for (int i = 0; i < 6; ++i) {
        alignas(64) float sums[LANES];
        store(sums, i < 3 ? pose.turn[i] : pose.shift[i - 3]);
        pose_out[i] = 0.0f;
        for (float sum : sums) pose_out[i] += sum;
    }
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
