// Views of Gaussians that are being fitted, and the slopes of what is asked of them.
#pragma once

#include <memory>
#include <vector>

#include "fit_kernel.h"
#include "isa.h"

namespace splatrl {

// Views that are drawn at once: of one model, of one size.
struct FitBatch {
    FitModel model;
    const float* camera_to_world;  // [views, 4, 4]
    const float* K;                // [views, 3, 3]
    const float* const* known;     // of each view, [height, width] inverse depths, 0 where unknown
    size_t views;
    int width, height;
};

// Draws views and pulls slopes back through them. Its memory is kept from call to call. A view is the work of one
// thread, so results do not depend on how many there are. Not for several threads at once.
class Fitter {
public:
    explicit Fitter(Isa isa);
    ~Fitter();
    Fitter(const Fitter&) = delete;
    Fitter& operator=(const Fitter&) = delete;

    // Draw into rgb [views, height, width, 3], not clamped, agreement and alpha [views, height, width].
    void render(const FitBatch& batch, size_t threads, float* rgb, float* agreement, float* alpha);

    // Slopes of the parameters, [views, rows, stride], and of the poses, [views, 6], from those of the images
    // [views, height, width, FIT_CHANNELS].
    void pull(const FitBatch& batch, size_t threads, const float* slopes, float* gradients, float* poses);

    // The loss of each view, and its slopes by the parameters.
    void compare(const FitBatch& batch, size_t threads, const FitTarget* targets, float* gradients, FitLoss* losses);

    void update(const FitUpdate& update, size_t threads) const;

private:
    struct Workspace;

    void make_room(const FitBatch& batch);
    uint32_t draw(const FitBatch& batch, size_t view, const Camera& camera);
    // Draw each view and pull back its slopes, which `slopes_of(view, workspace)` writes; it returns where those of the
    // pose go.
    template <class Slopes>
    void differentiate(const FitBatch& batch, size_t threads, float* gradients, Slopes&& slopes_of);

    const FitKernels& kernels_;
    std::vector<std::unique_ptr<Workspace>> workspaces_;  // of each view
};

}  // namespace splatrl
