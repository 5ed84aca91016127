// A small convolutional network over images, and its gradient: two convolutions and a dense layer, each with a ReLU.
#pragma once

#include <cstddef>

#include "isa.h"

namespace splatrl {

constexpr int TRUNK_LANES = 16;  // the channels of the convolutions are multiples of it
constexpr int TRUNK_CHUNK = 16;  // images per work item; sums over images are sums of those of the chunks

// A convolution without padding, from images [height, width, in] to [tall, wide, out].
struct Convolution {
    int height, width, in, out, side, stride;

    int tall() const { return (height - side) / stride + 1; }
    int wide() const { return (width - side) / stride + 1; }
    int run() const { return side * in; }  // numbers of a window in one row of the image, which are contiguous
    size_t read() const { return size_t(height) * size_t(width) * size_t(in); }
    size_t written() const { return size_t(tall()) * size_t(wide()) * size_t(out); }
    size_t weights() const { return size_t(side) * size_t(run()) * size_t(out); }
};

struct TrunkShape {
    Convolution first, second;
    int features;

    size_t flat() const { return second.written(); }
};

// Weights in PyTorch's layout: [out, in, side, side] of convolutions, [features, flat] of the dense layer.
struct TrunkWeights {
    const float *first, *first_bias, *second, *second_bias, *dense, *dense_bias;
};

struct TrunkGradients {
    float *first, *first_bias, *second, *second_bias, *dense, *dense_bias;
};

// Outputs of the layers, after their ReLUs: [count, tall, wide, out] of convolutions, [count, features] of the last.
struct TrunkLayers {
    float *first, *second, *hidden;
};

// Weights of the convolutions in the order in which the kernels read them: [side, run, out] for the forward pass, and
// [side, out, run] for the backward pass.
struct PackedTrunk {
    float *first, *second, *second_back;
};

struct TrunkKernels {
    // Compute the outputs of all layers for images [count, height, width, in].
    void (*forward)(const TrunkShape&, const PackedTrunk&, const TrunkWeights&, const float* images, size_t count,
                    const TrunkLayers&);
    // Add the images' contribution to the gradients of the convolutions, [side, run, out]. `slope` [count, features] is
    // the gradient of the dense layer before its ReLU, and `scratch` has room for [count · flat + first.written()].
    void (*backward)(const TrunkShape&, const PackedTrunk&, const TrunkWeights&, const float* images, size_t count,
                     const TrunkLayers&, const float* slope, const TrunkGradients&, float* scratch);
    // Compute the gradient of the dense layer's weights for its inputs [begin, end), both multiples of sixteen.
    void (*dense_gradient)(const TrunkShape&, const float* read, const float* slope, size_t count, size_t begin,
                           size_t end, float* out);
};

namespace portable { extern const TrunkKernels trunk_kernels; }
namespace avx2 { extern const TrunkKernels trunk_kernels; }
namespace avx512 { extern const TrunkKernels trunk_kernels; }

const TrunkKernels& trunk_kernels_of(Isa isa);

}  // namespace splatrl
