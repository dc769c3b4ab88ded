// Forces on the modes of a matrix: individual rates, or a noise.
#pragma once

#include "forces/random.hpp"
#include "matrices/modes.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

class ModeForce {
    // What the change k adds to a mode, with a sign of the imaginary part.
    auto change_of(int64_t k, double sign) const {
        const double* const weights = table.rate + (1 + k) * modes.count();
        return [this, weights, sign](int64_t e, const Complex& c) {
            const double real = weights[e] * values[2 * e], imaginary = sign * weights[e] * values[2 * e + 1];
            return Complex(real * c.real() - imaginary * c.imag(), real * c.imag() + imaginary * c.real());
        };
    }

  public:
    explicit ModeForce(const ForceTable& table) : table(table), modes(table) {}

    // c' = -(rate + i turning) c, exactly. `function` has the number of changes, one if a buoyancy adds to the vorticity,
    // and a layer that is changed and one that is read for each change. `rate` has the rates, then for each change the
    // weights of what is read. `aim` is the state at rest, if `sets` is one, then the factors of the buoyancy.
    void relax(double* x, double tau) {
        if (prepared_for != tau) prepare(tau);
        const int64_t square = modes.size() * modes.size();
        Complex* const X = reinterpret_cast<Complex*>(x);
        const Complex* rest = table.sets ? reinterpret_cast<const Complex*>(table.aim) : nullptr;
        const double* const factors = table.function[1] ? table.aim + 4 * square : nullptr;
        if (factors) {
            before.assign(X, X + square);
            at_rest.assign(rest, rest + 2 * square);
            for (int64_t e = 0; e < square; ++e) at_rest[square + e] += factors[e] * X[e];
            rest = at_rest.data();
        }
        const Complex* const source = as_before(X);
        for (int64_t k = 0; k < table.function[0]; ++k) {
            const int64_t changed = table.function[2 + 2 * k] * square, read = table.function[3 + 2 * k] * square;
            modes.change(X + changed, source + read, rest ? rest + read : nullptr, false, change_of(k, 1.0));
        }
        if (!factors) return;
        Complex mean(0.0);
        for (int64_t e = 0; e < square; ++e) {
            const Complex added = factors[e] * (X[e] - before[e]);
            X[square + e] += added;
            if (e % (modes.size() + 1) == 0) mean += added / double(modes.size());
        }
        for (int64_t e = square; e < 2 * square; e += modes.size() + 1) X[e] -= mean;
    }

    // Apply the derivative of `relax`, or its transpose, to layers of skew-Hermitian matrices, without a buoyancy.
    void carry(double* vector, double tau, bool transposed) {
        if (prepared_for != tau) prepare(tau);
        const int64_t square = modes.size() * modes.size();
        Complex* const X = reinterpret_cast<Complex*>(vector);
        const Complex* const source = as_before(X);
        for (int64_t k = 0; k < table.function[0]; ++k) {
            const int64_t changed = table.function[2 + 2 * k] * square, read = table.function[3 + 2 * k] * square;
            modes.change(X + (transposed ? read : changed), source + (transposed ? changed : read), nullptr, false,
                         change_of(k, transposed ? -1.0 : 1.0));
        }
    }

    // Whether another force relaxes the same modes of the same layers.
    bool has_modes_of(const ForceTable& other) const {
        const int64_t diagonals = modes.diagonals();
        return table.extent == other.extent && table.shape == other.shape &&
               std::equal(table.function, table.function + 2 + 2 * table.function[0], other.function) &&
               std::equal(table.begin, table.begin + diagonals + 1, other.begin) &&
               std::equal(table.direction, table.direction + modes.count(), other.direction) &&
               std::equal(table.basis, table.basis + modes.basis_size(), other.basis);
    }

    // The factors of `relax`, of each mode in each change.
    std::vector<Complex> factors(double tau) {
        prepare(tau);
        const int64_t count = modes.count();
        std::vector<Complex> found(table.function[0] * count);
        for (int64_t i = 0; i < int64_t(found.size()); ++i)
            found[i] = table.rate[count + i] * Complex(values[2 * (i % count)], values[2 * (i % count) + 1]);
        return found;
    }

