// The loss of proximal policy optimisation over discrete actions (Schulman et al. 2017, eq. 9) with its gradient, and
// Adam (Kingma and Ba 2015) with gradient clipping, compiled once for each instruction set.
#include "policy.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/registers.h"

namespace splatrl {
namespace SPLATRL_ISA {

static float dot(const float* a, const float* b, size_t count) {
    Register sum{};
    size_t i = 0;
    for (; i + WIDTH <= count; i += WIDTH) sum = sum + get(a + i) * get(b + i);
    float out = total(sum);
    for (; i < count; ++i) out += a[i] * b[i];
    return out;
}

static void add_times(float* __restrict to, const float* __restrict from, float factor, size_t count) {
    for (size_t i = 0; i < count; ++i) to[i] += factor * from[i];
}

// Normalise advantages to mean 0 and standard deviation 1; a single one stays as it is.
static void normalise(const float* advantage, size_t count, float* out) {
    double mean = 0.0, square = 0.0;
    for (size_t i = 0; i < count; ++i) mean += double(advantage[i]);
    mean /= double(count);
    for (size_t i = 0; i < count; ++i) square += (double(advantage[i]) - mean) * (double(advantage[i]) - mean);
    const double spread = count > 1 ? std::max(std::sqrt(square / double(count - 1)), 1e-6) : 1.0;
    for (size_t i = 0; i < count; ++i)
        out[i] = count > 1 ? float((double(advantage[i]) - mean) / spread) : advantage[i];
}

static void loss(const PolicyFrames& frames, const PolicyHeads& heads, const PolicyWeights& weights,
                 const PolicyGradients& out, float* statistics, float* scratch) {
    const size_t count = frames.count, features = frames.features, actions = frames.actions;
    float *advantage = scratch, *logits = scratch + count, *shares = logits + actions;
    normalise(frames.advantage, count, advantage);
    std::memset(out.policy, 0, sizeof(float) * actions * features);
    std::memset(out.policy_bias, 0, sizeof(float) * actions);
    std::memset(out.value, 0, sizeof(float) * features);
    std::memset(out.hidden, 0, sizeof(float) * count * features);
    double sums[POLICY_STATISTICS] = {}, value_bias = 0.0;
    const float each = 1.0f / float(count), least = 1.0f - weights.clip_epsilon, most = 1.0f + weights.clip_epsilon;
    for (size_t n = 0; n < count; ++n) {
        const float* hidden = frames.hidden + n * features;
        float* slope = out.hidden + n * features;
        float highest = -INFINITY, sum = 0.0f, entropy = 0.0f;
        for (size_t a = 0; a < actions; ++a) {
            logits[a] = dot(hidden, heads.policy + a * features, features) + heads.policy_bias[a];
            highest = std::max(highest, logits[a]);
        }
        for (size_t a = 0; a < actions; ++a) sum += std::exp(logits[a] - highest);
        const float whole = highest + std::log(sum);
        for (size_t a = 0; a < actions; ++a) {
            logits[a] -= whole;
            shares[a] = std::exp(logits[a]);
            entropy -= shares[a] * logits[a];
        }
        const size_t chosen = size_t(frames.action[n]);
        const float log_ratio = logits[chosen] - frames.log_prob[n], ratio = std::exp(log_ratio);
        const float clipped = std::min(std::max(ratio, least), most);
        const float free = ratio * advantage[n], held = clipped * advantage[n];
        const float by_log_prob = free <= held ? -each * free : 0.0f;  // clipped ratios have no gradient
        for (size_t a = 0; a < actions; ++a) {
            const float by_logit = by_log_prob * (float(a == chosen) - shares[a]) +
                                   weights.entropy_coeff * each * shares[a] * (logits[a] + entropy);
            add_times(slope, heads.policy + a * features, by_logit, features);
            add_times(out.policy + a * features, hidden, by_logit, features);
            out.policy_bias[a] += by_logit;
        }
        const float off = dot(hidden, heads.value, features) + heads.value_bias[0] - frames.value_target[n];
        const float by_value = weights.critic_coeff * each * std::min(std::max(off, -1.0f), 1.0f);
        add_times(slope, heads.value, by_value, features);
        add_times(out.value, hidden, by_value, features);
        value_bias += double(by_value);
        const float far = std::fabs(off);
        sums[OBJECTIVE] -= double(std::min(free, held));
        sums[CRITIC] += double(weights.critic_coeff * (far < 1.0f ? 0.5f * off * off : far - 0.5f));
        sums[ENTROPY] += double(entropy);
        sums[KL_APPROX] -= double(log_ratio);
        sums[CLIP_FRACTION] += double(clipped != ratio);
    }
    out.value_bias[0] = float(value_bias);
    for (int i = 0; i < POLICY_STATISTICS; ++i) statistics[i] = float(sums[i] / double(count));
}

static void adam(const Moments* tensors, size_t count, const AdamSettings& settings) {
    double square = 0.0;
    for (size_t t = 0; t < count; ++t)
        square += double(dot(tensors[t].gradient, tensors[t].gradient, tensors[t].count));
    const float share = std::min(1.0f, settings.max_norm / (float(std::sqrt(square)) + 1e-6f));
    const float step = settings.rate / settings.correction1, root = 1.0f / std::sqrt(settings.correction2);
    for (size_t t = 0; t < count; ++t) {
        const Moments& tensor = tensors[t];
        float *__restrict values = tensor.values, *__restrict first = tensor.first, *__restrict second = tensor.second;
        const float* __restrict gradient = tensor.gradient;
        for (size_t i = 0; i < tensor.count; ++i) {
            const float g = gradient[i] * share;
            first[i] += (1.0f - settings.beta1) * (g - first[i]);
            second[i] = settings.beta2 * second[i] + (1.0f - settings.beta2) * g * g;
            values[i] -= step * first[i] / (__builtin_sqrtf(second[i]) * root + settings.epsilon);
        }
    }
}

extern const PolicyKernels policy_kernels = {loss, adam};

}  // namespace SPLATRL_ISA
}  // namespace splatrl
