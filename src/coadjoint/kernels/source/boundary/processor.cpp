// The highest level of kernels that this x86-64 processor supports.
#if defined(_WIN32)
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

#if defined(__x86_64__) || defined(_M_X64)
#include <cpuid.h>

namespace {

constexpr unsigned bits() { return 0; }
template <class... Further>
constexpr unsigned bits(unsigned first, Further... further) {
    return 1u << first | bits(further...);
}
constexpr bool contains(unsigned found, unsigned wanted) { return (found & wanted) == wanted; }

// The registers that the operating system saves.
unsigned saved_registers() {
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

}  // namespace

// What compilers use for -march=x86-64-v3 and -v4, by CPUID, which needs no library of the compiler: 4, 3, else 1.
EXPORT int processor_level() {
    unsigned a, b, c, d, b7, c1, extended;
    if (!__get_cpuid(1, &a, &b, &c1, &d) || !__get_cpuid_count(7, 0, &a, &b7, &c, &d)) return 1;
    if (!__get_cpuid(0x80000001, &a, &b, &extended, &d)) return 1;
    // SSE3, SSSE3, FMA, CMPXCHG16B, SSE4.1, SSE4.2, MOVBE, POPCNT, OSXSAVE, AVX, F16C; LAHF, LZCNT; BMI1, AVX2, BMI2.
    if (!contains(c1, bits(0, 9, 12, 13, 19, 20, 22, 23, 27, 28, 29)) || !contains(extended, bits(0, 5)) ||
        !contains(b7, bits(3, 5, 8)) || !contains(saved_registers(), bits(1, 2)))
        return 1;
    // AVX-512 F, DQ, CD, BW, VL.
    return contains(b7, bits(16, 17, 28, 30, 31)) && contains(saved_registers(), bits(5, 6, 7)) ? 4 : 3;
}
#else
EXPORT int processor_level() { return 1; }
#endif
