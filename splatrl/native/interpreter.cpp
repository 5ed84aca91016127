#include "interpreter.h"

#include <atomic>
#include <chrono>
#include <stdexcept>
#include <thread>

#if !defined(_WIN32)
#include <pthread.h>
#endif

#include "bindings.h"
#include "threads.h"

namespace nb = nanobind;

namespace splatrl {

namespace {

using namespace std::chrono_literals;

std::atomic<int> released{0};  // calls that are running without the GIL
std::atomic<bool> ending{false};

// Handles signals at most ten times a second, so that Ctrl-C interrupts long work, and stops work that runs without the
// GIL once the interpreter is shutting down.
void answer() {
    static thread_local std::chrono::steady_clock::time_point last;
    const auto now = std::chrono::steady_clock::now();
    if (now - last < 100ms) return;
    last = now;
    if (ending && !PyGILState_Check()) throw std::runtime_error("interrupted: Python is shutting down");
    const nb::gil_scoped_acquire held;
    if (PyErr_CheckSignals() != 0) throw nb::python_error();
}

// Runs as Python exits, before daemon threads lose the GIL for good: waits until no call is running without it.
void end() {
    ending = true;
    const nb::gil_scoped_release release;
    while (released > 0) std::this_thread::sleep_for(1ms);
}

}  // namespace

Release::Release() {
    if (ending) return;
    ++released;
    release_.emplace();
}

Release::~Release() {
    if (!release_) return;
    release_.reset();
    --released;
}

void bind_interpreter(nb::module_&) {
    on_poll = answer;
    nb::module_::import_("atexit").attr("register")(nb::cpp_function(&end));
#if !defined(_WIN32)
    pthread_atfork(nullptr, nullptr, [] { released = 0; });  // a child has none of the other threads
#endif
}

}  // namespace splatrl
