#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "gru.h"
#include "interpreter.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr size_t GRU_CHUNK = 32;  // frames, or rows of weights, per work item
constexpr size_t SIDE_BY_SIDE = 64;    // the most episodes that one thread runs side by side

// Episodes in groups for threads, sorted by descending length. How they are grouped changes no byte of the results.
using Groups = std::vector<std::vector<Episode>>;

// `begins` [episodes] are the first frames, ascending from 0, and `states` [episodes, memory] the states before them.
Groups groups_of(size_t frames, const int64_t* begins, size_t episodes, const float* states, size_t memory,
                 size_t threads) {
    std::vector<Episode> all(episodes);
    for (size_t e = 0; e < episodes; ++e) {
        const int64_t begin = begins[e], end = e + 1 < episodes ? begins[e + 1] : int64_t(frames);
        if ((e == 0 && begin != 0) || end <= begin || end > int64_t(frames))
            throw std::invalid_argument("begins: expected ascending frames, the first of which is 0");
        all[e] = {size_t(begin), size_t(end - begin), states + e * memory};
    }
    if (episodes == 0 && frames > 0) throw std::invalid_argument("begins: expected at least one episode");
    std::stable_sort(all.begin(), all.end(), [](const Episode& a, const Episode& b) { return a.length > b.length; });
    Groups groups(std::min(std::max(threads, (episodes + SIDE_BY_SIDE - 1) / SIDE_BY_SIDE), episodes));
    for (size_t e = 0; e < episodes; ++e) groups[e % groups.size()].push_back(all[e]);
    return groups;
}

GruShape shape_of(const std::array<size_t, 4>& sizes) {
    for (size_t size : {sizes[2], sizes[3]})
        if (size < 1 || size > 65536 || size % GRU_LANES != 0)
            throw std::invalid_argument("sizes: expected features and memory to be multiples of 16, at most 65536");
    return {sizes[2], sizes[3]};
}

Buffer<float> scratch_of(const GruShape& shape, const std::vector<Episode>& group) {
    return make_buffer<float>(group.size() * (shape.memory + shape.gates()));
}

size_t gru_chunks(size_t count) { return (count + GRU_CHUNK - 1) / GRU_CHUNK; }

// `sizes`: frames, episodes, features, memory. `known`: addresses of begins and states. `weights`: see GruWeights.
// `made`: addresses of hidden and of what is kept for the gradient.
void gru_forward(const std::array<size_t, 4>& sizes, const std::array<Address, 2>& known, Address features,
                 const std::array<Address, 4>& weights, const std::array<Address, 2>& made, size_t threads) {
    const GruShape shape = shape_of(sizes);
    const size_t frames = sizes[0];
    const Groups groups = groups_of(frames, at<const int64_t>(known[0]), sizes[1], at(known[1]),
                                    shape.memory, threads);
    const GruKernels& kernels = gru_kernels_of(choose_isa());
    const GruWeights w{at(weights[0]), at(weights[1]), at(weights[2]), at(weights[3])};
    const Release release;
    const Buffer<float> packed = make_buffer<float>(shape.gates() * (shape.features + shape.memory));
    float* recurrent = packed.get() + shape.gates() * shape.features;
    kernels.pack(w.input, shape.gates(), shape.features, packed.get());
    kernels.pack(w.recurrent, shape.gates(), shape.memory, recurrent);
    parallel_for(gru_chunks(frames), threads, [&](size_t, size_t chunk) {
        const size_t begin = chunk * GRU_CHUNK, some = std::min(frames - begin, GRU_CHUNK);
        kernels.input(shape, packed.get(), at(features) + begin * shape.features, some,
                      at(made[1]) + begin * shape.kept());
    });
    parallel_for(groups.size(), threads, [&](size_t, size_t group) {
        const Buffer<float> scratch = scratch_of(shape, groups[group]);
        kernels.forward(shape, recurrent, w, groups[group].data(), groups[group].size(), at(made[0]), at(made[1]),
                        scratch.get());
    });
}

// `made`: addresses of what is kept, as `gru_forward` wrote it, and of the gradient of hidden. `gradients`: addresses
// of the results, of the weights in their order and of the features.
void gru_backward(const std::array<size_t, 4>& sizes, const std::array<Address, 2>& known, Address features,
                  const std::array<Address, 4>& weights, const std::array<Address, 2>& made,
                  const std::array<Address, 5>& gradients, size_t threads) {
    const GruShape shape = shape_of(sizes);
    const size_t frames = sizes[0], memory = shape.memory, step = shape.slopes();
    const Groups groups = groups_of(frames, at<const int64_t>(known[0]), sizes[1], at(known[1]),
                                    memory, threads);
    const GruKernels& kernels = gru_kernels_of(choose_isa());
    const GruWeights w{at(weights[0]), at(weights[1]), at(weights[2]), at(weights[3])};
    const GruGradients out{at(gradients[0]), at(gradients[1]), at(gradients[2]), at(gradients[3])};
    const float *kept = at(made[0]), *before = kept + (GRU_KEPT - 1) * memory;
    const Release release;
    const Buffer<float> slopes = make_buffer<float>(frames * step);
    parallel_for(groups.size(), threads, [&](size_t, size_t group) {
        const Buffer<float> scratch = scratch_of(shape, groups[group]);
        kernels.backward(shape, w, groups[group].data(), groups[group].size(), kept, at(made[1]), slopes.get(),
                         scratch.get());
    });
    for (float* each : {out.input_bias, out.recurrent_bias}) std::memset(each, 0, sizeof(float) * shape.gates());
    if (frames == 0) {
        std::memset(out.input, 0, sizeof(float) * shape.gates() * shape.features);
        std::memset(out.recurrent, 0, sizeof(float) * shape.gates() * memory);
        return;
    }
    const size_t each = gru_chunks(memory), parts = GRU_GATES * each, whole = gru_chunks(frames);
    parallel_for(2 * parts + whole, threads, [&](size_t, size_t item) {
        if (item >= 2 * parts) {
            const size_t begin = (item - 2 * parts) * GRU_CHUNK, some = std::min(frames - begin, GRU_CHUNK);
            kernels.input_gradient(shape, w, slopes.get() + begin * step, some,
                                   at(gradients[4]) + begin * shape.features);
            return;
        }
        const bool of_state = item >= parts;
        const size_t gate = item % parts / each, unit = item % each * GRU_CHUNK, row = gate * memory + unit;
        const size_t columns = of_state ? memory : shape.features, rows = std::min(memory - unit, GRU_CHUNK);
        // Where the slopes of a gate are: see GruKernels.
        const size_t place = (of_state ? gate + 1 : (gate + 1) % GRU_GATES) * memory + unit;
        const float* slope = slopes.get() + place;
        kernels.weight_gradient(slope, step, of_state ? before : at(features), of_state ? shape.kept() : columns,
                                frames, rows, columns, (of_state ? out.recurrent : out.input) + row * columns);
        float* bias = (of_state ? out.recurrent_bias : out.input_bias) + row;
        for (size_t frame = 0; frame < frames; ++frame)
            for (size_t u = 0; u < rows; ++u) bias[u] += slope[frame * step + u];
    });
}

}  // namespace

void bind_gru(nb::module_& m) {
    m.def("gru_forward", &gru_forward);
    m.def("gru_backward", &gru_backward);
}

}  // namespace splatrl
