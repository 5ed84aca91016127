// An index that maps rows of bytes to numbers.
#include <nanobind/nanobind.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <string>
#include <unordered_map>
#include <vector>

#include "bindings.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using Columns = std::vector<std::array<uintptr_t, 3>>;  // address, bytes per row, stride between rows in bytes

// Concatenate a row's bytes from all columns into `key`.
void read_row(const Columns& columns, size_t row, std::string& key) {
    key.clear();
    for (const auto& [address, bytes, stride] : columns)
        key.append(reinterpret_cast<const char*>(address) + row * stride, bytes);
}

class RowIndex {
public:
    // Write the number of each row. Returns the rows that have none, in order and without duplicates; each of them, and
    // every later row with the same bytes, gets -1 - i, where i is its position in what is returned.
    std::vector<size_t> find(const Columns& columns, size_t count, uintptr_t out) const {
        auto* numbers = reinterpret_cast<int64_t*>(out);
        std::vector<size_t> first;
        std::unordered_map<std::string, int64_t> fresh;
        std::string key;
        for (size_t row = 0; row < count; ++row) {
            read_row(columns, row, key);
            if (const auto found = numbers_.find(key); found != numbers_.end()) {
                numbers[row] = found->second;
                continue;
            }
            const auto [place, added] = fresh.emplace(key, -1 - int64_t(first.size()));
            if (added) first.push_back(row);
            numbers[row] = place->second;
        }
        return first;
    }

    // Give these rows, which have no numbers yet, the next ones.
    void add(const Columns& columns, const std::vector<size_t>& rows) {
        std::string key;
        for (size_t row : rows) {
            read_row(columns, row, key);
            numbers_.emplace(key, int64_t(numbers_.size()));
        }
    }

    size_t size() const { return numbers_.size(); }

private:
    std::unordered_map<std::string, int64_t> numbers_;
};

}  // namespace

void bind_row_index(nb::module_& m) {
    nb::class_<RowIndex>(m, "RowIndex")
        .def(nb::init<>())
        .def("find", &RowIndex::find)
        .def("add", &RowIndex::add)
        .def("__len__", &RowIndex::size);
}

}  // namespace splatrl
