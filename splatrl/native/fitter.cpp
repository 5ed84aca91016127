#include "fitter.h"

#include <algorithm>

#include "buffer.h"
#include "threads.h"

namespace splatrl {

namespace {

const FitKernels& kernels_of(Isa isa) {
    switch (isa) {
#ifdef SPLATRL_X86
        case Isa::avx512: return avx512::fit_kernels;
        case Isa::avx2: return avx2::fit_kernels;
#endif
        default: return portable::fit_kernels;
    }
}

FitGrid grid_of(int width, int height) {
    const int across = (width + FIT_BLOCK - 1) / FIT_BLOCK, down = (height + FIT_BLOCK - 1) / FIT_BLOCK;
    return {width, height, across, down, (width + FIT_LANES - 1) / FIT_LANES * FIT_LANES};
}

constexpr size_t FIT_MAPS = 10;

}  // namespace

struct Fitter::Workspace {
    FitGrid grid;
    size_t capacity, span_room = 0, list_room = 0;
    Buffer<FitSplat> projected, splats;
    Buffer<uint32_t> ranks, starts, taken, spans, list;
    Buffer<uint64_t> keys, sorted;
    Buffer<float> moments, known, image, slopes, maps;

    Workspace(size_t capacity, const FitGrid& grid)
        : grid(grid), capacity(capacity), projected(make_buffer<FitSplat>(capacity + FIT_LANES)),
          splats(make_buffer<FitSplat>(capacity + FIT_LANES)), ranks(make_buffer<uint32_t>(capacity)),
          starts(make_buffer<uint32_t>(grid.blocks() + 1)), taken(make_buffer<uint32_t>(grid.blocks())),
          keys(make_buffer<uint64_t>(capacity)), sorted(make_buffer<uint64_t>(capacity)),
          moments(make_buffer<float>(capacity * FIT_MOMENTS)), known(make_buffer<float>(grid.area())),
          image(make_buffer<float>(grid.area() * FIT_CHANNELS)),
          slopes(make_buffer<float>(grid.area() * FIT_CHANNELS)), maps(make_buffer<float>(grid.area() * FIT_MAPS)) {}

    void make_room(Buffer<uint32_t>& buffer, size_t& room, size_t needed) {
        if (needed <= room) return;
        room = needed + needed / 4;
        buffer.reset();
        buffer = make_buffer<uint32_t>(room);
    }

