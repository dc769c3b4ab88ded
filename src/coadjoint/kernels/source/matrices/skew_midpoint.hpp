// The isospectral midpoint rule of skew-Hermitian matrices, by Newton's method for the stream matrix P at the midpoint.
//
// With A = 1 - (h/2) P the midpoint of P is M = A^-1 W A^-*, and P = stream(M) is solved. Any P preserves the spectrum
// of W, and a change D of P changes M by (h/2)(C M - (C M)*), C = A^-1 D: the linear equation for D needs few digits,
// and is solved by iteration in the lower precision. The initial P is extrapolated from its differences over the last
// steps.
#pragma once

#include <limits>

#include "matrices/isospectral.hpp"
#include "matrices/triangles.hpp"

namespace coadjoint {

template <class T>
struct Lower;
template <>
struct Lower<double> {
    typedef float type;
};
template <>
struct Lower<Complex> {
    typedef std::complex<float> type;
};

template <class T>
struct SkewMidpoint final : Isospectral<T> {
    typedef Isospectral<T> Base;
    typedef typename Lower<T>::type LowPrecision;
    using Base::n, Base::all, Base::numbers, Base::products, Base::stream;

    static constexpr int64_t DIFFERENCES = 12;     // of P over the last steps
    static constexpr int64_t MOST_CORRECTIONS = 24;
    static constexpr double LOW_ACCURACY = 0x1p-21;  // accuracy of a correction in the lower precision
    static constexpr double LAST_DIGIT = 0x1p-52;
    static constexpr double NEAR = 0x1p-28;        // of P: within it, one correction reaches round-off

    const int64_t half;  // numbers on and above the diagonal
    Triangles<T> triangles;
    Triangles<LowPrecision> low;
    std::vector<T> W, P, G, M, A, F, D, C;
    std::vector<LowPrecision> low_A, low_M, low_C, low_D;

    static constexpr int64_t DIRECTIONS = 4;
    struct Direction {
        std::vector<LowPrecision> p, q, moves;
        double square = 0.0;
    };
    Direction directions[DIRECTIONS];

    explicit SkewMidpoint(const StepTables& tables)
        : Base(tables), half(numbers / n * (n + 1) / 2), triangles(tables.whole[GEMM], tables.whole[TRSM], n),
          low(tables.whole[LOWER_GEMM], tables.whole[LOWER_TRSM], n), W(all), P(all), G(all), M(all), A(all), F(all),
          D(all), C(all), low_A(all), low_M(all), low_C(all), low_D(all) {
        for (Direction& each : directions) each.p.resize(all), each.q.resize(all), each.moves.resize(all);
        this->memory_size = 3 + DIFFERENCES * half;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        double *w = numbers_of(W.data()), *p = numbers_of(P.data()), *m = numbers_of(M.data());
        double *g = numbers_of(G.data()), *f = numbers_of(F.data()), *d = numbers_of(D.data());
        for (int64_t k = 0; k < numbers; ++k) w[k] = x[k] + dx[k];
        extrapolate(t, h);
        this->iterations = this->evaluations = 0;
        this->status = DONE;
        for (;;) {
            solve(h);
            if (!stream.apply(M.data(), t + 0.5 * h, G.data())) return UNDEFINED;
            ++this->evaluations;
            this->residual = largest_of(numbers, [=](int64_t k) { return f[k] = g[k] - p[k]; });
            const double size = largest_of(numbers, [=](int64_t k) { return g[k]; });
            if (this->ended(this->residual, size) || this->residual <= LAST_DIGIT * size) break;
            const bool last = this->residual <= NEAR * size;
            const bool near =
                correct(h, std::max(LOW_ACCURACY * this->residual, last ? LAST_DIGIT * size : NEAR * size / 4)) && last;
            for (int64_t k = 0; k < numbers; ++k) p[k] += d[k];
            if (near) {
                for (int64_t k = 0; k < numbers; ++k) m[k] += g[k];
                break;
            }
        }
        if (this->status != DONE) return this->status;
        store_history(h);
        products.multiply(P.data(), M.data(), A.data());
        this->commutator(P.data(), M.data(), A.data(), h, G.data(), false);
        this->advance(x, dx, G.data());
        return DONE;
    }

  private:
    // M = A^-1 W A^-*. Fortran sees transposed matrices: for A the conjugate, 1 + (h/2) P with P as it sees it.
    void solve(double h) {
        double *a = numbers_of(A.data()), *p = numbers_of(P.data());
        for (int64_t k = 0; k < numbers; ++k) a[k] = 0.5 * h * p[k];
        for (int64_t e = 0; e < all; e += n + 1) A[e] += 1.0;
        triangles.factor(A.data());
        std::copy_n(W.data(), all, M.data());
        triangles.both_sides(A.data(), M.data());
    }

