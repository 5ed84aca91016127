// Functions that the CPU, CUDA and the tests' emulator all compile.
#pragma once

#ifdef __CUDACC__
#define HOST_DEVICE __host__ __device__
#define SPLAT_INLINE HOST_DEVICE __forceinline__
#else
#define HOST_DEVICE
#define SPLAT_INLINE static inline __attribute__((always_inline))
#endif
