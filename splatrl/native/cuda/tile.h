// Data that the stages of render.cu pass to each other.
#pragma once

#include "platform.h"

#include "coverage.h"
#include "flat_scene.h"
#include "frustum.h"
#include "places.h"

namespace splatrl {

constexpr int THREADS = BLOCK_THREADS, WARPS = THREADS / WARP;
constexpr int QUARTER = WARP / 4;  // lanes that share a cell
static_assert(CELL_WIDTH * CELL_HEIGHT == QUARTER, "a quarter warp must have one lane for each pixel of a cell");
static_assert(THREADS / QUARTER * BANDS == CELLS, "each quarter warp must have one cell in each band");

// Blocks among which the registers of a multiprocessor are divided: as many as fit into its shared memory, which is 100
// KB on graphics cards and 164 KB on sm_80.
#if defined(__CUDA_ARCH__) && (__CUDA_ARCH__ == 860 || __CUDA_ARCH__ == 890 || __CUDA_ARCH__ >= 1200)
constexpr int BLOCKS_AT_ONCE = 2;
#elif defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 900
constexpr int BLOCKS_AT_ONCE = 3;
#else
constexpr int BLOCKS_AT_ONCE = 4;
#endif

constexpr bool ANTIALIASED_IMAGE = ANTIALIASED_IMAGES != 0, WITH_LEVELS = LEVELS_OF_DETAIL != 0;
constexpr bool WITH_PARTS = MOST_PARTS > 0;  // otherwise a row draws the first model in its own frame
constexpr int VIEWS = WITH_PARTS ? MOST_PARTS : 1;

constexpr int SLAB = 512;      // splats that are sorted and blended together
constexpr int CHUNKS = SLAB / WARP;  // chunks per slab; a chunk is 32 splats, each with a bit in a word
constexpr int BUCKETS = 2048, SLAB_BUCKETS = 1024;  // buckets by which the depths of a tile and of a slab are grouped

// A key has the depth in its high bits and, in the low ones, the index in the row, counted across its parts. No two
// keys of an image are equal, so their order does not depend on the order in which they were found.
using Key = uint64_t;
constexpr int INDEX_BITS = 28;
constexpr Key NO_KEY = ~Key(0);

SPLAT_INLINE uint32_t index_of(Key key) { return uint32_t(key) & ((1u << INDEX_BITS) - 1); }

// The models of a renderer, one after another. Slots are in the order of the trees; some only pad a group to sixteen.
struct SceneArrays {
    const float4* spheres;            // [slots] mean, metres; the bits of its reach (flat_scene.h), 0 if never visible
    const uint32_t* indices;          // [slots] index in the model; merged Gaussians come after the others
    const float4* shapes;             // [indices of all models, 3] the numbers of SHAPE (flat_scene.h)
    const uint4* colors;              // [indices of all models] color_stride half floats, [harmonics, 3]; at degree 0
                                      // the final colour
    const Cluster* clusters;          // the trees in preorder
    const GroupBounds* group_bounds;  // of each cluster
    float background[3];              // the colours are relative to it
    float tolerance;                  // pixels by which what is shown may be displaced
};

struct Views {
    const float* camera_to_world;     // [batch, 4, 4]
    const float* K;                   // [batch, 3, 3]
    const uint8_t* only;              // [batch] whether to draw each row; null for all
    const Place* places;              // [batch, parts]; unused without parts
    int batch, width, height, parts;
};

SPLAT_INLINE const Place& place_of(const Views& views, int row, int part) {
    return views.places[size_t(row) * views.parts + part];
}

// Working memory of a launch, of which each block has its own part.
struct Workspace {
    Key* keys;                        // [blocks, 2, key_capacity]
    uint32_t* nodes;                  // [blocks, 3, node_capacity]
    int* next_tile;                   // 0 at the start
    const int* chosen;                // number of tiles to draw, then which; null for all
    int* left;                        // number of tiles left to another launch because their candidates exceeded
                                      // key_capacity, then which; null if there is always room
    int* fault;                       // lowest row whose camera is refused
    uint32_t* efforts;                // [batch, EFFORTS] added to; null if not asked for
    int key_capacity, node_capacity;
};

enum Efforts { PROJECTED, VISIBLE, BLENDED, EFFORTS };  // candidates, visible splats, pairs of a splat and a cell

// Where to write; null if not asked for.
struct Images {
    uint8_t* pixels;                  // [batch, height, width, 3]
    float *rgb, *depth, *alpha;       // [batch, height, width, 3], [batch, height, width] twice
};

// A splat as blending reads it, in two words of sixteen bytes.
struct alignas(16) Record {
    float x, y, l11, l12;
    float l22, log2_opacity;
    uint32_t peak_red, green_blue;    // half floats, the first in the low bits; relative to the background. Until the
                                      // colour is evaluated: the peak as a float, and the index in the row
};

// The state of a pixel: its colour so far, and how much of what lies behind shows through.
struct alignas(16) Pixel {
    float red, green, blue, transmittance;
};

// More state of a pixel, for images with depth: the sum of depths, weighted by how much each splat contributes, and the
// sum of the weights.
struct alignas(8) Behind {
    float depth, alpha;
};

// Progress in sorting the candidates of a tile; see order.h.
struct Slabs {
    const Key* keys;                  // grouped by bucket, unless one slab takes them all
    uint32_t count;
    uint32_t begin, end;              // of the current buckets in keys
    int bucket;                       // the one after the current buckets
    Key from, last;                   // range of the current keys that is still to be drawn; empty if last < from
    Key low, high;                    // range of all keys
};

// What a model is culled with: the camera in the frame of the model, and its frustum.
struct View {
    Camera camera;
    Frustum frustum;
};

// The shared memory of a block, which draws one tile at a time.
struct Shared {
    Camera camera;
    Tile tile;
    int item, row, drawn;             // drawn: whether the tile is drawn at all
    uint32_t count, gathered, accepted, frontier[2];
    Key low, high;                    // range of the keys that were examined last
    Slabs slabs;
    uint32_t sums[WARPS];
    uint32_t ends[BUCKETS];           // where each bucket of the candidates ends
    union {                           // never needed at the same time
        Key sorted[SLAB];             // the keys of a slab, nearest first
        uint32_t cells[CHUNKS][CELLS];  // which splats of each chunk are visible on each cell, highest bit first
    };
    uint32_t chunks[CELLS];           // which chunks have any such splats, likewise
    uint32_t bases[VIEWS];            // first index of each part; not set without parts
    union {                           // likewise
        View views[VIEWS];            // one per part
        struct {
            union {                   // likewise
                struct {
                    uint32_t histogram[SLAB_BUCKETS];
                    Key dealt[SLAB];  // the keys of a slab, grouped by bucket
                };
                Record records[SLAB];
            };
            Pixel pixels[BANDS][THREADS];  // of each thread, in the cells of its quarter; private to the thread
        };
    };
};

struct SharedWithDepth : Shared {
    float depths[SLAB];               // of the records
    Behind behind[BANDS][THREADS];    // of the pixels
};

template <bool WITH_DEPTH>
struct SharedFor {
    using Type = Shared;
};
template <>
struct SharedFor<true> {
    using Type = SharedWithDepth;
};

static_assert(sizeof(Shared) <= SHARED_BYTES, "SHARED_BYTES is too small");
static_assert(sizeof(SharedWithDepth) <= SHARED_BYTES_WITH_DEPTH, "SHARED_BYTES_WITH_DEPTH is too small");

}  // namespace splatrl
