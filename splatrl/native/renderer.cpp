#include "renderer.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <tuple>

#include "frustum.h"
#include "threads.h"

namespace splatrl {

namespace {

RenderTile kernel_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::render_tile;
        case Isa::avx2: return avx2::render_tile;
#endif
        default: return portable::render_tile;
    }
}

// A whole tile, and one of the pieces that it is cut into, which lie one below the other. Often there is only one.
struct Piece {
    Tile whole, tile;
};

// Frames are cut into independent tiles so that the working memory of each stays small; tiles are cut into pieces if
// there are fewer frames than threads.
std::vector<Piece> pieces_of(size_t batch, int width, int height, size_t threads) {
    const int rows = (height + BLOCK - 1) / BLOCK, down = (height + TILE - 1) / TILE;
    const size_t least = batch == 0 || batch >= threads ? 1 : (threads + batch - 1) / batch;
    std::vector<Piece> pieces;
    for (int row = 0; row < down; ++row) {
        const int top = int(int64_t(rows) * row / down), bottom = int(int64_t(rows) * (row + 1) / down);
        const int cuts = int(std::min((least + down - 1) / down, size_t(bottom - top)));
        const auto pixel = [height](int block) { return std::min(block * BLOCK, height); };
        for (int cut = 0; cut < cuts; ++cut)
            for (int left = 0; left < width; left += TILE) {
                const int right = std::min(left + TILE, width);
                pieces.push_back({{left, pixel(top), right, pixel(bottom)},
                                  {left, pixel(top + (bottom - top) * cut / cuts), right,
                                   pixel(top + (bottom - top) * (cut + 1) / cuts)}});
            }
    }
    return pieces;
}

// Order rows so that those that see the same model in a similar direction follow each other and find it in the cache.
std::vector<size_t> by_likeness(const Batch& batch) {
    std::vector<std::tuple<int64_t, float, size_t>> rows;
    for (size_t row = 0; row < batch.rows; ++row) {
        size_t part = 0;
        while (part < batch.parts && batch.model(row, part) < 0) ++part;
        const float* pose = batch.camera_to_models + 16 * (row * batch.parts + part);
        if (part == batch.parts)
            rows.push_back({-1, 0.0f, row});
        else
            rows.push_back({batch.model(row, part), std::atan2(pose[6], pose[2]), row});
    }
    std::sort(rows.begin(), rows.end());
    std::vector<size_t> order;
    for (const auto& [model, heading, row] : rows) order.push_back(row);
    return order;
}

template <class T>
T* offset(T* images, size_t items) {
    return images == nullptr ? nullptr : images + items;
}

}  // namespace

struct Renderer::Workspace {
    Buffer<Branch> branches, later;
    Buffer<Shown> groups;
    Buffer<uint32_t> tied;
    Buffer<Splat> splats;
    Buffer<float> peaks;
    Buffer<uint64_t> ties, keys, sorted;
    Buffer<SlabSplat> slab = make_buffer<SlabSplat>(SLAB + 1);
    Buffer<uint16_t> lists = make_buffer<uint16_t>(LISTS * LIST);
    Buffer<float> pixels = make_buffer<float>(BLOCKS * CHANNELS * BLOCK * BLOCK);
    std::vector<Part> parts;
    size_t capacity;  // Gaussians per row

    explicit Workspace(size_t capacity)
        : branches(make_buffer<Branch>(capacity / GROUP + SPARE)),
          later(make_buffer<Branch>(capacity / GROUP + SPARE)),
          groups(make_buffer<Shown>(capacity / GROUP + SPARE)),
          tied(make_buffer<uint32_t>(capacity + SPARE)),
          splats(make_buffer<Splat>(capacity + SPARE)),
          peaks(make_buffer<float>(capacity + SPARE)),
          ties(make_buffer<uint64_t>(capacity + SPARE)),
          keys(make_buffer<uint64_t>(capacity + SPARE)),
          sorted(make_buffer<uint64_t>(capacity + SPARE)),
          capacity(capacity) {}

    Scratch scratch() const {
        return {branches.get(), later.get(), groups.get(), splats.get(), peaks.get(), ties.get(),
                keys.get(),     sorted.get(), tied.get(),  slab.get(),   lists.get(), pixels.get()};
    }
};

