// The groups of a scene that may show on a tile, at the level of detail that the camera asks for.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Whether nothing of some Gaussians can show on a tile: everything is behind the near plane, or further beside an
// edge than it reaches. An edge is a plane through the camera; the reach follows the projected covariance with its
// bounded Jacobian and its dilation, so the test never drops what the projection would show.
struct Frustum {
    float normals[4][3];  // world axes, pixels; positive is outside
    float lengths[4];
    float slants[4];      // pixels that a standard deviation of one metre at one metre reaches at most
    float forward[3];
};

LANE_INLINE Frustum frustum_of(const Camera& camera, const Tile& tile) {
    const float far_x = camera.slope_right > -camera.slope_left ? camera.slope_right : -camera.slope_left;
    const float far_y = camera.slope_bottom > -camera.slope_top ? camera.slope_bottom : -camera.slope_top;
    const float slant_x = camera.fx * __builtin_sqrtf(1.0f + far_x * far_x);
    const float slant_y = camera.fy * __builtin_sqrtf(1.0f + far_y * far_y);
    const float edges[4][3] = {{camera.fx, 0.0f, camera.cx - float(tile.right)},
                               {-camera.fx, 0.0f, float(tile.left) - camera.cx},
                               {0.0f, camera.fy, camera.cy - float(tile.bottom)},
                               {0.0f, -camera.fy, float(tile.top) - camera.cy}};
    Frustum out;
    for (int edge = 0; edge < 4; ++edge) {
        float squared = 0.0f;
        for (int axis = 0; axis < 3; ++axis) {
            out.normals[edge][axis] = 0.0f;
            for (int row = 0; row < 3; ++row)
                out.normals[edge][axis] += edges[edge][row] * camera.rotation[3 * row + axis];
            squared += out.normals[edge][axis] * out.normals[edge][axis];
        }
        out.lengths[edge] = __builtin_sqrtf(squared);
        out.slants[edge] = edge < 2 ? slant_x : slant_y;
    }
    for (int axis = 0; axis < 3; ++axis) out.forward[axis] = camera.rotation[6 + axis];
    return out;
}

LANE_INLINE float max(float a, float b) { return a > b ? a : b; }

// Positive where Gaussians within these bounds miss the tile. `F` is float, or Lanes for sixteen bounds at once.
template <class F>
LANE_INLINE F missed_by(const Frustum& frustum, const Camera& camera, const F* center, F radius, F reach,
                        F reach_scale) {
    const Vector<F> offset{center[0] - camera.position[0], center[1] - camera.position[1],
                           center[2] - camera.position[2]};
    const F depth = offset.x * frustum.forward[0] + offset.y * frustum.forward[1] + offset.z * frustum.forward[2];
    const F deepest = depth + radius;
    F missed = NEAR_DEPTH - deepest;
    for (int edge = 0; edge < 4; ++edge) {
        const float* normal = frustum.normals[edge];
        const F outside = offset.x * normal[0] + offset.y * normal[1] + offset.z * normal[2] -
                          frustum.lengths[edge] * radius;
        // sqrt(σ² + dilation) <= σ + sqrt(dilation)
        const F reached = reach_scale * frustum.slants[edge] + reach * 0.5478f * deepest;
        missed = max(missed, outside - 1.001f * reached);
    }
    return missed;
}

LANE_INLINE bool misses(const Frustum& frustum, const Camera& camera, const Bounds& bounds) {
    return missed_by(frustum, camera, bounds.center, bounds.radius, bounds.reach, bounds.reach_scale) > 0.0f;
}

// The groups of a cluster that do not miss the tile, as bits.
LANE_INLINE uint32_t groups_in_view(const Frustum& frustum, const Camera& camera, const GroupBounds& bounds,
                                    uint32_t groups) {
    Lanes members[6];
    for (int i = 0; i < 6; ++i) members[i] = load(bounds.members[i]);
    const Lanes missed = missed_by(frustum, camera, members, members[3], members[4], members[5]);
    return ~bits_above(missed, lanes(0.0f)) & ((2u << (groups - 1)) - 1);
}

// The error of a node in pixels at the depth where it begins; infinite where that is behind the near plane.
LANE_INLINE float pixel_error(const Frustum& frustum, const Camera& camera, const Cluster& node) {
    float depth = -node.bounds.radius;
    for (int axis = 0; axis < 3; ++axis)
        depth += (node.bounds.center[axis] - camera.position[axis]) * frustum.forward[axis];
    const float focal = camera.fx > camera.fy ? camera.fx : camera.fy;
    return depth > NEAR_DEPTH ? node.error * focal / depth : __builtin_inff();
}

// The groups that may show on a tile, in the order of the scene.
LANE_INLINE uint32_t cull(const SceneView& scene, const Camera& camera, const Tile& tile, uint32_t* groups) {
    const Frustum frustum = frustum_of(camera, tile);
    uint32_t count = 0;
    for (uint32_t c = 0; c < scene.cluster_count;) {
        const Cluster& cluster = scene.clusters[c];
        if (misses(frustum, camera, cluster.bounds)) {
            c = cluster.skip;
            continue;
        }
        if (cluster.error > 0.0f && !(pixel_error(frustum, camera, cluster) <= scene.tolerance)) {
            ++c;
            continue;
        }
        const GroupBounds& bounds = scene.group_bounds[c];
        for (uint32_t left = groups_in_view(frustum, camera, bounds, cluster.groups); left != 0; left &= left - 1)
            groups[count++] = cluster.first_group + uint32_t(__builtin_ctz(left));
        c = cluster.skip;
    }
    for (uint32_t i = 0; i < SPARE; ++i) groups[count + i] = 0;
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