    // Add the modes of a state times these factors to another one.
    void add(const std::vector<Complex>& factors, const double* x, double* to) {
        const int64_t square = modes.size() * modes.size();
        const Complex* const source = reinterpret_cast<const Complex*>(x);
        for (int64_t k = 0; k < table.function[0]; ++k) {
            const int64_t changed = table.function[2 + 2 * k] * square, read = table.function[3 + 2 * k] * square;
            const Complex* const own = factors.data() + k * modes.count();
            modes.change(reinterpret_cast<Complex*>(to) + changed, source + read, nullptr, false,
                         [=](int64_t e, const Complex& c) { return Modes::times(own[e], c); });
        }
    }

    // The noise of a time: each mode changes by normal numbers of variance rate^2 tau, half each in its real and its
    // imaginary part; harmonics of the main diagonal have an imaginary part only.
    void shake(double* x, double t, double tau, int64_t member) {
        values.resize(deviates());
        DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, 0).fill(deviates(), values.data());
        add(values.data(), tau, x);
    }

    // The count of normal deviates of a noise, two for each mode.
    int64_t deviates() const { return 2 * modes.count(); }

    // Add the noise of a time with given deviates, and with other amplitudes than those of the table.
    void add(const double* given, double tau, double* x, const double* amplitudes = nullptr) {
        const double* const sizes = amplitudes ? amplitudes : table.rate;
        modes.change(reinterpret_cast<Complex*>(x + table.position), nullptr, nullptr, table.shape == WAVES,
                     [&](int64_t e, const Complex&) { return change_by(e, sizes[e], given, tau); });
    }

    // The derivatives by the amplitudes of the pairing of a skew-Hermitian matrix with the noise are added to those given.
    void add_slopes(const double* given, double tau, const double* with, double* slopes) {
        unchanged.assign(modes.size() * modes.size(), Complex(0.0));
        modes.change(unchanged.data(), reinterpret_cast<const Complex*>(with), nullptr, false, [&](int64_t e, const Complex& c) {
            const Complex unit = change_by(e, 1.0, given, tau);
            // Entries off the diagonal are in both halves of the matrix, and waves on it with those of opposite numbers.
            slopes[e] += (is_diagonal(e) ? 1.0 : 2.0) * (c.real() * unit.real() + c.imag() * unit.imag());
            return Complex(0.0);
        });
    }

  private:
    bool is_diagonal(int64_t e) const { return e < table.begin[1] && table.shape != WAVES; }

    // The noise of a mode with an amplitude.
    Complex change_by(int64_t e, double amplitude, const double* given, double tau) const {
        if (is_diagonal(e)) return Complex(0.0, std::sqrt(tau) * amplitude * given[2 * e]);
        const double size = std::sqrt(0.5 * tau) * amplitude;
        return Complex(size * given[2 * e], size * given[2 * e + 1]);
    }

    // The layers as they are before any changes, which several changes read.
    const Complex* as_before(const Complex* X) {
        if (table.function[0] <= 1) return X;
        const int64_t* const layers = table.function + 2;
        const int64_t last = *std::max_element(layers, layers + 2 * table.function[0]);
        unchanged.assign(X, X + (last + 1) * modes.size() * modes.size());
        return unchanged.data();
    }

    const ForceTable& table;
    Modes modes;
    std::vector<double> values;
    std::vector<Complex> before, at_rest;  // the buoyancy before a change, and the state at rest with its part
    std::vector<Complex> unchanged;  // layers before the changes
    double prepared_for = std::numeric_limits<double>::quiet_NaN();  // the time for which `values` is computed

    // exp(-(rate + i turning) tau) - 1.
    void prepare(double tau) {
        const int64_t count = modes.count();
        values.resize(2 * count);
        for (int64_t e = 0; e < count; ++e) {
            const double grown = growth_by(-table.rate[e] * tau).expm1;
            const Rotation<double> rotation = rotation_by(-table.turning[e] * tau);
            values[2 * e] = fma(1.0 + grown, rotation.cosm1, grown);
            values[2 * e + 1] = (1.0 + grown) * rotation.sine;
        }
        prepared_for = tau;
    }
};

}  // namespace coadjoint
