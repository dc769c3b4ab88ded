// Derivatives of the damping of matrices along their orbits with its noise: by the state, the amplitude of the noise, the
// factor of the damping, and moved parameters of the stream.
//
// Its midpoint is M = L X L*, L = (1 - A/2)^-1, and its end X + [A, M], of A = c K [Y, M], where Y is the stream of M and K
// makes an element of a derivative. With the linear part S of the stream, tangents are
//     dM = L dX L* + T dA,  T a = (Z - Z*)/2,  Z = L a M,    dA = c K ([S dM, M] + [Y, dM]) = D dM.
// S and K are symmetric in the pairing of states with elements, in which a factor is transposed by its adjoint, and which
// pairs layers X0 + eps X1 with those in reverse order. With the cotangent G of the end those of A and M are
//     a = [M, G] + T' m,  T' m = (Z* - Z)/2,  Z = L* m M,    m = D' a - [A, G],  D' a = S [M, b] - [Y, b],  b = c K a,
// and that of the state G + L* m L. The linear equations of dM and m are solved by fixed points, from predictions.
#pragma once

#include <array>
#include <deque>
#include <map>

#include "forces/matrix_force.hpp"
#include "matrices/prediction.hpp"
#include "tangents/decay_derivatives.hpp"
#include "tangents/orbit_derivatives.hpp"

namespace coadjoint {

class MatrixOrbitDerivative {
  public:
    virtual ~MatrixOrbitDerivative() = default;
    // As those of `OrbitDerivative`, for flows that follow each other at the same `place` of a step.
    virtual bool push(const double* x, const double* end, double t, double tau, int64_t member, int64_t place,
                      double* vectors, int64_t count, const double* directions, int64_t stride) = 0;
    virtual bool pull(const double* x, const double* end, double t, double tau, int64_t member, int64_t place,
                      double* cotangent, double* by_coefficients) = 0;
};

template <class T>
class DampingDerivative final : OrbitDamping<T>, public MatrixOrbitDerivative {
    typedef OrbitDamping<T> Base;
    using Base::table, Base::stream, Base::by, Base::n, Base::square, Base::all, Base::depth, Base::M, Base::Y, Base::slope;

  public:
    DampingDerivative(const ForceTable& force, const ForceDerivatives& derivatives)
        : Base(force), derivatives(derivatives), products(by.products_of(by.layers)),
          numbers(all * int64_t(sizeof(T) / sizeof(double))), dY(derivatives.moved, std::vector<T>(all)), chord(all), F(all),
          F_adjoint(all), known(all), rest(all), d(all), a(all), b(all), first(all), second(all), third(all), forced(all),
          vector(all) {
        for (int64_t j = 0; j < NODES * derivatives.moved; ++j) {
            const ForceTable& there = *reinterpret_cast<const ForceTable*>(derivatives.nearby[j]);
            nearby.emplace_back(there.begin, there.aim);
        }
    }

    bool push(const double* x, const double* end, double t, double tau, int64_t member, int64_t place, double* vectors,
              int64_t count, const double* directions, int64_t stride) override {
        if (!find(matrix(x), matrix(end), t, tau, member)) return false;
        bool directed = false;
        for (int64_t v = 0; v < count; ++v)
            for (int64_t k = 0; k < derivatives.moved; ++k)
                directed = directed || directions[v * stride + derivatives.own + k] != 0.0;
        if (directed && !find_slopes()) return false;
        for (int64_t v = 0; v < count; ++v) {
            const double* const along = directions + v * stride;
            T* const dX = vector.data();
            load(matrix(vectors) + v * all, dX, false);
            for (size_t k = 0; k < middle_turn; ++k) push_turn(turns[k], along[0], dX);
            // What does not depend on the change of the midpoint.
            this->set_element(tau * along[1], slope.data(), forced.data());
            for (int64_t k = 0; directed && k < derivatives.moved; ++k) {
                bracket(dY[k].data(), M.data(), third.data(), false);
                for (int64_t e = 0; e < all; ++e) third[e] *= along[derivatives.own + k];
                this->set_element(c, third.data(), a.data());
                for (int64_t e = 0; e < all; ++e) forced[e] += a[e];
            }
            std::copy_n(dX, all, known.data());
            conjugate_by(F, known.data());
            const bool solved = solve({member, place, v}, size_of(dX), [&] {
                change_of_element();
                through_midpoint(F, a.data(), 0.5, rest.data());
                return true;
            });
            if (!solved) return false;
            add_known();
            change_of_element();
            bracket(a.data(), M.data(), dX, true);
            bracket(by.A.data(), d.data(), dX, true);
            for (size_t k = middle_turn; k < turns.size(); ++k) push_turn(turns[k], along[0], dX);
            std::copy_n(dX, all, matrix(vectors) + v * all);
        }
        return true;
    }

