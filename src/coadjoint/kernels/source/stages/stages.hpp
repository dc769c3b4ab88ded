// Stages of a step side by side, and sums over them: X_i = base + (error + sum_j mix_ij L_j).
//
// For one trajectory the stages are lanes; for many members the members are lanes, and stages are stored one after the
// other. Stage arrays hold `blocks` blocks of numbers A, one for each component. A quantity of the whole trajectory is
// a V.
//
// Every sum over stages has two parts, over even j from the error and over odd j from zero, each in ascending order and
// fused, and then the sum of the two: the same bits in every layout.
#pragma once

#include <vector>

#include "field/field.hpp"

namespace coadjoint {

// Numbers of all stages as a layout has them in memory, with `width` stages next to each other.
struct StageNumbers {
    double* numbers;
    int64_t size, width;

    INLINE double& operator()(int64_t component, int64_t stage) const {
        return numbers[((stage / width) * size + component) * width + stage % width];
    }
    INLINE void repeat_last(int64_t stages) const {
        for (int64_t c = 0; c < size; ++c)
            for (int64_t stage = stages; stage % width; ++stage) (*this)(c, stage) = (*this)(c, stages - 1);
    }
};

template <class A>
INLINE StageNumbers stage_numbers(const A* y, int64_t size) {
    return {reinterpret_cast<double*>(const_cast<A*>(y)), size, Numbers<A>::lanes};
}

// Stages as lanes, W of them in a block; lanes beyond the last stage repeat it, and have no effect.
template <int W>
struct StageLanes {
    typedef Lanes<W> A;
    typedef double V;
    typedef A Coefficient;
    static constexpr bool side_by_side = true;
    static constexpr int together = A::count < 4 ? 3 : 1;  // components whose sums are interleaved in registers

    static INLINE int64_t blocks(int64_t stages) { return (stages + W - 1) / W; }
    // Store row-major coefficients, `count` for each stage, as columns of lanes: those of block b begin at b * count.
    NOINLINE static void lay_out(const double* from, int64_t stages, int64_t count, A* to) {
        for (int64_t b = 0; b < blocks(stages); ++b)
            for (int64_t j = 0; j < count; ++j)
                for (int lane = 0; lane < W; ++lane)
                    to[b * count + j].set(lane, from[std::min(b * W + lane, stages - 1) * count + j]);
    }
    static INLINE A spread(double value) { return A(value); }
    static INLINE double at(const A* y, int64_t size, int64_t component, int64_t stage) {
        return stage_numbers(y, size)(component, stage);
    }
    static INLINE void put(A* y, int64_t size, int64_t component, int64_t stage, double value) {
        stage_numbers(y, size)(component, stage) = value;
    }
    static void repeat_last(A* y, int64_t size, int64_t stages) { stage_numbers(y, size).repeat_last(stages); }
    static INLINE bool every(const typename A::Mask& mask) { return all(mask); }
    static INLINE bool some(const typename A::Mask& mask) { return any(mask); }
    static INLINE double largest(const A& a) { return largest_lane(a); }
    static INLINE A choose(bool where, const A& a, const A& b) { return where ? a : b; }
    template <class C>
    static INLINE FirstLanes<C> constants(const C& all, int64_t block, int64_t stages) {
        return FirstLanes<C>(all, int(std::min<int64_t>(W, stages - block * W)));
    }

    // totals[m] = errors[m] + sum_j coefficient[j] y_j for M components.
    template <int M>
    static INLINE void mix(const A* coefficient, int64_t stages, const A* y, int64_t size, const double* errors,
                           A* totals) {
        A even[M], odd[M];
        for (int m = 0; m < M; ++m) even[m] = A(errors[m]), odd[m] = A(0.0);
        for (; stages > W; stages -= W, coefficient += W, y += size) mix_block<M>(coefficient, W, y, even, odd);
        mix_block<M>(coefficient, stages, y, even, odd);
        for (int m = 0; m < M; ++m) totals[m] = even[m] + odd[m];
    }
    // The same for stages in one block.
    template <int M>
    static INLINE void mix_one(const A* coefficient, int64_t stages, const A* y, const double* errors, A* totals) {
        A even[M], odd[M];
        for (int m = 0; m < M; ++m) even[m] = A(errors[m]), odd[m] = A(0.0);
        mix_block<M>(coefficient, stages, y, even, odd);
        for (int m = 0; m < M; ++m) totals[m] = even[m] + odd[m];
    }
    // Lanes are broadcast within registers: through memory each sum would wait for the slopes to be written and read.
    template <int M>
    static INLINE void mix_block(const A* coefficient, int64_t count, const A* y, A* even, A* odd) {
#pragma GCC unroll 16
        for (int j = 0; j < W; j += 2) {
            if (j >= count) break;
            for (int m = 0; m < M; ++m) even[m] = fma(coefficient[j], A(y[m][j]), even[m]);
            if (j + 1 >= count) break;
            for (int m = 0; m < M; ++m) odd[m] = fma(coefficient[j + 1], A(y[m][j + 1]), odd[m]);
        }
    }
};

// Stages one after the other, each with a number for every member.
template <class M>
struct MemberLanes {
    typedef M A;
    typedef M V;
    typedef double Coefficient;
    static constexpr bool side_by_side = false;
    static constexpr int together = Numbers<M>::lanes == 1 ? 3 : 1;

