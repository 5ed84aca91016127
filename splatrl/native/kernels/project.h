// From the scene to the splats of one camera: cull, project, colour.
#pragma once

#include "kernel.h"
#include "lanes.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Whether nothing of a cluster can show on the image: everything in it is behind the near plane, or further beside an
// edge than it reaches. An edge is a plane through the camera; the reach follows the projected covariance with its
// bounded Jacobian and its dilation, so the test never drops what the projection would show.
struct Frustum {
    float normals[4][3];  // world axes, pixels; positive is outside
    float lengths[4];
    float slants[4];      // pixels that a standard deviation of one metre at one metre reaches at most
    float forward[3];
};

LANE_INLINE Frustum frustum_of(const Camera& camera) {
    const float far_x = camera.slope_right > -camera.slope_left ? camera.slope_right : -camera.slope_left;
    const float far_y = camera.slope_bottom > -camera.slope_top ? camera.slope_bottom : -camera.slope_top;
    const float slant_x = camera.fx * __builtin_sqrtf(1.0f + far_x * far_x);
    const float slant_y = camera.fy * __builtin_sqrtf(1.0f + far_y * far_y);
    const float edges[4][3] = {{camera.fx, 0.0f, camera.cx - float(camera.width)},
                               {-camera.fx, 0.0f, -camera.cx},
                               {0.0f, camera.fy, camera.cy - float(camera.height)},
                               {0.0f, -camera.fy, -camera.cy}};
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

LANE_INLINE bool misses(const Frustum& frustum, const Camera& camera, const Cluster& cluster) {
    float offset[3], depth = 0.0f;
    for (int axis = 0; axis < 3; ++axis) {
        offset[axis] = cluster.center[axis] - camera.position[axis];
        depth += offset[axis] * frustum.forward[axis];
    }
    if (depth + cluster.radius < NEAR_DEPTH) return true;
    const float deepest = depth + cluster.radius;
    for (int edge = 0; edge < 4; ++edge) {
        float outside = -frustum.lengths[edge] * cluster.radius;
        for (int axis = 0; axis < 3; ++axis) outside += offset[axis] * frustum.normals[edge][axis];
        // sqrt(σ² + dilation) <= σ + sqrt(dilation)
        const float reached = cluster.reach_scale * frustum.slants[edge] + cluster.reach * 0.5478f * deepest;
        if (outside > reached * 1.001f) return true;
    }
    return false;
}

LANE_INLINE void shade(const SceneView& scene, uint32_t group, const Vector<Lanes>& offset, Lanes* rgb) {
    const int harmonics = (scene.degree + 1) * (scene.degree + 1);
    const float* colors = scene.colors + size_t(group) * 3 * harmonics * GROUP;
    if (scene.degree == 0) {
        for (int channel = 0; channel < 3; ++channel) rgb[channel] = load(colors + channel * GROUP);
        return;
    }
    const Lanes squared = offset.x * offset.x + offset.y * offset.y + offset.z * offset.z;
    const Lanes inverse = 1.0f / sqrt(max(squared, 1e-30f));
    Lanes basis[16];
    sh_basis(scene.degree, offset.x * inverse, offset.y * inverse, offset.z * inverse, basis);
    for (int channel = 0; channel < 3; ++channel) rgb[channel] = lanes(0.5f);
    for (int i = 0; i < harmonics; ++i)
        for (int channel = 0; channel < 3; ++channel)
            rgb[channel] = rgb[channel] + basis[i] * load(colors + (3 * i + channel) * GROUP);
    for (int channel = 0; channel < 3; ++channel) rgb[channel] = max(rgb[channel], 0.0f);
}

// The first and last block whose pixel centres the interval middle ± extent touches, where it touches the image.
// The first is rounded down from just below the first centre: a block too many costs time, never a pixel.
LANE_INLINE void blocks_between(const Lanes& middle, const Lanes& extent, int size, Lanes& first, Lanes& last) {
    first = floor((max(middle - extent - 0.5f, 0.0f) + 0.999f) * (1.0f / BLOCK));
    last = floor(min(middle + extent - 0.5f, float(size - 1)) * (1.0f / BLOCK));
}

// Depths in double precision, split into two floats: the order of two Gaussians must not hang on a rounding.
LANE_INLINE void exact_depths(const float* means, const Camera& camera, float* depths, float* rests) {
    const float *forward = camera.rotation + 6, *position = camera.position;
    for (int lane = 0; lane < GROUP; ++lane) {
        const double depth = double(forward[0]) * (double(means[lane]) - double(position[0])) +
                             double(forward[1]) * (double(means[GROUP + lane]) - double(position[1])) +
                             double(forward[2]) * (double(means[2 * GROUP + lane]) - double(position[2]));
        depths[lane] = float(depth);
        rests[lane] = float(depth - double(depths[lane]));
    }
}

LANE_INLINE uint32_t visible_lanes(const Footprint<Lanes>& print, const Camera& camera) {
    const Lanes first_center = lanes(0.5f);
    const Lanes last_column = lanes(float(camera.width) - 0.5f), last_row = lanes(float(camera.height) - 0.5f);
    const uint32_t hidden = bits_above(lanes(NEAR_DEPTH), print.depth) |
                            bits_above(first_center, print.x + print.extent_x) |
                            bits_above(first_center, print.y + print.extent_y) |
                            bits_above(print.x - print.extent_x, last_column) |
                            bits_above(print.y - print.extent_y, last_row);
    return bits_above(print.log2_opacity, lanes(LOG2_INVISIBLE)) & ~hidden;
}

// Append the visible lanes to the splats. Each lane is written, and the next one writes over it unless it is visible.
LANE_INLINE uint32_t append(const Lanes (&fields)[12], const float* first, const float* across, const float* down,
                            uint32_t visible, const Scratch& scratch, uint32_t count) {
    alignas(64) float rows[GROUP][12];
    transpose(fields, rows);
    for (int lane = 0; lane < GROUP; ++lane) {
        std::memcpy(&scratch.splats[count], rows[lane], sizeof(Splat));
        scratch.patches[count] = {uint32_t(first[lane]), uint16_t(across[lane]), uint16_t(down[lane])};
        uint32_t depth_bits;
        std::memcpy(&depth_bits, &rows[lane][9], sizeof(depth_bits));
        scratch.keys[count] = uint64_t(depth_bits) << 32 | count;
        count += visible >> lane & 1;
    }
    return count;
}

template <bool ANTIALIASED>
LANE_INLINE uint32_t project_group(const SceneView& scene, const Camera& camera, uint32_t group, const Scratch& scratch,
                                   uint32_t count) {
    const float* geometry = scene.geometry + size_t(group) * GEOMETRY * GROUP;
    const Vector<Lanes> offset{load(geometry) - camera.position[0], load(geometry + GROUP) - camera.position[1],
                               load(geometry + 2 * GROUP) - camera.position[2]};
    Lanes axes[9];
    for (int i = 0; i < 9; ++i) axes[i] = load(geometry + (AXES + i) * GROUP);
    const Footprint<Lanes> print = project<ANTIALIASED>(camera, offset, axes, load(geometry + LOG2_OPACITY * GROUP));
    const uint32_t visible = visible_lanes(print, camera);
    if (visible == 0) return count;

    Lanes rgb[3];
    shade(scene, group, offset, rgb);
    alignas(64) float depths[GROUP], rests[GROUP];
    exact_depths(geometry, camera, depths, rests);
    Lanes left, right, top, bottom;
    blocks_between(print.x, print.extent_x, camera.width, left, right);
    blocks_between(print.y, print.extent_y, camera.height, top, bottom);
    alignas(64) float first[GROUP], across[GROUP], down[GROUP];
    const int row = (camera.width + BLOCK - 1) / BLOCK;
    store(first, top * float(row) + left);
    store(across, max(right - left + 1.0f, 1.0f));
    store(down, max(bottom - top + 1.0f, 1.0f));
    const Lanes fields[12] = {print.x, print.y, print.l11, print.l12,    print.l22,   print.log2_opacity,
                              rgb[0],  rgb[1],  rgb[2],    load(depths), load(rests),
                              load(reinterpret_cast<const float*>(scene.original_index + group * GROUP))};
    return append(fields, first, across, down, visible, scratch, count);
}

template <bool ANTIALIASED>
static uint32_t project_scene(const SceneView& scene, const Camera& camera, const Scratch& scratch) {
    const Frustum frustum = frustum_of(camera);
    uint32_t count = 0;
    for (uint32_t c = 0; c < scene.cluster_count; ++c) {
        const Cluster& cluster = scene.clusters[c];
        if (misses(frustum, camera, cluster)) continue;
        for (uint32_t group = cluster.first_group; group < cluster.first_group + cluster.groups; ++group)
            count = project_group<ANTIALIASED>(scene, camera, group, scratch, count);
    }
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
