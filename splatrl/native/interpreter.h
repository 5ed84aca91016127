// Python's interpreter while the core works: its lock, its signals, and its end.
#pragma once

#include <nanobind/nanobind.h>

#include <optional>

namespace splatrl {

// Lets other Python threads run until the end of a block. Once the interpreter ends, it does nothing: a daemon thread
// that waited for the lock then would be torn down in the middle of C++, which aborts the process.
class Release {
public:
    Release();
    ~Release();
    Release(const Release&) = delete;
    Release& operator=(const Release&) = delete;

private:
    std::optional<nanobind::gil_scoped_release> release_;
};

}  // namespace splatrl
