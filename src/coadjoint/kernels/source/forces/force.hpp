// The flow of one force, which acts in addition to the Hamiltonian.
#pragma once

#include <memory>

#include "field/field.hpp"
#include "forces/hamiltonian_noise.hpp"
#include "forces/matrix_force.hpp"
#include "forces/mode_force.hpp"
#include "forces/orbit_bath.hpp"
#include "forces/random.hpp"
#include "forces/selective_decay.hpp"
#include "forces/spin_bath.hpp"
#include "numbers/arithmetic.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

class Force {
  public:
    const ForceTable& table;
    int64_t iterations = 0, evaluations = 0;
    double residual = 0.0;

    // The state may have further numbers behind it, `size` with them, if the flow is a function.
    Force(const ForceTable& table, const Field& field, const GroupField& group, const MemberConstants& constants,
          int64_t size = 0)
        : table(table), field(field), constants(constants), n(size ? size : field.size), workspace(field),
          one(std::max<int64_t>(n + 1 + (table.kind == BY_FLOW ? 2 * table.extent * table.sets : 0), 4)), two(n),
          three(n), four(n), five(n), six(n), matrix(matrix_force(table)) {
        if (table.kind == MODE_RATES || table.kind == MODE_NOISE) modes.reset(new ModeForce(table));
        if (table.kind == SELECTIVE_DECAY) decay = selective_decay(table, field, constants);
        if (table.kind == ON_ORBIT) {
            spins.reset(new SpinBath(table, field, constants));
            if (*spins) return;
            spins.reset();
            orbit.reset(new OrbitBath<double, MemberConstants>(table, field, group, constants));
        }
        if (table.kind != HAMILTONIAN_NOISE) return;
        noise.reset(new HamiltonianNoise<double, MemberConstants>(table, field, group, constants));
        increments.reset(new BrownianIncrements(table, table.position, table.extent, 0));
    }

    // Whether it acts before (side 0) or after (side 1) a whole step, and not in substeps.
    bool around_steps() const { return noise || (matrix && matrix->around_steps()); }

    // Whether it acts on this side of the step from t of length h.
    bool acts(double t, double h, int64_t member, int64_t side) {
        return noise ? increments->of(t, h, member).first == (side == 0) : matrix->acts(t, h, member, side);
    }

    // Apply the flow to x from time t for the time tau, negative for backward; return a status. A flow around a step also
    // moves the group element, if there is one.
    int64_t flow(double* x, double* element, double t, double tau, int64_t member, int64_t side) {
        iterations = evaluations = 0;
        residual = std::numeric_limits<double>::quiet_NaN();
        switch (table.kind) {
            case DAMPING: return damp(x, t, tau, member);
            case CONSTANT: return push(x, tau, table.aim, constants), DONE;
            case OF_TIME: return push(x, tau, mean_torque(t, tau), SharedConstants{}), defined(x);
            case OF_STATE: return push_by_state(x, t, tau);
            case ON_ORBIT: return spins ? rotate_spins(x, t, tau, member) : stay_on_orbit(x, t, tau, member);
            case HAMILTONIAN_NOISE: return shake_by(x, element, t, tau, member, side);
            case KICKS: return kick(x, t, tau, member);
            case MODE_RATES: return modes->relax(x, tau), defined(x);
            case SELECTIVE_DECAY: return lose_casimir(x, t, tau);
            case MODE_NOISE: return modes->shake(x, t, tau, member), defined(x);
            case ON_MATRIX_ORBIT:
            case MATRIX_NOISE:
            case MODE_TRANSPORT: return move_matrix(x, t, tau, member);
        }
        return given_flow(x, t, tau, member);
    }

    // Set `out` to the value of the function of a torque.
    void call_at(const double* y, double t, double* out) {
        InterruptCheck::of_this_call().after(WORK_OF_A_CALL);
        ++evaluations;
        call(constants.address(table.function, 0, 0), y, t, out);
    }

    // Whether the flow computes the change of the energy, the only invariant that it changes.
    bool measures() const { return spins && spins->measures(); }
    double change() const { return spins->change; }

    // Whether the flow is a midpoint rule of spins; copy those of the last one to their coordinates.
    bool has_midpoint() const { return bool(spins); }
    void copy_midpoint(double* to) const { spins->copy_midpoint(to); }

