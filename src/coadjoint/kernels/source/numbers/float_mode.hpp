// The floating-point mode of the calling thread: rounding, subnormal numbers, traps. Loops run in the standard one,
// whatever their caller has set, as by fesetround, or by a library that was linked with -ffast-math.
#pragma once

#include <cstdint>

#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#elif !defined(__aarch64__) && !defined(_M_ARM64)
#include <cfenv>
#endif

namespace coadjoint {

#if defined(__x86_64__) || defined(_M_X64)
typedef uint32_t FloatMode;
constexpr FloatMode STANDARD_MODE = 0x1f80, UPWARD_MODE = 0x5f80, DOWNWARD_MODE = 0x3f80, RAISED_FLAGS = 0x3f;
inline FloatMode float_mode() { return _mm_getcsr() & ~RAISED_FLAGS; }
inline void set_float_mode(FloatMode mode) {
    const uint32_t present = _mm_getcsr();
    if ((present & ~RAISED_FLAGS) != mode) _mm_setcsr(mode | (present & RAISED_FLAGS));
}
#elif defined(__aarch64__) || defined(_M_ARM64)
typedef uint64_t FloatMode;
constexpr FloatMode STANDARD_MODE = 0, UPWARD_MODE = 1 << 22, DOWNWARD_MODE = 1 << 23;
inline FloatMode float_mode() {
    FloatMode mode;
    __asm__ __volatile__("mrs %0, fpcr" : "=r"(mode));
    return mode;
}
inline void set_float_mode(FloatMode mode) {
    if (float_mode() != mode) __asm__ __volatile__("msr fpcr, %0" : : "r"(mode) : "memory");
}
#else
typedef int FloatMode;
constexpr FloatMode STANDARD_MODE = FE_TONEAREST, UPWARD_MODE = FE_UPWARD, DOWNWARD_MODE = FE_DOWNWARD;
inline FloatMode float_mode() { return std::fegetround(); }
inline void set_float_mode(FloatMode mode) {
    if (float_mode() != mode) std::fesetround(mode);
}
#endif

// The mode of the loops that this thread calls: another one where rounding is measured.
inline thread_local FloatMode mode_of_loops = STANDARD_MODE;

}  // namespace coadjoint
