// Culling: tests for what can be visible on a tile at all. `F` is float, or Lanes for sixteen bounds at once.
#pragma once

#include "camera.h"
#include "scalars.h"
#include "splat.h"
#include "tree.h"

namespace splatrl {

constexpr float BEYOND = 1e30f;  // metres or pixels: larger than any that occurs

// The view frustum of a tile. Gaussians miss the tile if all of them are behind the near plane, or further outside one
// of its edges than they reach. An edge is a plane through the camera; the reach follows the projected covariance with
// its bounded Jacobian and its dilation, so the test never drops anything that the projection would show.
struct Frustum {
    float normals[4][3];  // world axes, pixels; positive is outside
    float lengths[4];
    float slants[4];      // the most pixels that a standard deviation of one metre, seen from one metre, reaches
    float forward[3];
};

SPLAT_INLINE Frustum frustum_of(const Camera& camera, const Tile& tile) {
    const float far_x = max(camera.slope_right, -camera.slope_left);
    const float far_y = max(camera.slope_bottom, -camera.slope_top);
    const float slant_x = camera.fx * square_root(1.0f + far_x * far_x);
    const float slant_y = camera.fy * square_root(1.0f + far_y * far_y);
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
        out.lengths[edge] = square_root(squared);
        out.slants[edge] = edge < 2 ? slant_x : slant_y;
    }
    for (int axis = 0; axis < 3; ++axis) out.forward[axis] = camera.rotation[6 + axis];
    return out;
}

// Positive if all Gaussians within these bounds miss the tile.
template <class F>
SPLAT_INLINE F missed_by(const Frustum& frustum, const float* position, const F* center, F radius, F reach,
                         F reach_scale) {
    const Vector<F> offset{center[0] - position[0], center[1] - position[1], center[2] - position[2]};
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

SPLAT_INLINE bool misses(const Frustum& frustum, const Camera& camera, const Bounds& bounds) {
    return missed_by(frustum, camera.position, bounds.center, bounds.radius, bounds.reach, bounds.reach_scale) > 0.0f;
}

// Whether a single Gaussian misses the tile: as above, but tighter. Its reach is in standard deviations, and
// reach_scale is that times its longest axis, metres.
SPLAT_INLINE bool misses(const Frustum& frustum, const float* position, const float* mean, float reach,
                         float reach_scale) {
    constexpr float SLACK = 1e-5f;  // metres: covers rounding errors
    const Vector<float> offset{mean[0] - position[0], mean[1] - position[1], mean[2] - position[2]};
    const float* forward = frustum.forward;
    const float depth = offset.x * forward[0] + offset.y * forward[1] + offset.z * forward[2] + SLACK;
    if (depth < NEAR_DEPTH) return true;
    const float blurred = reach * depth, dilated = DILATION * blurred * blurred;
    float reached = 0.0f, missed = 0.0f;
    for (int edge = 0; edge < 4; ++edge) {
        const float* normal = frustum.normals[edge];
        if (edge % 2 == 0) {  // left and right share one slant, top and bottom the other
            const float scaled = reach_scale * frustum.slants[edge];
            reached = 1.001f * square_root(scaled * scaled + dilated);
        }
        const float outside = offset.x * normal[0] + offset.y * normal[1] + offset.z * normal[2];
        missed = max(missed, outside - frustum.lengths[edge] * SLACK - reached);
    }
    return missed > 0.0f;
}

// A lower bound on the depth of the means below a node.
SPLAT_INLINE float nearest_depth(const Frustum& frustum, const Camera& camera, const Cluster& node) {
    float depth = -node.bounds.radius;
    for (int axis = 0; axis < 3; ++axis)
        depth += (node.bounds.center[axis] - camera.position[axis]) * frustum.forward[axis];
    return depth;
}

// Displacement in pixels of what a node shows, at its nearest depth: 0 for a leaf, BEYOND behind the near plane.
SPLAT_INLINE float displacement(const Camera& camera, const Cluster& node, float nearest) {
    if (node.error == 0.0f) return 0.0f;
    return nearest > NEAR_DEPTH ? node.error * max(camera.fx, camera.fy) / nearest : BEYOND;
}

// Whether what a node shows is displaced by at most `tolerance` pixels.
SPLAT_INLINE bool within_tolerance(const Frustum& frustum, const Camera& camera, const Cluster& node, float tolerance) {
    return displacement(camera, node, nearest_depth(frustum, camera, node)) <= tolerance;
}

}  // namespace splatrl