    bool pull(const double* x, const double* end, double t, double tau, int64_t member, int64_t place, double* cotangent,
              double* by_coefficients) override {
        if (!find(matrix(x), matrix(end), t, tau, member)) return false;
        T* const G = vector.data();
        load(matrix(cotangent), G, true);
        for (size_t k = turns.size(); k-- > middle_turn;) pull_turn(turns[k], G, by_coefficients[0]);
        bracket(G, by.A.data(), known.data(), false);
        bracket(M.data(), G, forced.data(), false);
        const auto find_element = [&] {
            add_known();
            through_midpoint(F_adjoint, d.data(), -0.5, a.data());
            for (int64_t e = 0; e < all; ++e) a[e] += forced[e];
        };
        const bool solved = solve({member, place, 0}, size_of(G), [&] {
            find_element();
            this->set_element(c, a.data(), b.data());
            bracket(M.data(), b.data(), third.data(), false);
            slope_along(third.data(), rest.data());
            bracket(b.data(), Y.data(), rest.data(), true);
            return true;
        });
        if (!solved) return false;
        find_element();
        this->set_element(tau, a.data(), b.data());
        by_coefficients[1] += paired(b.data(), slope.data());
        if (derivatives.moved && !find_slopes()) return false;
        bracket(M.data(), b.data(), third.data(), false);
        for (int64_t k = 0; k < derivatives.moved; ++k)
            by_coefficients[derivatives.own + k] += table.rate[0] * paired(third.data(), dY[k].data());
        conjugate_by(F_adjoint, d.data());
        for (int64_t e = 0; e < all; ++e) G[e] += d[e];
        for (size_t k = middle_turn; k-- > 0;) pull_turn(turns[k], G, by_coefficients[0]);
        load(G, matrix(cotangent), true);
        return true;
    }

  private:
    // One exponential of the noise: U - 1, the state after it, and the derivative of its generator by the amplitude.
    struct Turn {
        int64_t depth;
        std::vector<T> E, after, by_amplitude;
    };
    struct History {
        int64_t count = 0;
        std::vector<double> rows;
    };
    typedef std::array<int64_t, 3> Unknown;  // the member, the place, and the number of the vector
    static constexpr int64_t HISTORY = 8, MOST_NUMBERS = int64_t(1) << 22;
    const ForceDerivatives& derivatives;
    const Products<T>& products;
    const int64_t numbers;
    std::deque<Stream<T>> nearby;
    std::vector<Turn> turns;
    size_t middle_turn = 0;  // the first one after the damping
    double c = 0.0, middle = 0.0;
    std::vector<std::vector<T>> dY;
    std::vector<T> chord, F, F_adjoint, known, rest, d, a, b, first, second, third, forced, vector;  // F is L - 1
    std::vector<double> before;
    std::map<Unknown, History> histories;

    static const T* matrix(const double* x) { return reinterpret_cast<const T*>(x); }
    static T* matrix(double* x) { return reinterpret_cast<T*>(x); }
    static double* numbers_of(std::vector<T>& X) { return reinterpret_cast<double*>(X.data()); }

    // Project a vector on the algebra; the layers of a cotangent are exchanged.
    void load(const T* from, T* to, bool exchanged) {
        for (int64_t l = 0; l < by.layers; ++l) {
            T* const layer = first.data() + (exchanged ? by.layers - 1 - l : l) * square;
            skew_part(n, from + l * square, 0.5, layer, false);
            project_on_blocks(n, table.direction, layer);
        }
        std::copy_n(first.data(), all, to);
    }

