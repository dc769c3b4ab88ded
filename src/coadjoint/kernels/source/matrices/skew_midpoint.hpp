// The isospectral midpoint rule of skew-Hermitian matrices, by Newton's method for the stream matrix P at the midpoint.
//
// With X = (h/2) P, B = (1 - X)^-1 and C = B - 1 the midpoint is M = B W B* = W + Z - Z* + V, Z = C W, V = Z C*, and
// P = stream(M) is solved. The step adds 2 (Z - Z*) + 4 V to W, which is conjugation by the Cayley transform 1 + 2 C of
// X: any P preserves the spectrum. A change D of P adds Y - Y* to M, Y = (h/2) B D M, and 2 (Y' - Y'*), Y' = Y - Y X,
// to the step. The linear equation for D needs few digits, and is solved by iteration in the lower precision. The
// initial P is predicted from earlier steps.
#pragma once

#include "matrices/cayley.hpp"
#include "matrices/isospectral.hpp"

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

inline float rounded(double value) { return float(value); }
inline std::complex<float> rounded(const Complex& value) { return {float(value.real()), float(value.imag())}; }
inline double exact(float value) { return value; }
inline Complex exact(const std::complex<float>& value) { return {value.real(), value.imag()}; }

template <class T>
struct SkewMidpoint final : Isospectral<T> {
    typedef Isospectral<T> Base;
    typedef typename Lower<T>::type LowPrecision;
    using Base::n, Base::all, Base::numbers, Base::products, Base::stream;

    static constexpr int64_t HISTORY = 13;            // rows of earlier steps from which P is predicted
    static constexpr int64_t SAMPLES = 256, RUN = 8;  // numbers of a row to which a prediction is fitted, in short runs
    static constexpr int64_t MOST_CORRECTIONS = 24;
    static constexpr double LOW_ACCURACY = 0x1p-21;  // accuracy of a correction in the lower precision
    static constexpr double LAST_DIGIT = 0x1p-52;
    static constexpr double NEAR = 0x1p-28;        // of P: within it, one correction reaches round-off

    const int64_t half;  // real numbers on and above the diagonal; P, F, D and `start` have these only, row by row
    const Products<LowPrecision> low;
    Cayley<T> cayley;
    std::vector<T> X, C, Z, V, M, G, P, F, D, start;
    std::vector<LowPrecision> low_B, low_M, low_D, low_U, low_Y;

    // Directions kept orthogonal; more cost memory, and fewer cost iterations.
    static constexpr int64_t DIRECTIONS = 4;
    struct Direction {
        std::vector<LowPrecision> p, q, y;
        double square, share, overlap[DIRECTIONS];
    };
    Direction directions[DIRECTIONS];

    explicit SkewMidpoint(const StepTables& tables)
        : Base(tables), half(numbers / n * (n + 1) / 2), low(tables.whole[LOWER_GEMM], n, 1),
          cayley(tables.whole[GEMM], n), X(all), C(all), Z(all), V(all), M(all), G(all), P(entries()), F(entries()),
          D(entries()), start(entries()), low_B(all), low_M(all), low_D(all), low_U(all), low_Y(all) {
        for (Direction& each : directions) each.p.resize(entries()), each.q.resize(entries()), each.y.resize(all);
        this->memory_size = 3 + (1 + HISTORY) * half;
    }

