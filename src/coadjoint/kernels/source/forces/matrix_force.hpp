// Forces that move a matrix along its coadjoint orbit, X -> U X U*, U = exp(A) or the Cayley transform of a
// skew-Hermitian A: damping, a heat bath, and Hamiltonian noise. A state of two layers, X0 + eps X1, is conjugated by
// both layers of U, or each of its layers by a single one.
#pragma once

#include <memory>
#include <vector>

#include "forces/increments.hpp"
#include "forces/mode_force.hpp"
#include "matrices/cayley.hpp"
#include "matrices/largest.hpp"
#include "matrices/stream.hpp"

namespace coadjoint {

// U of an element A of `depth` layers, and its action on states; no difference from 1 is formed, so that rounding errors
// are relative to U - 1.
template <class T>
class Conjugation {
  public:
    const int64_t n, square, layers;  // of a state
    std::vector<T> A, E;              // E = U - 1

    // The products of matrices of T and of real ones are given.
    Conjugation(int64_t gemm, int64_t real_gemm, int64_t n, int64_t layers)
        : n(n), square(n * n), layers(layers), A(layers * square), E(layers * square), single(gemm, n, 1),
          whole(gemm, n, layers), cayley(real_gemm, n), swept(n * n), B(layers * square), C(layers * square),
          second(layers * square), third(layers * square), fourth(layers * square) {}

    // Approximate number of multiplications of an exponential and its action.
    int64_t work() const { return 8 * layers * square * n * int64_t(sizeof(T) / sizeof(double)); }

    const Products<T>& products_of(int64_t depth) const { return depth == 1 ? single : whole; }

    // U := exp(A), by its series of A/2^s, of degree 4, 8, 12 or 16, which is squared s times; return a status.
    int64_t exponential(int64_t depth) {
        const Products<T>& products = products_of(depth);
        products.multiply(A.data(), A.data(), second.data());
        products.multiply_skew(second.data(), A.data(), third.data());
        products.multiply(second.data(), second.data(), fourth.data());
        // The norm of a normal matrix is the fourth root of that of its fourth power.
        double most = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            double sum = 0.0;
            for (int64_t j = 0; j < n; ++j) sum += magnitude(fourth[i * n + j]);
            if (!(sum <= most)) most = sum;
        }
        if (!(most - most == 0.0)) return OVERFLOWED;
        double norm = std::sqrt(std::sqrt(most)), scale = 1.0;
        int64_t squarings = 0;
        for (; norm > RADIUS[3]; norm *= 0.5, scale *= 0.5) ++squarings;
        if (scale * double(MOST_SUBSTEPS) < 1.0) return TOO_LONG;
        int64_t block = 0;
        while (norm > RADIUS[block]) ++block;
        double factor[1 + 4 * BLOCKS] = {1.0};
        for (int64_t k = 1; k <= 4 * (block + 1); ++k) factor[k] = factor[k - 1] * scale / double(k);
        const int64_t all = depth * square;
        std::fill_n(B.data(), all, T(0.0));
        for (;; --block) {
            const double* f = factor + 4 * block;
            for (int64_t e = 0; e < all; ++e)
                E[e] = B[e] + ((f[4] * fourth[e] + f[3] * third[e]) + (f[2] * second[e] + f[1] * A[e]));
            if (block == 0) break;
            products.multiply(fourth.data(), E.data(), B.data());
        }
        for (; squarings > 0; --squarings) {
            products.multiply(E.data(), E.data(), B.data());
            for (int64_t e = 0; e < all; ++e) E[e] = 2.0 * E[e] + B[e];
        }
        return DONE;
    }

    // U := (1 + A/2)(1 - A/2)^-1.
    void transform(int64_t depth) {
        const Planes<T> planes = swept.layer();
        for (int64_t e = 0; e < square; ++e) planes.set(e, 0.5 * A[e]);
        cayley.transform(planes);
        for (int64_t e = 0; e < square; ++e) E[e] = planes.at(e);
        if (depth == 2) {
            // (1 + E) A1/2 (1 + E), E = (1 - A0/2)^-1 - 1
            T* const layer = E.data() + square;
            single.multiply(E.data(), A.data() + square, B.data());
            for (int64_t e = 0; e < square; ++e) B[e] = 0.5 * (B[e] + A[square + e]);
            single.multiply(B.data(), E.data(), layer);
            for (int64_t e = 0; e < square; ++e) layer[e] += B[e];
        }
        for (int64_t e = 0; e < depth * square; ++e) E[e] = 2.0 * E[e];
    }

