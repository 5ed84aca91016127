// Renders views of Gaussians that are being fitted, and back-propagates gradients to their parameters.
#pragma once

#include <memory>
#include <vector>

#include "fit_kernel.h"
#include "isa.h"

namespace splatrl {

// Views that are drawn together: all of one model and of one size.
struct FitBatch {
    FitModel model;
    const float* camera_to_world;  // [views, 4, 4]
    const float* K;                // [views, 3, 3]
    const float* const* known;     // [views] pointers to [height, width] inverse depths, 0 where unknown
    size_t views;
    int width, height;
};

// Draws views and back-propagates gradients through them. Its memory is reused from call to call. Each view is drawn by
// a single thread, so results do not depend on the number of threads. Not to be used by several threads at once.
class Fitter {
public:
    explicit Fitter(Isa isa);
    ~Fitter();
    Fitter(const Fitter&) = delete;
    Fitter& operator=(const Fitter&) = delete;

    // Draw into rgb [views, height, width, 3], not clamped, agreement and alpha [views, height, width].
    void render(const FitBatch& batch, size_t threads, float* rgb, float* agreement, float* alpha);

    // Compute the gradients of the parameters, [views, rows, stride], and of the poses, [views, 6], from those of the
    // images, [views, height, width, FIT_CHANNELS].
    void pull(const FitBatch& batch, size_t threads, const float* slopes, float* gradients, float* poses);

    // Compute the loss of each view and its gradient by the parameters.
    void compare(const FitBatch& batch, size_t threads, const FitTarget* targets, float* gradients, FitLoss* losses);

    void update(const FitUpdate& update, size_t threads) const;

private:
    struct Workspace;

    void make_room(const FitBatch& batch);
    uint32_t draw(const FitBatch& batch, size_t view, const Camera& camera);
    // Draw each view and back-propagate its image's gradient, which `slopes_of(view, workspace)` writes; it returns
    // where to write the gradient of the pose.
    template <class Slopes>
    void differentiate(const FitBatch& batch, size_t threads, float* gradients, Slopes&& slopes_of);

    const FitKernels& kernels_;
    std::vector<std::unique_ptr<Workspace>> workspaces_;  // one per view
};

}  // namespace splatrl