    int64_t step(double* x, double* dx, double*, double*, double t, double h) override {
        const T* W = reinterpret_cast<const T*>(x);  // dx is below its last digit
        double *p = numbers_of(P.data()), *f = numbers_of(F.data()), *d = numbers_of(D.data());
        if (!stream.apply(W, t, G.data(), true)) return UNDEFINED;
        pack(G, start);
        predict(h);
        this->iterations = 0, this->evaluations = 1;
        this->status = DONE;
        bool corrected = false;
        const double constant = stream.largest_constant();
        while (!corrected) {
            solve(W, h);
            if (!stream.apply(M.data(), t + 0.5 * h, G.data(), true)) return UNDEFINED;
            ++this->evaluations;
            pack(G, F);
            const double size = std::max(largest_of(half, [=](int64_t k) { return f[k]; }), constant);
            this->residual = largest_of(half, [=](int64_t k) { return f[k] -= p[k]; });
            if (this->ended(this->residual, size) || this->residual <= LAST_DIGIT * size) break;
            const bool last = this->residual <= NEAR * size;
            const double enough = std::max(LOW_ACCURACY * this->residual, last ? LAST_DIGIT * size : NEAR * size / 4);
            corrected = correct(h, enough) && last;
            for (int64_t k = 0; k < half; ++k) p[k] += d[k];
        }
        if (this->status != DONE) return this->status;
        store_history(h);
        increment(corrected);
        this->advance(x, dx, G.data());
        return DONE;
    }

  private:
    int64_t entries() const { return n * (n + 1) / 2; }

    // Call use(first, at, count) for each row: the index of its diagonal entry, that when packed, and their number.
    template <class Use>
    void each_row(const Use& use) const {
        for (int64_t i = 0, at = 0; i < n; at += n - i, ++i) use(i * (n + 1), at, n - i);
    }

    void pack(const std::vector<T>& from, std::vector<T>& to) const {
        each_row([&](int64_t first, int64_t at, int64_t count) {
            std::copy_n(from.data() + first, count, to.data() + at);
        });
    }

    // Set `to` to the skew-Hermitian matrix with the packed entries value(k).
    template <class R, class Value>
    void unpack(std::vector<R>& to, const Value& value) const {
        R* matrix = to.data();
        each_row([&](int64_t first, int64_t at, int64_t count) {
            for (int64_t j = 0; j < count; ++j) matrix[first + j] = value(at + j);
        });
        each_pair(n, [=](int64_t e, int64_t f) {
            if (e != f) matrix[e] = -conjugate(matrix[f]);
        });
    }

    // Compute the midpoint M for P.
    void solve(const T* W, double h) {
        const T* p = P.data();
        unpack(X, [=](int64_t k) { return 0.5 * h * p[k]; });
        std::copy_n(X.data(), all, C.data());
        cayley.transform(C.data());
        products.multiply(C.data(), W, Z.data());
        products.lower_by_adjoint(Z.data(), C.data(), V.data());
        const T *z = Z.data(), *v = V.data();
        T* m = M.data();
        each_pair(n, [=](int64_t e, int64_t f) {
            const T entry = W[e] + (v[e] + (z[e] - conjugate(z[f])));
            m[e] = entry;
            m[f] = e == f ? 0.5 * (entry - conjugate(entry)) : -conjugate(entry);
        });
    }

    // G := 2 (Z - Z*) + 4 V, and with `corrected` the part of the last change of P.
    void increment(bool corrected) {
        const T *z = Z.data(), *v = V.data();
        T* move = G.data();
        const LowPrecision* y = low_Y.data();
        const double twice = 2.0 * this->residual;
        if (corrected) {
            for (int64_t e = 0; e < all; ++e) low_D[e] = rounded(X[e]);
            low.multiply(y, low_D.data(), low_U.data());
            for (int64_t e = 0; e < all; ++e) low_Y[e] -= low_U[e];
        }
        each_pair(n, [=](int64_t e, int64_t f) {
            T entry = 4.0 * v[e] + 2.0 * (z[e] - conjugate(z[f]));
            if (corrected) entry += twice * exact(y[e] - conjugate(y[f]));
            if (e == f) entry = 0.5 * (entry - conjugate(entry));
            move[f] = -conjugate(entry);
            move[e] = entry;
        });
    }

