// Number types of the kernels: a double, or lanes of doubles side by side. Every kernel is a template over them.
//
// The same operations in the same order on every lane, and no contraction by the compiler: a trajectory has the same
// bits alone, as one lane of several, and on every processor.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__AVX512F__) || defined(__AVX2__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace coadjoint {

#define INLINE __attribute__((always_inline)) inline
#define NOINLINE __attribute__((noinline))
// Of functions that are compiled once, in the .cpp of their header. Steps of users, compiled apart, contain what they call.
#if defined(COADJOINT_APART)
#define ONCE inline
#else
#define ONCE
#endif

#if defined(__AVX512F__)
constexpr int NATIVE = 8;
#elif defined(__AVX2__)
constexpr int NATIVE = 4;
#else
constexpr int NATIVE = 2;
#endif
constexpr int MEMBER_LANES = 4 * NATIVE;  // members advanced as lanes: four vectors hide each other's latency

// The bits of exponents, and the sum of the exponents of a power of two and of its inverse.
constexpr int64_t EXPONENT_BITS = int64_t(0x7ff) << 52, INVERSE_BITS = int64_t(2046) << 52;
constexpr uint64_t UNIT_OF_2_52 = uint64_t(1075) << 52;  // the bits of 2^52, to which those of a small integer are added

template <int width>
struct Registers;
#define REGISTERS(width)                                                \
    template <>                                                         \
    struct Registers<width> {                                           \
        typedef double Vector __attribute__((vector_size(8 * width)));  \
        typedef int64_t Bits __attribute__((vector_size(8 * width)));   \
        typedef uint64_t Unsigned __attribute__((vector_size(8 * width))); \
    };
REGISTERS(2)
REGISTERS(4)
REGISTERS(8)

template <int N>
struct Lanes {
    static constexpr int width = N < NATIVE ? N : NATIVE;
    static constexpr int count = N / width;
    static_assert(count == 1 || count == 2 || count == 4 || count == 8, "EACH is written out for these");
    typedef typename Registers<width>::Vector Vector;
    typedef typename Registers<width>::Bits Bits;
    typedef typename Registers<width>::Unsigned Unsigned;

// Unrolled by hand instead of a loop, so that the parts become registers immediately.
#define PART(position, statement) \
    {                           \
        constexpr int k = position; \
        statement;              \
    }
#define EACH(statement)                                                                     \
    PART(0, statement)                                                                      \
    if constexpr (count > 1) PART(1, statement)                                             \
    if constexpr (count > 2) { PART(2, statement) PART(3, statement) }                      \
    if constexpr (count > 4) { PART(4, statement) PART(5, statement) PART(6, statement) PART(7, statement) }
// Copied register by register: GCC copies a struct of several in halves, and waits for both when a whole one is loaded.
#define COPIED_BY_REGISTERS(Type)                                                                 \
    INLINE Type() = default;                                                                      \
    INLINE Type(const Type& other) { EACH(part[k] = other.part[k]) }                              \
    INLINE Type& operator=(const Type& other) { EACH(part[k] = other.part[k]) return *this; }
    struct Mask {
        Bits part[count];
        COPIED_BY_REGISTERS(Mask)
    };

    Vector part[count];

    COPIED_BY_REGISTERS(Lanes)
    INLINE Lanes(double value) {
        // Minus zero, which the compiler folds away; adding plus zero would change -0.
        for (int k = 0; k < count; ++k) part[k] = value - Vector{};
    }
    INLINE double operator[](int lane) const { return part[lane / width][lane % width]; }
    INLINE void set(int lane, double value) { part[lane / width][lane % width] = value; }

#define BINARY(Result, Operand, symbol)                                    \
    INLINE friend Result operator symbol(const Operand& a, const Operand& b) { \
        Result c;                                                          \
        EACH(c.part[k] = a.part[k] symbol b.part[k])                       \
        return c;                                                          \
    }
    BINARY(Lanes, Lanes, +)
    BINARY(Lanes, Lanes, -)
    BINARY(Lanes, Lanes, *)
    BINARY(Lanes, Lanes, /)
    BINARY(Mask, Lanes, <)
    BINARY(Mask, Lanes, <=)
    BINARY(Mask, Lanes, ==)
    BINARY(Mask, Mask, &)
    BINARY(Mask, Mask, |)
    INLINE friend Lanes operator-(const Lanes& a) { Lanes c; EACH(c.part[k] = -a.part[k]) return c; }
    INLINE Lanes& operator+=(const Lanes& b) { return *this = *this + b; }
    INLINE Lanes& operator-=(const Lanes& b) { return *this = *this - b; }
    INLINE Lanes& operator*=(const Lanes& b) { return *this = *this * b; }
    INLINE friend Mask operator>(const Lanes& a, const Lanes& b) { return b < a; }
    INLINE friend Mask operator>=(const Lanes& a, const Lanes& b) { return b <= a; }
    INLINE friend Mask operator!(const Mask& a) { Mask c; EACH(c.part[k] = ~a.part[k]) return c; }