    double size_of(const T* X) const {
        const double* const entries = reinterpret_cast<const double*>(X);
        double sum = 0.0;
        for (int64_t e = 0; e < numbers; ++e) sum += absolute(entries[e]);
        return sum;
    }

    // The pairing, of layers with those in reverse order.
    double paired(const T* P, const T* X) const {
        const int64_t count = numbers / by.layers;
        double sum = 0.0;
        for (int64_t l = 0; l < by.layers; ++l)
            sum += dot(count, reinterpret_cast<const double*>(P) + (by.layers - 1 - l) * count,
                       reinterpret_cast<const double*>(X) + l * count);
        return sum;
    }

    // to := [A, B], or to += that.
    void bracket(const T* A, const T* B, T* to, bool add) {
        InterruptCheck::of_this_call().after(by.work() / 4);
        products.multiply(A, B, second.data());
        for (int64_t l = 0; l < all; l += square) skew_part(n, second.data() + l, 1.0, to + l, add);
    }

    // X := (1 + E) X (1 + E)*
    void conjugate_by(const std::vector<T>& E, T* X, int64_t deep = 0) {
        std::copy_n(E.data(), (deep ? deep : depth) * square, by.E.data());
        by.act(deep ? deep : depth, X);
    }

    void set_adjoint(const std::vector<T>& from, std::vector<T>& to) const {
        for (int64_t l = 0; l < all; l += square)
            for (int64_t i = 0; i < n; ++i)
                for (int64_t j = 0; j < n; ++j) to[l + i * n + j] = conjugate(from[l + j * n + i]);
    }

    // out := the linear part of the stream
    void slope_along(const T* X, T* out) {
        if (stream.linear()) return stream.apply_linear(X, out);
        stream.apply(X, middle, out);
        const T* const constant = table.begin[4] ? reinterpret_cast<const T*>(table.aim) : nullptr;
        for (int64_t e = 0; constant && e < all; ++e) out[e] -= constant[e];
    }

    // d := the known part and the rest
    void add_known() {
        for (int64_t e = 0; e < all; ++e) d[e] = known[e] + rest[e];
    }

    // a := the change of the element by that of the midpoint
    void change_of_element() {
        add_known();
        slope_along(d.data(), first.data());
        bracket(first.data(), M.data(), third.data(), false);
        bracket(Y.data(), d.data(), third.data(), true);
        this->set_element(c, third.data(), a.data());
        for (int64_t e = 0; e < all; ++e) a[e] += forced[e];
    }

    // out := factor (Z - Z*), Z = (1 + E) X M
    void through_midpoint(const std::vector<T>& E, const T* X, double factor, T* out) {
        products.multiply(E.data(), X, first.data());
        for (int64_t e = 0; e < all; ++e) first[e] += X[e];
        products.multiply(first.data(), M.data(), second.data());
        for (int64_t l = 0; l < all; l += square) skew_part(n, second.data() + l, factor, out + l, false);
    }

    void push_turn(const Turn& turn, double by_amplitude, T* dX) {
        conjugate_by(turn.E, dX, turn.depth);
        if (by_amplitude == 0.0) return;
        bracket(turn.by_amplitude.data(), turn.after.data(), third.data(), false);
        for (int64_t e = 0; e < all; ++e) dX[e] += by_amplitude * third[e];
    }

    void pull_turn(const Turn& turn, T* G, double& by_amplitude) {
        bracket(turn.after.data(), G, third.data(), false);
        by_amplitude += paired(third.data(), turn.by_amplitude.data());
        set_adjoint(turn.E, first);
        conjugate_by(first, G, turn.depth);
    }

