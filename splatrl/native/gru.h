// A gated recurrent unit (GRU, Cho et al. 2014) in the form of PyTorch's, through time, and its gradient.
#pragma once

#include <cstddef>

#include "isa.h"

namespace splatrl {

constexpr size_t GRU_LANES = 16;  // the sizes of features and memory are multiples of it
constexpr size_t GRU_GATES = 3;   // reset, update and new, in this order
constexpr size_t GRU_KEPT = 5;    // reset, update, new, the state's part of new before the reset, the state before

struct GruShape {
    size_t features, memory;

    size_t gates() const { return GRU_GATES * memory; }
    size_t kept() const { return GRU_KEPT * memory; }
    size_t slopes() const { return 4 * memory + GRU_LANES; }  // of a frame; not a power of two, which caches dislike
};

// Weights in PyTorch's layout: [gates, features] and [gates, memory], and two biases [gates].
struct GruWeights {
    const float *input, *recurrent, *input_bias, *recurrent_bias;
};

struct GruGradients {
    float *input, *recurrent, *input_bias, *recurrent_bias;
};

// Consecutive frames of an episode; `state` [memory] is that before the first one.
struct Episode {
    size_t begin, length;
    const float* state;
};

// Slopes are the gradients of what enters the gates, for each frame: of new, reset and update, and of the state's part
// of new. The first three are those of the input's part, and the last three those of the state's.
struct GruKernels {
    // Pack weights [gates, in] in the order in which `input` and `forward` read them.
    void (*pack)(const float* weights, size_t gates, size_t in, float* out);
    // Write the input's part of the gates, without bias, into the first numbers that are kept of each frame.
    void (*input)(const GruShape&, const float* packed, const float* features, size_t count, float* kept);
    // Run episodes, sorted by descending length, through time: write hidden [frames, memory], and complete what is kept
    // [frames, 5 · memory]. `scratch` has room for episodes · (memory + gates).
    void (*forward)(const GruShape&, const float* packed, const GruWeights&, const Episode*, size_t episodes,
                    float* hidden, float* kept, float* scratch);
    // Run them backwards: write the slopes of the gates, from those of hidden. `scratch` as above.
    void (*backward)(const GruShape&, const GruWeights&, const Episode*, size_t episodes, const float* kept,
                     const float* hidden_slope, float* slopes, float* scratch);
    // Compute the gradient of the features.
    void (*input_gradient)(const GruShape&, const GruWeights&, const float* slopes, size_t count, float* out);
    // Compute the gradient of weights [rows, columns], from the slopes of their rows, [frames, step], and what they
    // read.
    void (*weight_gradient)(const float* slopes, size_t step, const float* read, size_t read_step, size_t count,
                            size_t rows, size_t columns, float* out);
};

namespace portable { extern const GruKernels gru_kernels; }
namespace avx2 { extern const GruKernels gru_kernels; }
namespace avx512 { extern const GruKernels gru_kernels; }

const GruKernels& gru_kernels_of(Isa isa);

}  // namespace splatrl