    // X := U X U*.
    void act(int64_t depth, T* X) {
        for_parts(depth, X, [&](T* part, int64_t count) {
            const Products<T>& products = products_of(depth);
            products.multiply(E.data(), part, B.data());
            products.multiply_skew_by_adjoint(B.data(), E.data(), C.data());
            for (int64_t l = 0; l < count; l += square) {
                skew_part(n, B.data() + l, 1.0, C.data() + l, true);
                // The product rounds the diagonal to numbers with a real part, which would grow.
                for (int64_t e = l; e < l + square; e += n + 1) set(C[e], 0.0, Complex(C[e]).imag());
            }
            for (int64_t e = 0; e < count; ++e) part[e] += C[e];
        });
    }

    // M := X + [A, M]/2 + A M A/4: the midpoint of X and its Cayley transform by A; return the largest change.
    double improve_midpoint(int64_t depth, const T* X, T* M) {
        double change = 0.0;
        for_parts(depth, M, [&](T* part, int64_t count) {
            const Products<T>& products = products_of(depth);
            products.multiply(A.data(), part, B.data());
            products.multiply_skew(B.data(), A.data(), C.data());
            for (int64_t e = 0; e < count; ++e) C[e] *= 0.25;
            for (int64_t l = 0; l < count; l += square) skew_part(n, B.data() + l, 0.5, C.data() + l, true);
            const T* const from = X + (part - M);
            for (int64_t e = 0; e < count; ++e) C[e] += from[e];
            const double* const now = reinterpret_cast<const double*>(C.data());
            const double* const before = reinterpret_cast<const double*>(part);
            const int64_t numbers = count * int64_t(sizeof(T) / sizeof(double));
            const double moved = largest_of(numbers, [=](int64_t k) { return now[k] - before[k]; });
            if (!(moved <= change)) change = moved;
            std::copy_n(C.data(), count, part);
        });
        return change;
    }

    // to := [Y, X] in the layers of a state.
    void commutator(const T* Y, const T* X, T* to) {
        whole.multiply(Y, X, B.data());
        for (int64_t l = 0; l < layers * square; l += square) skew_part(n, B.data() + l, 1.0, to + l, false);
    }

    // X1 += [A, X0], A of one layer.
    void shear(T* X) {
        single.multiply(A.data(), X, B.data());
        skew_part(n, B.data(), 1.0, X + square, true);
    }

  private:
    // Bounds of the norm for which the series of degree 4, 8, 12, 16 ends below round-off, and their number.
    static constexpr int64_t BLOCKS = 4;
    static constexpr double RADIUS[BLOCKS] = {1.9e-4, 0.035, 0.234, 0.655};
    const Products<T> single, whole;
    Cayley<T> cayley;
    PlanesOf<T> swept;
    std::vector<T> B, C, second, third, fourth;  // powers of A

    // The parts of a state that one product acts on: both layers together, or one after the other.
    template <class Use>
    void for_parts(int64_t depth, T* X, const Use& use) const {
        if (depth == layers) return use(X, layers * square);
        for (int64_t l = 0; l < layers; ++l) use(X + l * square, square);
    }
};

class MatrixForce {
  public:
    int64_t iterations = 0, evaluations = 0;
    double residual = std::numeric_limits<double>::quiet_NaN();

    virtual ~MatrixForce() = default;
    // As those of `Force`.
    virtual bool around_steps() const { return false; }
    virtual bool acts(double, double, int64_t, int64_t) { return true; }
    virtual int64_t flow(double* x, double t, double tau, int64_t member) = 0;
};

// X' = [A, X] with A = rate[0] times the dual of [Y, X], by the midpoint rule in Cayley transforms, which is symmetric,
// between halves of a noise of `amplitude` in all directions of the blocks on the diagonal. Of the table: `begin` and `aim`
// are the integers and the numbers of the stream Y, `function` has the addresses of the product and of that of real
// matrices, and `position` is the layers of A. Row i belongs to the block b = direction[i] / 4, whose adjoint Casimir is
// rate[1 + b], with the bits REAL_BLOCK and TRACELESS_BLOCK.
template <class T>
class OrbitDamping : public MatrixForce {
  public:
    explicit OrbitDamping(const ForceTable& table)
        : table(table), stream(table.begin, table.aim),
          by(table.function[0], table.function[1], table.begin[0], table.begin[1]),
          n(by.n), square(by.square), all(by.layers * square), depth(table.position), M(all), Y(all), slope(all),
          deviates(table.amplitude[0] > 0.0 ? square : 0) {}

