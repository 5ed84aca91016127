// From the scene to the splats of one camera: cull, project, colour.
#pragma once

#include "kernel.h"
#include "lanes.h"
#include "pack.h"

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
LANE_INLINE uint32_t groups_in_view(const Frustum& frustum, const Camera& camera, const Cluster& cluster) {
    Lanes bounds[6];
    for (int i = 0; i < 6; ++i) bounds[i] = load(cluster.groups_bounds[i]);
    const Lanes missed = missed_by(frustum, camera, bounds, bounds[3], bounds[4], bounds[5]);
    return ~bits_above(missed, lanes(0.0f)) & ((2u << (cluster.groups - 1)) - 1);
}

// Colours relative to the background, as half floats.
LANE_INLINE void shade(const SceneView& scene, uint32_t group, const Vector<Lanes>& offset, IntLanes* rgb) {
    const int harmonics = (scene.degree + 1) * (scene.degree + 1);
    const uint16_t* colors = scene.colors + size_t(group) * 3 * harmonics * GROUP;
    if (scene.degree == 0) {
        for (int channel = 0; channel < 3; ++channel) rgb[channel] = load_shorts(colors + channel * GROUP);
        return;
    }
    const Lanes squared = offset.x * offset.x + offset.y * offset.y + offset.z * offset.z;
    const Lanes inverse = reciprocal_sqrt(max(squared, 1e-30f));
    Lanes basis[16], sums[3];
    sh_basis(scene.degree, offset.x * inverse, offset.y * inverse, offset.z * inverse, basis);
    for (int channel = 0; channel < 3; ++channel) sums[channel] = lanes(0.5f);
    for (int i = 0; i < harmonics; ++i)
        for (int channel = 0; channel < 3; ++channel)
            sums[channel] = sums[channel] + basis[i] * load_halves(colors + (3 * i + channel) * GROUP);
    for (int channel = 0; channel < 3; ++channel)
        rgb[channel] = to_halves(max(sums[channel], 0.0f) - scene.background[channel]);
}

// The first and the last pixel whose centre is in [middle - extent, middle + extent] and which is in [low, high]; the
// last is before the first where there is none.
LANE_INLINE void pixels_between(const Lanes& middle, const Lanes& extent, int low, int high, Lanes& first, Lanes& last) {
    first = ceil(max(middle - extent - 0.5f, float(low)));
    last = floor(max(min(middle + extent - 0.5f, float(high)) + 1.0f, 0.0f)) - 1.0f;
}

// Depths in double precision, split into two floats: the order of two Gaussians must not hang on a rounding.
LANE_INLINE void exact_depths(const float* means, const Camera& camera, Lanes& depths, Lanes& rests) {
    const float *forward = camera.rotation + 6, *position = camera.position;
    alignas(64) float near[GROUP], rest[GROUP];
    for (int lane = 0; lane < GROUP; ++lane) {
        const double depth = double(forward[0]) * (double(means[lane]) - double(position[0])) +
                             double(forward[1]) * (double(means[GROUP + lane]) - double(position[1])) +
                             double(forward[2]) * (double(means[2 * GROUP + lane]) - double(position[2]));
        near[lane] = float(depth);
        rest[lane] = float(depth - double(near[lane]));
    }
    depths = load(near), rests = load(rest);
}

// The patches of sixteen splats that show on the pixels of these columns and rows.
LANE_INLINE void patches_of(const Tile& tile, const Lanes& left, const Lanes& right, const Lanes& top,
                            const Lanes& bottom, IntLanes& low, IntLanes& high) {
    const IntLanes first_column = to_ints((left - float(tile.left)) * (1.0f / BLOCK));
    const IntLanes first_row = to_ints((top - float(tile.top)) * (1.0f / BLOCK));
    const IntLanes last_column = to_ints((right - float(tile.left)) * (1.0f / BLOCK));
    const IntLanes last_row = to_ints((bottom - float(tile.top)) * (1.0f / BLOCK));
    alignas(64) static constexpr uint32_t TURNS[GROUP] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    const IntLanes turns = load_ints(TURNS);  // lists of the waste take turns: none waits for the splat before it
    FOR_PARTS {
        const IntPart first = first_row.part[p] * ACROSS + first_column.part[p], waste = turns.part[p] + WASTE;
        const IntPart right_by = last_column.part[p] - first_column.part[p], down_by = last_row.part[p] - first_row.part[p];
        const IntPart second = right_by == 0 ? waste : first + 1, third = down_by == 0 ? waste + GROUP : first + ACROSS;
        const IntPart fourth = (right_by == 0) | (down_by == 0) ? waste + 2 * GROUP : first + (ACROSS + 1);
        const IntPart large = (right_by | down_by) > 1;
        low.part[p] = large ? LARGE | first << 16 : first | second << 16;
        high.part[p] = large ? right_by | down_by << 16 : third | fourth << 16;
    }
}

