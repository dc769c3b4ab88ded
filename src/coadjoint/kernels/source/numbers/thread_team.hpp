// Threads that share the loops over the coordinates of one large member. What they compute does not depend on their
// number: each element is computed by one of them as by a single thread, and sums are those of blocks of fixed length.
#pragma once

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#if !defined(_WIN32)
#include <pthread.h>
#endif

#include "numbers/aligned_array.hpp"
#include "numbers/float_mode.hpp"
#include "numbers/lanes.hpp"

namespace coadjoint {

constexpr int64_t LEAST_SHARED = 1024;  // elements from which on threads may share them
constexpr int64_t SUMMED = 4096;         // elements of a block of a sum

// A reference to a function, which must outlive it: code that calls it is compiled once, not for each function.
template <class Signature>
class Called;
template <class Result, class... Arguments>
class Called<Result(Arguments...)> {
  public:
    template <class Function>
    INLINE Called(const Function& function)
        : context(&function), call([](const void* at, Arguments... arguments) -> Result {
              return (*static_cast<const Function*>(at))(arguments...);
          }) {}
    INLINE Result operator()(Arguments... arguments) const { return call(context, arguments...); }

  private:
    const void* context;
    Result (*call)(const void*, Arguments...);
};

typedef Called<void(int64_t, int64_t)> CalledForSlices;

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

    // Call `visit(first, last)` for slices of 0 to count - 1, on all threads; it must not throw. Slices begin at
    // multiples of `aligned`.
    void each(int64_t count, int64_t aligned, const CalledForSlices& visit) {
        job = &visit, total = count, multiple = aligned, mode = float_mode();
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
    static constexpr int SPINS = 1 << 12, MOST_SPINS = 1 << 18;  // polls before a thread yields, and before it sleeps
    std::vector<std::thread> others;
    std::mutex mutex;
    std::condition_variable wake;
    std::atomic<uint64_t> job_number{0};
    std::atomic<int64_t> left{0};
    const CalledForSlices* job = nullptr;
    int64_t total = 0, multiple = 1;
    FloatMode mode = STANDARD_MODE;
    bool ended = false;

    void take_slice(int64_t number) const {
        const int64_t threads = int64_t(others.size()) + 1, blocks = (total + multiple - 1) / multiple;
        const int64_t first = std::min(total, blocks * number / threads * multiple);
        const int64_t last = std::min(total, blocks * (number + 1) / threads * multiple);
        if (first < last) (*job)(first, last);
    }

    void serve(int64_t number) {
        uint64_t done = 0;
        while (true) {
            // Steps have parts that are not shared, and waking takes longer than they do.
            int spins = 0;
            while (job_number.load(std::memory_order_acquire) == done && spins < MOST_SPINS)
                if (++spins % SPINS == 0) std::this_thread::yield();
            if (spins == MOST_SPINS) {
                std::unique_lock<std::mutex> lock(mutex);
                wake.wait(lock, [&] { return job_number.load(std::memory_order_acquire) != done; });
            }
            done = job_number.load(std::memory_order_acquire);
            if (ended) return;
            set_float_mode(mode);
            take_slice(number);
            left.fetch_sub(1, std::memory_order_release);
        }
    }
};

// The team that shares the loops of this thread, if any: that of the member whose step it takes.
inline thread_local ThreadTeam* team_of_this_thread = nullptr;

constexpr int64_t ALIGNED = 64;  // slices begin at multiples: of registers and of cache lines

NOINLINE inline void share_among(ThreadTeam& team, int64_t count, int64_t aligned, const CalledForSlices& visit) {
    team_of_this_thread = nullptr;  // loops inside are not shared again
    team.each(count, aligned, visit);
    team_of_this_thread = &team;
}

// Call `visit(first, last)` for slices of 0 to count - 1, on the threads of the team if there is one; it must not throw.
template <int64_t aligned = ALIGNED, class Visit>
INLINE void share(int64_t count, const Visit& visit) {
    if (__builtin_expect(count >= LEAST_SHARED && team_of_this_thread, 0))
        return share_among(*team_of_this_thread, count, aligned, visit);
    visit(int64_t(0), count);
}

// The same for few blocks of many elements.
template <class Visit>
INLINE void share_blocks(int64_t blocks, const Visit& visit) {
    if (team_of_this_thread) return share_among(*team_of_this_thread, blocks, 1, visit);
    visit(int64_t(0), blocks);
}

// Call `visit(memory, i)` for all i below `count`. Each thread of a team has a copy of the memory.
template <class Memory, class Visit>
inline void share_with_copies(Memory& memory, int64_t count, const Visit& visit) {
    const auto each = [&](Memory& own, int64_t first, int64_t last) {
        for (int64_t i = first; i < last; ++i) visit(own, i);
    };
    if (!team_of_this_thread) return each(memory, 0, count);
    share_blocks(count, [&](int64_t first, int64_t last) {
        Memory own(memory);
        each(own, first, last);
    });
}

// The sum of `part(first, last)` over blocks of `summed` elements, added in their order.
template <class A>
NOINLINE A sum_of_blocks(int64_t count, int64_t summed, const Called<A(int64_t, int64_t)>& part) {
    const int64_t blocks = (count + summed - 1) / summed;
    AlignedArray<A> sums(blocks);
    const auto fill = [&](int64_t first, int64_t last) {
        for (int64_t b = first; b < last; ++b) sums.at[b] = part(b * summed, std::min(count, (b + 1) * summed));
    };
    share_blocks(blocks, fill);
    A total(0.0);
    for (int64_t b = 0; b < blocks; ++b) total = total + sums.at[b];
    return total;
}

template <class A, int64_t summed = SUMMED, class Part>
INLINE A shared_sum(int64_t count, const Part& part) {
    if (__builtin_expect(count > summed, 0)) return sum_of_blocks<A>(count, summed, part);
    return part(int64_t(0), count);
}

// Let `part(first, last, to)` continue `number` results that begin with zeros, over blocks, and `join(to, more)` join
// them in their order.
template <class A>
NOINLINE void shared_results(int64_t count, int64_t number, A* results, const Called<void(int64_t, int64_t, A*)>& part,
                             const Called<void(A*, const A*)>& join) {
    if (count <= SUMMED) return part(int64_t(0), count, results);
    const int64_t blocks = (count + SUMMED - 1) / SUMMED;
    AlignedArray<A> of_blocks(blocks * number);
    share_blocks(blocks, [&](int64_t first, int64_t last) {
        for (int64_t b = first; b < last; ++b)
            part(b * SUMMED, std::min(count, (b + 1) * SUMMED), of_blocks.at + b * number);
    });
    for (int64_t b = 0; b < blocks; ++b) join(results, of_blocks.at + b * number);
}

template <class A>
inline void shared_copy(const A* from, int64_t count, A* to) {
    share(count, [=](int64_t first, int64_t last) { std::copy(from + first, from + last, to + first); });
}

// A team, and how long the last steps took without and with it. One waits for the next call, since threads take time
// to start, and a call may take one step only.
struct MeasuredTeam {
    const int64_t threads, size;
    std::unique_ptr<ThreadTeam> team;  // made when a step is shared
    int64_t number = 0, followed = 0;
    std::chrono::steady_clock::duration least[2] = {};
};

inline std::atomic<MeasuredTeam*> idle_team{nullptr};

inline MeasuredTeam* take_team(int64_t threads, int64_t size) {
#if !defined(_WIN32)
    static const int once = pthread_atfork(nullptr, nullptr, [] { idle_team.store(nullptr); });  // it has no threads there
    (void)once;
#endif
    std::unique_ptr<MeasuredTeam> idle(idle_team.exchange(nullptr));
    if (idle && idle->threads == threads && idle->size == size) return idle.release();
    return new MeasuredTeam{threads, size, idle && idle->threads == threads ? std::move(idle->team) : nullptr};
}

// The steps of one member, of `size` coordinates, and the threads that may share them: of every 64 steps two are taken
// without the team and two with it, and the others as was faster, on this machine and with its present load. Without a
// team of its own a loop that another loop calls is shared by that of the other.
class SharedSteps {
  public:
    SharedSteps(int64_t threads, int64_t size) {
        threads = std::min(threads, 2 * size / LEAST_SHARED);
        if (threads > 1) measured.reset(take_team(threads, size));
    }
    ~SharedSteps() {
        team_of_this_thread = outer;
        if (measured) delete idle_team.exchange(measured.release());
    }
    SharedSteps(const SharedSteps&) = delete;
    SharedSteps& operator=(const SharedSteps&) = delete;

