// The groups of a scene that may show on a tile, at the level of detail that the camera asks for, from near to far.
#pragma once

#include "frustum.h"
#include "kernel.h"
#include "lanes.h"
#include "veil.h"

namespace splatrl {
namespace SPLATRL_ISA {

// The groups of a cluster that do not miss the tile, as bits.
LANE_INLINE uint32_t groups_in_view(const Frustum& frustum, const Camera& camera, const GroupBounds& bounds,
                                    uint32_t groups) {
    Lanes members[6];
    for (int i = 0; i < 6; ++i) members[i] = load(bounds.members[i]);
    const Lanes missed = missed_by<Lanes>(frustum, camera.position, members, members[3], members[4], members[5]);
    return ~bits_above(missed, lanes(0.0f)) & ((2u << (groups - 1)) - 1);
}

// Append the groups of a cluster that may show on a tile; returns the new count.
LANE_INLINE uint32_t append_groups(const SceneView& scene, const Frustum& frustum, const Camera& camera, uint32_t c,
                                   uint32_t* groups, uint32_t count) {
    const Cluster& cluster = scene.clusters[c];
    for (uint32_t left = groups_in_view(frustum, camera, scene.group_bounds[c], cluster.groups); left != 0;
         left &= left - 1)
        groups[count++] = cluster.first_group + uint32_t(__builtin_ctz(left));
    return count;
}

// Nodes of which nothing has been drawn yet, in the order of the parts.
struct Branches {
    Branch* items;
    uint32_t count;

    void add(const Branch& branch) { items[count++] = branch; }
};

constexpr float COARSEST = 4.0f;  // times the tolerance by which what is veiled may be displaced
constexpr float OPEN = 0.5f;      // of the light: where less comes through a veil, what is behind it may be displaced more
constexpr uint32_t STEP = 512;    // groups that are drawn between one look at what they hide and the next, about

// Opening a node makes more groups of it; this is a guess, by which frames are divided into steps.
LANE_INLINE Branch branch_of(uint32_t part, uint32_t c, const Cluster& node, float nearest, float displaced,
                             float tolerance) {
    const float opened = displaced > tolerance ? splatrl::min(displaced / tolerance, BEYOND) : 1.0f;
    return {part, c, nearest, float(node.groups) * opened};
}

// The branches that may show on a tile: the highest nodes that would do behind a veil, or leaves.
LANE_INLINE void branch_out(const Row& row, const Tile& tile, Branches& branches) {
    branches.count = 0;
    for (uint32_t number = 0; number < row.count; ++number) {
        const Part& part = row.parts[number];
        const SceneView& scene = *part.scene;
        const Frustum frustum = frustum_of(part.camera, tile);
        for (uint32_t c = 0; c < scene.cluster_count;) {
            const Cluster& node = scene.clusters[c];
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

// The depth up to which the next step draws, metres: all where few groups are left.
LANE_INLINE float next_border(const Branches& branches) {
    constexpr uint32_t BITS = 20, FIRST = 120 << (23 - BITS), BINS = 192;  // eight an octave, from 8 mm to 100 km
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

// The groups that may show on a tile of the part whose branches are next in the list, in the order of the scene. What
// is behind `border` is put off. Behind a veil, if there is one, a node may be displaced the more the less of it comes
// through, so that its error weighs as much. The bounds of a cluster's groups are fetched while those of the cluster
// before it are tested.
LANE_INLINE uint32_t cull(const Part& part, const Tile& tile, float border, const Veil* veil, const Branches& branches,
                          uint32_t& next, Branches& later, uint32_t* groups) {
    const SceneView& scene = *part.scene;
    const Camera& camera = part.camera;
    const Frustum frustum = frustum_of(camera, tile);
    const uint32_t number = branches.items[next].part, none = scene.cluster_count;
    uint32_t count = 0, fetched = none;
    for (; next < branches.count && branches.items[next].part == number; ++next) {
        const Branch& branch = branches.items[next];
        if (branch.nearest >= border) {
            later.add(branch);
            continue;
        }
        for (uint32_t c = branch.cluster; c < scene.clusters[branch.cluster].skip;) {
            const Cluster& node = scene.clusters[c];
            if (c != branch.cluster && misses(frustum, camera, node.bounds)) {
                c = node.skip;
                continue;
            }
            const float nearest = nearest_depth(frustum, camera, node);
            const float displaced = displacement(camera, node, nearest);
            if (nearest >= border) {
                later.add(branch_of(number, c, node, nearest, displaced, scene.tolerance));
                c = node.skip;
                continue;
            }
            if (displaced > scene.tolerance) {
                const float most = OPEN * scene.tolerance / displaced;  // root mean square of the transmittance
                if (veil == nullptr || displaced > COARSEST * scene.tolerance ||
                    seen_through(*veil, camera, tile, scene.boxes[c]) > most * most) {
                    ++c;
                    continue;
                }
            }
            for (const float(&member)[GROUP] : scene.group_bounds[c].members) __builtin_prefetch(member);
            if (fetched != none) count = append_groups(scene, frustum, camera, fetched, groups, count);
            fetched = c;
            c = node.skip;
        }
    }
    if (fetched != none) count = append_groups(scene, frustum, camera, fetched, groups, count);
    for (uint32_t i = 0; i < SPARE; ++i) groups[count + i] = 0;
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