    int64_t flow(double* x, double t, double tau, int64_t member) override {
        T* const X = reinterpret_cast<T*>(x);
        const bool random = table.amplitude[0] > 0.0;
        if (random)
            if (const int64_t status = shake(X, t, tau, 0, member)) return status;
        if (const int64_t status = settle(X, t + 0.5 * tau, tau)) return status;
        return random ? shake(X, t, tau, 1, member) : int64_t(DONE);
    }

  protected:
    // Of the state: corrections that may stagnate as round-off, and multiple of the first one that diverges; midpoint
    // iterations, of which convergent ones take some ten.
    static constexpr double NEAR_ROUND_OFF = 0x1p-40, GROWN = 0x1p20;
    static constexpr int64_t MOST_MIDPOINTS = 192;
    const ForceTable& table;
    Stream<T> stream;
    Conjugation<T> by;
    const int64_t n, square, all, depth;
    std::vector<T> M, Y, slope;
    std::vector<double> deviates;

    int64_t settle(T* X, double middle, double tau) {
        const int64_t numbers = all * int64_t(sizeof(T) / sizeof(double));
        const double* const entries = reinterpret_cast<const double*>(X);
        const double size = largest_of(numbers, [=](int64_t k) { return entries[k]; });
        std::copy_n(X, all, M.data());
        double first = 0.0, last = std::numeric_limits<double>::infinity();
        for (iterations = 1;; ++iterations) {
            if (iterations > MOST_MIDPOINTS) return NOT_CONVERGED;
            InterruptCheck::of_this_call().after(by.work() / 2);
            ++evaluations;
            if (!stream.apply(M.data(), middle, Y.data())) return UNDEFINED;
            by.commutator(Y.data(), M.data(), slope.data());
            set_element(tau * table.rate[0], slope.data(), by.A.data());
            residual = by.improve_midpoint(depth, X, M.data());
            if (!(residual - residual == 0.0)) return OVERFLOWED;
            if (iterations == 1) first = residual;
            if (residual == 0.0 || (residual >= 0.5 * last && residual <= NEAR_ROUND_OFF * size)) break;
            if (residual > GROWN * (first + size)) return NOT_CONVERGED;
            last = residual;
        }
        by.transform(depth);
        by.act(depth, X);
        return DONE;
    }

    // The derivative by one layer is an element of the other.
    void set_element(double factor, const T* Z, T* to) const {
        for (int64_t l = 0; l < depth; ++l) {
            const T* const from = Z + (by.layers - 1 - l) * square;
            for (int64_t e = 0; e < square; ++e) to[l * square + e] = factor * from[e];
        }
    }

    // Half of the noise. Its exponential has the law of a Gaussian element, whose distribution is invariant under U: on
    // functions of X its mean is a function of the Laplacian alone, of which the variance below makes the second order
    // exact. The shears of a second layer commute with that Laplacian.
    int64_t shake(T* X, double t, double tau, int half, int64_t member) {
        const DeviateStream drawn(uint64_t(table.seed), uint64_t(table.stream + member), t, uint64_t(half));
        const double variance = 0.5 * tau * table.amplitude[0] * table.amplitude[0];
        if (depth == 2) {
            draw(DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, uint64_t(2 + half)), variance, false);
            by.shear(X);
        }
        draw(drawn, variance, true);
        if (const int64_t status = by.exponential(1)) return status;
        InterruptCheck::of_this_call().after(by.work());
        by.act(1, X);
        return DONE;
    }

    void draw(const DeviateStream& drawn, double variance, bool corrected) {
        drawn.fill(square, deviates.data());
        const double* const g = deviates.data();
        for (int64_t i = 0; i < n; ++i)
            for (int64_t j = 0; j <= i; ++j) {
                const int64_t e = i * n + j, f = j * n + i;
                if (table.direction[i] != table.direction[j]) {
                    by.A[e] = by.A[f] = T(0.0);
                    continue;
                }
                const double casimir = corrected ? table.rate[1 + table.direction[i] / 4] : 0.0;
                const double imaginary = table.direction[i] & REAL_BLOCK ? 0.0 : 1.0;
                const double size = std::sqrt(variance / (1.0 + variance * casimir / 24.0)), shared = std::sqrt(0.5) * size;
                if (i == j) set(by.A[e], 0.0, imaginary * size * g[e]);
                else set(by.A[e], shared * g[e], imaginary * shared * g[f]);
                if (i != j) by.A[f] = -conjugate(by.A[e]);
            }
    }
};

