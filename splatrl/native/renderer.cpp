#include "renderer.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "threads.h"

namespace splatrl {

namespace {

constexpr uint32_t PAIRS = 1 << 16;  // a slab stays within the second-level cache

RenderFrame kernel_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::render_frame;
        case Isa::avx2: return avx2::render_frame;
#endif
        default: return baseline::render_frame;
    }
}

// The margin is 0.15 image sizes: outside it the linearised projection would explode.
Camera camera_of(const float* pose, const float* K, int width, int height) {
    Camera camera{};
    for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 3; ++column) camera.rotation[3 * row + column] = pose[4 * column + row];
    for (int axis = 0; axis < 3; ++axis) camera.position[axis] = pose[4 * axis + 3];
    camera.fx = K[0], camera.fy = K[4], camera.cx = K[2], camera.cy = K[5];
    const float margin_x = 0.15f * float(width) / camera.fx, margin_y = 0.15f * float(height) / camera.fy;
    camera.slope_left = -camera.cx / camera.fx - margin_x;
    camera.slope_right = (float(width) - camera.cx) / camera.fx + margin_x;
    camera.slope_top = -camera.cy / camera.fy - margin_y;
    camera.slope_bottom = (float(height) - camera.cy) / camera.fy + margin_y;
    camera.width = width, camera.height = height;
    return camera;
}

template <class T>
T* offset(T* images, size_t items) {
    return images == nullptr ? nullptr : images + items;
}

}  // namespace

struct Renderer::Workspace {
    size_t blocks = 0;
    Buffer<Splat> splats;
    Buffer<Patch> patches;
    Buffer<uint32_t> lists, list_ends;
    Buffer<uint64_t> keys, sorted;
    Buffer<Pair> pairs;
    Buffer<uint8_t> finished;
    Buffer<float> frame;
    Scratch scratch{};

    explicit Workspace(size_t capacity)
        : splats(make_buffer<Splat>(capacity + SPARE)),
          patches(make_buffer<Patch>(capacity + SPARE)),
          keys(make_buffer<uint64_t>(capacity + SPARE)),
          sorted(make_buffer<uint64_t>(capacity + SPARE)) {}

    const Scratch& prepare(int width, int height) {
        const size_t needed = size_t((width + BLOCK - 1) / BLOCK) * size_t((height + BLOCK - 1) / BLOCK);
        const uint32_t capacity = std::max(PAIRS, uint32_t(needed));
        if (needed > blocks) {
            pairs = make_buffer<Pair>(capacity + SPARE);
            lists = make_buffer<uint32_t>(capacity + SPARE);
            list_ends = make_buffer<uint32_t>(needed + 1);
            finished = make_buffer<uint8_t>(needed);
            frame = make_buffer<float>(needed * CHANNELS * BLOCK * BLOCK);
            blocks = needed;
        }
        scratch = {splats.get(), patches.get(),   keys.get(),     sorted.get(), pairs.get(),
                   lists.get(),  list_ends.get(), finished.get(), frame.get(),  capacity};
        return scratch;
    }
};

// A workspace borrowed for one call.
class Renderer::Loan {
public:
    explicit Loan(Renderer& owner) : owner_(owner) {
        const std::lock_guard<std::mutex> lock(owner.mutex_);
        if (owner.idle_.empty()) {
            workspace_ = std::make_unique<Workspace>(owner.scene_.capacity());
        } else {
            workspace_ = std::move(owner.idle_.back());
            owner.idle_.pop_back();
        }
    }
    ~Loan() {
        const std::lock_guard<std::mutex> lock(owner_.mutex_);
        owner_.idle_.push_back(std::move(workspace_));
    }
    Loan(const Loan&) = delete;
    Loan& operator=(const Loan&) = delete;

    Workspace& operator*() { return *workspace_; }

private:
    Renderer& owner_;
    std::unique_ptr<Workspace> workspace_;
};

Renderer::Renderer(Scene scene, bool antialiased, std::array<float, 3> background, Isa isa)
    : scene_(std::move(scene)), antialiased_(antialiased), background_(background), render_frame_(kernel_of(isa)) {}

Renderer::~Renderer() = default;

void Renderer::render(const float* camera_to_world, const float* K, size_t batch, int width, int height,
                      size_t threads, const Images& images, int32_t* visible) {
    const size_t workers = std::max<size_t>(1, std::min(threads, batch));
    std::vector<std::unique_ptr<Loan>> loans;
    for (size_t worker = 0; worker < workers; ++worker) loans.push_back(std::make_unique<Loan>(*this));
    const SceneView view = scene_.view();
    const size_t area = size_t(width) * size_t(height);
    parallel_for(batch, workers, [&](size_t worker, size_t row) {
        const Scratch& scratch = (**loans[worker]).prepare(width, height);
        const Camera camera = camera_of(camera_to_world + 16 * row, K + 9 * row, width, height);
        visible[row] = int32_t(render_frame_(view, camera, antialiased_, images.depth != nullptr, scratch));
        const Images own{offset(images.rgb, 3 * area * row), offset(images.depth, area * row),
                         offset(images.alpha, area * row), offset(images.pixels, 3 * area * row)};
        write_images(scratch.frame, camera, background_.data(), own);
    });
}

}  // namespace splatrl
