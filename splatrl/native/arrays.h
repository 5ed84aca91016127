// Arrays that are passed between Python and C++.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <vector>

namespace splatrl {

// Address of an array, as Python passes it for memory that another library owns.
using Address = uintptr_t;

template <class T = float>
T* at(Address address) {
    return reinterpret_cast<T*>(address);
}

// A C-contiguous array in main memory with this shape; -1 matches any size.
template <class T, long... SHAPE>
using Tensor = nanobind::ndarray<T, nanobind::shape<SHAPE...>, nanobind::c_contig, nanobind::device::cpu>;

// Move values into a numpy array of this shape, which then owns them.
template <class T>
nanobind::ndarray<nanobind::numpy, T> to_numpy(std::vector<T> values, std::initializer_list<size_t> shape) {
    auto* kept = new std::vector<T>(std::move(values));
    const nanobind::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return nanobind::ndarray<nanobind::numpy, T>(kept->data(), shape, owner);
}

}  // namespace splatrl