    FitScratch scratch() const {
        return {projected.get(), splats.get(), ranks.get(), keys.get(),  sorted.get(), moments.get(), starts.get(),
                taken.get(),     spans.get(),  list.get(),  known.get(), image.get(), slopes.get(), maps.get()};
    }
};

Fitter::Fitter(Isa isa) : kernels_(kernels_of(isa)) {}

Fitter::~Fitter() = default;

void Fitter::make_room(const FitBatch& batch) {
    const FitGrid grid = grid_of(batch.width, batch.height);
    if (workspaces_.size() < batch.views) workspaces_.resize(batch.views);
    for (size_t view = 0; view < batch.views; ++view) {
        std::unique_ptr<Workspace>& own = workspaces_[view];
        if (own && own->capacity >= batch.model.stride && own->grid.width == grid.width &&
            own->grid.height == grid.height)
            continue;
        own.reset();
        own = std::make_unique<Workspace>(batch.model.stride, grid);
    }
}

// Draw one view into its workspace. Returns the number of visible Gaussians.
uint32_t Fitter::draw(const FitBatch& batch, size_t view, const Camera& camera) {
    Workspace& own = *workspaces_[view];
    std::fill(own.known.get(), own.known.get() + own.grid.area(), 0.0f);
    for (int y = 0; y < batch.height; ++y)
        std::copy_n(batch.known[view] + size_t(y) * size_t(batch.width), batch.width,
                    own.known.get() + size_t(y) * size_t(own.grid.stride));
    size_t rows = 0;
    const uint32_t visible = kernels_.project(batch.model, camera, own.grid, own.scratch(), &rows);
    own.make_room(own.spans, own.span_room, rows);
    const size_t pairs = kernels_.count_pairs(own.grid, own.scratch(), visible);
    own.make_room(own.list, own.list_room, pairs);
    kernels_.fill_lists(own.grid, own.scratch(), visible);
    kernels_.blend(own.grid, own.scratch());
    return visible;
}

void Fitter::render(const FitBatch& batch, size_t threads, float* rgb, float* agreement, float* alpha) {
    make_room(batch);
    parallel_for(batch.views, threads, [&](size_t, size_t view) {
        draw(batch, view, camera_of(batch.camera_to_world + 16 * view, batch.K + 9 * view, batch.width, batch.height));
        const Workspace& own = *workspaces_[view];
        const size_t area = own.grid.area(), pixels = size_t(batch.width) * size_t(batch.height);
        for (int y = 0; y < batch.height; ++y)
            for (int x = 0; x < batch.width; ++x) {
                const size_t from = size_t(y) * size_t(own.grid.stride) + size_t(x);
                const size_t to = view * pixels + size_t(y) * size_t(batch.width) + size_t(x);
                for (size_t c = 0; c < 3; ++c) rgb[3 * to + c] = own.image[c * area + from];
                agreement[to] = own.image[F_AGREEMENT * area + from], alpha[to] = own.image[F_ALPHA * area + from];
            }
    });
}

template <class Slopes>
void Fitter::differentiate(const FitBatch& batch, size_t threads, float* gradients, Slopes&& slopes_of) {
    make_room(batch);
    const size_t rows = size_t(FIT_SH + 3 * (batch.model.degree + 1) * (batch.model.degree + 1));
    parallel_for(batch.views, threads, [&](size_t, size_t view) {
        const Camera camera =
            camera_of(batch.camera_to_world + 16 * view, batch.K + 9 * view, batch.width, batch.height);
        const uint32_t visible = draw(batch, view, camera);
        const Workspace& own = *workspaces_[view];
        float* const pose = slopes_of(view, own);
        kernels_.backward(batch.model, camera, own.grid, own.scratch(), visible,
                          gradients + view * rows * batch.model.stride, pose);
    });
}

void Fitter::pull(const FitBatch& batch, size_t threads, const float* slopes, float* gradients, float* poses) {
    differentiate(batch, threads, gradients, [&](size_t view, const Workspace& own) {
        const size_t area = own.grid.area();
        std::fill(own.slopes.get(), own.slopes.get() + FIT_CHANNELS * area, 0.0f);
        const float* from = slopes + view * size_t(batch.width) * size_t(batch.height) * FIT_CHANNELS;
        for (int y = 0; y < batch.height; ++y)
            for (int x = 0; x < batch.width; ++x)
                for (size_t c = 0; c < FIT_CHANNELS; ++c)
                    own.slopes[c * area + size_t(y) * size_t(own.grid.stride) + size_t(x)] = *from++;
        return poses + 6 * view;
    });
}

void Fitter::compare(const FitBatch& batch, size_t threads, const FitTarget* targets, float* gradients,
                     FitLoss* losses) {
    differentiate(batch, threads, gradients, [&](size_t view, const Workspace& own) {
        losses[view] = kernels_.loss(own.grid, own.scratch(), targets[view]);
        return losses[view].pose;
    });
}

void Fitter::update(const FitUpdate& update, size_t threads) const {
    constexpr size_t CHUNK = 4096;  // Gaussians per work item; each is updated independently of the others
    const size_t chunks = (update.stride + CHUNK - 1) / CHUNK;
    parallel_for(chunks, threads, [&](size_t, size_t chunk) {
        kernels_.update(update, chunk * CHUNK, std::min((chunk + 1) * CHUNK, update.stride));
    });
}

}  // namespace splatrl
