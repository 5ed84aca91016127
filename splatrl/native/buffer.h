// Uninitialised memory aligned for vector loads.
#pragma once

#include <cstddef>
#include <cstdlib>
#include <memory>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace splatrl {

struct Free {
    void operator()(void* memory) const { std::free(memory); }
};

template <class T>
using Buffer = std::unique_ptr<T[], Free>;

// Large buffers ask for huge pages where the system has them, which makes address translation cheaper for scattered
// access.
template <class T>
Buffer<T> make_buffer(size_t count) {
    constexpr size_t HUGE_PAGE = size_t(1) << 21;
    const size_t bytes = (count > 0 ? count : 1) * sizeof(T), alignment = bytes > HUGE_PAGE / 2 ? HUGE_PAGE : 64;
    void* memory = std::aligned_alloc(alignment, (bytes + alignment - 1) / alignment * alignment);
    if (memory == nullptr) throw std::bad_alloc();
#if defined(__linux__)
    if (alignment == HUGE_PAGE) madvise(memory, bytes, MADV_HUGEPAGE);
#endif
    return Buffer<T>(static_cast<T*>(memory));
}

}  // namespace splatrl
