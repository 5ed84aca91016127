// Kernels that fit Gaussians to photos, compiled once for each instruction set.
#include "kernels/fit_bin.h"
#include "kernels/fit_blend.h"
#include "kernels/fit_loss.h"
#include "kernels/fit_pull.h"
#include "kernels/fit_update.h"
#include "kernels/fit_visible.h"

namespace splatrl {
namespace SPLATRL_ISA {

static uint32_t project_and_sort(const FitModel& model, const Camera& camera, const FitGrid& grid,
                                 const FitScratch& scratch, size_t* rows) {
    *rows = 0;
    const uint32_t visible = project_all(model, camera, grid, scratch, rows);
    sort_splats(scratch, visible);
    return visible;
}

static void backward(const FitModel& model, const Camera& camera, const FitGrid& grid, const FitScratch& scratch,
                     uint32_t visible, float* out, float* pose) {
    blend_back(grid, scratch, visible);
    unproject_all(model, camera, scratch, out, pose);
}

extern const FitKernels fit_kernels = {project_and_sort, count_all, fill_all, blend_all,
                                       loss_of,          backward,  update_all};

}  // namespace SPLATRL_ISA
}  // namespace splatrl
