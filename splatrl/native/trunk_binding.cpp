#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "threads.h"
#include "trunk.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

constexpr size_t DENSE_CHUNK = 16 * TRUNK_LANES;  // dense-layer inputs per work item of the weight gradient

using Addresses = std::array<Address, 6>;
using LayerAddresses = std::array<Address, 3>;

TrunkWeights weights_at(const Addresses& a) { return {at(a[0]), at(a[1]), at(a[2]), at(a[3]), at(a[4]), at(a[5])}; }

TrunkLayers layers_at(const LayerAddresses& a) { return {at(a[0]), at(a[1]), at(a[2])}; }

TrunkLayers from(const TrunkShape& shape, const TrunkLayers& layers, size_t image) {
    return {layers.first + image * shape.first.written(), layers.second + image * shape.flat(),
            layers.hidden + image * size_t(shape.features)};
}

class Trunk {
public:
    // numbers: height, width and channels of the image; channels of the two convolutions; features.
    explicit Trunk(const std::array<int, 6>& numbers) {
        const auto [height, width, depth, first, second, features] = numbers;
        if (height < 8 || width < 8 || height > 4096 || width > 4096)
            throw std::invalid_argument("shape: expected images of 8 to 4096 pixels per side");
        if (depth < 1 || depth > 4096 || features < 1 || features > 65536)
            throw std::invalid_argument("shape: expected 1 to 4096 image channels and 1 to 65536 features");
        for (int channels : {first, second})
            if (channels < 1 || channels > 4096 || channels % TRUNK_LANES != 0)
                throw std::invalid_argument("shape: expected convolution channels to be multiples of 16, at most 4096");
        shape_.first = {height, width, depth, first, 4, 2};
        shape_.second = {shape_.first.tall(), shape_.first.wide(), first, second, 3, 2};
        shape_.features = features;
    }

    void forward(Address images, size_t count, const Addresses& weights, const LayerAddresses& layers,
                 size_t threads) const {
        const TrunkKernels& kernels = trunk_kernels_of(choose_isa());
        const TrunkWeights w = weights_at(weights);
        const TrunkLayers all = layers_at(layers);
        const Release release;
        const Packed packed(shape_, w);
        parallel_for(chunks(count), threads, [&](size_t, size_t chunk) {
            const size_t begin = chunk * TRUNK_CHUNK, some = std::min(count - begin, size_t(TRUNK_CHUNK));
            kernels.forward(shape_, packed.weights, w, at(images) + begin * shape_.first.read(), some,
                            from(shape_, all, begin));
        });
    }

    void backward(Address images, size_t count, const Addresses& weights, const LayerAddresses& layers,
                  Address slopes, const Addresses& gradients, size_t threads) const {
        const TrunkKernels& kernels = trunk_kernels_of(choose_isa());
        const TrunkWeights w = weights_at(weights);
        const TrunkLayers all = layers_at(layers);
        const Release release;
        const Packed packed(shape_, w);
        const size_t features = size_t(shape_.features), flat = shape_.flat();
        const size_t parts = std::max(chunks(count), size_t(1));  // with no images, the gradients are zero
        const size_t dense_parts = (flat + DENSE_CHUNK - 1) / DENSE_CHUNK;
        const Buffer<float> slope = make_buffer<float>(count * features);  // gradient before the last ReLU
        for (size_t i = 0; i < count * features; ++i) slope[i] = all.hidden[i] > 0.0f ? at(slopes)[i] : 0.0f;
        const size_t each = gradient_count();
        const Buffer<float> sums = make_buffer<float>(parts * each);
        parallel_for(parts + dense_parts, threads, [&](size_t, size_t item) {
            if (item >= parts) {
                const size_t begin = (item - parts) * DENSE_CHUNK;
                kernels.dense_gradient(shape_, all.second, slope.get(), count, begin,
                                       std::min(begin + DENSE_CHUNK, flat), at(gradients[4]));
                return;
            }
            const size_t begin = item * TRUNK_CHUNK, some = std::min(count - begin, size_t(TRUNK_CHUNK));
            const Buffer<float> scratch = make_buffer<float>(some * flat + shape_.first.written());
            float* mine = sums.get() + item * each;
            std::memset(mine, 0, sizeof(float) * each);
            kernels.backward(shape_, packed.weights, w, at(images) + begin * shape_.first.read(), some,
                             from(shape_, all, begin), slope.get() + begin * features, gradients_at(mine),
                             scratch.get());
        });
        std::memset(at(gradients[5]), 0, sizeof(float) * features);
        for (size_t i = 0; i < count; ++i)
            for (size_t f = 0; f < features; ++f) at(gradients[5])[f] += slope[i * features + f];
        for (size_t part = 1; part < parts; ++part)
            for (size_t i = 0; i < each; ++i) sums[i] += sums[part * each + i];
        const TrunkGradients sum = gradients_at(sums.get());
        unpack(shape_.first, sum.first, at(gradients[0]));
        unpack(shape_.second, sum.second, at(gradients[2]));
        std::memcpy(at(gradients[1]), sum.first_bias, sizeof(float) * size_t(shape_.first.out));
        std::memcpy(at(gradients[3]), sum.second_bias, sizeof(float) * size_t(shape_.second.out));
    }

private:
    TrunkShape shape_;

