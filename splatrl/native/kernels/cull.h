// Culling: selects the groups of Gaussians that may be visible on a tile, at the level of detail that the camera needs,
// from near to far.
#pragma once

#include "frustum.h"
#include "kernel.h"
#include "lanes.h"
#include "veil.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Bit mask of the groups of a cluster that may touch the tile.
LANE_INLINE uint32_t groups_in_view(const Frustum& frustum, const Camera& camera, const GroupBounds& bounds,
                                    uint32_t groups) {
    Lanes members[6];
    for (int i = 0; i < 6; ++i) members[i] = load(bounds.members[i]);
    const Lanes missed = missed_by<Lanes>(frustum, camera.position, members, members[3], members[4], members[5]);
    return ~bits_above(missed, lanes(0.0f)) & ((2u << (groups - 1)) - 1);
}

// Append the groups of one of a part's clusters that may be visible on the tile; returns the new count.
LANE_INLINE uint32_t append_groups(const Row& row, uint32_t number, uint32_t c, Shown* groups, uint32_t count) {
    const Part& part = row.parts[number];
    const Cluster& cluster = part.scene->clusters[c];
    const GroupBounds& bounds = part.scene->group_bounds[c];
    for (uint32_t left = groups_in_view(part.frustum, part.camera, bounds, cluster.groups); left != 0; left &= left - 1)
        groups[count++] = {number, cluster.first_group + uint32_t(__builtin_ctz(left))};
    return count;
}

// Nodes whose subtrees have not been drawn yet, in the order of the parts.
struct Branches {
    Branch* items;
    uint32_t count;

    void add(const Branch& branch) { items[count++] = branch; }
};

constexpr float COARSEST = 4.0f;  // veiled nodes may be displaced by at most this many times the tolerance
constexpr float OPEN = 0.5f;      // nodes behind a veil that passes less than this fraction of the light may be coarser
constexpr uint32_t STEP = 512;    // approximate number of groups drawn between two updates of the veil

// Make a branch. Descending into a node that is too coarse yields more groups than it has itself; the number given here
// is an estimate, and only serves to divide frames into steps.
LANE_INLINE Branch branch_of(uint32_t part, uint32_t c, const Cluster& node, float nearest, float displaced,
                             float tolerance) {
    const float opened = displaced > tolerance ? splatrl::min(displaced / tolerance, BEYOND) : 1.0f;
    return {part, c, nearest, float(node.groups) * opened};
}

// Prefetch the nodes at the root of a tree, which come first in memory.
LANE_INLINE void fetch_root(const SceneView& scene) {
    constexpr int LINES = 4;
    const char* clusters = reinterpret_cast<const char*>(scene.clusters);
    for (int line = 0; line < LINES; ++line) __builtin_prefetch(clusters + 64 * line);
}

LANE_INLINE void fetch_bounds(const GroupBounds& bounds) {
    for (const float(&member)[GROUP] : bounds.members) __builtin_prefetch(member);
}

// Prefetch everything that culling reads of a branch.
LANE_INLINE void fetch_branch(const Row& row, const Branch& branch) {
    const SceneView& scene = *row.parts[branch.part].scene;
    __builtin_prefetch(&scene.clusters[branch.cluster]);
    __builtin_prefetch(&scene.boxes[branch.cluster]);
    fetch_bounds(scene.group_bounds[branch.cluster]);
}

// Find the branches that may be visible on a tile: the highest nodes that are fine enough to be drawn behind a veil, or
// leaves.
LANE_INLINE void branch_out(const Row& row, const Tile& tile, Branches& branches) {
    branches.count = 0;
    for (uint32_t number = 0; number < row.count; ++number) {
        Part& part = row.parts[number];
        const SceneView& scene = *part.scene;
        if (number + 1 < row.count) fetch_root(*row.parts[number + 1].scene);
        const Frustum& frustum = part.frustum = frustum_of(part.camera, tile);
        for (uint32_t c = 0; c < scene.cluster_count;) {
            const Cluster& node = scene.clusters[c];
            __builtin_prefetch(&scene.clusters[node.skip]);
            if (misses(frustum, part.camera, node.bounds)) {
                c = node.skip;
                continue;
            }
            const float nearest = nearest_depth(frustum, part.camera, node);
            const float displaced = displacement(part.camera, node, nearest);
            if (displaced > COARSEST * scene.tolerance) {
                ++c;
                continue;
            }
            branches.add(branch_of(number, c, node, nearest, displaced, scene.tolerance));
            c = node.skip;
        }
    }
}

