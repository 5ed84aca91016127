// From groups of Gaussians to the splats of a tile: project, colour.
#pragma once

#include "kernel.h"
#include "lanes.h"
#include "pack.h"

namespace splatrl {
namespace SPLATRL_ISA {

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
    first = ceil(min(max(middle - extent - 0.5f, float(low)), float(high + 1)));
    last = floor(max(min(middle + extent - 0.5f, float(high)) + 1.0f, 0.0f)) - 1.0f;
}

// Depths in double precision, split into two floats: the order of two Gaussians must not depend on rounding.
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
    const IntLanes turns = load_ints(TURNS);  // waste lists take turns, so that no splat waits for the one before it
    FOR_PARTS {
        const IntPart first = first_row.part[p] * ACROSS + first_column.part[p], waste = turns.part[p] + WASTE;
        const IntPart right_by = last_column.part[p] - first_column.part[p], down_by = last_row.part[p] - first_row.part[p];
        const IntPart second = right_by == 0 ? waste : first + 1, third = down_by == 0 ? waste + GROUP : first + ACROSS;
        const IntPart fourth = ((right_by == 0) | (down_by == 0)) ? waste + 2 * GROUP : first + (ACROSS + 1);
        const IntPart large = (right_by | down_by) > 1;
        low.part[p] = large ? LARGE | first << 16 : first | second << 16;
        high.part[p] = large ? right_by | down_by << 16 : third | fourth << 16;
    }
}

template <bool ANTIALIASED, bool MERGED>
static uint32_t project_group(const SceneView& scene, const Camera& camera, uint32_t first_index, const Tile& tile,
                              float log2_invisible, uint32_t group, const Scratch& scratch, uint32_t count) {
    const float* geometry = scene.geometry + size_t(group) * GEOMETRY * GROUP;
    const Vector<Lanes> offset{load(geometry) - camera.position[0], load(geometry + GROUP) - camera.position[1],
                               load(geometry + 2 * GROUP) - camera.position[2]};
    Lanes axes[9];
    for (int i = 0; i < 9; ++i) axes[i] = load(geometry + (AXES + i) * GROUP);
    Merging<Lanes> merging{lanes(1.0f), lanes(0.0f)};
    if (MERGED) {
        const float* merged = scene.merging + size_t(group - scene.first_merged) * MERGING * GROUP;
        merging = {load(merged + MEMBERS * GROUP), load(merged + SUM * GROUP)};
    }
    const Footprint<Lanes> print =
        project<ANTIALIASED, MERGED>(camera, offset, axes, load(geometry + LOG2_OPACITY * GROUP), merging, log2_invisible);
    Lanes left, right, top, bottom;
    pixels_between(print.x, print.extent_x, tile.left, tile.right - 1, left, right);
    pixels_between(print.y, print.extent_y, tile.top, tile.bottom - 1, top, bottom);
    const uint32_t hidden =
        bits_above(lanes(NEAR_DEPTH), print.depth) | bits_above(left, right) | bits_above(top, bottom);
    const uint32_t visible = bits_above(print.log2_opacity, lanes(log2_invisible)) & ~hidden;
    if (visible == 0) return count;

    IntLanes rgb[3];
    shade(scene, group, offset, rgb);
    Lanes depths, rests;
    exact_depths(geometry, camera, depths, rests);
    Record record{{print.x, print.y, print.l11, print.l12, print.l22, print.log2_opacity,
                   from_bits(join_halves(rgb[0], rgb[1])), from_bits(join_halves(rgb[2], to_halves(print.peak)))},
                  {}, {}, depths, rests,
                  plus(load_ints(scene.original_index + group * GROUP), first_index)};
    patches_of(tile, left, right, top, bottom, record.patch_low, record.patch_high);
    return append(record, visible, scratch, count);
}

LANE_INLINE void fetch_group(const SceneView& scene, uint32_t group) {
    const char* geometry = reinterpret_cast<const char*>(scene.geometry + size_t(group) * GEOMETRY * GROUP);
    for (int line = 0; line < GEOMETRY; ++line) __builtin_prefetch(geometry + 64 * line);
    const size_t bytes = size_t(3 * (scene.degree + 1) * (scene.degree + 1)) * GROUP * sizeof(uint16_t);
    const char* colors = reinterpret_cast<const char*>(scene.colors) + group * bytes;
    for (size_t line = 0; line < bytes; line += 64) __builtin_prefetch(colors + line, 0, 1);
    __builtin_prefetch(scene.original_index + size_t(group) * GROUP);
    if (group < scene.first_merged) return;
    const float* merging = scene.merging + size_t(group - scene.first_merged) * MERGING * GROUP;
    for (int line = 0; line < MERGING; ++line) __builtin_prefetch(merging + GROUP * line);
}

// Project the groups of a part that scratch names, after the first `count` splats. Returns the new number of splats.
template <bool ANTIALIASED>
static uint32_t project_groups(const Part& part, const Tile& tile, float log2_invisible, uint32_t groups,
                               const Scratch& scratch, uint32_t count) {
    constexpr uint32_t GROUPS_AHEAD = 4;
    static_assert(GROUPS_AHEAD <= SPARE, "the array has room to read ahead");
    const SceneView& scene = *part.scene;
    const Camera& camera = part.camera;
    for (uint32_t i = 0; i < groups; ++i) {
        fetch_group(scene, scratch.groups[i + GROUPS_AHEAD]);
        const uint32_t group = scratch.groups[i], first = part.first_index;
        count = group < scene.first_merged
                    ? project_group<ANTIALIASED, false>(scene, camera, first, tile, log2_invisible, group, scratch, count)
                    : project_group<ANTIALIASED, true>(scene, camera, first, tile, log2_invisible, group, scratch, count);
    }
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