    // Find the midpoint of the damping between the states around it, and what the derivatives need there.
    bool find(const T* x, const T* end, double t, double tau, int64_t member) {
        std::copy_n(x, all, known.data()), std::copy_n(end, all, rest.data());
        turns.clear();
        if (table.amplitude[0] > 0.0) {
            for (int half = 0; half < 2; ++half) {
                middle_turn = turns.size();
                for (const bool shears : {true, false})
                    if (!(shears && depth == 1) && !find_turn(t, tau, half, shears, member)) return false;
            }
            for (size_t k = 0; k < middle_turn; ++k) {
                conjugate_by(turns[k].E, known.data(), turns[k].depth);
                turns[k].after = known;
            }
            for (size_t k = turns.size(); k-- > middle_turn;) {
                turns[k].after = rest;
                set_adjoint(turns[k].E, first);
                conjugate_by(first, rest.data(), turns[k].depth);
            }
        }
        c = tau * table.rate[0], middle = t + 0.5 * tau;
        for (int64_t e = 0; e < all; ++e) M[e] = chord[e] = 0.5 * (known[e] + rest[e]);
        std::fill(by.A.begin(), by.A.end(), T(0.0));
        const auto find_element = [&] {
            if (!stream.apply(M.data(), middle, Y.data())) return false;
            bracket(Y.data(), M.data(), slope.data(), false);
            this->set_element(c, slope.data(), by.A.data());
            return true;
        };
        const auto change = iterate(numbers_of(M), numbers, before, [&] {
            if (!find_element()) return false;
            products.multiply(by.A.data(), M.data(), first.data());
            products.multiply_skew(first.data(), by.A.data(), second.data());
            for (int64_t e = 0; e < all; ++e) M[e] = chord[e] + 0.25 * second[e];
            return true;
        });
        if (!change || !find_element()) return false;
        by.transform(depth);
        for (int64_t e = 0; e < depth * square; ++e) F[e] = 0.5 * by.E[e];
        set_adjoint(F, F_adjoint);
        return true;
    }

    // An exponential of `shake`; a shear is one of dual numbers. Parts of its generator in blocks commute with it.
    bool find_turn(double t, double tau, int half, bool shears, int64_t member) {
        const double variance = 0.5 * tau * table.amplitude[0] * table.amplitude[0];
        this->draw(DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, uint64_t(shears ? 2 + half : half)),
                   variance, !shears);
        Turn turn{shears ? 2 : 1, std::vector<T>(all), std::vector<T>(), std::vector<T>(all)};
        const int64_t layer = shears ? square : 0;
        for (int64_t i = 0; i < n; ++i) {
            const double casimir = shears ? 0.0 : table.rate[1 + table.direction[i] / 4];
            const double factor = 1.0 / (table.amplitude[0] * (1.0 + variance * casimir / 24.0));
            for (int64_t e = i * n; e < (i + 1) * n; ++e) turn.by_amplitude[layer + e] = factor * by.A[e];
        }
        if (!shears && by.exponential(1) != DONE) return false;
        std::copy_n((shears ? by.A : by.E).data(), square, turn.E.data() + layer);
        turns.push_back(std::move(turn));
        return true;
    }

    // The derivatives of the stream at the midpoint by moved parameters.
    bool find_slopes() {
        for (int64_t k = 0; k < derivatives.moved; ++k) {
            std::fill(dY[k].begin(), dY[k].end(), T(0.0));
            for (int64_t node = 0; node < NODES; ++node) {
                if (!nearby[k * NODES + node].apply(M.data(), middle, first.data())) return false;
                const double weight = difference_weight(node) / derivatives.distance[k];
                for (int64_t e = 0; e < all; ++e) dY[k][e] += weight * first[e];
            }
        }
        return true;
    }

    // Solve for `rest`, which `improve` computes of itself, with errors relative to a size; from a prediction by earlier flows.
    template <class Improve>
    bool solve(const Unknown& unknown, double size, const Improve& improve) {
        std::fill(rest.begin(), rest.end(), T(0.0));
        // Those of flows with noise are not smooth. Which histories fit does not depend on other members.
        const bool fits = (unknown[1] + 1) * (unknown[2] + 1) * HISTORY * numbers <= MOST_NUMBERS;
        History* const history = turns.empty() && fits ? &histories[unknown] : nullptr;
        const auto earlier = [&](int64_t j) -> const double* {
            return history->rows.data() + (history->count - 1 - j) % HISTORY * numbers;
        };
        if (history && history->count > 0) {
            double factor[HISTORY];
            const int64_t count = fit_rows(numbers, std::min(history->count, HISTORY), earlier, factor);
            add_rows(numbers, count, earlier, factor, numbers_of(rest));
        }
        if (!iterate(numbers_of(rest), numbers, before, improve, size) || !finite(numbers, numbers_of(rest))) return false;
        if (!history) return true;
        history->rows.resize(HISTORY * numbers);
        std::copy_n(numbers_of(rest), numbers, history->rows.data() + history->count++ % HISTORY * numbers);
        return true;
    }
};

