// Interrupts of loops. Each piece of work reports its size. After about a millisecond of work the clock is read, and a
// few times a second Python's signals are checked.
#pragma once

#include <chrono>
#include <cstdint>

namespace coadjoint {

struct Interrupted {};  // thrown to end a call at once

// Interrupt state of one call: the interpreter, whose lock it releases meanwhile, and a flag that other threads set.
class Hearing {
  public:
    explicit Hearing(const int64_t* stop);
    ~Hearing();
    Hearing(const Hearing&) = delete;
    Hearing& operator=(const Hearing&) = delete;

    // The object of the current call of this thread. Loops of short steps fetch it once, before they begin.
    static Hearing& of_this_call();

    // Report `work`, in multiplications or operations of equal cost.
    void after(int64_t work) {
        left -= work;
        if (__builtin_expect(left < 0, 0)) look();
    }

    // For a step compiled separately.
    static Hearing* now_heard() { return current; }
    static void look_at(Hearing* hearing) { hearing->look(); }

  private:
    typedef std::chrono::steady_clock Clock;
    static thread_local Hearing* current;
    int64_t left = 0;
    const int64_t* stop;
    void* thread;
    Hearing* const outer;  // of the enclosing call: a step written in Python may run another loop
    Clock::time_point next;

    void look();
};

// What the kernels export to a step compiled separately, in its own library.
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
