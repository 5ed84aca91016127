// One tile, start to end, for one instruction set.
#include <chrono>

#include "kernels/blend.h"
#include "kernels/project.h"
#include "kernels/sort.h"

namespace splatrl {
namespace SPLATRL_ISA {

static Effort render_one(const SceneView& scene, const Camera& camera, const Tile& tile, bool antialiased, bool with_depth,
                    const Scratch& scratch) {
    using Clock = std::chrono::steady_clock;
    using Milliseconds = std::chrono::duration<float, std::milli>;
    Effort effort{};
    const auto start = Clock::now();
    const auto project = antialiased ? project_scene<true> : project_scene<false>;
    effort.visible = project(scene, camera, tile, scratch, effort.projected);
    const auto projected = Clock::now();
    const uint64_t* keys = sort_by_depth(scratch, effort.visible);
    const auto sorted = Clock::now();
    const auto blend = with_depth ? blend_tile<true> : blend_tile<false>;
    effort.blended = blend(tile, scene.background, keys, effort.visible, scratch);
    const auto blended = Clock::now();
    effort.project_ms = Milliseconds(projected - start).count();
    effort.sort_ms = Milliseconds(sorted - projected).count();
    effort.blend_ms = Milliseconds(blended - sorted).count();
    return effort;
}

extern const RenderTile render_tile = render_one;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
