// How a loop hears that it is to stop. Each piece of work says how large it was. After about a millisecond of work the
// clock is looked at, and some times a second Python's signals.
#pragma once

#include <chrono>
#include <cstdint>

namespace coadjoint {

struct Interrupted {};  // thrown where a call is to end at once

// What one call listens to: the interpreter, whose lock it gives back meanwhile, and a number that other threads set.
class Hearing {
  public:
    explicit Hearing(const int64_t* stop);
    ~Hearing();
    Hearing(const Hearing&) = delete;
    Hearing& operator=(const Hearing&) = delete;

    // The one of the call that this thread is in. Loops of short steps ask for it once, before they begin.
    static Hearing& of_this_call();

    // Say that `work` was done, in multiplications or what takes as long.
    void after(int64_t work) {
        left -= work;
        if (__builtin_expect(left < 0, 0)) look();
    }

    // For a step that was compiled apart.
    static Hearing* now_heard() { return current; }
    static void look_at(Hearing* hearing) { hearing->look(); }

  private:
    typedef std::chrono::steady_clock Clock;
    static thread_local Hearing* current;
    int64_t left = 0;
    const int64_t* stop;
    void* thread;
    Hearing* const outer;  // of the call inside which this one is: a step written in Python may run another loop
    Clock::time_point next;

    void look();
};

// What the kernels lend to a step that was compiled apart from them, into a library of its own.
struct Lent {
    Hearing* (*now_heard)();
    void (*look_at)(Hearing*);
};

#if defined(COADJOINT_APART)
inline Lent lent{};
inline Hearing& Hearing::of_this_call() { return *lent.now_heard(); }
inline void Hearing::look() { lent.look_at(this); }
#else
inline Hearing& Hearing::of_this_call() { return *current; }
#endif

}  // namespace coadjoint
