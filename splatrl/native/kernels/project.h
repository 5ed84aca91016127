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

// The blocks whose pixel centres an interval of pixels touches; the interval touches the image.
LANE_INLINE void blocks_between(float low, float high, int size, uint16_t& first, uint16_t& last) {
    const float from = low - 0.5f > 0.0f ? low - 0.5f : 0.0f;
    const float to = high - 0.5f < float(size - 1) ? high - 0.5f : float(size - 1);
    const int column = int(from) + (float(int(from)) < from);
    first = uint16_t(column / BLOCK);
    last = uint16_t(int(to) / BLOCK);
}

// Depths in double precision: the order of two Gaussians must not hang on a rounding.
LANE_INLINE void exact_depths(const float* means, const Camera& camera, double* depths) {
    const float *forward = camera.rotation + 6, *position = camera.position;
    for (int lane = 0; lane < GROUP; ++lane)
        depths[lane] = double(forward[0]) * (double(means[lane]) - double(position[0])) +
                       double(forward[1]) * (double(means[GROUP + lane]) - double(position[1])) +
                       double(forward[2]) * (double(means[2 * GROUP + lane]) - double(position[2]));
}

template <bool ANTIALIASED>
LANE_INLINE uint32_t project_group(const SceneView& scene, const Camera& camera, uint32_t group, const Scratch& scratch,
                                   uint32_t count) {
    const float* geometry = scene.geometry + size_t(group) * GEOMETRY * GROUP;
    const Vector<Lanes> offset{load(geometry) - camera.position[0], load(geometry + GROUP) - camera.position[1],
                               load(geometry + 2 * GROUP) - camera.position[2]};
    Lanes axes[9];
    for (int i = 0; i < 9; ++i) axes[i] = load(geometry + (AXES + i) * GROUP);
    const Footprint<Lanes> print =
        project<ANTIALIASED>(camera, offset, axes, load(geometry + LOG2_OPACITY * GROUP));
    const Lanes first_center = lanes(0.5f);
    uint32_t visible = ~bits_above(lanes(NEAR_DEPTH), print.depth) & 0xffff;
    visible &= bits_above(print.log2_opacity, lanes(LOG2_INVISIBLE));
    visible &= ~bits_above(first_center, print.x + print.extent_x) & ~bits_above(first_center, print.y + print.extent_y);
    visible &= ~bits_above(print.x - print.extent_x, lanes(float(camera.width) - 0.5f));
    visible &= ~bits_above(print.y - print.extent_y, lanes(float(camera.height) - 0.5f));
    if (visible == 0) return count;

    Lanes rgb[3];
    shade(scene, group, offset, rgb);
    alignas(64) float table[12][GROUP];
    const Lanes columns[12] = {print.x,  print.y, print.l11, print.l12,   print.l22,      print.log2_opacity,
                               rgb[0], rgb[1],  rgb[2],    print.depth, print.extent_x, print.extent_y};
    for (int column = 0; column < 12; ++column) store(table[column], columns[column]);
    alignas(64) double depths[GROUP];
    exact_depths(geometry, camera, depths);
    for (; visible != 0; visible &= visible - 1) {
        const int lane = __builtin_ctz(visible);
        Splat& splat = scratch.splats[count];
        float* fields = &splat.x;
        for (int column = 0; column < 10; ++column) fields[column] = table[column][lane];
        blocks_between(splat.x - table[10][lane], splat.x + table[10][lane], camera.width, splat.left, splat.right);
        blocks_between(splat.y - table[11][lane], splat.y + table[11][lane], camera.height, splat.top, splat.bottom);
        if (splat.left > splat.right || splat.top > splat.bottom) continue;
        const float rounded = float(depths[lane]);
        uint32_t depth_bits;
        std::memcpy(&depth_bits, &rounded, sizeof(rounded));
        scratch.depths[count] = depths[lane];
        scratch.keys[count] = uint64_t(depth_bits) << 32 | count;
        scratch.identity[count] = scene.original_index[group * GROUP + lane];
        ++count;
    }
    return count;
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
