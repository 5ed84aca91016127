// The tree over a scene, and its levels of detail: inner nodes hold fewer, larger Gaussians for everything below them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace splatrl {

// Gaussians in the world frame, metres, all values finite: means [count, 3], axes [count, 3, 3] (Σ = A Aᵀ), opacities
// [count], sh [count, (degree + 1)², 3].
struct GaussianArrays {
    const float *means, *axes, *opacities, *sh;
    size_t count;
    int degree;

    size_t colors() const { return 3 * size_t((degree + 1) * (degree + 1)); }
};

// Nodes are in preorder: the subtrees of an inner node's two children, or its only one, follow it.
struct Node {
    uint32_t first, count;  // range in the order for a leaf, in the merged Gaussians for an inner node
    uint32_t skip;          // the node after all those below this one
    uint32_t leaf;          // 1 or 0
    float error;            // metres by which what it shows is displaced: 0 in a leaf, infinite if it shows nothing
};

struct Levels {
    std::vector<uint32_t> order;  // indices of the scene's Gaussians, leaf by leaf
    std::vector<Node> nodes;
    // Merged Gaussians, as in GaussianArrays. An opacity is mass (opacity times area) over area, and may exceed 1.
    std::vector<float> means, axes, opacities, sh;
    std::vector<float> members;  // how many Gaussians of equal mass each stands for
    std::vector<float> sums;     // the sum of the opacities of those it stands for
};

// Build a tree whose nodes hold at most `capacity` Gaussians, in runs of `run` neighbours. With `merge`, inner nodes
// hold merged Gaussians, and nodes with fewer and fewer of them are added above the root, for models that are small or
// distant. Without it, inner nodes hold nothing.
Levels build_levels(const GaussianArrays& gaussians, size_t capacity, size_t run, bool merge);

}  // namespace splatrl
