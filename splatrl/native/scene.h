// The Gaussians of a scene in the order and layout that the kernels read.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "buffer.h"
#include "kernel.h"
#include "levels.h"

namespace splatrl {

// The tolerance to apply: classic images enlarge every small Gaussian to a pixel, which makes merging more visible.
inline float held_tolerance(float tolerance, bool antialiased) { return antialiased ? tolerance : tolerance / 4.0f; }

// The highest opacity that a merged Gaussian can reach in an image. In classic images each of its members is dilated,
// so that together they may cover more than their area.
inline float most_opacity(float opacity, float sum, bool antialiased) { return antialiased ? opacity : opacity + sum; }

// The largest distance, in standard deviations, at which a Gaussian of this opacity is visible.
float reach_of(float opacity);

// The longest axis of a Gaussian (one standard deviation), from a factor A of its covariance (row-major 3×3); slightly
// enlarged, so that rounding never makes it too short.
float longest_axis(const float* axes);

// log2 of the opacity of slots that pad a group, and of transparent Gaussians.
constexpr float NEVER_SHOWS = std::numeric_limits<float>::lowest();

// The values of one Gaussian as they are stored.
struct Stored {
    float mean[3], factor[6], log2_opacity;
    float members, sum;  // 0 for one of the scene's own
};

Stored stored(const SceneView& scene, size_t group, size_t lane);

// Write a factor without its upper triangle into a matrix (row-major 3×3), whose upper triangle is left as it is.
inline void copy_factor(const float (&factor)[6], float* axes) {
    for (int row = 0, i = 0; row < 3; ++row)
        for (int column = 0; column <= row; ++column, ++i) axes[3 * row + column] = factor[i];
}

class Scene {
public:
    // Colours are stored relative to the background.
    Scene(const GaussianArrays& gaussians, const Levels& levels, std::array<float, 3> background, bool antialiased);
    // A copy of a scene that has this many groups.
    Scene(const SceneView& view, size_t groups);

    SceneView view(float tolerance) const;
    size_t groups() const { return groups_; }
    size_t capacity() const { return groups_ * GROUP; }

private:
    void add_merged(const Levels& levels, const GaussianArrays& gaussians, bool antialiased);
    void add(const GaussianArrays& gaussians, const float* opacities, const uint32_t* order, uint32_t first_index,
             const Node& node, size_t index);
    void pack(const GaussianArrays& gaussians, const uint32_t* order, const Node& node);
    void enclose(const std::vector<Node>& nodes);
    void enclose_means();

    std::array<float, 3> background_;
    int degree_;
    size_t groups_ = 0, first_merged_ = 0;
    Buffer<float> geometry_;
    Buffer<MergedGroup> merged_;
    Buffer<uint16_t> colors_;
    Buffer<uint32_t> original_index_;
    std::vector<Cluster> clusters_;
    std::vector<GroupBounds> group_bounds_;
    std::vector<Box> boxes_;
};

}  // namespace splatrl