// Derivatives of the noise of Hamiltonians on matrices, by the state and by the numbers of its elements. Those of
// X -> U X U* with U = exp(A), A a combination of elements, are
//     dX -> U dX U* + [F(ad A) dA, U X U*],  F(z) = (exp(z) - 1)/z,
// and ad A is skew in the pairing. F is summed as a series for A/2^s, and doubled by F(2z) = (1 + exp(z)) F(z)/2. Layers that
// one element conjugates are paired each with itself.
template <class T>
class MatrixNoiseDerivative final : MatrixNoise<T>, public MatrixOrbitDerivative {
    typedef MatrixNoise<T> Base;
    using Base::table, Base::modes, Base::by, Base::depth, Base::count;

  public:
    MatrixNoiseDerivative(const ForceTable& force, const ForceDerivatives& derivatives)
        : Base(force), derivatives(derivatives), products(by.products_of(depth)), n(by.n), square(by.square),
          all(by.layers * square), size(depth * square), after(all), element(all), term(all), product(all) {}

    bool push(const double*, const double* end, double t, double h, int64_t member, int64_t, double* vectors, int64_t carried,
              const double* directions, int64_t stride) override {
        if (!find(end, t, h, member)) return false;
        for (int64_t v = 0; v < carried; ++v) {
            T* const dX = reinterpret_cast<T*>(vectors) + v * all;
            const double* const along = directions + v * stride;
            const bool directed = std::any_of(along, along + derivatives.own, [](double entry) { return entry != 0.0; });
            project(dX);
            for (const Turn& turn : turns) {
                conjugate_by(turn.E.back(), dX);
                if (!directed) continue;
                this->combine(turn.factors, along, element.data());
                if (!average(turn, 1.0)) return false;
                for (int64_t l = 0; l < all; l += size) bracket(element.data(), turn.after.data() + l, dX + l, true);
            }
        }
        return true;
    }

    bool pull(const double*, const double* end, double t, double h, int64_t member, int64_t, double* cotangent,
              double* by_coefficients) override {
        if (!find(end, t, h, member)) return false;
        T* const G = reinterpret_cast<T*>(cotangent);
        project(G);
        exchange(G);
        for (size_t k = turns.size(); k-- > 0;) {
            const Turn& turn = turns[k];
            if (derivatives.own) {
                for (int64_t l = 0; l < all; l += size) bracket(turn.after.data() + l, G + l, element.data(), l > 0);
                if (!average(turn, -1.0)) return false;
                exchange(element.data());
                add_slopes(turn.factors, reinterpret_cast<const double*>(element.data()), by_coefficients);
            }
            conjugate_by(adjoint_of(turn.E.back()), G);
        }
        exchange(G);
        return true;
    }

  private:
    // One exponential: A/2^s, U - 1 of that and of its doubles, the state after it, and the factors of its elements.
    struct Turn {
        std::vector<T> A;
        std::vector<std::vector<T>> E;
        std::vector<T> after;
        std::vector<double> factors;
    };
    static constexpr double MOST = 2.0, ROUNDING = 0x1p-56;  // of the norm of A/2^s, and of terms that are left out
    static constexpr int MOST_TERMS = 64;
    const ForceDerivatives& derivatives;
    const Products<T>& products;
    const int64_t n, square, all, size;
    std::vector<Turn> turns;
    std::vector<T> after, element, term, product;

    bool find(const double* end, double t, double h, int64_t member) {
        turns.clear();
        for (const std::vector<double>& factors : this->factors_of(t, h, member)) {
            Turn turn{std::vector<T>(size), {}, {}, factors};
            this->combine(factors, modes ? table.rate : table.basis, turn.A.data());
            double norm = std::sqrt(squares(turn.A.data(), square)), scale = 1.0;
            if (!(norm - norm == 0.0)) return false;
            int doublings = 0;
            for (; norm * scale > MOST; scale *= 0.5) ++doublings;
            for (int64_t e = 0; e < size; ++e) by.A[e] = turn.A[e] *= scale;
            InterruptCheck::of_this_call().after(by.work());
            if (by.exponential(depth) != DONE) return false;
            turn.E.emplace_back(by.E.begin(), by.E.begin() + size);
            for (; doublings > 0; --doublings) {
                std::vector<T> next = turn.E.back();
                products.multiply(next.data(), next.data(), product.data());
                for (int64_t e = 0; e < size; ++e) next[e] = 2.0 * next[e] + product[e];
                turn.E.push_back(std::move(next));
            }
            turns.push_back(std::move(turn));
        }
        std::copy_n(reinterpret_cast<const T*>(end), all, after.data());
        for (size_t k = turns.size(); derivatives.own && k-- > 0;) {
            turns[k].after = after;
            if (k) conjugate_by(adjoint_of(turns[k].E.back()), after.data());
        }
        return true;
    }