    // Solve D - K D = F, where K D is the stream of G, by which D changes the midpoint, until the residual is at most
    // `enough`; return whether that was reached. Residuals are minimized along one direction after the other, whose
    // images under 1 - K are orthogonal to the last ones (truncated GCR).
    bool correct(double h, double enough) {
        std::copy_n(F.data(), all, D.data());
        if (!stream.linear()) return false;
        invert();
        double *d = numbers_of(D.data()), *g = numbers_of(G.data()), *kp = numbers_of(A.data());
        std::fill_n(d, numbers, 0.0);
        std::fill_n(g, numbers, 0.0);
        double* r = numbers_of(F.data());
        for (int64_t k = 0; k < MOST_CORRECTIONS; ++k) {
            Direction& now = directions[k % DIRECTIONS];
            float *p = row(now.p), *q = row(now.q), *moves = row(now.moves);
            for (int64_t e = 0; e < numbers; ++e) p[e] = float(r[e]);
            low.multiply(low_A.data(), now.p.data(), low_C.data());
            low.multiply(low_C.data(), low_M.data(), low_D.data());
            // as seen by Fortran
            skew_part(n, low_D.data(), float(-0.5 * h), now.moves.data(), false);
            for (int64_t e = 0; e < numbers; ++e) kp[e] = moves[e];
            stream.apply_linear(A.data(), C.data());
            ++this->evaluations;
            const double* image = numbers_of(C.data());
            for (int64_t e = 0; e < numbers; ++e) q[e] = float(r[e] - image[e]);
            for (int64_t j = std::max(int64_t(0), k - DIRECTIONS + 1); j < k; ++j) {
                Direction& old = directions[j % DIRECTIONS];
                const float share = float(dot(q, row(old.q)) / old.square);
                const float *op = row(old.p), *oq = row(old.q), *omoves = row(old.moves);
                for (int64_t e = 0; e < numbers; ++e) {
                    q[e] -= share * oq[e];
                    p[e] -= share * op[e];
                    moves[e] -= share * omoves[e];
                }
            }
            now.square = dot(q, q);
            const double share = dot(r, q) / now.square;
            if (!(now.square > 0.0) || !(share - share == 0.0)) return false;
            const double left = largest_of(numbers, [=](int64_t e) {
                d[e] += share * p[e];
                g[e] += share * moves[e];
                return r[e] -= share * q[e];
            });
            if (left <= enough) return true;
        }
        return false;
    }

    template <class A, class B>
    double dot(const A* a, const B* b) const {
        constexpr int64_t ROWS = 8;
        double sums[ROWS] = {};
        int64_t e = 0;
        for (; e + ROWS <= numbers; e += ROWS)
            for (int64_t k = 0; k < ROWS; ++k) sums[k] += double(a[e + k]) * double(b[e + k]);
        for (; e < numbers; ++e) sums[0] += double(a[e]) * double(b[e]);
        for (int64_t k = 1; k < ROWS; ++k) sums[0] += sums[k];
        return sums[0];
    }

    static float* row(std::vector<LowPrecision>& of) { return reinterpret_cast<float*>(of.data()); }

    // The inverse of A, and M, in the lower precision.
    void invert() {
        convert(A, low_C);
        convert(M, low_M);
        std::fill(low_A.begin(), low_A.end(), LowPrecision(0));
        for (int64_t e = 0; e < all; e += n + 1) low_A[e] = LowPrecision(1);
        low.solve(low_C.data(), low_A.data());
    }

    void convert(std::vector<T>& from, std::vector<LowPrecision>& to) const {
        const double* exact = numbers_of(from.data());
        float* rounded = row(to);
        for (int64_t k = 0; k < numbers; ++k) rounded[k] = float(exact[k]);
    }

    // memory: the number of differences of P, the step that they belong to, how many of them gave the best
    // extrapolation, and P with its backward differences, each as its entries on and above the diagonal.
    void extrapolate(double t, double h) {
        const double* memory = this->memory;
        const bool usable = memory && memory[0] == memory[0] && memory[1] == h;
        if (!usable) {
            stream.apply(W.data(), t, P.data());
            return;
        }
        const int64_t taken = int64_t(memory[2]);
        double *sum = numbers_of(G.data());
        const double* past = memory + 3;
        std::copy_n(past, half, sum);
        for (int64_t d = 1; d < taken; ++d)
            for (int64_t k = 0; k < half; ++k) sum[k] += past[d * half + k];
        const T* entry = G.data();
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = i; j < n; ++j, ++entry) {
                P[j * n + i] = -conjugate(*entry);
                P[i * n + j] = *entry;
            }
    }

    void store_history(double h) {
        double* memory = this->memory;
        if (!memory) return;
        const bool usable = memory[0] == memory[0] && memory[1] == h;
        const int64_t known = usable ? int64_t(memory[0]) : 0;
        // Two more than the best extrapolation needs are stored, to test whether they improve it.
        const int64_t stored = std::min({known + 1, DIFFERENCES, (known ? int64_t(memory[2]) : 1) + 2});
        double *past = memory + 3, *next = numbers_of(G.data());
        for (int64_t i = 0, at = 0; i < n; at += n - i, ++i) std::copy_n(P.data() + i * n + i, n - i, G.data() + at);
        int64_t taken = 1;
        double least = std::numeric_limits<double>::infinity();
        for (int64_t d = 0; d < stored; ++d) {
            double* row = past + d * half;
            const bool filled = d < known;
            // The d-th difference is the error of the extrapolation by the first d of them.
            const double extrapolation_error = largest_of(half, [=](int64_t k) {
                const double now = next[k], old = filled ? row[k] : 0.0;
                row[k] = now;
                next[k] = now - old;
                return now;
            });
            if (d > 0 && extrapolation_error < least) least = extrapolation_error, taken = d;
        }
        memory[0] = double(stored);
        memory[1] = h;
        memory[2] = double(taken);
    }
};

}  // namespace coadjoint
