// Copies of batches in which some rows are replaced.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "bindings.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

// `tensors` holds, for each tensor, the addresses of the old, the fresh and the written values, and the size of the
// latter in bytes.
void with_rows(const std::vector<std::array<uintptr_t, 4>>& tensors, uintptr_t rows, size_t some, size_t count) {
    const auto* places = reinterpret_cast<const int64_t*>(rows);
    for (size_t i = 0; i < some; ++i)
        if (places[i] < 0 || size_t(places[i]) >= count)
            throw std::invalid_argument("rows: expected row indices of the batch");
    for (const auto& [old, fresh, out, size] : tensors) {
        auto* written = reinterpret_cast<char*>(out);
        const size_t bytes = count > 0 ? size / count : 0;  // per row
        std::memcpy(written, reinterpret_cast<const char*>(old), size);
        for (size_t i = 0; i < some; ++i)
            std::memcpy(written + size_t(places[i]) * bytes, reinterpret_cast<const char*>(fresh) + i * bytes, bytes);
    }
}

}  // namespace

void bind_rows(nb::module_& m) {
    m.def("with_rows", &with_rows);
}

}  // namespace splatrl