    INLINE friend Lanes select(const Mask& where, const Lanes& a, const Lanes& b) {
        Lanes c;
        EACH(c.part[k] = where.part[k] ? a.part[k] : b.part[k])
        return c;
    }
    INLINE friend bool any(const Mask& mask) {
        Bits together = mask.part[0];
        EACH(together |= mask.part[k])
        return some(together);
    }
    INLINE friend bool all(const Mask& mask) {
        Bits together = mask.part[0];
        EACH(together &= mask.part[k])
        return !some(~together);
    }
    INLINE friend bool at(const Mask& mask, int lane) { return mask.part[lane / width][lane % width] != 0; }
    INLINE friend Lanes fma(const Lanes& a, const Lanes& b, const Lanes& c) {
        Lanes d;
        EACH(d.part[k] = fused(a.part[k], b.part[k], c.part[k]))
        return d;
    }
    INLINE friend Lanes absolute(const Lanes& a) {
        Lanes b;
        EACH(b.part[k] = (Vector)((Bits)a.part[k] & INT64_MAX))
        return b;
    }
    // The last bits of a number that was rounded to an integer by adding 1.5 * 2^52.
    INLINE friend Mask odd_bit(const Lanes& rounded, int bit, int added) {
        Mask c;
        EACH(c.part[k] = ((((Unsigned)rounded.part[k] + uint64_t(added)) >> bit) & 1) != 0)
        return c;
    }
    // The largest lane, if no lane is NaN.
    INLINE friend double largest_lane(const Lanes& a) {
        Vector most = a.part[0];
        EACH(most = most < a.part[k] ? a.part[k] : most)
#if defined(__AVX512F__)
        if constexpr (width == 8) return _mm512_reduce_max_pd((__m512d)most);
#endif
#if defined(__AVX2__)
        if constexpr (width == 4) {
            const __m128d halves = _mm_max_pd(_mm256_castpd256_pd128((__m256d)most), _mm256_extractf128_pd((__m256d)most, 1));
            return halves[0] < halves[1] ? halves[1] : halves[0];
        }
#endif
        double result = most[0];
        for (int lane = 1; lane < width; ++lane) result = result < most[lane] ? most[lane] : result;
        return result;
    }
    // 2^k, from k + 1.5 * 2^52.
    INLINE friend Lanes power_of_two(const Lanes& rounded) {
        Lanes c;
        EACH(c.part[k] = (Vector)(((Unsigned)rounded.part[k] << 52) + (uint64_t(1023) << 52)))
        return c;
    }
    // The power of two of each lane rounded down, or its inverse. Zero has the inverse 2^1023.
    INLINE friend Lanes leading_power(const Lanes& a) {
        Lanes b;
        EACH(b.part[k] = (Vector)((Bits)a.part[k] & EXPONENT_BITS))
        return b;
    }
    INLINE friend Lanes inverse_power(const Lanes& power) {
        Lanes b;
        EACH(b.part[k] = (Vector)(INVERSE_BITS - (Bits)power.part[k]))
        return b;
    }
    // The exponent of a positive power of two, a normal number.
    INLINE friend Lanes exponent_of(const Lanes& power) {
        Lanes b;
        EACH(b.part[k] = (Vector)(((Unsigned)power.part[k] >> 52) | UNIT_OF_2_52) - (0x1p52 + 1023.0))
        return b;
    }
    INLINE friend Lanes square_root(const Lanes& a) {
        Lanes b;
        EACH(b.part[k] = rooted(a.part[k]))
        return b;
    }
    template <class Function>
    INLINE friend Lanes map(const Lanes& a, Function function) {
        Lanes b;
        for (int lane = 0; lane < N; ++lane) b.set(lane, function(a[lane]));
        return b;
    }
#undef BINARY
#undef COPIED_BY_REGISTERS
#undef EACH
#undef PART

