// One frame, start to end, for one instruction set.
#include "kernels/blend.h"
#include "kernels/project.h"
#include "kernels/sort.h"

namespace splatrl {
namespace SPLATRL_ISA {

static uint32_t frame(const SceneView& scene, const Camera& camera, bool antialiased, bool with_depth,
                      const Scratch& scratch) {
    const uint32_t count =
        antialiased ? project_scene<true>(scene, camera, scratch) : project_scene<false>(scene, camera, scratch);
    const uint64_t* keys = sort_by_depth(scratch, count);
    if (with_depth)
        blend_frame<true>(camera, keys, count, scratch);
    else
        blend_frame<false>(camera, keys, count, scratch);
    return count;
}

extern const RenderFrame render_frame = frame;

}  // namespace SPLATRL_ISA
}  // namespace splatrl
