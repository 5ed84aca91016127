// One tile, start to end, for one instruction set.
#include <chrono>
#include <utility>

#include "kernels/blend.h"
#include "kernels/cull.h"
#include "kernels/project.h"
#include "kernels/sort.h"

namespace splatrl {
namespace SPLATRL_ISA {

// Draws from near to far, in steps: what is in front veils what is behind, which then needs fewer Gaussians.
template <bool ANTIALIASED, bool WITH_DEPTH>
static Effort render(const Row& row, const Tile& whole, Tile& tile, const Scratch& scratch) {
    using Clock = std::chrono::steady_clock;
    using Milliseconds = std::chrono::duration<float, std::milli>;
    Effort effort{};
    auto last = Clock::now();
    const auto take_time = [&last](float& ms) {
        const auto now = Clock::now();
        ms += Milliseconds(now - last).count();
        last = now;
    };
    const auto project = row.ranked ? project_groups<ANTIALIASED, true> : project_groups<ANTIALIASED, false>;
    const auto sort = row.ranked ? sort_by_depth<true> : sort_by_depth<false>;
    bool peaked = false;
    Branches branches{scratch.branches, 0}, later{scratch.later, 0};
    branch_out(row, whole, branches);
    const bool stepped = ANTIALIASED && !row.ranked && next_border(branches) < BEYOND;
    if (stepped) {
        if (tile.top > whole.top) {
            tile.bottom = tile.top;
            return effort;
        }
        tile = whole;
    } else if (tile.top > whole.top || tile.bottom < whole.bottom) {
        branch_out(row, tile, branches);
    }
    Blocks blocks;
    start_tile<WITH_DEPTH>(scratch, blocks, tile, row.background);
    Veil veil;
    uint32_t blended = 0;  // splats
    for (bool first = true, more = true; more; first = false) {
        const float border = stepped ? next_border(branches) : BEYOND;
        later.count = 0;
        for (uint32_t next = 0; next < branches.count;) {
            const Part& part = row.parts[branches.items[next].part];
            const uint32_t groups =
                cull(part, tile, border, first ? nullptr : &veil, branches, next, later, scratch.groups);
            effort.projected += groups * GROUP;
            effort.visible = project(part, tile, row.log2_invisible, groups, scratch, effort.visible, peaked);
        }
        take_time(effort.project_ms);
        more = border < BEYOND;
        uint64_t* keys = scratch.keys + blended;
        const uint32_t open = effort.visible - blended;
        const uint32_t near = more ? bring_near(scratch, keys, open, border) : open;
        sort(scratch, keys, near);
        take_time(effort.sort_ms);
        const bool firm = row.finished <= MIN_TRANSMITTANCE;
        const auto blend = firm ? (peaked ? blend_splats<WITH_DEPTH, true, true> : blend_splats<WITH_DEPTH, true, false>)
                                : (peaked ? blend_splats<WITH_DEPTH, false, true> : blend_splats<WITH_DEPTH, false, false>);
        effort.blended += blend(tile, row, keys, near, scratch, blocks);
        blended += near;
        if (more) draw_veil(scratch.pixels, blocks.finished, veil);
        take_time(effort.blend_ms);
        std::swap(branches, later);
    }
    return effort;
}

static Effort render_any(const Row& row, const Tile& whole, Tile& piece, bool antialiased, bool with_depth,
                         const Scratch& scratch) {
    if (antialiased)
        return with_depth ? render<true, true>(row, whole, piece, scratch) : render<true, false>(row, whole, piece, scratch);
    return with_depth ? render<false, true>(row, whole, piece, scratch) : render<false, false>(row, whole, piece, scratch);
}

extern const RenderTile render_tile = render_any;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
