// How a scene lies in memory for CUDA, in flat_scene.cpp and cuda/.
#pragma once

namespace splatrl {

constexpr int SPHERE = 4;   // floats: mean; two half floats, rounded up: the most standard deviations at which the
                            // Gaussian shows (low bits), and that times its longest axis, metres (high bits)
constexpr int SHAPE = 12;   // floats: mean; log2 opacity; the factor of the covariance, whose upper triangle is zero and
                            // left out; members and sum if merged

constexpr int harmonics_of(int degree) { return (degree + 1) * (degree + 1); }

// Half floats per colour, padded to whole words of sixteen bytes.
constexpr int color_stride(int degree) { return (3 * harmonics_of(degree) + 7) / 8 * 8; }

}  // namespace splatrl