template <bool ANTIALIASED>
LANE_INLINE uint32_t project_group(const SceneView& scene, const Camera& camera, const Tile& tile, uint32_t group,
                                   const Scratch& scratch, uint32_t count) {
    const float* geometry = scene.geometry + size_t(group) * GEOMETRY * GROUP;
    const Vector<Lanes> offset{load(geometry) - camera.position[0], load(geometry + GROUP) - camera.position[1],
                               load(geometry + 2 * GROUP) - camera.position[2]};
    Lanes axes[9];
    for (int i = 0; i < 9; ++i) axes[i] = load(geometry + (AXES + i) * GROUP);
    const Footprint<Lanes> print = project<ANTIALIASED>(camera, offset, axes, load(geometry + LOG2_OPACITY * GROUP));
    Lanes left, right, top, bottom;
    pixels_between(print.x, print.extent_x, tile.left, tile.right - 1, left, right);
    pixels_between(print.y, print.extent_y, tile.top, tile.bottom - 1, top, bottom);
    const uint32_t hidden =
        bits_above(lanes(NEAR_DEPTH), print.depth) | bits_above(left, right) | bits_above(top, bottom);
    const uint32_t visible = bits_above(print.log2_opacity, lanes(LOG2_INVISIBLE)) & ~hidden;
    if (visible == 0) return count;

    IntLanes rgb[3];
    shade(scene, group, offset, rgb);
    Lanes depths, rests;
    exact_depths(geometry, camera, depths, rests);
    Record record{{print.x, print.y, print.l11, print.l12, print.l22, print.log2_opacity,
                   from_bits(join_halves(rgb[0], rgb[1])), from_bits(rgb[2])},
                  {}, {}, depths, rests, load_ints(scene.original_index + group * GROUP)};
    patches_of(tile, left, right, top, bottom, record.patch_low, record.patch_high);
    return append(record, visible, scratch, count);
}

// The groups that may show on a tile, in the order of the scene.
LANE_INLINE uint32_t cull(const SceneView& scene, const Camera& camera, const Tile& tile, uint32_t* groups) {
    const Frustum frustum = frustum_of(camera, tile);
    uint32_t count = 0;
    for (uint32_t c = 0; c < scene.cluster_count; ++c) {
        const Cluster& cluster = scene.clusters[c];
        if (misses(frustum, camera, cluster.bounds)) continue;
        for (uint32_t left = groups_in_view(frustum, camera, cluster); left != 0; left &= left - 1)
            groups[count++] = cluster.first_group + uint32_t(__builtin_ctz(left));
    }
    for (uint32_t i = 0; i < SPARE; ++i) groups[count + i] = 0;
    return count;
}

LANE_INLINE void fetch_group(const SceneView& scene, uint32_t group) {
    const char* geometry = reinterpret_cast<const char*>(scene.geometry + size_t(group) * GEOMETRY * GROUP);
    for (int line = 0; line < GEOMETRY; ++line) __builtin_prefetch(geometry + 64 * line);
}

// Returns how many splats there are; `projected` takes how many Gaussians were projected.
template <bool ANTIALIASED>
static uint32_t project_scene(const SceneView& scene, const Camera& camera, const Tile& tile, const Scratch& scratch,
                              uint32_t& projected) {
    constexpr uint32_t AHEAD_GROUPS = 3;
    const uint32_t groups = cull(scene, camera, tile, scratch.groups);
    uint32_t count = 0;
    for (uint32_t i = 0; i < groups; ++i) {
        fetch_group(scene, scratch.groups[i + AHEAD_GROUPS]);
        count = project_group<ANTIALIASED>(scene, camera, tile, scratch.groups[i], scratch, count);
    }
    projected = groups * GROUP;
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