  private:
    template <class C>
    friend class ForceLanes;
    const Field& field;
    const MemberConstants constants;
    const int64_t n;
    FieldWorkspace<double> workspace;
    std::vector<double> one, two, three, four, five, six, expm1, spread;
    // The times for which `expm1` and `spread` are computed.
    double prepared_for = std::numeric_limits<double>::quiet_NaN(), spread_for = prepared_for;
    std::unique_ptr<ModeForce> modes;
    std::unique_ptr<SpinBath> spins;
    std::unique_ptr<OrbitBath<double, MemberConstants>> orbit;
    std::unique_ptr<HamiltonianNoise<double, MemberConstants>> noise;
    std::unique_ptr<BrownianIncrements> increments;
    const std::unique_ptr<MatrixForce> matrix;
    std::unique_ptr<SelectiveDecay> decay;

    double number(const double* from, int64_t position) const { return constants.number_at<double>(from, position); }

    int64_t damp(double* x, double t, double tau, int64_t member) {
        prepare(tau);
        damp_by(expm1.data(), x, one.data(), constants);
        return number(table.amplitude, 0) > 0.0 ? agitate(x, t, tau, member) : int64_t(DONE);
    }

    // x' = -R (x - aim): x + (exp(-R tau) - 1) (x - aim), of one member or of members as lanes.
    template <class A, class E, class C>
    void damp_by(const E* expm1, A* x, A* from, const C& constants) const {
        for (int64_t i = 0; i < n; ++i) from[i] = x[i] - constants.template number_at<A>(table.aim, i);
        for (int64_t i = 0; i < n; ++i) {
            if (table.shape == FULL) {
                A sum(0.0);
                for (int64_t j = 0; j < n; ++j) sum = fma(A(expm1[i * n + j]), from[j], sum);
                x[i] += sum;
            } else {
                x[i] = fma(A(expm1[table.shape == DIAGONAL ? i : 0]), from[i], x[i]);
            }
        }
    }

