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
template <class F>
LANE_INLINE void pixels_between(const F& middle, const F& extent, int low, int high, F& first, F& last) {
    first = ceil(min(max(middle - extent - 0.5f, float(low)), float(high + 1)));
    last = floor(max(min(middle + extent - 0.5f, float(high)) + 1.0f, 0.0f)) - 1.0f;
}

// Depths in double precision, split into two floats, as the order of two Gaussians must not depend on rounding. What
// single precision drops is given as bits in the order of the numbers.
LANE_INLINE void exact_depths(const float* means, const Camera& camera, Lanes& depths, IntLanes& rests) {
    const float *forward = camera.rotation + 6, *position = camera.position;
    alignas(64) float near[GROUP], rest[GROUP];
    for (int lane = 0; lane < GROUP; ++lane) {
        const double depth = double(forward[0]) * (double(means[lane]) - double(position[0])) +
                             double(forward[1]) * (double(means[GROUP + lane]) - double(position[1])) +
                             double(forward[2]) * (double(means[2 * GROUP + lane]) - double(position[2]));
        near[lane] = float(depth);
        rest[lane] = float(depth - double(near[lane]));
    }
    depths = load(near), rests = bits_of(load(rest));
    FOR_PARTS rests.part[p] ^= (rests.part[p] >> 31) | INT32_MIN;
}

// The patches of sixteen splats that show on the pixels of these columns and rows.
LANE_INLINE IntLanes patches_of(const Tile& tile, const Lanes& left, const Lanes& right, const Lanes& top,
                                const Lanes& bottom) {
    const IntLanes first_column = to_ints((left - float(tile.left)) * (1.0f / BLOCK));
    const IntLanes first_row = to_ints((top - float(tile.top)) * (1.0f / BLOCK));
    const IntLanes last_column = to_ints((right - float(tile.left)) * (1.0f / BLOCK));
    const IntLanes last_row = to_ints((bottom - float(tile.top)) * (1.0f / BLOCK));
    IntLanes out;
    FOR_PARTS {
        const IntPart first = first_row.part[p] * ACROSS + first_column.part[p];
        const IntPart right_by = last_column.part[p] - first_column.part[p];
        const IntPart down_by = last_row.part[p] - first_row.part[p];
        out.part[p] = first | right_by << RIGHT | down_by << DOWN;
    }
    return out;
}

template <bool RANKED>
LANE_INLINE void fetch_group(const SceneView& scene, uint32_t group) {
    const char* geometry = reinterpret_cast<const char*>(scene.geometry + size_t(group) * GEOMETRY * GROUP);
    for (int line = 0; line < GEOMETRY; ++line) __builtin_prefetch(geometry + 64 * line);
    const size_t bytes = size_t(3 * (scene.degree + 1) * (scene.degree + 1)) * GROUP * sizeof(uint16_t);
    const char* colors = reinterpret_cast<const char*>(scene.colors) + group * bytes;
    for (size_t line = 0; line < bytes; line += 64) __builtin_prefetch(colors + line, 0, 1);
    if (RANKED) __builtin_prefetch(scene.original_index + size_t(group) * GROUP);
    if (group < scene.first_merged) return;
    const float* merging = scene.merging + size_t(group - scene.first_merged) * MERGING * GROUP;
    for (int line = 0; line < MERGING; ++line) __builtin_prefetch(merging + GROUP * line);
}

// Groups whose footprints are computed at once: each alone would wait for its own results, if there are the registers.
constexpr uint32_t AT_ONCE = SPLATRL_REGISTER == LANES ? 4 : 1;
constexpr uint32_t GROUPS_AHEAD = 4;  // some kilobytes, as memory may be far away
static_assert(GROUPS_AHEAD + AT_ONCE <= SPARE, "the array has room to read ahead");

