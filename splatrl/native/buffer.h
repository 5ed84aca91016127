// Uninitialised memory aligned for vector loads.
#pragma once

#include <cstddef>
#include <memory>
#include <new>

namespace splatrl {

struct AlignedDelete {
    void operator()(void* memory) const { ::operator delete(memory, std::align_val_t(64)); }
};

template <class T>
using Buffer = std::unique_ptr<T[], AlignedDelete>;

template <class T>
Buffer<T> make_buffer(size_t count) {
    const size_t bytes = (count > 0 ? count : 1) * sizeof(T);
    return Buffer<T>(static_cast<T*>(::operator new(bytes, std::align_val_t(64))));
}

}  // namespace splatrl
