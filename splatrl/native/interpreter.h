// The Python interpreter while the core works: its global lock (GIL), its signals and its shutdown.
#pragma once

#include <nanobind/nanobind.h>

#include <optional>

namespace splatrl {

// Releases the GIL until the end of a scope. Does nothing once the interpreter is shutting down: a daemon thread that
// then waited for the GIL would be torn down in the middle of C++ code, which aborts the process.
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