    static size_t chunks(size_t count) { return (count + TRUNK_CHUNK - 1) / TRUNK_CHUNK; }

    size_t gradient_count() const {
        return shape_.first.weights() + shape_.second.weights() + size_t(shape_.first.out) + size_t(shape_.second.out);
    }

    // The gradients of the convolutions, laid out one after another from `place` on.
    TrunkGradients gradients_at(float* place) const {
        TrunkGradients out{};
        out.first = place;
        out.second = out.first + shape_.first.weights();
        out.first_bias = out.second + shape_.second.weights();
        out.second_bias = out.first_bias + shape_.first.out;
        return out;
    }

    // Call visit(place, row, k, output) for all weights of a convolution: `place` is the index in [out, in, side,
    // side], `row` the row of the window, and `k` the index in that row, [side, in].
    template <class Visit>
    static void each_weight(const Convolution& c, Visit&& visit) {
        size_t place = 0;
        for (int out = 0; out < c.out; ++out)
            for (int in = 0; in < c.in; ++in)
                for (int y = 0; y < c.side; ++y)
                    for (int x = 0; x < c.side; ++x) visit(place++, size_t(y), size_t(x * c.in + in), size_t(out));
    }

    static void unpack(const Convolution& c, const float* packed, float* weights) {
        each_weight(c, [&](size_t place, size_t y, size_t k, size_t out) {
            weights[place] = packed[(y * size_t(c.run()) + k) * size_t(c.out) + out];
        });
    }

    struct Packed {
        Buffer<float> memory;
        PackedTrunk weights;

        Packed(const TrunkShape& shape, const TrunkWeights& given)
            : memory(make_buffer<float>(shape.first.weights() + 2 * shape.second.weights())) {
            float *first = memory.get(), *second = first + shape.first.weights();
            float* back = second + shape.second.weights();
            weights = {first, second, back};
            each_weight(shape.first, [&](size_t place, size_t y, size_t k, size_t out) {
                first[(y * size_t(shape.first.run()) + k) * size_t(shape.first.out) + out] = given.first[place];
            });
            const size_t run = size_t(shape.second.run()), outs = size_t(shape.second.out);
            each_weight(shape.second, [&](size_t place, size_t y, size_t k, size_t out) {
                second[(y * run + k) * outs + out] = back[(y * outs + out) * run + k] = given.second[place];
            });
        }
    };
};

void forward(const std::array<int, 6>& shape, Address images, size_t count, const Addresses& weights,
             const LayerAddresses& layers, size_t threads) {
    Trunk(shape).forward(images, count, weights, layers, threads);
}

void backward(const std::array<int, 6>& shape, Address images, size_t count, const Addresses& weights,
              const LayerAddresses& layers, Address slopes, const Addresses& gradients, size_t threads) {
    Trunk(shape).backward(images, count, weights, layers, slopes, gradients, threads);
}

}  // namespace

void bind_trunk(nb::module_& m) {
    m.def("trunk_forward", &forward);
    m.def("trunk_backward", &backward);
}

}  // namespace splatrl
