// The memory layout of a scene for CUDA, shared by flat_scene.cpp and cuda/.
#pragma once

namespace splatrl {

constexpr int SPHERE = 4;   // floats: mean; two half floats, rounded up: the most standard deviations at which the
                            // Gaussian is visible (low bits), and that times its longest axis, metres (high bits)
constexpr int SHAPE = 12;   // floats: mean; log2 opacity; the factor of the covariance without its upper triangle,
                            // which is zero; members and sum if merged

constexpr int harmonics_of(int degree) { return (degree + 1) * (degree + 1); }

// Half floats per colour, padded to whole 16-byte words.
constexpr int color_stride(int degree) { return (3 * harmonics_of(degree) + 7) / 8 * 8; }

}  // namespace splatrl
