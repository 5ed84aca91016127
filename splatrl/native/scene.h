// The Gaussians of a scene in the order and layout that the kernels read.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "buffer.h"
#include "kernel.h"

namespace splatrl {

class Scene {
public:
    // The colours are kept relative to the background.
    // means [N, 3], axes [N, 3, 3] (columns are the axes times the standard deviations), opacities [N],
    // sh [N, harmonics, 3]; all finite, in the world frame, metres.
    Scene(const float* means, const float* axes, const float* opacities, const float* sh, size_t count, int degree,
          std::array<float, 3> background);

    SceneView view() const;
    size_t capacity() const { return groups_ * GROUP; }

private:
    void pack(const float* means, const float* axes, const float* opacities, const float* sh,
              const std::vector<uint32_t>& order);
    void bound(const float* means, const float* axes, const float* opacities, const std::vector<uint32_t>& order);

    size_t count_, groups_;
    int degree_;
    std::array<float, 3> background_;
    Buffer<float> geometry_;
    Buffer<uint16_t> colors_;
    Buffer<uint32_t> original_index_;
    std::vector<Cluster> clusters_;
};

}  // namespace splatrl
