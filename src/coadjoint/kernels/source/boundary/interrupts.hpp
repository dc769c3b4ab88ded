// Interrupts of loops. Each piece of work reports its size. After about a millisecond of work the clock is read, and a
// few times a second Python's signals are checked.
#pragma once

#include <chrono>
#include <cstdint>

#include "numbers/float_mode.hpp"

namespace coadjoint {

struct Interrupted {};  // thrown to end a call at once

// State of one call: the interpreter, whose lock it releases meanwhile, a flag that other threads set, and the
// floating-point mode of the caller.
class InterruptCheck {
  public:
    explicit InterruptCheck(const int64_t* stop);
    ~InterruptCheck();
    InterruptCheck(const InterruptCheck&) = delete;
    InterruptCheck& operator=(const InterruptCheck&) = delete;

    // The object of the current call of this thread. Loops of short steps fetch it once, before they begin.
    static InterruptCheck& of_this_call();

    // Report `work`, in multiplications or operations of equal cost.
    void after(int64_t work) {
        left -= work;
        if (__builtin_expect(left < 0, 0)) check();
    }

    // For a step compiled separately.
    static InterruptCheck* current_call() { return current; }
    static void check_now(InterruptCheck* interrupts) { interrupts->check(); }

  private:
    typedef std::chrono::steady_clock Clock;
    static thread_local InterruptCheck* current;
    int64_t left = 0;
    const int64_t* stop;
    const FloatMode mode;
    void* thread;
    InterruptCheck* const outer;  // of the enclosing call: a step written in Python may run another loop
    Clock::time_point next{};  // of the next signal check, once the clock has been read

    void check();
};

// Functions of the kernels for a step compiled separately, in another library.
struct InterruptFunctions {
    InterruptCheck* (*current_call)();
    void (*check_now)(InterruptCheck*);
};

#if defined(COADJOINT_APART)
inline InterruptFunctions imported_functions{};
inline InterruptCheck& InterruptCheck::of_this_call() { return *imported_functions.current_call(); }
inline void InterruptCheck::check() { imported_functions.check_now(this); }
#else
inline InterruptCheck& InterruptCheck::of_this_call() { return *current; }
#endif

}  // namespace coadjoint
