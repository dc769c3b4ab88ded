// Forces on the modes of a matrix: individual rates, or a noise.
#pragma once

#include "forces/random.hpp"
#include "matrices/modes.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

class ModeForce {
  public:
    explicit ModeForce(const ForceTable& table) : table(table), modes(table) {}

    // c' = -(rate + i turning) c, exactly.
    void relax(double* x, double tau) {
        if (prepared_for != tau) prepare(tau);
        const auto move = [&](int64_t e, const Complex& c) {
            const double real = values[2 * e], imaginary = values[2 * e + 1];
            return Complex(real * c.real() - imaginary * c.imag(), real * c.imag() + imaginary * c.real());
        };
        for (int64_t layer = 0; layer < table.function[0]; ++layer) modes.change(x, true, false, move, layer);
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

    // Add the noise of a time with given deviates.
    void add(const double* given, double tau, double* x) {
        const double whole = std::sqrt(tau), half = std::sqrt(0.5 * tau);
        const bool waves = table.shape == WAVES;
        modes.change(x, false, waves, [&](int64_t e, const Complex&) {
            if (e < table.begin[1] && !waves) return Complex(0.0, whole * table.rate[e] * given[2 * e]);
            return Complex(half * table.rate[e] * given[2 * e], half * table.rate[e] * given[2 * e + 1]);
        });
    }

  private:
    const ForceTable& table;
    Modes modes;
    std::vector<double> values;
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
