// The groups of a scene that may show on a tile, at the level of detail that the camera asks for.
#pragma once

#include "frustum.h"
#include "kernel.h"
#include "lanes.h"

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

// The groups that may show on a tile, in the order of the scene: none where the root misses it. The bounds of a
// cluster's groups are fetched while those of the cluster before it are tested.
LANE_INLINE uint32_t cull(const SceneView& scene, const Camera& camera, const Tile& tile, uint32_t* groups) {
    const Frustum frustum = frustum_of(camera, tile);
    const uint32_t none = scene.cluster_count;
    uint32_t count = 0, fetched = none;
    for (uint32_t c = 0; c < scene.cluster_count;) {
        const Cluster& cluster = scene.clusters[c];
        if (misses(frustum, camera, cluster.bounds)) {
            c = cluster.skip;
            continue;
        }
        if (cluster.error > 0.0f && !within_tolerance(frustum, camera, cluster, scene.tolerance)) {
            ++c;
            continue;
        }
        for (const float(&member)[GROUP] : scene.group_bounds[c].members) __builtin_prefetch(member);
        if (fetched != none) count = append_groups(scene, frustum, camera, fetched, groups, count);
        fetched = c;
        c = cluster.skip;
    }
    if (fetched != none) count = append_groups(scene, frustum, camera, fetched, groups, count);
    for (uint32_t i = 0; i < SPARE; ++i) groups[count + i] = 0;
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