// Append what a tile shows of some groups, at most AT_ONCE, after the first `count` splats. Returns the new number of
// splats. However many there are, the same code computes them, so that they are rounded alike.
template <bool ANTIALIASED, bool MERGED, bool RANKED>
static uint32_t project_some(const Part& part, const Tile& tile, float log2_invisible,
                             const uint32_t* groups, uint32_t some, const Scratch& scratch, uint32_t count,
                             bool& peaked) {
    using Wide = FloatLanes<AT_ONCE * PARTS>;
    const SceneView& scene = *part.scene;
    const Camera& camera = part.camera;
    const float* geometry[AT_ONCE];
    Vector<Lanes> offsets[AT_ONCE];
    Flat<Lanes> flat[AT_ONCE];
    Lanes log2_opacity[AT_ONCE];
    Merging<Lanes> merging[AT_ONCE];
#pragma GCC unroll 1
    for (uint32_t i = 0; i < AT_ONCE; ++i) {
        fetch_group<RANKED>(scene, groups[GROUPS_AHEAD + i]);
        const uint32_t group = groups[i < some ? i : 0];
        geometry[i] = scene.geometry + size_t(group) * GEOMETRY * GROUP;
        offsets[i] = {load(geometry[i]) - camera.position[0], load(geometry[i] + GROUP) - camera.position[1],
                      load(geometry[i] + 2 * GROUP) - camera.position[2]};
        Lanes factor[6];
        for (int k = 0; k < 6; ++k) factor[k] = load(geometry[i] + (FACTOR + k) * GROUP);
        flat[i] = flatten(camera, offsets[i], factor);
        log2_opacity[i] = load(geometry[i] + LOG2_OPACITY * GROUP);
        merging[i] = {lanes(1.0f), lanes(0.0f)};
        if (MERGED) {
            const float* merged = scene.merging + size_t(group - scene.first_merged) * MERGING * GROUP;
            merging[i] = {load(merged + MEMBERS * GROUP), load(merged + SUM * GROUP)};
        }
    }
    using From = Flat<Lanes>;
    const Flat<Wide> wide{joined(flat, &From::x),  joined(flat, &From::y),  joined(flat, &From::depth),
                          joined(flat, &From::xx), joined(flat, &From::yy), joined(flat, &From::xy),
                          joined(flat, &From::determinant)};
    const Merging<Wide> merged{joined(merging, &Merging<Lanes>::members), joined(merging, &Merging<Lanes>::sum)};
    const Footprint<Wide> prints = dilate<ANTIALIASED, MERGED>(wide, joined(log2_opacity), merged, log2_invisible);
    Wide lefts, rights, tops, bottoms;
    pixels_between(prints.x, prints.extent_x, tile.left, tile.right - 1, lefts, rights);
    pixels_between(prints.y, prints.extent_y, tile.top, tile.bottom - 1, tops, bottoms);
    for (uint32_t i = 0; i < some; ++i) {
        const Lanes left = lanes_of(lefts, i), right = lanes_of(rights, i), top = lanes_of(tops, i);
        const Lanes bottom = lanes_of(bottoms, i), opacity = lanes_of(prints.log2_opacity, i);
        const uint32_t close = bits_above(lanes(NEAR_DEPTH), lanes_of(prints.depth, i));
        const uint32_t hidden = close | bits_above(left, right) | bits_above(top, bottom);
        const uint32_t visible = bits_above(opacity, lanes(log2_invisible)) & ~hidden;
        if (visible == 0) continue;
        peaked |= MERGED || (bits_above(opacity, lanes(LOG2_BELOW_PEAK)) & visible) != 0;
        IntLanes rgb[3], rests{}, indices{};
        shade(scene, groups[i], offsets[i], rgb);
        Lanes depths = lanes_of(prints.depth, i);
        if (RANKED) {
            exact_depths(geometry[i], camera, depths, rests);
            indices = plus(load_ints(scene.original_index + groups[i] * GROUP), part.first_index);
        }
        const IntLanes patches = patches_of(tile, left, right, top, bottom);
        const Lanes l11 = lanes_of(prints.l11, i), l12 = lanes_of(prints.l12, i), l22 = lanes_of(prints.l22, i);
        const Lanes x = lanes_of(prints.x, i), y = lanes_of(prints.y, i);
        const Record record{{-(l11 * x + l12 * y), -(l22 * y), l11, l12, l22, opacity,
                             from_bits(join_halves(rgb[0], rgb[1])), from_bits(join_halves(rgb[2], patches))},
                            depths, rests, indices, lanes_of(prints.peak, i), scene.tolerance > 0.0f, RANKED};
        count = append(record, visible, scratch, count);
    }
    return count;
}

// Project the groups of a part that scratch names, after the first `count` splats. Returns the new number of splats;
// `peaked` becomes true where one of them could exceed its peak.
template <bool ANTIALIASED, bool RANKED>
static uint32_t project_groups(const Part& part, const Tile& tile, float log2_invisible, uint32_t groups,
                               const Scratch& scratch, uint32_t count, bool& peaked) {
    const SceneView& scene = *part.scene;
    for (uint32_t i = 0; i < groups;) {
        const uint32_t* group = scratch.groups + i;
        const bool merged = group[0] >= scene.first_merged;
        uint32_t some = 1;
        while (some < AT_ONCE && i + some < groups && (group[some] >= scene.first_merged) == merged) ++some;
        const auto project = merged ? project_some<ANTIALIASED, true, RANKED> : project_some<ANTIALIASED, false, RANKED>;
        count = project(part, tile, log2_invisible, group, some, scratch, count, peaked);
        i += some;
    }
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
