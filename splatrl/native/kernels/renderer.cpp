// One tile, start to end, for one instruction set.
#include <chrono>

#include "kernels/blend.h"
#include "kernels/cull.h"
#include "kernels/project.h"
#include "kernels/sort.h"

namespace splatrl {
namespace SPLATRL_ISA {

template <bool ANTIALIASED, bool WITH_DEPTH>
static Effort render(const Row& row, const Tile& tile, const Scratch& scratch) {
    using Clock = std::chrono::steady_clock;
    using Milliseconds = std::chrono::duration<float, std::milli>;
    Effort effort{};
    bool peaked = false;
    const auto start = Clock::now();
    for (const Part* part = row.parts; part != row.parts + row.count; ++part) {
        const uint32_t groups = cull(*part->scene, part->camera, tile, scratch.groups);
        effort.projected += groups * GROUP;
        effort.visible =
            project_groups<ANTIALIASED>(*part, tile, row.log2_invisible, groups, scratch, effort.visible, peaked);
    }
    const auto projected = Clock::now();
    const uint64_t* keys = sort_by_depth(scratch, effort.visible);
    const auto sorted = Clock::now();
    const bool firm = row.finished <= MIN_TRANSMITTANCE;
    const auto blend = firm ? (peaked ? blend_tile<WITH_DEPTH, true, true> : blend_tile<WITH_DEPTH, true, false>)
                            : (peaked ? blend_tile<WITH_DEPTH, false, true> : blend_tile<WITH_DEPTH, false, false>);
    effort.blended = blend(tile, row, keys, effort.visible, scratch);
    const auto blended = Clock::now();
    effort.project_ms = Milliseconds(projected - start).count();
    effort.sort_ms = Milliseconds(sorted - projected).count();
    effort.blend_ms = Milliseconds(blended - sorted).count();
    return effort;
}

static Effort render_any(const Row& row, const Tile& tile, bool antialiased, bool with_depth, const Scratch& scratch) {
    if (antialiased)
        return with_depth ? render<true, true>(row, tile, scratch) : render<true, false>(row, tile, scratch);
    return with_depth ? render<false, true>(row, tile, scratch) : render<false, false>(row, tile, scratch);
}

extern const RenderTile render_tile = render_any;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
