// Renders batches of cameras over threads, frame by frame, with the kernels of one instruction set.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

#include "frame.h"
#include "isa.h"
#include "scene.h"

namespace splatrl {

class Renderer {
public:
    Renderer(Scene scene, bool antialiased, float tolerance, Isa isa);
    ~Renderer();

    // camera_to_world [batch, 4, 4] and K [batch, 3, 3] row-major; the images of the batch lie one after another.
    // efforts [batch] takes what each frame took.
    void render(const float* camera_to_world, const float* K, size_t batch, int width, int height, size_t threads,
                const Images& images, Effort* efforts);

private:
    struct Workspace;
    class Loan;

    Scene scene_;
    bool antialiased_;
    float tolerance_;
    RenderTile render_tile_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<Workspace>> idle_;  // kept: fresh memory costs a page fault every 4 KiB
};

}  // namespace splatrl
