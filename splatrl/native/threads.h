// Parallel loops on threads that live only as long as the call: it is safe to fork between calls, and there is nothing
// to shut down.
#pragma once

#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace splatrl {

// A callback that the calling thread invokes now and then during long work, and that may throw to end it. Set by
// interpreter.cpp.
inline void (*on_poll)() = nullptr;

inline void poll() {
    if (on_poll != nullptr) on_poll();
}

struct Joined {
    std::vector<std::thread> threads;
    ~Joined() {
        for (std::thread& thread : threads) thread.join();
    }
};

// Call work(worker, item) for every item in [0, count), on at most `threads` workers numbered from 0, or fewer if the
// system cannot start as many. The first exception that a worker throws is rethrown here.
template <class Work>
void parallel_for(size_t count, size_t threads, Work&& work) {
    std::atomic<size_t> next{0};
    std::exception_ptr error;
    std::mutex error_mutex;
    auto run = [&](size_t worker) {
        try {
            for (size_t item = next++; item < count; item = next++) {
                work(worker, item);
                if (worker == 0) poll();
            }
        } catch (...) {
            const std::lock_guard<std::mutex> lock(error_mutex);
            if (!error) error = std::current_exception();
            next = count;
        }
    };
    {
        Joined others;
        try {
            for (size_t worker = 1; worker < threads && worker < count; ++worker)
                others.threads.emplace_back(run, worker);
        } catch (const std::exception&) {  // out of threads or memory: the running workers take all items
        }
        run(0);
    }
    if (error) std::rethrow_exception(error);
}

}  // namespace splatrl
