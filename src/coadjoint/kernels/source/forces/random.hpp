// Random numbers as a function of their purpose: a counter-based generator, and normal deviates. Every operation is
// exact or rounded once, so that the bits are the same on every machine.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#include "numbers/lanes.hpp"
#include "numbers/thread_team.hpp"

namespace coadjoint {

// Four words of 64 bits, or of several members side by side.
template <class Word>
struct Words {
    Word at[4];
};

// The high and the low half of a product.
INLINE void multiply(uint64_t a, uint64_t constant, uint64_t& high, uint64_t& low) {
    const unsigned __int128 product = (unsigned __int128)constant * a;
    high = uint64_t(product >> 64), low = uint64_t(product);
}

#if defined(__AVX512F__)
// Of eight numbers: by four products of halves, which take less time than eight products one after the other.
typedef Registers<8>::Unsigned SeveralWords;
INLINE void multiply(SeveralWords a, uint64_t constant, SeveralWords& high, SeveralWords& low) {
    const auto product = [](SeveralWords x, SeveralWords y) { return (SeveralWords)_mm512_mul_epu32((__m512i)x, (__m512i)y); };
    const SeveralWords above = a >> 32, small = SeveralWords{} + constant, large = SeveralWords{} + (constant >> 32);
    const SeveralWords last = product(a, small), middle = product(above, small) + (last >> 32);
    const SeveralWords other = product(a, large) + (middle & UINT32_MAX);
    high = product(above, large) + (middle >> 32) + (other >> 32);
    low = (other << 32) | (last & UINT32_MAX);
}
#else
typedef uint64_t SeveralWords;
#endif

// Philox4x64 with ten rounds: J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, Parallel random numbers: as easy as
// 1, 2, 3 (2011).
template <class Word>
INLINE Words<Word> philox(Words<Word> counter, uint64_t key, uint64_t other) {
    constexpr uint64_t FIRST = 0xD2E7470EE14C6C93, SECOND = 0xCA5A826395121157;
    constexpr uint64_t KEY_INCREMENT = 0x9E3779B97F4A7C15, OTHER_KEY_INCREMENT = 0xBB67AE8584CAA73B;
    for (int round = 0; round < 10; ++round) {
        Words<Word> next;
        Word high, other_high;
        multiply(counter.at[0], FIRST, high, next.at[3]);
        multiply(counter.at[2], SECOND, other_high, next.at[1]);
        next.at[0] = other_high ^ counter.at[1] ^ key;
        next.at[2] = high ^ counter.at[3] ^ other;
        counter = next;
        key += KEY_INCREMENT, other += OTHER_KEY_INCREMENT;
    }
    return counter;
}

// The logarithm of a positive normal number, to about a unit in the last place.
template <class A>
INLINE A logarithm(const A& x) {
    A power = leading_power(x), m = 0.5 * (x * inverse_power(power)), exponent = exponent_of(power) + 1.0;  // exact
    const auto low = m < A(0.70710678118654752);
    m = select(low, m * 2.0, m);
    exponent = select(low, exponent - 1.0, exponent);
    const A s = (m - 1.0) / (m + 1.0), z = s * s;
    A sum(0.0);
    for (int k = 11; k > 0; --k) sum = z * (sum + 1.0 / (2.0 * k + 1.0));
    return exponent * 0.6931471805599453 + (2.0 * s + 2.0 * s * sum);
}

template <class A>
INLINE A ratio(const double* above, const double* below, const A& r) {
    A p(above[7]), q(below[7]);
    for (int k = 6; k >= 0; --k) p = p * r + above[k], q = q * r + below[k];
    return p / q;
}

// The normal deviate of 53 of 64 random bits: the inverse of the distribution function, M. J. Wichura, Algorithm AS 241
// (1988). The sign is one bit, and the tail is reached to 8.2 standard deviations.
struct Normal {
    static constexpr double MIDDLE[] = {3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3,
                                        1.3731693765509461125e4, 4.5921953931549871457e4, 6.7265770927008700853e4,
                                        3.3430575583588128105e4, 2.5090809287301226727e3};
    static constexpr double UNDER_MIDDLE[] = {1.0, 4.2313330701600911252e1, 6.8718700749205790830e2,
                                              5.3941960214247511077e3, 2.1213794301586595867e4,
                                              3.9307895800092710610e4, 2.8729085735721942674e4,
                                              5.2264952788528545610e3};
    static constexpr double NEAR[] = {1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0,
                                      3.64784832476320460504e0, 1.27045825245236838258e0, 2.41780725177450611770e-1,
                                      2.27238449892691845833e-2, 7.74545014278341407640e-4};
    static constexpr double UNDER_NEAR[] = {1.0, 2.05319162663775882187e0, 1.67638483018380384940e0,
                                            6.89767334985100004550e-1, 1.48103976427480074590e-1,
                                            1.51986665636164571966e-2, 5.47593808499534494600e-4,
                                            1.05075007164441684324e-9};
    static constexpr double FAR[] = {6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0,
                                     2.96560571828504891230e-1, 2.65321895265761230930e-2, 1.24266094738807843860e-3,
                                     2.71155556874348757815e-5, 2.01033439929228813265e-7};
    static constexpr double UNDER_FAR[] = {1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1,
                                           1.48753612908506148525e-2, 7.86869131145613259100e-4,
                                           1.84631831751005468180e-5, 1.42151175831644588870e-7,
                                           2.04426310338993978564e-15};