    double squares(const T* X, int64_t entries) const {
        const int64_t numbers = entries * int64_t(sizeof(T) / sizeof(double));
        return dot(numbers, reinterpret_cast<const double*>(X), reinterpret_cast<const double*>(X));
    }

    // Vectors and cotangents are those of the algebra.
    void project(T* X) const {
        for (int64_t l = 0; l < all; l += square) skew_part(n, X + l, 0.5, X + l, false);
    }

    void exchange(T* X) const {
        if (depth == 2) std::swap_ranges(X, X + square, X + square);
    }

    // to := [A, B], or to += that.
    void bracket(const T* A, const T* B, T* to, bool add) {
        InterruptCheck::of_this_call().after(by.work() / 8);
        products.multiply(A, B, product.data());
        for (int64_t l = 0; l < size; l += square) skew_part(n, product.data() + l, 1.0, to + l, add);
    }

    // X := (1 + E) X (1 + E)*
    void conjugate_by(const std::vector<T>& E, T* X) {
        std::copy_n(E.data(), size, by.E.data());
        by.act(depth, X);
    }

    std::vector<T> adjoint_of(const std::vector<T>& E) const {
        std::vector<T> to(size);
        for (int64_t l = 0; l < size; l += square)
            for (int64_t i = 0; i < n; ++i)
                for (int64_t j = 0; j < n; ++j) to[l + i * n + j] = conjugate(E[l + j * n + i]);
        return to;
    }

    // The element becomes F(ad A) of itself, or F(-ad A).
    bool average(const Turn& turn, double sign) {
        const double least = ROUNDING * ROUNDING * squares(element.data(), size);
        std::copy_n(element.data(), size, term.data());
        int k = 1;
        for (; k < MOST_TERMS && !(squares(term.data(), size) <= least); ++k) {
            bracket(turn.A.data(), term.data(), term.data(), false);
            for (int64_t e = 0; e < size; ++e) element[e] += term[e] *= sign / double(k + 1);
        }
        for (size_t s = 0; s + 1 < turn.E.size(); ++s) {
            std::copy_n(element.data(), size, term.data());
            conjugate_by(sign > 0.0 ? turn.E[s] : adjoint_of(turn.E[s]), term.data());
            for (int64_t e = 0; e < size; ++e) element[e] = 0.5 * (element[e] + term[e]);
        }
        return k < MOST_TERMS;
    }

    void add_slopes(const std::vector<double>& factors, const double* of_element, double* by_coefficients) {
        const int64_t numbers = this->numbers_of_element();
        if (modes) modes->add_slopes(factors.data(), 1.0, of_element, by_coefficients);
        for (int64_t k = 0; k < (modes ? 0 : count); ++k)
            for (int64_t e = 0; e < numbers; ++e)
                by_coefficients[k * numbers + e] = fma(factors[k], of_element[e], by_coefficients[k * numbers + e]);
    }
};

inline std::unique_ptr<MatrixOrbitDerivative> matrix_orbit_derivative(const ForceTable& force, const ForceDerivatives& table) {
    typedef std::unique_ptr<MatrixOrbitDerivative> Found;
    const bool real = force.kind != MODE_TRANSPORT && !force.shape;
    if (force.kind != ON_MATRIX_ORBIT)
        return real ? Found(new MatrixNoiseDerivative<double>(force, table)) : Found(new MatrixNoiseDerivative<Complex>(force, table));
    return real ? Found(new DampingDerivative<double>(force, table)) : Found(new DampingDerivative<Complex>(force, table));
}

}  // namespace coadjoint
