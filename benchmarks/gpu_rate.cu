// What the arithmetic of a GPU can do: nothing but fused multiply-adds, in chains that do not wait for each other.
#include "platform.h"

extern "C" __global__ void multiply_add(float* out, int rounds, float factor, float term) {
    float value[CHAINS];
    for (int i = 0; i < CHAINS; ++i) value[i] = float(threadIdx.x + i);
    for (int round = 0; round < rounds; ++round)
#pragma unroll
        for (int step = 0; step < STEPS; ++step)
#pragma unroll
            for (int i = 0; i < CHAINS; ++i) value[i] = value[i] * factor + term;
    float sum = 0.0f;
    for (int i = 0; i < CHAINS; ++i) sum += value[i];
    out[size_t(blockIdx.x) * blockDim.x + threadIdx.x] = sum;
}