    // The deviation 1/2 - tail of a probability from one half, at most `MIDDLE_END`.
    static constexpr double MIDDLE_END = 0.425, NEAR_END = 5.0;
    template <class A>
    static INLINE A in_the_middle(const A& q) { return q * ratio(MIDDLE, UNDER_MIDDLE, 0.180625 - q * q); }

    template <class A>
    static INLINE A in_the_tail(const A& tail) {
        const A r = square_root(-logarithm(tail));
        const A size = ratio(NEAR, UNDER_NEAR, r - 1.6);
        const auto near = r <= A(NEAR_END);
        return __builtin_expect(all(near), 1) ? size : select(near, size, ratio(FAR, UNDER_FAR, r - 5.0));
    }

    static INLINE double tail_of(uint64_t word) { return (double(word >> 12) + 0.5) * 0x1p-53; }  // exact, below 1/2
    static INLINE double signed_by(uint64_t word, double size) { return word & 1 ? -size : size; }  // no size is zero
};

inline double normal_of(uint64_t word) {
    const double tail = Normal::tail_of(word), q = 0.5 - tail;
    return Normal::signed_by(word, q <= Normal::MIDDLE_END ? Normal::in_the_middle(q) : Normal::in_the_tail(tail));
}

// The deviates of `count` words, at most 256 and a multiple of eight: all as if in the middle, then those of the tails.
inline void normals_of(const uint64_t* words, int64_t count, double* out) {
    typedef Lanes<8> A;
    double tails[256];
    uint64_t sizes[256];
    int32_t at[256 + 8];
    int64_t far = 0;
    for (int64_t k = 0; k < count; ++k) tails[k] = Normal::tail_of(words[k]);
    for (int64_t k = 0; k < count; k += 8)
        store(reinterpret_cast<double*>(sizes + k), Normal::in_the_middle(A(0.5) - load<A>(tails + k)));
    for (int64_t k = 0; k < count; ++k) {
        at[far] = int32_t(k);
        far += 0.5 - tails[k] > Normal::MIDDLE_END;
    }
    for (int64_t k = 0; k < far; k += 8) {
        double some[8];
        for (int64_t lane = 0; lane < 8; ++lane) some[lane] = k + lane < far ? tails[at[k + lane]] : 0.01;
        store(some, Normal::in_the_tail(load<A>(some)));
        for (int64_t lane = 0; lane < 8 && k + lane < far; ++lane) std::memcpy(sizes + at[k + lane], some + lane, 8);
    }
    for (int64_t k = 0; k < count; ++k) sizes[k] ^= words[k] << 63;  // without branches, which signs would mislead
    std::memcpy(out, sizes, 8 * count);
}

// Independent normal deviates for the coordinates of a member, from a time on, and for each part that begins at that
// time: a function of these and of the seed only.
class DeviateStream {
  public:
    DeviateStream(uint64_t seed, uint64_t stream, double moment, uint64_t part) : seed(seed), stream(stream), part(part) {
        moment += 0.0;  // normalize minus zero
        std::memcpy(&when, &moment, 8);
    }

