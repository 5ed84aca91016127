// The tree over a scene, as it is culled.
#pragma once

#include <cstdint>

namespace splatrl {

constexpr int GROUP = 16;    // Gaussians that the CPU projects at once; the lanes of a vector
constexpr int CLUSTER = 256; // Gaussians that are culled at once; its groups are the lanes of a vector

// Bounds of some Gaussians, world frame, metres.
struct Bounds {
    float center[3], radius;  // a sphere around the means
    float reach;              // the most standard deviations at which one of them shows
    float reach_scale;        // the largest product of that and its longest axis, metres
};

// A node of the tree over a scene, in preorder: the children of an inner node, two or one, follow it.
struct Cluster {
    Bounds bounds;   // of all below it
    float error;     // metres by which what it shows is displaced: 0 in a leaf, infinite where it shows nothing
    uint32_t first_group, groups;
    uint32_t skip;   // the cluster after all those below this one
};

// The box around the means of a cluster's own Gaussians: its middle and half its edges, metres.
struct Box {
    float center[3], half[3];
};

// Bounds of the groups of a cluster: the members of Bounds, one after another.
struct alignas(64) GroupBounds {
    float members[6][GROUP];
};

}  // namespace splatrl
