// Renders batches of cameras on several threads, frame by frame, with the kernels of one instruction set.
#pragma once

#include <array>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

#include "frame.h"
#include "isa.h"
#include "scene.h"

namespace splatrl {

// What the rows of a batch draw; all arrays are row-major.
struct Batch {
    const int64_t* models;          // [rows, parts], -1 for none; null draws model 0 in each row
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

    // Add, replace or remove a model; one that has been removed must not be drawn. Not to be called while anything is
    // drawn.
    void put(size_t model, std::optional<Scene> scene);

    // What each camera needs of each of several models in one frame, given the bounds of their trees: NOTHING if the
    // model cannot be visible, TOP if nodes with this error would be within the tolerance, else WHOLE; [rows, count].
    enum Need : uint8_t { NOTHING, TOP, WHOLE };
    void needs(const Bounds* bounds, const float* errors, size_t count, const Batch& batch, uint8_t* out) const;

    std::array<float, 3> background() const { return background_; }
    bool antialiased() const { return antialiased_; }

    // The images of the batch lie one after another in memory; efforts [rows] receives the work of each frame, unless
    // it is null.
    void render(const Batch& batch, size_t threads, const Images& images, Effort* efforts);

private:
    struct Workspace;
    class Loan;

    size_t capacity_of(const Batch& batch) const;
    void place(const Batch& batch, size_t row, const SceneView* views, std::vector<Part>& parts) const;

    const Scene& scene(int64_t model) const;

    std::vector<std::optional<Scene>> scenes_;
    std::array<float, 3> background_;
    bool antialiased_;
    float tolerance_;
    RenderTile render_tile_;
    std::mutex mutex_;
    std::vector<std::unique_ptr<Workspace>> idle_;  // reused, as fresh memory costs a page fault every 4 KiB
};

}  // namespace splatrl