    static INLINE int64_t blocks(int64_t stages) { return stages; }
    NOINLINE static void lay_out(const double* from, int64_t stages, int64_t count, double* to) {
        std::copy_n(from, stages * count, to);
    }
    static INLINE const A& spread(const A& value) { return value; }
    static INLINE const A& at(const A* y, int64_t size, int64_t component, int64_t stage) {
        return y[stage * size + component];
    }
    static INLINE void put(A* y, int64_t size, int64_t component, int64_t stage, const A& value) {
        y[stage * size + component] = value;
    }
    static void repeat_last(A*, int64_t, int64_t) {}
    static INLINE auto every(const typename Numbers<A>::Mask& mask) { return mask; }
    static INLINE auto some(const typename Numbers<A>::Mask& mask) { return mask; }
    static INLINE const A& largest(const A& a) { return a; }
    static INLINE A choose(const typename Numbers<A>::Mask& where, const A& a, const A& b) {
        return select(where, a, b);
    }
    template <class C>
    static INLINE const C& constants(const C& all, int64_t, int64_t) { return all; }

    template <int m>
    static INLINE void mix(const double* coefficient, int64_t stages, const A* y, int64_t size, const A* errors,
                           A* totals) {
        A even[m], odd[m];
        for (int k = 0; k < m; ++k) even[k] = errors[k], odd[k] = A(0.0);
        int64_t j = 0;
        for (; j + 1 < stages; j += 2, y += 2 * size)
            for (int k = 0; k < m; ++k) {
                even[k] = fma(A(coefficient[j]), y[k], even[k]);
                odd[k] = fma(A(coefficient[j + 1]), y[size + k], odd[k]);
            }
        if (j < stages)
            for (int k = 0; k < m; ++k) even[k] = fma(A(coefficient[j]), y[k], even[k]);
        for (int k = 0; k < m; ++k) totals[k] = even[k] + odd[k];
    }
};

// Visit sum_j coefficient_j y_j + errors for the components first to last - 1, several at a time so that their sums are interleaved.
template <class Layout, class Visit>
INLINE void mix_slice(const typename Layout::Coefficient* coefficient, int64_t stages, const typename Layout::A* y,
                      int64_t size, const typename Layout::V* errors, int64_t first, int64_t last, Visit visit) {
    constexpr int M = Layout::together;
    typename Layout::A totals[M];
    int64_t c = first;
    for (; c + M <= last; c += M) {
        Layout::template mix<M>(coefficient, stages, y + c, size, errors + c, totals);
        for (int m = 0; m < M; ++m) visit(c + m, totals[m]);
    }
    for (; c < last; ++c) {
        Layout::template mix<1>(coefficient, stages, y + c, size, errors + c, totals);
        visit(c, totals[0]);
    }
}

template <class Layout, class Visit>
INLINE void mix_each(const typename Layout::Coefficient* coefficient, int64_t stages, const typename Layout::A* y,
                     int64_t size, const typename Layout::V* errors, Visit visit) {
    share(size, [&](int64_t first, int64_t last) __attribute__((always_inline)) {
        mix_slice<Layout>(coefficient, stages, y, size, errors, first, last, visit);
    });
}

// x += sum_j out_j L_j, with compensation.
template <class Layout>
NOINLINE void add_slopes(const double* out, int64_t stages, const typename Layout::A* slopes, int64_t size,
                         typename Layout::V* x, typename Layout::V* errors) {
    typedef typename Layout::V V;
    share(size, [&](int64_t first, int64_t last) {
        for (int64_t c = first; c < last; ++c) {
            V even = errors[c], odd(0.0);
            int64_t j = 0;
            for (; j + 1 < stages; j += 2) {
                even = fma(V(out[j]), Layout::at(slopes, size, c, j), even);
                odd = fma(V(out[j + 1]), Layout::at(slopes, size, c, j + 1), odd);
            }
            if (j < stages) even = fma(V(out[j]), Layout::at(slopes, size, c, j), even);
            const V old = x[c];
            two_sum(old, even + odd, x[c], errors[c]);
        }
    });
}

}  // namespace coadjoint
