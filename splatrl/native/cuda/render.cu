// Renders thousands of small images at once. A block draws a tile of 32×32 pixels from start to finish and then takes
// the next: it descends the trees (candidates.h), sorts the Gaussians that may be visible by depth (order.h), and
// blends them slab by slab with the pixels in shared memory (blend.h). Blocks are independent. Threads find Gaussians
// in any order, but sort them by keys of which no two are equal, so a frame has the same bytes in every batch.
//
// ANTIALIASED_IMAGES, LEVELS_OF_DETAIL (1 or 0), SH_DEGREE and MOST_PARTS (per row; 0 draws the first model in its own
// frame) are macros, so that each combination is compiled separately.
#include "platform.h"

#include "blend.h"
#include "candidates.h"
#include "order.h"
#include "rigid.h"

namespace splatrl {

// Take the next tile. Returns whether there is one; shared.drawn tells whether it is to be drawn.
SPLAT_INLINE bool next_tile(const Views& views, const Workspace& workspace, Shared& shared) {
    const int across = (views.width + SMALL_TILE - 1) / SMALL_TILE, down = (views.height + SMALL_TILE - 1) / SMALL_TILE;
    __syncthreads();
    if (thread() == 0) {
        shared.item = atomicAdd(workspace.next_tile, 1);
        if (workspace.chosen != nullptr)
            shared.item = shared.item < workspace.chosen[0] ? workspace.chosen[1 + shared.item]
                                                            : views.batch * across * down;
        shared.row = shared.item / (across * down);
        shared.drawn = shared.row < views.batch && (views.only == nullptr || views.only[shared.row] != 0);
        if (shared.drawn) {
            const float *pose = views.camera_to_world + 16 * size_t(shared.row), *K = views.K + 9 * size_t(shared.row);
            const int tile = shared.item % (across * down);
            const int left = tile % across * SMALL_TILE, right = left + SMALL_TILE;
            const int top = tile / across * SMALL_TILE, bottom = top + SMALL_TILE;
            shared.tile = {left, top, right < views.width ? right : views.width,
                           bottom < views.height ? bottom : views.height};
            shared.camera = camera_of(pose, K, views.width, views.height);
            if (!WITH_PARTS) shared.views[0] = {shared.camera, frustum_of(shared.camera, shared.tile)};
            shared.drawn = is_pose(pose) && is_lens(K);
            if (!shared.drawn) atomicMin(workspace.fault, shared.row);
        }
    }
    __syncthreads();
    return shared.row < views.batch;
}

// The block's own working memory for nodes [3, node_capacity].
SPLAT_INLINE uint32_t* nodes_of_block(const Workspace& workspace) {
    return workspace.nodes + 3 * size_t(blockIdx.x) * workspace.node_capacity;
}

// Set up the view of each part of the row: the row's camera in the part's frame.
SPLAT_INLINE void view_parts(const Views& views, Shared& shared) {
    if (!WITH_PARTS) return;
    for (int part = thread(); part < views.parts; part += THREADS) {
        const Place& place = place_of(views, shared.row, part);
        shared.bases[part] = place.base;
        const Camera camera =
            camera_of(place.camera_to_model, views.K + 9 * size_t(shared.row), views.width, views.height);
        shared.views[part] = {camera, frustum_of(camera, shared.tile)};
    }
}

// Leave a tile whose candidates exceed the room for keys to another launch. Returns whether it was left.
SPLAT_INLINE bool leave_tile(const Workspace& workspace, const Shared& shared) {
    if (shared.count <= uint32_t(workspace.key_capacity)) return false;
    if (thread() == 0) workspace.left[1 + atomicAdd(workspace.left, 1)] = shared.item;
    return true;
}

// Add a thread's count to the effort statistics of the frame.
SPLAT_INLINE void note(const Workspace& workspace, const Shared& shared, Efforts what, uint32_t count) {
    if (count > 0) atomicAdd(workspace.efforts + size_t(shared.row) * EFFORTS + what, count);
}

// Estimate the work of each tile by the groups of sixteen Gaussians among which its candidates are.
SPLAT_INLINE void weigh(const SceneArrays& scene, const Views& views, const Workspace& workspace, int* weights) {
    DYNAMIC_SHARED(Shared, shared);
    uint32_t* nodes = nodes_of_block(workspace);
    while (next_tile(views, workspace, shared)) {
        if (!shared.drawn) continue;
        view_parts(views, shared);  // cull synchronises before it reads the views
        cull(scene, views, shared, nodes, workspace.node_capacity);
        const uint32_t* accepted = nodes + 2 * size_t(workspace.node_capacity);
        int groups = 0;
        for (uint32_t i = thread(); i < shared.accepted; i += THREADS)
            groups += int(scene.clusters[Node{accepted[i]}.cluster()].groups);
        if (groups > 0) atomicAdd(weights + shared.item, groups);
    }
}

template <bool WITH_DEPTH>
SPLAT_INLINE void draw_tiles(const SceneArrays& scene, const Views& views, const Workspace& workspace,
                             const Images& images) {
    using SharedMemory = typename SharedFor<WITH_DEPTH>::Type;
    DYNAMIC_SHARED(SharedMemory, shared);
    Key* keys = workspace.keys + 2 * size_t(blockIdx.x) * workspace.key_capacity;
    uint32_t* nodes = nodes_of_block(workspace);
    while (next_tile(views, workspace, shared)) {
        if (!shared.drawn) continue;
        view_parts(views, shared);  // cull synchronises before it reads the views
        cull(scene, views, shared, nodes, workspace.node_capacity);
        find_candidates(scene, workspace, shared, nodes, keys);
        if (leave_tile(workspace, shared)) continue;
        if (workspace.efforts != nullptr) note(workspace, shared, PROJECTED, thread() == 0 ? shared.count : 0);
        Pixels<WITH_DEPTH> pixels;
        pixels.begin(scene, shared);
        begin_slabs(shared, keys, workspace.key_capacity);
        while (const uint32_t count = next_slab(scene, shared)) {
            const uint32_t shown = project_slab<WITH_DEPTH>(scene, views, shared, count, pixels.log2_invisible);
            if (workspace.efforts != nullptr) note(workspace, shared, VISIBLE, thread() == 0 ? shown : 0);
            color_slab(scene, views, shared, shown, pixels.log2_invisible);
            pixels.blend_slab(shared);
            if (!__syncthreads_or(pixels.active != 0)) break;
        }
        pixels.write(shared, images, views.width, views.height);
        if (workspace.efforts != nullptr) note(workspace, shared, BLENDED, lane() % QUARTER == 0 ? pixels.blended : 0);
    }
}

}  // namespace splatrl

extern "C" __global__ void __launch_bounds__(splatrl::THREADS, splatrl::BLOCKS_AT_ONCE)
weigh_tiles(splatrl::SceneArrays scene, splatrl::Views views, splatrl::Workspace workspace, int* weights) {
    splatrl::weigh(scene, views, workspace, weights);
}

extern "C" __global__ void __launch_bounds__(splatrl::THREADS, splatrl::BLOCKS_AT_ONCE)
draw_pixels(splatrl::SceneArrays scene, splatrl::Views views, splatrl::Workspace workspace, splatrl::Images images) {
    splatrl::draw_tiles<false>(scene, views, workspace, images);
}

extern "C" __global__ void __launch_bounds__(splatrl::THREADS, splatrl::BLOCKS_AT_ONCE)
draw_images(splatrl::SceneArrays scene, splatrl::Views views, splatrl::Workspace workspace, splatrl::Images images) {
    splatrl::draw_tiles<true>(scene, views, workspace, images);
}
