// One tile, start to end, for one instruction set.
#include <chrono>

#include "kernels/blend.h"
#include "kernels/cull.h"
#include "kernels/project.h"
#include "kernels/sort.h"

namespace splatrl {
namespace SPLATRL_ISA {

template <bool ANTIALIASED, bool WITH_DEPTH>
static Effort render(const SceneView& scene, const Camera& camera, const Tile& tile, const Scratch& scratch) {
    using Clock = std::chrono::steady_clock;
    using Milliseconds = std::chrono::duration<float, std::milli>;
    Effort effort{};
    const auto start = Clock::now();
    const uint32_t groups = cull(scene, camera, tile, scratch.groups);
    effort.projected = groups * GROUP;
    effort.visible = project_groups<ANTIALIASED>(scene, camera, tile, groups, scratch);
    const auto projected = Clock::now();
    const uint64_t* keys = sort_by_depth(scratch, effort.visible);
    const auto sorted = Clock::now();
    effort.blended = blend_tile<ANTIALIASED, WITH_DEPTH>(tile, scene.background, keys, effort.visible, scratch);
    const auto blended = Clock::now();
    effort.project_ms = Milliseconds(projected - start).count();
    effort.sort_ms = Milliseconds(sorted - projected).count();
    effort.blend_ms = Milliseconds(blended - sorted).count();
    return effort;
}

static Effort render_any(const SceneView& scene, const Camera& camera, const Tile& tile, bool antialiased,
                         bool with_depth, const Scratch& scratch) {
    if (antialiased)
        return with_depth ? render<true, true>(scene, camera, tile, scratch)
                          : render<true, false>(scene, camera, tile, scratch);
    return with_depth ? render<false, true>(scene, camera, tile, scratch)
                      : render<false, false>(scene, camera, tile, scratch);
}

extern const RenderTile render_tile = render_any;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
