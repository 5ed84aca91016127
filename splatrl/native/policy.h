// A gradient step of a policy over discrete actions: the loss of proximal policy optimisation (PPO), and Adam.
#pragma once

#include <cstddef>
#include <cstdint>

#include "isa.h"

namespace splatrl {

struct PolicyFrames {
    const float* hidden;        // [count, features]
    const int64_t* action;      // [count]
    const float *log_prob, *advantage, *value_target;  // [count]
    size_t count, features, actions;
};

// Weights and biases of two linear layers: policy [actions, features] and [actions], value [features] and [1].
struct PolicyHeads {
    const float *policy, *policy_bias, *value, *value_bias;
};

struct PolicyGradients {
    float *policy, *policy_bias, *value, *value_bias, *hidden;
};

struct PolicyWeights {
    float clip_epsilon, critic_coeff, entropy_coeff;
};

enum PolicyStatistic { OBJECTIVE, CRITIC, ENTROPY, KL_APPROX, CLIP_FRACTION, POLICY_STATISTICS };

// A tensor, its gradient, and the moments that Adam keeps of it.
struct Moments {
    float* values;
    const float* gradient;
    float *first, *second;
    size_t count;
};

struct AdamSettings {
    float rate, beta1, beta2, epsilon, max_norm;
    float correction1, correction2;  // 1 - beta^step
};

struct PolicyKernels {
    // Write the gradients of the loss and its statistics. `scratch` has room for [count + 2 · actions].
    void (*loss)(const PolicyFrames&, const PolicyHeads&, const PolicyWeights&, const PolicyGradients&,
                 float* statistics, float* scratch);
    // Clip the joint norm of the gradients of all tensors, and take a step.
    void (*adam)(const Moments*, size_t count, const AdamSettings&);
};

namespace portable { extern const PolicyKernels policy_kernels; }
namespace avx2 { extern const PolicyKernels policy_kernels; }
namespace avx512 { extern const PolicyKernels policy_kernels; }

const PolicyKernels& policy_kernels_of(Isa isa);

}  // namespace splatrl