    // Solve D - K D = F, where K D is the stream of Y - Y*, until the residual is at most `enough`; return whether that
    // was reached. Residuals are minimized along one direction after the other, whose images under 1 - K are orthogonal
    // to the others since the last restart (GCR).
    bool correct(double h, double enough) {
        std::copy_n(F.data(), entries(), D.data());
        if (!stream.linear()) return false;
        // The lower precision has a small range: residuals are in units of the first one, and (h/2) M replaces M.
        const double unit = this->residual, scale = 1.0 / unit;
        for (int64_t e = 0; e < all; ++e) low_B[e] = rounded(C[e]), low_M[e] = rounded(0.5 * h * M[e]);
        for (int64_t e = 0; e < all; e += n + 1) low_B[e] += LowPrecision(1);
        std::fill(low_Y.begin(), low_Y.end(), LowPrecision(0));
        double *r = numbers_of(F.data()), *d = numbers_of(D.data());
        for (int64_t k = 0; k < half; ++k) r[k] *= scale, d[k] = 0.0;
        int64_t used = 0;
        double left = 1.0;
        for (int64_t k = 0; k < MOST_CORRECTIONS && !(left <= enough * scale); ++k) {
            if (used == DIRECTIONS) combine(used, unit), used = 0;
            Direction& now = directions[used];
            float *p = row(now.p), *q = row(now.q);
            for (int64_t e = 0; e < half; ++e) p[e] = float(r[e]);
            const LowPrecision* entry = now.p.data();
            unpack(low_D, [=](int64_t e) { return entry[e]; });
            low.multiply(low_B.data(), low_D.data(), low_U.data());
            low.multiply(low_U.data(), low_M.data(), now.y.data());
            const LowPrecision* y = now.y.data();
            T* moved = M.data();
            each_pair(n, [=](int64_t e, int64_t f) {
                moved[f] = exact(y[f] - conjugate(y[e]));
                moved[e] = -conjugate(moved[f]);
            });
            stream.apply_linear(M.data(), G.data(), true);
            ++this->evaluations;
            each_row([&](int64_t first, int64_t at, int64_t count) {
                for (int64_t j = 0; j < count; ++j) now.q[at + j] = rounded(F[at + j] - G[first + j]);
            });
            for (int64_t j = 0; j < used; ++j) {
                Direction& old = directions[j];
                const float *other = row(old.q), overlap = float(dot(q, other) / old.square);
                now.overlap[j] = overlap;
                for (int64_t e = 0; e < half; ++e) q[e] -= overlap * other[e];
            }
            now.square = dot(q, q);
            now.share = dot(r, q) / now.square;
            if (!(now.square > 0.0) || !(now.share - now.share == 0.0)) break;
            const double share = now.share;
            left = largest_of(half, [=](int64_t e) { return r[e] -= share * q[e]; });
            ++used;
        }
        combine(used, unit);
        return left <= enough * scale;
    }

    // Add the sum of the directions to D and low_Y: shares of the orthogonal images become those of the directions.
    void combine(int64_t used, double unit) {
        double* d = numbers_of(D.data());
        for (int64_t k = used - 1; k >= 0; --k) {
            Direction& now = directions[k];
            const double share = now.share;
            for (int64_t j = 0; j < k; ++j) directions[j].share -= now.overlap[j] * share;
            const float* p = row(now.p);
            for (int64_t e = 0; e < half; ++e) d[e] += unit * share * double(p[e]);
            for (int64_t e = 0; e < all; ++e) low_Y[e] += float(share) * now.y[e];
        }
    }

    template <class A, class B>
    double dot(const A* a, const B* b) const { return dot(half, a, b); }

    template <class A, class B>
    static double dot(int64_t count, const A* a, const B* b) {
        // Partial sums, in a fixed order on every processor.
        constexpr int64_t ROWS = 8;
        double sums[ROWS] = {};
        int64_t e = 0;
        for (; e + ROWS <= count; e += ROWS)
            for (int64_t k = 0; k < ROWS; ++k) sums[k] += double(a[e + k]) * double(b[e + k]);
        for (; e < count; ++e) sums[0] += double(a[e]) * double(b[e]);
        for (int64_t k = 1; k < ROWS; ++k) sums[0] += sums[k];
        return sums[0];
    }

    static float* row(std::vector<LowPrecision>& of) { return reinterpret_cast<float*>(of.data()); }