// X' = sum over k of [A_k, X] o dB_k, on one side of each step: exp(Z1) exp(Z2), Z = (B/2 +- D/sqrt(2)) . A with an
// independent copy D of the increments B, has weak order two for any A_k; where these commute it is exp(B . A), the exact
// flow. Of the table: `function` has the address of the product, the layers of a state, the levels of the increments, and
// the address of the product of real matrices, and `amplitude` is one if the A_k commute. Those that are no modes are `sets` matrices in `basis`, each of
// `direction[0]` layers.
template <class T>
class MatrixNoise : public MatrixForce {
  public:
    explicit MatrixNoise(const ForceTable& table)
        : table(table), modes(table.kind == MODE_TRANSPORT ? new ModeForce(table) : nullptr),
          by(table.function[0], table.function[3], table.extent, table.function[1]), depth(modes ? 1 : table.direction[0]),
          count(modes ? modes->deviates() : table.sets), commuting(table.amplitude[0] != 0.0),
          increments(table, table.function[2], count, commuting ? 0 : count), factors(commuting ? 1 : 2) {}

    bool around_steps() const override { return true; }

    bool acts(double t, double h, int64_t member, int64_t side) override {
        return increments.of(t, h, member).first == (side == 0);
    }

    int64_t flow(double* x, double t, double h, int64_t member) override {
        for (const std::vector<double>& own : factors_of(t, h, member)) {
            combine(own, modes ? table.rate : table.basis, by.A.data());
            if (const int64_t status = by.exponential(depth)) return status;
            InterruptCheck::of_this_call().after(by.work());
            by.act(depth, reinterpret_cast<T*>(x));
        }
        return DONE;
    }

  protected:
    const ForceTable& table;
    const std::unique_ptr<ModeForce> modes;
    Conjugation<T> by;
    const int64_t depth, count;
    const bool commuting;
    BrownianIncrements increments;

    // The factors of the elements in each exponential of a step; the first one acts first.
    const std::vector<std::vector<double>>& factors_of(double t, double h, int64_t member) {
        const BrownianIncrements::Step& step = increments.of(t, h, member);
        if (commuting) factors[0] = step.sums;
        for (size_t factor = 0; !commuting && factor < 2; ++factor) {
            const double share = (factor ? 1.0 : -1.0) * std::sqrt(0.5 * h);
            factors[factor].resize(count);
            for (int64_t k = 0; k < count; ++k)
                factors[factor][k] = fma(share, step.further[k], 0.5 * step.sums[k]);
        }
        return factors;
    }

    int64_t numbers_of_element() const { return depth * by.square * int64_t(sizeof(T) / sizeof(double)); }

    // The sum of elements that consist of these numbers, the amplitudes of modes or all entries.
    void combine(const std::vector<double>& of_elements, const double* numbers, T* to) {
        const int64_t size = numbers_of_element();
        double* const A = reinterpret_cast<double*>(to);
        std::fill_n(A, size, 0.0);
        if (modes) modes->add(of_elements.data(), 1.0, A, numbers);
        for (int64_t k = 0; k < (modes ? 0 : count); ++k) {
            const double factor = of_elements[k], *element = numbers + k * size;
            for (int64_t e = 0; e < size; ++e) A[e] = fma(factor, element[e], A[e]);
        }
    }

  private:
    std::vector<std::vector<double>> factors;
};

// `shape` is one if entries are complex; modes have complex entries.
inline std::unique_ptr<MatrixForce> matrix_force(const ForceTable& table) {
    std::unique_ptr<MatrixForce> found;
    if (table.kind == ON_MATRIX_ORBIT) {
        if (table.shape) found.reset(new OrbitDamping<Complex>(table));
        else found.reset(new OrbitDamping<double>(table));
    }
    if (table.kind == MATRIX_NOISE && !table.shape) found.reset(new MatrixNoise<double>(table));
    else if (table.kind == MATRIX_NOISE || table.kind == MODE_TRANSPORT) found.reset(new MatrixNoise<Complex>(table));
    return found;
}

}  // namespace coadjoint
