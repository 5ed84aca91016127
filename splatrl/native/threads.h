// Work spread over threads that live as long as the call: safe to fork between calls, nothing to shut down.
#pragma once

#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace splatrl {

// Call work(worker, item) for every item in [0, count), from at most `threads` workers numbered from 0.
// The first exception that a worker throws is rethrown here.
template <class Work>
void parallel_for(size_t count, size_t threads, Work&& work) {
    std::atomic<size_t> next{0};
    std::exception_ptr error;
    std::mutex error_mutex;
    auto run = [&](size_t worker) {
        try {
            for (size_t item = next++; item < count; item = next++) work(worker, item);
        } catch (...) {
            const std::lock_guard<std::mutex> lock(error_mutex);
            if (!error) error = std::current_exception();
            next = count;
        }
    };
    std::vector<std::thread> others;
    for (size_t worker = 1; worker < threads && worker < count; ++worker) others.emplace_back(run, worker);
    run(0);
    for (std::thread& other : others) other.join();
    if (error) std::rethrow_exception(error);
}

}  // namespace splatrl
