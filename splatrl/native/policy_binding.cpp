#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "arrays.h"
#include "bindings.h"
#include "buffer.h"
#include "interpreter.h"
#include "policy.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

// The arrays hold addresses. `frames`: hidden, action, log_prob, advantage, value_target. `heads`: weights and bias of
// the policy head, then of the value head. `gradients`: gradients of the heads, in the same order, then of hidden.
void policy_loss(const std::array<Address, 5>& frames, const std::array<size_t, 3>& sizes,
                 const std::array<Address, 4>& heads, float clip_epsilon, float critic_coeff, float entropy_coeff,
                 const std::array<Address, 5>& gradients, Address statistics) {
    const auto [count, features, actions] = sizes;
    if (count < 1 || features < 1 || actions < 1)
        throw std::invalid_argument("sizes: expected count, features and actions of at least 1");
    const int64_t* action = reinterpret_cast<const int64_t*>(frames[1]);
    for (size_t i = 0; i < count; ++i)
        if (action[i] < 0 || size_t(action[i]) >= actions)
            throw std::invalid_argument("action: expected actions in [0, number of actions)");
    const PolicyKernels& kernels = policy_kernels_of(choose_isa());
    const Release release;
    const Buffer<float> scratch = make_buffer<float>(count + 2 * actions);
    kernels.loss({at(frames[0]), action, at(frames[2]), at(frames[3]), at(frames[4]), count, features, actions},
                 {at(heads[0]), at(heads[1]), at(heads[2]), at(heads[3])}, {clip_epsilon, critic_coeff, entropy_coeff},
                 {at(gradients[0]), at(gradients[1]), at(gradients[2]), at(gradients[3]), at(gradients[4])},
                 at(statistics), scratch.get());
}

// `tensors` holds the addresses of each tensor's values, gradient, first moment and second moment.
void adam(const std::vector<std::array<Address, 4>>& tensors, const std::vector<size_t>& counts, double step,
          double rate, double beta1, double beta2, double epsilon, double max_norm) {
    if (tensors.size() != counts.size()) throw std::invalid_argument("counts: expected one count per tensor");
    std::vector<Moments> moments;
    for (size_t i = 0; i < tensors.size(); ++i)
        moments.push_back({at(tensors[i][0]), at(tensors[i][1]), at(tensors[i][2]), at(tensors[i][3]), counts[i]});
    const PolicyKernels& kernels = policy_kernels_of(choose_isa());
    const Release release;
    kernels.adam(moments.data(), moments.size(),
                 {float(rate), float(beta1), float(beta2), float(epsilon), float(max_norm),
                  float(1.0 - std::pow(beta1, step)), float(1.0 - std::pow(beta2, step))});
}

}  // namespace

void bind_policy(nb::module_& m) {
    m.def("policy_loss", &policy_loss);
    m.def("adam", &adam);
}

}  // namespace splatrl
