// Threads that share the loops over the coordinates of one large member. What they compute does not depend on their
// number, since each element is computed by one of them as by a single thread.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

namespace coadjoint {

constexpr int64_t LEAST_SHARED = 1024;  // elements from which on threads may share them

class ThreadTeam {
  public:
    // `threads` includes the calling thread; there are fewer if the system starts no more.
    explicit ThreadTeam(int64_t threads) {
        try {
            for (int64_t number = 1; number < threads; ++number)
                others.emplace_back([this, number] { serve(number); });
        } catch (const std::system_error&) {
        }
    }

    ~ThreadTeam() {
        {
            std::lock_guard<std::mutex> lock(mutex);
            ended = true;
            job_number.fetch_add(1, std::memory_order_release);
        }
        wake.notify_all();
        for (std::thread& other : others) other.join();
    }

    ThreadTeam(const ThreadTeam&) = delete;
    ThreadTeam& operator=(const ThreadTeam&) = delete;

    // Call `visit(first, last)` for slices of 0 to count - 1, on all threads; it must not throw. Few elements are one
    // slice.
    template <class Visit>
    void each(int64_t count, const Visit& visit) {
        if (count < LEAST_SHARED) return visit(int64_t(0), count);
        job = [](const void* at, int64_t first, int64_t last) { (*static_cast<const Visit*>(at))(first, last); };
        context = &visit, total = count;
        left.store(int64_t(others.size()), std::memory_order_relaxed);
        {
            std::lock_guard<std::mutex> lock(mutex);
            job_number.fetch_add(1, std::memory_order_release);
        }
        wake.notify_all();
        take_slice(0);
        for (int spins = 0; left.load(std::memory_order_acquire) > 0; ++spins)
            if (spins > SPINS) std::this_thread::yield();
    }

  private:
    typedef void (*Job)(const void*, int64_t, int64_t);
    static constexpr int64_t ALIGNED = 64;  // slices begin at multiples: of registers and of cache lines
    static constexpr int SPINS = 1 << 12;   // polls before a thread sleeps
    std::vector<std::thread> others;
    std::mutex mutex;
    std::condition_variable wake;
    std::atomic<uint64_t> job_number{0};
    std::atomic<int64_t> left{0};
    Job job = nullptr;
    const void* context = nullptr;
    int64_t total = 0;
    bool ended = false;

    void take_slice(int64_t number) const {
        const int64_t threads = int64_t(others.size()) + 1, blocks = (total + ALIGNED - 1) / ALIGNED;
        const int64_t first = std::min(total, blocks * number / threads * ALIGNED);
        const int64_t last = std::min(total, blocks * (number + 1) / threads * ALIGNED);
        if (first < last) job(context, first, last);
    }

    void serve(int64_t number) {
        uint64_t done = 0;
        while (true) {
            int spins = 0;
            while (job_number.load(std::memory_order_acquire) == done && spins < SPINS) ++spins;
            if (spins == SPINS) {
                std::unique_lock<std::mutex> lock(mutex);
                wake.wait(lock, [&] { return job_number.load(std::memory_order_acquire) != done; });
            }
            done = job_number.load(std::memory_order_acquire);
            if (ended) return;
            take_slice(number);
            left.fetch_sub(1, std::memory_order_release);
        }
    }
};

// Whether the team takes part in a step: of every 64 steps two are taken without it and two with it, and the others as
// was faster, on this machine and with its present load.
class SharedSteps {
  public:
    // Return whether the next step is shared.
    bool begin() {
        const int64_t trial = number++ % REPEATED;
        if (trial == 0) least[0] = least[1] = std::chrono::steady_clock::duration::max();
        shared = trial < 2 * TRIALS ? trial >= TRIALS : least[1] < least[0];
        begun = std::chrono::steady_clock::now();
        return shared;
    }

    // The step is done.
    void end() { least[shared] = std::min(least[shared], std::chrono::steady_clock::now() - begun); }

  private:
    static constexpr int64_t REPEATED = 64, TRIALS = 2;
    int64_t number = 0;
    bool shared = false;
    std::chrono::steady_clock::time_point begun;
    std::chrono::steady_clock::duration least[2];
};

}  // namespace coadjoint
