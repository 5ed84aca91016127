// Functions that the CPU, CUDA and the tests' emulator all compile.
#pragma once

#ifdef __CUDACC__
#define HOST_DEVICE __host__ __device__
#define SPLAT_INLINE HOST_DEVICE __forceinline__
#define INLINE_MEMBER SPLAT_INLINE
// A function of one float, in the GPU's own instructions.
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

// What kernels compile anew for each instruction set is in a namespace of its own, or the linker would keep one of them
// for all.
#ifdef SPLATRL_ISA
#define SPLATRL_JOINED(a, b) a##b
#define SPLATRL_JOIN(a, b) SPLATRL_JOINED(a, b)
#define EACH_ISA SPLATRL_JOIN(each_, SPLATRL_ISA)
#else
#define EACH_ISA each
#endif
