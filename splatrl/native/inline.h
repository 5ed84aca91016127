// Functions that the CPU, CUDA and the tests' emulator all compile.
#pragma once

#ifdef __CUDACC__
#define HOST_DEVICE __host__ __device__
#define SPLAT_INLINE HOST_DEVICE __forceinline__
#define INLINE_MEMBER SPLAT_INLINE
#else
#define HOST_DEVICE
#define SPLAT_INLINE static inline __attribute__((always_inline))
#define INLINE_MEMBER inline __attribute__((always_inline))  // of a class
#endif
