// What the portable part of the renderer and the kernels of each instruction set say to each other: plain memory.
#pragma once

#include <cstdint>

#include "splat.h"

namespace splatrl {

constexpr int GROUP = 16;    // Gaussians that are projected at once; the lanes of a vector
constexpr int CLUSTER = 256; // Gaussians that are culled at once
constexpr int BLOCK = 4;     // a block is 4×4 pixels; the lanes of a vector

// One group in memory: [GEOMETRY][GROUP] floats.
enum Geometry { MEAN = 0, AXES = 3, LOG2_OPACITY = 12, GEOMETRY = 13 };

// Bounds of the Gaussians of a cluster, world frame, metres.
struct Cluster {
    float center[3], radius;  // a sphere around the means
    float reach;              // the most standard deviations at which one of them shows
    float reach_scale;        // the largest product of that and its longest axis, metres
    uint32_t first_group, groups;
};

struct SceneView {
    const float* geometry;          // [groups, GEOMETRY, GROUP]
    const float* colors;            // [groups, 3 · harmonics, GROUP]; final colours where harmonics is 1
    const uint32_t* original_index; // [groups · GROUP]
    const Cluster* clusters;
    uint32_t cluster_count;
    int degree;
};

// A visible Gaussian, as blending reads it: twelve words.
struct alignas(16) Splat {
    float x, y, l11, l12, l22, log2_opacity;
    float red, green, blue;
    float depth;
    float depth_rest;          // what single precision leaves of the depth: it decides between equal depths
    uint32_t original_index;   // in the scene: it decides between what is still equal
};

// The blocks that a splat can show on.
struct Patch {
    uint32_t first;          // its top left block
    uint16_t across, down;   // at least 1
};

struct Pair {
    uint32_t block, splat;
};

// Accumulated per block: [CHANNELS][BLOCK · BLOCK] floats.
enum Channel { RED, GREEN, BLUE, ALPHA, DEPTH, TRANSMITTANCE, CHANNELS };

constexpr uint32_t SPARE = 16;  // items at the end of an array that may be touched without being counted

// Memory that a worker keeps from frame to frame.
struct Scratch {
    Splat* splats;           // [groups · GROUP + SPARE]
    Patch* patches;          // [groups · GROUP + SPARE] of each splat
    uint64_t* keys;          // [groups · GROUP + SPARE] depth in the high, splat in the low half
    uint64_t* sorted;        // the same size
    Pair* pairs;             // [pair_capacity + SPARE]
    uint32_t* lists;         // [pair_capacity + SPARE] splats, block by block, nearest first
    uint32_t* list_ends;     // [blocks + 1]
    uint8_t* finished;       // [blocks]
    float* frame;            // [blocks, CHANNELS, 16]
    uint32_t pair_capacity;  // at least the number of blocks
};

// Renders one frame into scratch.frame and returns the number of visible Gaussians.
using RenderFrame = uint32_t (*)(const SceneView&, const Camera&, bool antialiased, bool with_depth, const Scratch&);

namespace baseline { extern const RenderFrame render_frame; }
namespace avx2 { extern const RenderFrame render_frame; }
namespace avx512 { extern const RenderFrame render_frame; }

}  // namespace splatrl
