// Plain data that the portable part of the renderer and the kernels of each instruction set share.
#pragma once

#include <cstddef>
#include <cstdint>

#include "frustum.h"
#include "splat.h"
#include "tree.h"

namespace splatrl {

constexpr int BLOCK = 4;     // a block is 4×4 pixels; the lanes of a vector
constexpr int TILE = 64;     // a tile is at most 64×64 pixels, so that its lists and pixels stay in the L2 cache
constexpr int ACROSS = TILE / BLOCK, BLOCKS = ACROSS * ACROSS;  // blocks along an edge of a tile, and in all of it
constexpr int LISTS = BLOCKS + 2 * ACROSS + 2;  // per tile; those after its blocks' own stay empty
constexpr uint32_t SLAB = 2048;  // splats that are binned to blocks at a time

// The layout of one group of the scene's own Gaussians: [GEOMETRY][GROUP] floats. The factor of a covariance is a lower
// triangle, row by row.
enum Geometry { MEAN = 0, FACTOR = 3, LOG2_OPACITY = 9, GEOMETRY = 10 };

// One group of merged Gaussians. Half floats suffice, because these may be displaced anyway, and they save memory
// traffic, which is the bottleneck when a large scene is drawn. Means are relative to `center`; they and the factors
// are multiples of `scale`. `members` is how many Gaussians each stands for, and `sums` the sum of their opacities,
// which only classic images need.
struct alignas(64) MergedGroup {
    float center[3], scale;  // metres
    alignas(32) uint16_t means[3][GROUP], factor[6][GROUP], log2_opacity[GROUP], members[GROUP], sums[GROUP];
};

struct SceneView {
    const float* geometry;            // [first_merged, GEOMETRY, GROUP]
    const MergedGroup* merged;        // [groups - first_merged]
    const uint16_t* colors;           // [groups, 3 · harmonics, GROUP] half floats; final colours if harmonics is 1
    const uint32_t* original_index;   // [groups · GROUP]
    const Cluster* clusters;          // in preorder
    const GroupBounds* group_bounds;  // one per cluster
    const Box* boxes;                 // one per cluster
    uint32_t cluster_count;
    uint32_t first_merged;            // groups from here on hold merged Gaussians
    int degree;
    float background[3];              // the colours of splats are stored relative to it
    float tolerance;                  // pixels by which level of detail may displace what is shown
};

// A visible Gaussian in half a cache line, so that one fetch brings in all of it. At the pixel (x, y),
// u = l11 x + l12 y + u0 and v = l22 y + v0.
struct alignas(32) Splat {
    float u0, v0, l11, l12, l22, log2_opacity;
    uint16_t red, green, blue;  // half floats
    uint16_t patch;
};

// The blocks of a tile that a splat is binned to, in the bits of a patch: the first block, and from bits RIGHT and DOWN
// on, how many more there are to its right and below it. Nearly all splats touch at most 2×2 blocks; the others have
// some bit of LARGE set.
constexpr int RIGHT = 8, DOWN = 12;
constexpr uint32_t LARGE = 0xee00;

// The same splat in the form that blending reads: one cache line.
struct alignas(64) SlabSplat {
    Splat splat;
    float red, green, blue, peak, depth;
};

// A model as seen by a camera of the batch.
struct Part {
    const SceneView* scene;
    Camera camera;         // in the frame of the model
    uint32_t first_index;  // of its Gaussians, counted across all parts of the row
    Frustum frustum;       // of the camera and the tile that is drawn
};

// Everything that is drawn into one image: the parts and the background.
struct Row {
    Part* parts;
    size_t count;
    const float* background;
    float finished;        // the transmittance at which a pixel is finished
    float log2_invisible;  // log2 of the opacity below which a splat is invisible
    bool ranked;           // whether nearly equal depths are ordered in double precision, and ties are broken
    bool timed;            // whether the stages are timed
};

// The channels that are accumulated per block: [CHANNELS][BLOCK · BLOCK] floats.
enum Channel { RED, GREEN, BLUE, TRANSMITTANCE, DEPTH, ALPHA, CHANNELS };

constexpr uint32_t SPARE = 64;  // extra items at the end of an array that may be read or overwritten
constexpr uint32_t LIST = SLAB + 32;  // not a power of two, so that lists do not share cache sets

// A node of a part's tree of which nothing has been drawn yet: its nearest depth, and roughly how many groups it shows.
struct Branch {
    uint32_t part, cluster;
    float nearest, groups;
};

// A group that may be visible on a tile.
struct Shown {
    uint32_t part, group;
};

// Memory that a worker reuses from frame to frame. Arrays of splats hold [groups · GROUP + SPARE], over all parts.
struct Scratch {
    Branch *branches, *later;  // [groups + SPARE]
    Shown* groups;           // [groups + SPARE]
    Splat* splats;
    float* peaks;            // of the splats, if some may be merged Gaussians
    uint64_t* ties;          // tie-breakers for depths that are equal in single precision
    uint64_t* keys;          // depth in the high half, splat in the low half
    uint64_t* sorted;        // also [groups · GROUP + SPARE]
    uint32_t* tied;          // also [groups · GROUP + SPARE]
    SlabSplat* slab;         // [SLAB + 1] nearest first, then one that is visible nowhere
    uint16_t* lists;         // [LISTS, LIST] splats of the slab on each block, nearest first
    float* pixels;           // [BLOCKS, CHANNELS, BLOCK · BLOCK]
};

// The work that a tile took, which can be summed over tiles. `blended` counts splat-block pairs; times are the
// processor time of this thread.
struct Effort {
    uint32_t projected, visible, blended;
    float project_ms, sort_ms, blend_ms;

    void operator+=(const Effort& other) {
        projected += other.projected, visible += other.visible, blended += other.blended;
        project_ms += other.project_ms, sort_ms += other.sort_ms, blend_ms += other.blend_ms;
    }
};

// Renders a piece of a tile of a frame into scratch.pixels. A tile that is drawn in steps, from near to far, is not
// divided: its first piece becomes the whole tile, and the others become empty.
using RenderTile = Effort (*)(const Row&, const Tile& whole, Tile& piece, bool antialiased, bool with_depth,
                              const Scratch&);

namespace portable { extern const RenderTile render_tile; }
namespace avx2 { extern const RenderTile render_tile; }
namespace avx512 { extern const RenderTile render_tile; }

}  // namespace splatrl