// A workspace that is borrowed from the renderer for one call.
class Renderer::Loan {
public:
    Loan(Renderer& owner, size_t capacity) : owner_(owner) {
        const std::lock_guard<std::mutex> lock(owner.mutex_);
        if (!owner.idle_.empty()) {
            workspace_ = std::move(owner.idle_.back());
            owner.idle_.pop_back();
        }
        if (workspace_ && workspace_->capacity >= capacity) return;
        workspace_.reset();  // free it before a larger one is allocated
        workspace_ = std::make_unique<Workspace>(capacity);
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

Renderer::Renderer(std::array<float, 3> background, bool antialiased, float tolerance, Isa isa)
    : background_(background), antialiased_(antialiased), tolerance_(held_tolerance(tolerance, antialiased)),
      render_tile_(kernel_of(isa)) {}

Renderer::~Renderer() = default;

void Renderer::put(size_t model, std::optional<Scene> scene) {
    if (model >= scenes_.size()) scenes_.resize(model + 1);
    scenes_[model] = std::move(scene);
}

const Scene& Renderer::scene(int64_t model) const {
    const std::optional<Scene>& found = scenes_.at(size_t(model));
    if (!found) throw std::invalid_argument("models: expected a model that is loaded, got " + std::to_string(model));
    return *found;
}

void Renderer::needs(const Bounds* bounds, const float* errors, size_t count, const Batch& batch, uint8_t* out) const {
    constexpr float SLACK = 1.001f;  // rounding may make a node's bounds extend beyond the root's
    for (size_t row = 0; row < batch.rows; ++row) {
        const Camera camera = camera_of(batch.camera_to_models + 16 * row, batch.K + 9 * row, batch.width,
                                        batch.height);
        const Frustum frustum = frustum_of(camera, {0, 0, batch.width, batch.height});
        for (size_t model = 0; model < count; ++model) {
            Cluster top{};
            top.bounds = bounds[model];
            Need need = WHOLE;
            if (misses(frustum, camera, top.bounds)) {
                need = NOTHING;
            } else {
                top.bounds.radius *= SLACK;
                top.error = errors[model] * SLACK;
                if (errors[model] == 0.0f || within_tolerance(frustum, camera, top, tolerance_)) need = TOP;
            }
            out[row * count + model] = need;
        }
    }
}

// The largest number of Gaussians, summed over its parts, of any row.
size_t Renderer::capacity_of(const Batch& batch) const {
    constexpr size_t MOST = ~uint32_t(0);  // keys and ties hold 32-bit indices
    size_t most = 0;
    for (size_t row = 0; row < batch.rows; ++row) {
        size_t sum = 0;
        for (size_t part = 0; part < batch.parts; ++part) {
            const int64_t model = batch.model(row, part);
            sum += model < 0 ? 0 : scene(model).capacity();
        }
        most = std::max(most, sum);
    }
    if (most > MOST) throw std::length_error("parts: expected fewer than 2^32 Gaussians per row");
    return most;
}

// List the parts that a row draws.
void Renderer::place(const Batch& batch, size_t row, const SceneView* views, std::vector<Part>& parts) const {
    parts.clear();
    uint32_t first_index = 0;
    for (size_t part = 0; part < batch.parts; ++part) {
        const int64_t model = batch.model(row, part);
        if (model < 0) continue;
        const float* pose = batch.camera_to_models + 16 * (row * batch.parts + part);
        parts.push_back({views + model, camera_of(pose, batch.K + 9 * row, batch.width, batch.height),
                         first_index, {}});
        first_index += uint32_t(scenes_[size_t(model)]->capacity());
    }
}

void Renderer::render(const Batch& batch, size_t threads, const Images& images, Effort* efforts) {
    const size_t area = size_t(batch.width) * size_t(batch.height), capacity = capacity_of(batch);
    const std::vector<Piece> pieces = pieces_of(batch.rows, batch.width, batch.height, threads);
    const size_t workers = std::max<size_t>(1, std::min(threads, batch.rows * pieces.size()));
    std::vector<std::unique_ptr<Loan>> loans;
    for (size_t worker = 0; worker < workers; ++worker) loans.push_back(std::make_unique<Loan>(*this, capacity));
    std::vector<SceneView> views;
    for (const std::optional<Scene>& scene : scenes_) views.push_back(scene ? scene->view(tolerance_) : SceneView{});
    std::vector<Effort> taken(batch.rows * pieces.size());
    const std::vector<size_t> order = by_likeness(batch);
    parallel_for(taken.size(), workers, [&](size_t worker, size_t item) {
        const size_t row = order[item / pieces.size()], number = item % pieces.size();
        Tile tile = pieces[number].tile;
        Workspace& workspace = **loans[worker];
        const Scratch scratch = workspace.scratch();
        place(batch, row, views.data(), workspace.parts);
        const Row drawn{workspace.parts.data(), workspace.parts.size(), background_.data(), finished_at(tolerance_),
                        log2_invisible_at(tolerance_, antialiased_), ranked_at(tolerance_), efforts != nullptr};
        taken[row * pieces.size() + number] = render_tile_(drawn, pieces[number].whole, tile, antialiased_,
                                                             images.depth != nullptr, scratch);
        const Images own{offset(images.rgb, 3 * area * row), offset(images.depth, area * row),
                         offset(images.alpha, area * row), offset(images.pixels, 3 * area * row)};
        write_images(scratch.pixels, batch.width, tile, own);
    });
    if (efforts == nullptr) return;
    std::fill(efforts, efforts + batch.rows, Effort{});
    for (size_t item = 0; item < taken.size(); ++item) efforts[item / pieces.size()] += taken[item];
}

}  // namespace splatrl
