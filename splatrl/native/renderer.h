// Renders batches of cameras over threads, frame by frame, with the kernels of one instruction set.
#pragma once

#include <array>
#include <memory>
#include <mutex>
#include <vector>

#include "frame.h"
#include "isa.h"
#include "scene.h"

namespace splatrl {

// What the rows of a batch draw, row-major.
struct Batch {
    const int64_t* models;          // [rows, parts], -1 for none; null: model 0 in each row
    const float* camera_to_models;  // [rows, parts, 4, 4], ignored where there is no model
    const float* K;                 // [rows, 3, 3]
    size_t rows, parts;
    int width, height;

    int64_t model(size_t row, size_t part) const { return models == nullptr ? 0 : models[row * parts + part]; }
};

class Renderer {
public:
    Renderer(std::array<float, 3> background, bool antialiased, float tolerance, Isa isa);
    ~Renderer();

    void add(const GaussianArrays& gaussians, const Levels& levels);

    // The images of the batch lie one after another; efforts [rows] receives the work of each frame.
    void render(const Batch& batch, size_t threads, const Images& images, Effort* efforts);

private:
    struct Workspace;
    class Loan;

    size_t capacity_of(const Batch& batch) const;
    void place(const Batch& batch, size_t row, const SceneView* views, std::vector<Part>& parts) const;

    std::vector<Scene> scenes_;
    std::array<float, 3> background_;
    bool antialiased_;
    float tolerance_;
    RenderTile render_tile_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<Workspace>> idle_;  // kept, because fresh memory costs a page fault every 4 KiB
};

}  // namespace splatrl
