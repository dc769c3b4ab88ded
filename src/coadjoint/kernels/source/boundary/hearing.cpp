// Python's lock and its signals, as far as loops have to do with them.
#include "boundary/hearing.hpp"

#include "boundary/tables.hpp"

namespace coadjoint {

namespace {

constexpr int64_t BETWEEN_LOOKS = int64_t(1) << 20;
constexpr std::chrono::milliseconds BETWEEN_SIGNALS(50);

// PyEval_SaveThread, PyEval_RestoreThread and PyErr_CheckSignals, where there is a Python.
struct Python {
    void* (*release)();
    void (*acquire)(void*);
    int (*signals)();
} python{};

}  // namespace

thread_local Hearing* Hearing::current = nullptr;

Hearing::Hearing(const int64_t* stop)
    : stop(stop),
      thread(python.release ? python.release() : nullptr),
      outer(current),
      next(Clock::now() + BETWEEN_SIGNALS) {
    left = BETWEEN_LOOKS;
    current = this;
}

Hearing::~Hearing() {
    current = outer;
    if (python.acquire) python.acquire(thread);
}

void Hearing::look() {
    left = BETWEEN_LOOKS;
    const Clock::time_point now = Clock::now();
    if (now < next) return;
    next = now + BETWEEN_SIGNALS;
    if (__atomic_load_n(stop, __ATOMIC_RELAXED)) throw Interrupted();
    if (!python.signals) return;
    python.acquire(thread);
    // What a handler raises stays raised, and Python sees it when the call returns.
    const int raised = python.signals();
    thread = python.release();
    if (raised) throw Interrupted();
}

// For steps that are compiled apart: Python hands it to their `borrow`.
EXPORT const Lent* lent_to_others() {
    static const Lent lent{Hearing::now_heard, Hearing::look_at};
    return &lent;
}

// Called once, before the loops: they are then called with Python's lock.
EXPORT void listen(void* (*release)(), void (*acquire)(void*), int (*signals)()) {
    python = {release, acquire, signals};
}

}  // namespace coadjoint