    // Those of the coordinates `first` to `last` - 1, by one thread; `first` is a multiple of eight.
    void draw(int64_t first, int64_t last, double* out) const {
        uint64_t words[CHUNK];
        double deviates[CHUNK];
        for (int64_t low = first; low < last; low += CHUNK) {
            const int64_t size = last - low < CHUNK ? last - low : CHUNK, filled = (size + 7) / 8 * 8;
            for (int64_t k = 0; k < filled; k += 4) {
                const Words<uint64_t> four = philox<uint64_t>({{uint64_t((low + k) / 4), when, stream, part}}, seed, 0);
                for (int j = 0; j < 4; ++j) words[k + j] = four.at[j];
            }
            normals_of(words, filled, deviates);
            std::memcpy(out + low - first, deviates, 8 * size);
        }
    }

    void fill(int64_t count, double* out) const {
        share<CHUNK>(count, [&](int64_t first, int64_t last) { draw(first, last, out + first); });
    }

  private:
    static constexpr int64_t CHUNK = 256;
    uint64_t seed, stream, part, when;
};

// The same for members as lanes, whose streams have the numbers `stream` + number[lane].
template <class A>
class DeviatesOfLanes {
  public:
    DeviatesOfLanes(uint64_t seed, int64_t stream, const int64_t* number, double moment, uint64_t part)
        : seed(seed), part(part) {
        moment += 0.0;
        std::memcpy(&when, &moment, 8);
        for (int lane = 0; lane < lanes; ++lane) streams[lane] = uint64_t(stream + number[lane]);
    }

    // Those of the coordinates 0 to count - 1. With `negative`, also whether that of the coordinate `count` is.
    void draw(int64_t count, A* out, A* negative = nullptr) const {
        uint64_t words[TOGETHER * lanes];
        for (int64_t low = 0, last = count + (negative ? 1 : 0); low < last; low += TOGETHER) {
            for (int64_t k = 0; k < TOGETHER && low + k < last; k += 4) four_words(uint64_t((low + k) / 4), words + k * lanes);
            const int64_t size = count - low < TOGETHER ? count - low : TOGETHER;
            normals_of(words, size * lanes, reinterpret_cast<double*>(out + low));
            for (int lane = 0; negative && size < TOGETHER && lane < lanes; ++lane)
                set_lane(*negative, lane, words[size * lanes + lane] & 1 ? 1.0 : 0.0);
        }
    }

  private:
    // Apart from other code, which needs the registers.
    NOINLINE void four_words(uint64_t block, uint64_t* words) const {
        constexpr int together = sizeof(SeveralWords) / sizeof(uint64_t);
        for (int lane = 0; lane < lanes; lane += together) {
            SeveralWords stream;
            std::memcpy(&stream, streams + lane, sizeof(stream));
            const SeveralWords none{};
            const auto four = philox<SeveralWords>({{none + block, none + when, stream, none + part}}, seed, 0);
            for (int j = 0; j < 4; ++j) std::memcpy(words + j * lanes + lane, four.at + j, sizeof(stream));
        }
    }

    static constexpr int lanes = Numbers<A>::lanes;
    static constexpr int64_t TOGETHER = 8;  // coordinates
    static_assert(lanes >= 8 && TOGETHER * lanes <= 256, "as many words as `normals_of` takes");
    uint64_t seed, part, when, streams[lanes];
};

}  // namespace coadjoint
