// Uninitialised memory aligned for vector loads.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace splatrl {

// Frees memory. Mapped memory goes straight back to the system, so loading and unloading models leaves no holes.
struct Free {
    size_t mapped = 0;  // bytes

    void operator()(void* memory) const {
#if defined(__linux__)
        if (mapped > 0) {
            munmap(memory, mapped);
            return;
        }
#endif
        std::free(memory);
    }
};

template <class T>
using Buffer = std::unique_ptr<T[], Free>;

#if defined(__linux__)
// Map memory aligned to huge pages, or return null.
inline void* map_huge_pages(size_t bytes, size_t huge_page) {
    void* mapped = mmap(nullptr, bytes + huge_page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (mapped == MAP_FAILED) return nullptr;
    char* first = static_cast<char*>(mapped);
    const size_t before = (huge_page - reinterpret_cast<uintptr_t>(first) % huge_page) % huge_page;
    if (before > 0) munmap(first, before);
    munmap(first + before + bytes, huge_page - before);
    madvise(first + before, bytes, MADV_HUGEPAGE);
    return first + before;
}
#endif

// Allocate a buffer. Large ones request huge pages where the system has them, which makes the address translation of
// scattered accesses cheaper.
template <class T>
Buffer<T> make_buffer(size_t count) {
    constexpr size_t HUGE_PAGE = size_t(1) << 21;
    const size_t bytes = (count > 0 ? count : 1) * sizeof(T), alignment = bytes > HUGE_PAGE / 2 ? HUGE_PAGE : 64;
    const size_t whole = (bytes + alignment - 1) / alignment * alignment;
#if defined(__linux__)
    if (alignment == HUGE_PAGE) {
        void* memory = map_huge_pages(whole, HUGE_PAGE);
        if (memory == nullptr) throw std::bad_alloc();
        return Buffer<T>(static_cast<T*>(memory), Free{whole});
    }
#endif
    void* memory = std::aligned_alloc(alignment, whole);
    if (memory == nullptr) throw std::bad_alloc();
    return Buffer<T>(static_cast<T*>(memory));
}

}  // namespace splatrl