  private:
    INLINE static bool some(Bits bits) {
#if defined(__AVX512F__)
        if constexpr (width == 8) return _mm512_test_epi64_mask((__m512i)bits, (__m512i)bits) != 0;
#endif
#if defined(__AVX2__)
        if constexpr (width == 4) return _mm256_movemask_pd((__m256d)bits) != 0;
        if constexpr (width == 2) return _mm_movemask_pd((__m128d)bits) != 0;
#endif
        int64_t total = 0;
        for (int lane = 0; lane < width; ++lane) total |= bits[lane];
        return total != 0;
    }
    INLINE static Vector fused(Vector a, Vector b, Vector c) {
#if defined(__AVX512F__)
        if constexpr (width == 8) return (Vector)_mm512_fmadd_pd((__m512d)a, (__m512d)b, (__m512d)c);
#endif
#if defined(__AVX2__)
        if constexpr (width == 4) return (Vector)_mm256_fmadd_pd((__m256d)a, (__m256d)b, (__m256d)c);
        if constexpr (width == 2) return (Vector)_mm_fmadd_pd((__m128d)a, (__m128d)b, (__m128d)c);
#elif defined(__aarch64__)
        if constexpr (width == 2) return (Vector)vfmaq_f64((float64x2_t)c, (float64x2_t)a, (float64x2_t)b);
#endif
        return fused_by_lane(a, b, c);
    }
    INLINE static Vector rooted(Vector a) {
#if defined(__AVX512F__)
        if constexpr (width == 8) return (Vector)_mm512_sqrt_pd((__m512d)a);
#endif
#if defined(__AVX2__)
        if constexpr (width == 4) return (Vector)_mm256_sqrt_pd((__m256d)a);
#endif
        Vector b{};
        for (int lane = 0; lane < width; ++lane) b[lane] = __builtin_sqrt(a[lane]);
        return b;
    }
    // Without a hardware instruction each lane is a call; not inlined, so that it is not unrolled in every loop.
    NOINLINE static Vector fused_by_lane(Vector a, Vector b, Vector c) {
        Vector d{};
        for (int lane = 0; lane < width; ++lane) d[lane] = __builtin_fma(a[lane], b[lane], c[lane]);
        return d;
    }
};

// The same functions for one number.
INLINE double fma(double a, double b, double c) { return __builtin_fma(a, b, c); }
INLINE double select(bool where, double a, double b) { return where ? a : b; }
INLINE bool any(bool mask) { return mask; }
INLINE bool all(bool mask) { return mask; }
INLINE bool at(bool mask, int) { return mask; }
INLINE double absolute(double a) { return __builtin_fabs(a); }
INLINE bool odd_bit(double rounded, int bit, int added) {
    uint64_t bits;
    std::memcpy(&bits, &rounded, 8);
    return (((bits + uint64_t(added)) >> bit) & 1) != 0;
}
INLINE double power_of_two(double rounded) {
    uint64_t bits;
    std::memcpy(&bits, &rounded, 8);
    bits = (bits << 52) + (uint64_t(1023) << 52);
    std::memcpy(&rounded, &bits, 8);
    return rounded;
}
INLINE double leading_power(double a) {
    int64_t bits;
    std::memcpy(&bits, &a, 8);
    bits &= EXPONENT_BITS;
    std::memcpy(&a, &bits, 8);
    return a;
}
INLINE double inverse_power(double power) {
    int64_t bits;
    std::memcpy(&bits, &power, 8);
    bits = INVERSE_BITS - bits;
    std::memcpy(&power, &bits, 8);
    return power;
}
INLINE double exponent_of(double power) {
    uint64_t bits;
    std::memcpy(&bits, &power, 8);
    return double(int64_t(bits >> 52) - 1023);
}
INLINE double square_root(double a) { return __builtin_sqrt(a); }
template <class Function>
INLINE double map(double a, Function function) { return function(a); }
INLINE double lane_of(double a, int) { return a; }
INLINE void set_lane(double& a, int, double value) { a = value; }

template <int N>
INLINE double lane_of(const Lanes<N>& a, int lane) { return a[lane]; }
template <int N>
INLINE void set_lane(Lanes<N>& a, int lane, double value) { a.set(lane, value); }

template <class A>
struct Numbers {
    static constexpr int lanes = 1;
    typedef bool Mask;
};
template <int N>
struct Numbers<Lanes<N>> {
    static constexpr int lanes = N;
    typedef typename Lanes<N>::Mask Mask;
};

// Consecutive doubles in memory, one for each lane.
template <class A>
INLINE A load(const double* from) {
    A a;
    if constexpr (Numbers<A>::lanes == 1)
        a = *from;
    else
        for (int k = 0; k < A::count; ++k) std::memcpy(&a.part[k], from + k * A::width, sizeof(a.part[k]));
    return a;
}
template <class A>
INLINE void store(double* to, const A& a) {
    if constexpr (Numbers<A>::lanes == 1)
        *to = a;
    else
        for (int k = 0; k < A::count; ++k) std::memcpy(to + k * A::width, &a.part[k], sizeof(a.part[k]));
}

// Set sum to old + increment, and remainder to the rounding error of that.
template <class A>
INLINE void two_sum(const A& old, const A& increment, A& sum, A& remainder) {
    const A now = old + increment, added = now - old;
    remainder = (old - (now - added)) + (increment - added);
    sum = now;
}

template <class A>
INLINE A smaller(const A& a, const A& b) { return select(b < a, b, a); }
template <class A>
INLINE A larger(const A& a, const A& b) { return select(a < b, b, a); }

}  // namespace coadjoint
