// Arithmetic on numbers and vectors for the collision code, in double precision, for CPU and GPU.
#pragma once

#include <cstddef>
#include <cstdint>

#include "inline.h"

#ifndef __CUDACC__
#include <cmath>
#include <limits>
#endif

namespace splatrl {

#ifdef __CUDACC__
constexpr double INFINITE = __builtin_bit_cast(double, 0x7ff0000000000000ull);  // the only form that NVRTC accepts
#else
constexpr double INFINITE = std::numeric_limits<double>::infinity();
#endif

SPLAT_INLINE double min(double a, double b) { return b < a ? b : a; }
SPLAT_INLINE double max(double a, double b) { return a < b ? b : a; }
SPLAT_INLINE double clamp(double value, double low, double high) { return min(max(value, low), high); }
SPLAT_INLINE int min(int a, int b) { return b < a ? b : a; }
SPLAT_INLINE int max(int a, int b) { return a < b ? b : a; }

// Floor of a number that fits an int; the library's version is a function call if the target has no instruction for it.
SPLAT_INLINE int floor_of(double value) {
    const int whole = int(value);
    return whole - (value < whole);
}

SPLAT_INLINE int ceil_of(double value) { return -floor_of(-value); }

// Round a number that is not negative down to a float.
SPLAT_INLINE float rounded_down(double value) {
    const float nearest = float(value);
    return double(nearest) > value ? nextafterf(nearest, 0.0f) : nearest;
}

struct Vec3 {
    double at[3];

    HOST_DEVICE double& operator[](int i) { return at[i]; }
    HOST_DEVICE const double& operator[](int i) const { return at[i]; }
};

struct Mat3 {
    Vec3 rows[3];

    HOST_DEVICE Vec3& operator[](int i) { return rows[i]; }
    HOST_DEVICE const Vec3& operator[](int i) const { return rows[i]; }
};

SPLAT_INLINE double dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
SPLAT_INLINE double norm(const Vec3& a) { return sqrt(dot(a, a)); }
SPLAT_INLINE Vec3 cross(const Vec3& a, const Vec3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
SPLAT_INLINE Vec3 between(const Vec3& from, const Vec3& to) {
    return {to[0] - from[0], to[1] - from[1], to[2] - from[2]};
}
SPLAT_INLINE Vec3 along(const Vec3& p, const Vec3& d, double t) {
    return {p[0] + t * d[0], p[1] + t * d[1], p[2] + t * d[2]};
}
SPLAT_INLINE Vec3 column_of(const Mat3& matrix, int i) { return {matrix[0][i], matrix[1][i], matrix[2][i]}; }
SPLAT_INLINE bool same(const Mat3& a, const Mat3& b) {
    bool out = true;
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) out = out && a[i][k] == b[i][k];
    return out;
}

}  // namespace splatrl