    void prepare(double tau) {
        if (prepared_for == tau) return;
        prepared_for = tau;
        const int64_t count = table.shape == FULL ? n * n : table.shape == DIAGONAL ? n : 1;
        expm1.assign(count, 0.0);
        if (table.shape != FULL) {
            for (int64_t i = 0; i < count; ++i) expm1[i] = growth_by(-number(table.rate, i) * tau).expm1;
            return;
        }
        // exp(D) - 1 by its series for D halved until its norm is below 1/2, doubled again as often.
        double norm = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            double sum = 0.0;
            for (int64_t j = 0; j < n; ++j) sum += absolute(number(table.rate, i * n + j) * tau);
            norm = larger(norm, sum);
        }
        int64_t halvings = 0;
        for (double left = norm; left > 0.5 && halvings < MOST_HALVINGS; left *= 0.5) ++halvings;
        std::vector<double> D(count), power(count), image(count);
        const double scale = -tau * power_of_two(-halvings);
        for (int64_t i = 0; i < count; ++i) D[i] = power[i] = expm1[i] = number(table.rate, i) * scale;
        for (int64_t k = 2; k <= SERIES_OF_HALF; ++k) {
            multiply(D, power, 1.0 / double(k), image);
            power.swap(image);
            for (int64_t i = 0; i < count; ++i) expm1[i] += power[i];
        }
        for (; halvings > 0; --halvings) {
            multiply(expm1, expm1, 1.0, image);
            for (int64_t i = 0; i < count; ++i) expm1[i] = 2.0 * expm1[i] + image[i];
        }
    }

    // The noise of a temperature beside the damping, which make an Ornstein-Uhlenbeck process, exact in distribution: the
    // covariance (1 - exp(-2 R tau)) C with a root of C, `basis`, whose row i has the columns `direction` from begin[i] to
    // begin[i + 1] - 1. R is diagonal and commutes with C.
    int64_t agitate(double* x, double t, double tau, int64_t member) {
        InterruptCheck::of_this_call().after(64 * n);
        DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, 0).fill(n, three.data());
        prepare_spread(tau);
        spread_out(spread.data(), x, three.data(), constants);
        return finite(n, x) ? DONE : OVERFLOWED;
    }

    void prepare_spread(double tau) {
        if (spread_for == tau) return;
        spread_for = tau;
        spread.resize(n);
        for (int64_t i = 0; i < n; ++i) spread[i] = std::sqrt(-growth_by(-2.0 * number(table.rate, i) * tau).expm1);
    }

    template <class A, class E, class C>
    void spread_out(const E* spread, A* x, const A* deviates, const C& constants) const {
        for (int64_t i = 0; i < n; ++i) {
            A sum(0.0);
            for (int64_t e = table.begin[i]; e < table.begin[i + 1]; ++e)
                sum = fma(constants.template number_at<A>(table.basis, e), deviates[table.direction[e]], sum);
            x[i] = fma(A(spread[i]), sum, x[i]);
        }
    }

    void multiply(const std::vector<double>& A, const std::vector<double>& B, double factor, std::vector<double>& out) {
        for (int64_t i = 0; i < n; ++i) {
            InterruptCheck::of_this_call().after(n * n);
            double* row = out.data() + i * n;
            std::fill_n(row, n, 0.0);
            for (int64_t k = 0; k < n; ++k)
                for (int64_t j = 0; j < n; ++j) row[j] = fma(A[i * n + k], B[k * n + j], row[j]);
            for (int64_t j = 0; j < n; ++j) row[j] *= factor;
        }
    }

    template <class A, class C>
    void push(A* x, double tau, const double* torque, const C& constants) const {
        for (int64_t i = 0; i < n; ++i) x[i] = fma(A(tau), constants.template number_at<A>(torque, i), x[i]);
    }

    // The mean of a function of time by Gauss quadrature with five points, exact up to degree nine. It takes no state.
    const double* mean_torque(double t, double tau) {
        constexpr double FAR = 0.90617984593866399280, NEAR = 0.53846931010568309104;
        constexpr double NODE[] = {-FAR, -NEAR, 0.0, NEAR, FAR};
        constexpr double OUTER = 0.23692688505618908751, INNER = 0.47862867049936646804;
        constexpr double WEIGHT[] = {OUTER, INNER, 0.56888888888888888889, INNER, OUTER};
        std::fill_n(two.data(), n, 0.0);
        for (int k = 0; k < 5; ++k) {
            call_at(three.data(), fma(0.5 * tau, 1.0 + NODE[k], t), one.data());
            for (int64_t i = 0; i < n; ++i) two[i] = fma(0.5 * WEIGHT[k], one[i], two[i]);
        }
        return two.data();
    }

    // A step of the classical Runge-Kutta method, whose local error is of fifth order in tau, or of higher order.
    int64_t push_by_state(double* x, double t, double tau) {
        if (table.extent) return extrapolate(x, t, tau);
        constexpr double NODE[] = {0.0, 0.5, 0.5, 1.0}, WEIGHT[] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
        std::fill_n(two.data(), n, 0.0);
        std::copy_n(x, n, three.data());
        for (int k = 0; k < 4; ++k) {
            for (int64_t i = 0; i < n && k > 0; ++i) three[i] = fma(NODE[k] * tau, one[i], x[i]);
            call_at(three.data(), fma(NODE[k], tau, t), one.data());
            for (int64_t i = 0; i < n; ++i) two[i] = fma(WEIGHT[k], one[i], two[i]);
        }
        for (int64_t i = 0; i < n; ++i) x[i] = fma(tau, two[i], x[i]);
        return defined(x);
    }

    // Gragg's midpoint rule in 2, 4, ..., 2 k substeps for k = `extent`, extrapolated to the order 2 k.
    int64_t extrapolate(double* x, double t, double tau) {
        double *first = two.data(), *at = three.data(), *even = four.data(), *odd = five.data(), *change = six.data();
        call_at(x, t, first);
        std::fill_n(change, n, 0.0);
        for (int64_t k = 1; k <= table.extent; ++k) {
            const double count = 2.0 * double(k), length = tau / count;
            double weight = 1.0;
            for (int64_t i = 1; i <= table.extent; ++i)
                if (i != k) weight *= double(k * k) / double(k * k - i * i);
            for (int64_t i = 0; i < n; ++i) even[i] = 0.0, odd[i] = length * first[i];
            for (int64_t m = 1; m < 2 * k; ++m) {
                const double* last = m % 2 ? odd : even;
                double* next = m % 2 ? even : odd;
                for (int64_t i = 0; i < n; ++i) at[i] = x[i] + last[i];
                call_at(at, fma(double(m) / count, tau, t), one.data());
                for (int64_t i = 0; i < n; ++i) next[i] = fma(2.0 * length, one[i], next[i]);
            }
            for (int64_t i = 0; i < n; ++i) change[i] = fma(weight, even[i], change[i]);
        }
        for (int64_t i = 0; i < n; ++i) x[i] += change[i];
        return defined(x);
    }

    // Behind the state and the time are the deviates of each law that measures with noise.
    int64_t given_flow(double* x, double t, double tau, int64_t member) {
        std::copy_n(x, n, one.data());
        one[n] = tau;
        for (int64_t k = 0; k < table.sets; ++k) measure(k, t, tau, member, one.data() + n + 1 + 2 * table.extent * k);
        std::fill_n(two.data(), n, std::numeric_limits<double>::quiet_NaN());
        call_at(one.data(), t, two.data());
        std::copy_n(two.data(), n, x);
        return defined(x);
    }

    // The deviates of a sample, by its number, and those that are the same in all samples; zeros between samples.
    void measure(int64_t k, double t, double tau, int64_t member, double* out) const {
        const double period = this->number(table.rate, k), number = std::floor(t / period + 0.5);
        std::fill_n(out, 2 * table.extent, 0.0);
        if (!(absolute(t - period * number) < 0.25 * tau)) return;
        const uint64_t seed = uint64_t(table.direction[2 * k]), stream = uint64_t(table.direction[2 * k + 1] + member);
        DeviateStream(seed, stream, number, OF_SAMPLE).draw(0, table.extent, out);
        DeviateStream(seed, stream, 0.0, OF_RUN).draw(0, table.extent, out + table.extent);
    }

    int64_t defined(const double* x) const { return finite(n, x) ? DONE : UNDEFINED; }

    int64_t stay_on_orbit(double* x, double t, double tau, int64_t member) {
        const double status = orbit->flow(x, t, tau, true, [&](int half, double* deviates) {
            DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, uint64_t(half)).fill(n, deviates);
        });
        return counted(orbit->exponential, int64_t(status));
    }

    // Take over what a part has counted; return the status.
    template <class Part>
    int64_t counted(const Part& part, int64_t status) {
        evaluations = int64_t(part.evaluations);
        iterations = int64_t(part.iterations);
        residual = part.residual;
        return status;
    }

    // Additive noise: `sets` changes by the increments of `extent` Brownian motions, each with the coordinate that it
    // changes, the coordinate by which it is multiplied, or -1, and the number of its motion.
    int64_t kick(double* x, double t, double tau, int64_t member) {
        DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, 0).draw(0, table.extent, one.data());
        return add_kicks(x, one.data(), two.data(), tau, constants), defined(x);
    }

    template <class A, class C>
    void add_kicks(A* x, const A* drawn, A* change, double tau, const C& constants) const {
        const A size(std::sqrt(tau));
        std::fill_n(change, n, A(0.0));
        for (int64_t e = 0; e < table.sets; ++e) {
            const int64_t* const at = table.direction + 3 * e;
            const A value = at[1] < 0 ? A(1.0) : x[at[1]];
            change[at[0]] = fma(constants.template number_at<A>(table.rate, e) * value, size * drawn[at[2]], change[at[0]]);
        }
        for (int64_t i = 0; i < n; ++i) x[i] += change[i];
    }

    int64_t shake_by(double* x, double* element, double t, double tau, int64_t member, int64_t side) {
        const double* const sums = increments->of(t, tau, member).sums.data();
        return counted(noise->exponential, int64_t(noise->flow(x, element, t, sums, side, true)));
    }

    int64_t lose_casimir(double* x, double t, double tau) {
        return counted(*decay, decay->flow(number(table.rate, 0), x + table.position, t, tau));
    }

    int64_t rotate_spins(double* x, double t, double tau, int64_t member) {
        return counted(*spins, spins->flow(x, t, tau, member, workspace));
    }

    int64_t move_matrix(double* x, double t, double tau, int64_t member) {
        matrix->iterations = matrix->evaluations = 0;
        const int64_t status = counted(*matrix, matrix->flow(x, t, tau, member));
        return status != DONE || finite(n, x) ? status : int64_t(OVERFLOWED);
    }

    // Parts of the deviates of measurements; 0 and 1 are those of the halves of a bath.
    static constexpr uint64_t OF_SAMPLE = 2, OF_RUN = 3;
    // More than float64 has powers of two.
    static constexpr int MOST_HALVINGS = 1100;
    // Terms of exp of a matrix of norm 1/2: the next is 2^-17/17!, below 2^-65.
    static constexpr int64_t SERIES_OF_HALF = 16;
};

}  // namespace coadjoint