    // memory: the number of steps that it knows, their length, the row that was written last, P of the last step, and a
    // ring of rows: P + (P of the step before) - 2 stream(W in between), small and smooth in time.
    bool known_steps(double h) const {
        return this->memory && this->memory[0] == this->memory[0] && this->memory[1] == h;
    }
    double* past(int64_t steps) const {
        return this->memory + 3 + (1 + (int64_t(this->memory[2]) + steps) % HISTORY) * half;
    }

    // The next row is predicted by the combination that fits the last one to those before it.
    void predict(double h) {
        double *p = numbers_of(P.data()), *s = numbers_of(start.data());
        if (!known_steps(h)) {
            std::copy_n(s, half, p);
            return;
        }
        double factor[HISTORY];
        const int64_t taken = fit(int64_t(this->memory[0]) - 1, factor);
        const double* last = this->memory + 3;
        // Numbers that stay in the first cache while all samples are added.
        constexpr int64_t BLOCK = 2048;
        for (int64_t begin = 0; begin < half; begin += BLOCK) {
            const int64_t end = std::min(begin + BLOCK, half);
            for (int64_t k = begin; k < end; ++k) p[k] = 2.0 * s[k] - last[k];
            for (int64_t j = 0; j < taken; ++j) {
                const double *row = past(j), share = factor[j];
                for (int64_t k = begin; k < end; ++k) p[k] += share * row[k];
            }
        }
    }

    // Least squares for samples of the rows, by orthogonalization; return the number of factors.
    int64_t fit(int64_t rows, double* factor) const {
        if (rows < 2) return std::fill_n(factor, rows, 1.0), rows;
        const int64_t count = std::min(half, SAMPLES), run = half < SAMPLES ? half : RUN, runs = count / run;
        double sample[HISTORY][SAMPLES], share[HISTORY][HISTORY];  // the last row in sample[0]
        for (int64_t j = 0; j < rows; ++j) {
            const double* row = past(j);
            for (int64_t k = 0; k < runs; ++k) std::copy_n(row + k * (half / runs), run, sample[j] + k * run);
        }
        const double* newest = sample[0];
        const double scale = 1.0 / largest_of(count, [=](int64_t k) { return newest[k]; });
        if (!(scale - scale == 0.0)) return 0;
        int64_t taken = 0;
        for (int64_t j = 0; j < rows; ++j)
            for (int64_t k = 0; k < count; ++k) sample[j][k] *= scale;
        for (int64_t j = 1; j < rows && taken < count / 2; ++j, ++taken) {
            const double square = dot(count, sample[j], sample[j]);
            if (!(square > 0.0)) break;
            for (int64_t i = 0; i < rows; ++i) {
                if (i > 0 && i <= j) continue;
                const double part = share[j][i] = dot(count, sample[j], sample[i]) / square;
                for (int64_t k = 0; k < count; ++k) sample[i][k] -= part * sample[j][k];
            }
        }
        for (int64_t j = taken; j > 0; --j) {
            factor[j - 1] = share[j][0];
            for (int64_t i = j + 1; i <= taken; ++i) factor[j - 1] -= share[j][i] * factor[i - 1];
        }
        return taken;
    }

    void store_history(double h) {
        double* memory = this->memory;
        if (!memory) return;
        const bool known = known_steps(h);
        if (!known) memory[0] = 0.0, memory[1] = h, memory[2] = 0.0;
        const double *p = numbers_of(P.data()), *s = numbers_of(start.data());
        double* last = memory + 3;
        if (known) {
            memory[2] = double((int64_t(memory[2]) + HISTORY - 1) % HISTORY);
            double* row = past(0);
            for (int64_t k = 0; k < half; ++k) row[k] = (p[k] - s[k]) + (last[k] - s[k]);
        }
        std::copy_n(p, half, last);
        memory[0] = std::min(memory[0] + 1.0, double(HISTORY + 1));
    }
};

}  // namespace coadjoint
