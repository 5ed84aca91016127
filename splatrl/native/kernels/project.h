// Projects groups of Gaussians to the splats of a tile, and evaluates their colours.
#pragma once

#include "kernel.h"
#include "lanes.h"
#include "pack.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Evaluate the colours of a group, relative to the background, as half floats.
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

// Find the first and the last pixel in [low, high] whose centre lies in [middle - extent, middle + extent]. If there is
// none, the last comes before the first.
template <class F>
LANE_INLINE void pixels_between(const F& middle, const F& extent, int low, int high, F& first, F& last) {
    first = ceil(min(max(middle - extent - 0.5f, float(low)), float(high + 1)));
    last = floor(max(min(middle + extent - 0.5f, float(high)) + 1.0f, 0.0f)) - 1.0f;
}

// The geometry of the sixteen Gaussians of a group.
struct Group {
    Vector<Lanes> offset;  // means relative to the camera, world axes
    Lanes factor[6], log2_opacity;
    Merging<Lanes> merging;
};

LANE_INLINE void read_own(const float* from, const float* position, Group& out) {
    out.offset = {load(from) - position[0], load(from + GROUP) - position[1], load(from + 2 * GROUP) - position[2]};
    for (int i = 0; i < 6; ++i) out.factor[i] = load(from + (FACTOR + i) * GROUP);
    out.log2_opacity = load(from + LOG2_OPACITY * GROUP);
    out.merging = {lanes(1.0f), lanes(0.0f)};
}

LANE_INLINE void read_merged(const MergedGroup& from, const float* position, Group& out) {
    out.offset = {load_halves(from.means[0]) * from.scale + (from.center[0] - position[0]),
                  load_halves(from.means[1]) * from.scale + (from.center[1] - position[1]),
                  load_halves(from.means[2]) * from.scale + (from.center[2] - position[2])};
    for (int i = 0; i < 6; ++i) out.factor[i] = load_halves(from.factor[i]) * from.scale;
    out.log2_opacity = load_halves(from.log2_opacity);
    out.merging = {load_halves(from.members), load_halves(from.sums)};
}

// Compute depths in double precision, split into two floats, because the order of two Gaussians must not depend on
// rounding. `rests`, the remainder that single precision drops, is given as bits that sort like the numbers. The means
// [3][GROUP] are relative to `origin`.
LANE_INLINE void exact_depths(const float* means, const float* origin, const Camera& camera, Lanes& depths,
                              IntLanes& rests) {
    const float* forward = camera.rotation + 6;
    alignas(64) float near[GROUP], rest[GROUP];
    double from[3];
    for (int i = 0; i < 3; ++i) from[i] = double(camera.position[i]) - double(origin[i]);
    for (int lane = 0; lane < GROUP; ++lane) {
        const double depth = double(forward[0]) * (double(means[lane]) - from[0]) +
                             double(forward[1]) * (double(means[GROUP + lane]) - from[1]) +
                             double(forward[2]) * (double(means[2 * GROUP + lane]) - from[2]);
        near[lane] = float(depth);
        rest[lane] = float(depth - double(near[lane]));
    }
    depths = load(near), rests = bits_of(load(rest));
    FOR_PARTS rests.part[p] ^= (rests.part[p] >> 31) | INT32_MIN;
}

template <bool MERGED>
LANE_INLINE void exact_depths_of(const SceneView& scene, uint32_t group, const Camera& camera, Lanes& depths,
                                 IntLanes& rests) {
    if (!MERGED) {
        constexpr float ORIGIN[3] = {};
        exact_depths(scene.geometry + size_t(group) * GEOMETRY * GROUP, ORIGIN, camera, depths, rests);
        return;
    }
    const MergedGroup& merged = scene.merged[group - scene.first_merged];
    alignas(64) float means[3][GROUP];
    for (int i = 0; i < 3; ++i) store(means[i], load_halves(merged.means[i]) * merged.scale);
    exact_depths(means[0], merged.center, camera, depths, rests);
}

// Patches (see kernel.h) of sixteen splats that are visible on the pixels of these columns and rows.
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

template <size_t BYTES>
LANE_INLINE void fetch(const void* from) {
    for (size_t line = 0; line < BYTES; line += 64) __builtin_prefetch(static_cast<const char*>(from) + line);
}

template <bool RANKED>
LANE_INLINE void fetch_group(const Row& row, const Shown& shown) {
    const SceneView& scene = *row.parts[shown.part].scene;
    const uint32_t group = shown.group;
    if (group < scene.first_merged)
        fetch<GEOMETRY * GROUP * sizeof(float)>(scene.geometry + size_t(group) * GEOMETRY * GROUP);
    else
        fetch<offsetof(MergedGroup, sums)>(scene.merged + (group - scene.first_merged));
    const size_t bytes = size_t(3 * (scene.degree + 1) * (scene.degree + 1)) * GROUP * sizeof(uint16_t);
    const char* colors = reinterpret_cast<const char*>(scene.colors) + group * bytes;
    for (size_t line = 0; line < bytes; line += 64) __builtin_prefetch(colors + line, 0, 1);
    if (RANKED) __builtin_prefetch(scene.original_index + size_t(group) * GROUP);
}

