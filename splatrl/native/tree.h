// The tree over a scene, as culling reads it.
#pragma once

#include <cstdint>

namespace splatrl {

constexpr int GROUP = 16;    // Gaussians that the CPU projects at once: the lanes of a vector
constexpr int CLUSTER = 256; // Gaussians that are culled at once: its groups are the lanes of a vector

// Bounds of some Gaussians, world frame, metres.
struct Bounds {
    float center[3], radius;  // a sphere around the means
    float reach;              // the most standard deviations at which any of them is visible
    float reach_scale;        // the largest product of a Gaussian's reach and its longest axis, metres
};

// A node of the tree over a scene. Nodes are in preorder: the subtrees of an inner node's children, one or two, follow.
struct Cluster {
    Bounds bounds;   // of everything below it
    float error;     // metres by which what it shows is displaced: 0 in a leaf, infinite if it shows nothing
    uint32_t first_group, groups;
    uint32_t skip;   // the cluster after all those below this one
};

// The box around the means of a cluster's own Gaussians: its centre and half the lengths of its edges, metres.
struct Box {
    float center[3], half[3];
};

// Bounds of the groups of a cluster: for each member of Bounds, its values for all groups.
struct alignas(64) GroupBounds {
    float members[6][GROUP];
};

}  // namespace splatrl
