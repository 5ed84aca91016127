#include "renderer.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "threads.h"

namespace splatrl {

namespace {

RenderTile kernel_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::render_tile;
        case Isa::avx2: return avx2::render_tile;
        case Isa::baseline: return baseline::render_tile;
#endif
        default: return portable::render_tile;
    }
}

// Frames are cut into tiles, which take no account of each other: large frames so that a tile's memory stays small, and
// small ones where they are fewer than the threads.
std::vector<Tile> tiles_of(size_t batch, int width, int height, size_t threads) {
    const int rows = (height + BLOCK - 1) / BLOCK;
    const size_t least = batch == 0 || batch >= threads ? 1 : (threads + batch - 1) / batch;
    const int down = std::max((height + TILE - 1) / TILE, int(std::min(least, size_t(rows))));
    std::vector<Tile> tiles;
    for (int row = 0; row < down; ++row)
        for (int left = 0; left < width; left += TILE)
            tiles.push_back({left, int(int64_t(rows) * row / down) * BLOCK, std::min(left + TILE, width),
                             std::min(int(int64_t(rows) * (row + 1) / down) * BLOCK, height)});
    return tiles;
}

template <class T>
T* offset(T* images, size_t items) {
    return images == nullptr ? nullptr : images + items;
}

}  // namespace

struct Renderer::Workspace {
    Buffer<uint32_t> groups, tied;
    Buffer<Splat> splats;
    Buffer<Patch> patches;
    Buffer<Tie> ties;
    Buffer<uint64_t> keys, sorted;
    Buffer<SlabSplat> slab = make_buffer<SlabSplat>(SLAB);
    Buffer<uint16_t> lists = make_buffer<uint16_t>(LISTS * LIST);
    Buffer<float> pixels = make_buffer<float>(BLOCKS * CHANNELS * BLOCK * BLOCK);

    explicit Workspace(size_t capacity)
        : groups(make_buffer<uint32_t>(capacity / GROUP + SPARE)),
          tied(make_buffer<uint32_t>(capacity + SPARE)),
          splats(make_buffer<Splat>(capacity + SPARE)),
          patches(make_buffer<Patch>(capacity + SPARE)),
          ties(make_buffer<Tie>(capacity + SPARE)),
          keys(make_buffer<uint64_t>(capacity + SPARE)),
          sorted(make_buffer<uint64_t>(capacity + SPARE)) {}

    Scratch scratch() const {
        return {groups.get(), splats.get(), patches.get(), ties.get(), keys.get(), sorted.get(),
                tied.get(),   slab.get(),   lists.get(),   pixels.get()};
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

Renderer::Renderer(Scene scene, bool antialiased, float tolerance, Isa isa)
    : scene_(std::move(scene)), antialiased_(antialiased),
      tolerance_(held_tolerance(tolerance, antialiased)), render_tile_(kernel_of(isa)) {}

Renderer::~Renderer() = default;

void Renderer::render(const float* camera_to_world, const float* K, size_t batch, int width, int height,
                      size_t threads, const Images& images, Effort* efforts) {
    const size_t area = size_t(width) * size_t(height);
    const std::vector<Tile> tiles = tiles_of(batch, width, height, threads);
    const size_t workers = std::max<size_t>(1, std::min(threads, batch * tiles.size()));
    std::vector<std::unique_ptr<Loan>> loans;
    for (size_t worker = 0; worker < workers; ++worker) loans.push_back(std::make_unique<Loan>(*this));
    const SceneView view = scene_.view(tolerance_);
    std::vector<Effort> parts(batch * tiles.size());
    parallel_for(parts.size(), workers, [&](size_t worker, size_t item) {
        const size_t row = item / tiles.size();
        const Tile& tile = tiles[item % tiles.size()];
        const Scratch scratch = (**loans[worker]).scratch();
        const Camera camera = camera_of(camera_to_world + 16 * row, K + 9 * row, width, height);
        parts[item] = render_tile_(view, camera, tile, antialiased_, images.depth != nullptr, scratch);
        const Images own{offset(images.rgb, 3 * area * row), offset(images.depth, area * row),
                         offset(images.alpha, area * row), offset(images.pixels, 3 * area * row)};
        write_images(scratch.pixels, width, tile, own);
    });
    std::fill(efforts, efforts + batch, Effort{});
    for (size_t item = 0; item < parts.size(); ++item) efforts[item / tiles.size()] += parts[item];
}

}  // namespace splatrl