    // A step begins: until its end, the loops of this thread are shared, or not.
    INLINE void begin() {
        if (__builtin_expect(measured != nullptr, 0)) decide();
    }
    INLINE void end() {
        if (__builtin_expect(measured != nullptr, 0)) measure();
    }
    // A step of another kind begins, which is shared as the measured ones, and two of every 64 in any case.
    INLINE void begin_as_measured() {
        if (__builtin_expect(measured != nullptr, 0) && measured->team &&
            (measured->followed++ % REPEATED < TRIALS || measured->least[1] < measured->least[0]))
            team_of_this_thread = measured->team.get();
    }
    INLINE void end_as_measured() { team_of_this_thread = outer; }

  private:
    // Calls after which both ways are measured again, and measurements of each.
    static constexpr int64_t REPEATED = 64, TRIALS = 2;
    std::unique_ptr<MeasuredTeam> measured;
    ThreadTeam* const outer = team_of_this_thread;
    bool shared = false;
    std::chrono::steady_clock::time_point begun;

    NOINLINE void decide() {
        auto& least = measured->least;
        const int64_t trial = measured->number++ % REPEATED;
        if (trial == 0) least[0] = least[1] = std::chrono::steady_clock::duration::max();
        shared = trial < 2 * TRIALS ? trial >= TRIALS : least[1] < least[0];
        if (shared && !measured->team) measured->team = std::make_unique<ThreadTeam>(measured->threads);
        team_of_this_thread = shared ? measured->team.get() : outer;
        begun = std::chrono::steady_clock::now();
    }

    NOINLINE void measure() {
        auto& least = measured->least;
        least[shared] = std::min(least[shared], std::chrono::steady_clock::now() - begun);
        team_of_this_thread = outer;
    }
};

}  // namespace coadjoint
