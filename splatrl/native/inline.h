// Macros for functions that are compiled for the CPU, for CUDA and for the tests' emulator.
#pragma once

#ifdef __CUDACC__
#define HOST_DEVICE __host__ __device__
#define SPLAT_INLINE HOST_DEVICE __forceinline__
#define INLINE_MEMBER SPLAT_INLINE
// Define a function of one float by an instruction of the GPU.
#define HARDWARE(name, instruction)                       \
    SPLAT_INLINE float name(float a) {                    \
        float out;                                        \
        asm(instruction : "=f"(out) : "f"(a));            \
        return out;                                       \
    }
#else
#define HOST_DEVICE
#define SPLAT_INLINE static inline __attribute__((always_inline))
#define INLINE_MEMBER inline __attribute__((always_inline))  // for members of a class
#endif

// Code that kernels compile once for each instruction set is in a namespace for each; otherwise the linker would keep
// one version and use it for all.
#ifdef SPLATRL_ISA
#define SPLATRL_JOINED(a, b) a##b
#define SPLATRL_JOIN(a, b) SPLATRL_JOINED(a, b)
#define EACH_ISA SPLATRL_JOIN(each_, SPLATRL_ISA)
#else
#define EACH_ISA each
#endif