// Groups whose footprints are computed together, if there are enough registers: alone, each would stall on its own
// intermediate results.
constexpr uint32_t AT_ONCE = SPLATRL_REGISTER == LANES ? 4 : 1;
constexpr uint32_t GROUPS_AHEAD = 4;  // prefetch distance: some kilobytes, because memory latency may be high
static_assert(GROUPS_AHEAD + AT_ONCE <= SPARE, "prefetches must stay within the spare items of the array");

// Append the splats of at most AT_ONCE groups that are visible on a tile after the first `count` splats. Returns the
// new number of splats. The same code runs for any number of groups, so that all are rounded alike.
template <bool ANTIALIASED, bool MERGED, bool RANKED>
static uint32_t project_some(const Row& row, const Tile& tile, const Shown* groups, uint32_t some,
                             const Scratch& scratch, uint32_t count, bool& peaked) {
    using Wide = FloatLanes<AT_ONCE * PARTS>;
    Vector<Lanes> offsets[AT_ONCE];
    Flat<Lanes> flat[AT_ONCE];
    Lanes log2_opacity[AT_ONCE];
    Merging<Lanes> merging[AT_ONCE];
#pragma GCC unroll 1
    for (uint32_t i = 0; i < AT_ONCE; ++i) {
        fetch_group<RANKED>(row, groups[GROUPS_AHEAD + i]);
        const Shown& shown = groups[i < some ? i : 0];
        const Camera& camera = row.parts[shown.part].camera;
        const SceneView& scene = *row.parts[shown.part].scene;
        Group group;
        if (MERGED)
            read_merged(scene.merged[shown.group - scene.first_merged], camera.position, group);
        else
            read_own(scene.geometry + size_t(shown.group) * GEOMETRY * GROUP, camera.position, group);
        offsets[i] = group.offset;
        flat[i] = flatten(camera, group.offset, group.factor);
        log2_opacity[i] = group.log2_opacity;
        merging[i] = group.merging;
    }
    using From = Flat<Lanes>;
    const Flat<Wide> wide{joined(flat, &From::x),  joined(flat, &From::y),  joined(flat, &From::depth),
                          joined(flat, &From::xx), joined(flat, &From::yy), joined(flat, &From::xy),
                          joined(flat, &From::determinant)};
    const Merging<Wide> merged{joined(merging, &Merging<Lanes>::members), joined(merging, &Merging<Lanes>::sum)};
    const Footprint<Wide> prints = dilate<ANTIALIASED, MERGED>(wide, joined(log2_opacity), merged, row.log2_invisible);
    Wide lefts, rights, tops, bottoms;
    pixels_between(prints.x, prints.extent_x, tile.left, tile.right - 1, lefts, rights);
    pixels_between(prints.y, prints.extent_y, tile.top, tile.bottom - 1, tops, bottoms);
    for (uint32_t i = 0; i < some; ++i) {
        const Lanes left = lanes_of(lefts, i), right = lanes_of(rights, i), top = lanes_of(tops, i);
        const Lanes bottom = lanes_of(bottoms, i), opacity = lanes_of(prints.log2_opacity, i);
        const uint32_t close = bits_above(lanes(NEAR_DEPTH), lanes_of(prints.depth, i));
        const uint32_t hidden = close | bits_above(left, right) | bits_above(top, bottom);
        const uint32_t visible = bits_above(opacity, lanes(row.log2_invisible)) & ~hidden;
        if (visible == 0) continue;
        peaked |= MERGED || (bits_above(opacity, lanes(LOG2_BELOW_PEAK)) & visible) != 0;
        const Part& part = row.parts[groups[i].part];
        const SceneView& scene = *part.scene;
        IntLanes rgb[3], rests{}, indices{};
        shade(scene, groups[i].group, offsets[i], rgb);
        Lanes depths = lanes_of(prints.depth, i);
        if (RANKED) {
            exact_depths_of<MERGED>(scene, groups[i].group, part.camera, depths, rests);
            indices = plus(load_ints(scene.original_index + groups[i].group * GROUP), part.first_index);
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

// Project the groups in `scratch.groups`, and append their splats after the first `count`. Returns the new number of
// splats; sets `peaked` where the alpha of one of them could exceed its peak.
template <bool ANTIALIASED, bool RANKED>
static uint32_t project_groups(const Row& row, const Tile& tile, uint32_t groups, const Scratch& scratch,
                               uint32_t count, bool& peaked) {
    const auto merged = [&row](const Shown& shown) { return shown.group >= row.parts[shown.part].scene->first_merged; };
    for (uint32_t i = 0; i < groups;) {
        const Shown* shown = scratch.groups + i;
        const bool these = merged(shown[0]);
        uint32_t some = 1;
        while (some < AT_ONCE && i + some < groups && merged(shown[some]) == these) ++some;
        const auto project = these ? project_some<ANTIALIASED, true, RANKED> : project_some<ANTIALIASED, false, RANKED>;
        count = project(row, tile, shown, some, scratch, count, peaked);
        i += some;
    }
    return count;
}

}  // namespace SPLATRL_ISA
}  // namespace splatrl