// Depth in metres up to which the next step draws; BEYOND, which is everything, if few groups are left.
LANE_INLINE float next_border(const Branches& branches) {
    constexpr uint32_t BITS = 20, FIRST = 120 << (23 - BITS), BINS = 192;  // eight per octave, from 8 mm to 130 km
    float bins[BINS] = {}, nearer = 0.0f, behind = 0.0f;
    for (uint32_t i = 0; i < branches.count; ++i) {
        const float depth = splatrl::max(branches.items[i].nearest, NEAR_DEPTH);
        uint32_t bits;
        std::memcpy(&bits, &depth, sizeof(bits));
        const uint32_t bin = (bits >> BITS) - FIRST;
        bins[bin < BINS ? bin : BINS - 1] += branches.items[i].groups;
        behind += branches.items[i].groups;
    }
    for (uint32_t bin = 0; bin < BINS; ++bin) {
        nearer += bins[bin], behind -= bins[bin];
        if (behind < STEP) break;
        if (nearer < STEP) continue;
        const uint32_t bits = (bin + 1 + FIRST) << BITS;
        float depth;
        std::memcpy(&depth, &bits, sizeof(depth));
        return depth;
    }
    return BEYOND;
}

// Collect the groups that may be visible on a tile, in the order of the parts and their trees, and return their number.
// Nodes beyond `border` are deferred to `later`. If there is a veil, a node behind it may be displaced more, the less
// of its light comes through, so that its visible error stays the same. The data by which branches and the groups of a
// cluster are tested is prefetched, because memory latency may be high.
LANE_INLINE uint32_t cull(const Row& row, const Tile& tile, float border, const Veil* veil, const Branches& branches,
                          Branches& later, Shown* groups) {
    constexpr uint32_t AHEAD = 4;
    later.count = 0;
    uint32_t count = 0, fetched = 0, fetched_of = uint32_t(row.count);
    for (uint32_t next = 0; next < branches.count; ++next) {
        const Branch& branch = branches.items[next];
        if (next + AHEAD < branches.count) fetch_branch(row, branches.items[next + AHEAD]);
        if (branch.nearest >= border) {
            later.add(branch);
            continue;
        }
        const Part& part = row.parts[branch.part];
        const SceneView& scene = *part.scene;
        for (uint32_t c = branch.cluster; c < scene.clusters[branch.cluster].skip;) {
            const Cluster& node = scene.clusters[c];
            __builtin_prefetch(&scene.clusters[node.skip]);
            if (c != branch.cluster && misses(part.frustum, part.camera, node.bounds)) {
                c = node.skip;
                continue;
            }
            const float nearest = nearest_depth(part.frustum, part.camera, node);
            const float displaced = displacement(part.camera, node, nearest);
            if (nearest >= border) {
                later.add(branch_of(branch.part, c, node, nearest, displaced, scene.tolerance));
                c = node.skip;
                continue;
            }
            if (displaced > scene.tolerance) {
                const float most = OPEN * scene.tolerance / displaced;  // maximum RMS transmittance
                if (veil == nullptr || displaced > COARSEST * scene.tolerance ||
                    seen_through(*veil, part.camera, tile, scene.boxes[c]) > most * most) {
                    ++c;
                    continue;
                }
            }
            fetch_bounds(scene.group_bounds[c]);
            if (fetched_of < row.count) count = append_groups(row, fetched_of, fetched, groups, count);
            fetched = c, fetched_of = branch.part;
            c = node.skip;
        }
    }
    if (fetched_of < row.count) count = append_groups(row, fetched_of, fetched, groups, count);
    for (uint32_t i = 0; i < SPARE; ++i) groups[count + i] = {0, 0};
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
