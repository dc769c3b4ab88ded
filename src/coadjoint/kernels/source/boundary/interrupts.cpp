// Python's global lock and signals in compiled loops.
#include "boundary/interrupts.hpp"

#include <atomic>
#include <cstdlib>
#include <thread>

#ifndef _WIN32
#include <pthread.h>
#endif

#include "boundary/tables.hpp"

namespace coadjoint {

namespace {

// Operations between two checks: some milliseconds at most.
constexpr int64_t CHECK_INTERVAL = int64_t(1) << 20;
constexpr std::chrono::milliseconds SIGNAL_INTERVAL(50);

// PyEval_SaveThread, PyEval_RestoreThread, PyErr_CheckSignals and Py_IsFinalizing, if there is a Python.
struct Python {
    void* (*release)();
    void (*acquire)(void*);
    int (*signals)();
    int (*finalizing)();
} python{};

std::atomic<int64_t> running{0};  // calls whose threads are not suspended
std::atomic<bool> exiting{false};
thread_local bool in_finalizer = false;  // this thread finalizes the interpreter, and still runs Python

// The interpreter finalizes while a daemon thread is inside a loop. Acquiring Python's lock would now end the thread by
// an unwinding that no destructor survives, so the thread sleeps until the process exits.
[[noreturn]] void suspend() {
    --running;
    for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
}

void suspend_at_exit() {
    if (exiting.load(std::memory_order_relaxed) || (python.finalizing && python.finalizing() && !in_finalizer))
        suspend();
}

// Called with Python's lock; during finalization only the finalizing thread holds it.
void* release() {
    in_finalizer = python.finalizing && python.finalizing();
    ++running;
    return python.release ? python.release() : nullptr;
}

void acquire(void* thread) {
    suspend_at_exit();
    try {
        python.acquire(thread);
    } catch (...) {  // pthread_exit by a Python that began to finalize while this thread waited for its lock
        suspend();
    }
}

#ifndef _WIN32
// Longest wait for loops of other threads at process exit.
constexpr std::chrono::milliseconds EXIT_TIMEOUT(2000);

// Machine code of the user and BLAS are unloaded after this, so no loop may be inside of them. Windows ends the threads
// before it unloads anything.
void wait_for_loops() {
    exiting = true;
    const auto last = std::chrono::steady_clock::now() + EXIT_TIMEOUT;
    while (running > 0 && std::chrono::steady_clock::now() < last)
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

void reset_after_fork() { running = 0; }
#endif

}  // namespace

thread_local InterruptCheck* InterruptCheck::current = nullptr;

InterruptCheck::InterruptCheck(const int64_t* stop)
    : stop(stop), mode(float_mode()), thread(release()), outer(current) {
    left = CHECK_INTERVAL;
    current = this;
    set_float_mode(mode_of_loops);
}

InterruptCheck::~InterruptCheck() {
    current = outer;
    set_float_mode(mode);
    if (python.acquire) acquire(thread);
    --running;
}

void InterruptCheck::check() {
    left = CHECK_INTERVAL;
    suspend_at_exit();
    const Clock::time_point now = Clock::now();
    // A short call does not read the clock, which would take it a twentieth longer.
    const bool first = next == Clock::time_point{};
    if (now < next) return;
    next = now + SIGNAL_INTERVAL;
    if (first) return;
    if (__atomic_load_n(stop, __ATOMIC_RELAXED)) throw Interrupted();
    if (!python.signals) return;
    acquire(thread);
    // An exception raised by a handler stays pending until the call returns to Python.
    const int raised = python.signals();
    thread = python.release();
    set_float_mode(mode_of_loops);  // a handler may have changed it
    if (raised) throw Interrupted();
}

// For steps compiled separately: Python passes the result to their `import_interrupts`.
EXPORT const InterruptFunctions* interrupt_functions() {
    static const InterruptFunctions exported{InterruptCheck::current_call, InterruptCheck::check_now};
    return &exported;
}

// Called once, before the loops, which are then called with Python's lock.
EXPORT void set_python_callbacks(void* (*release)(), void (*acquire)(void*), int (*signals)(), int (*finalizing)()) {
    python = {release, acquire, signals, finalizing};
#ifndef _WIN32
    std::atexit(wait_for_loops);
    pthread_atfork(nullptr, nullptr, reset_after_fork);
#endif
}

}  // namespace coadjoint
