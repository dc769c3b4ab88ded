// Derivatives of a flow whose function has derivatives, or of a step of the classical Runge-Kutta method for a torque.
#pragma once

#include "forces/force.hpp"

namespace coadjoint {

class LawDerivative {
  public:
    // Of the table, `functions` are two: of (x, w), the derivatives by x and by the `own` coefficients of w times the torque,
    // and of (x, v, changes of the coefficients) the change of the torque. A flow has its duration behind x.
    LawDerivative(Force& flow, const ForceDerivatives& table, int64_t n)
        : flow(flow), table(table), is_flow(flow.table.kind == BY_FLOW), n(n), size(n + is_flow), states(STAGES * n), slopes(n),
          arguments(size + n + table.own), found(n + table.own), change(n), total(n) {}

    void push(const double* x, double t, double tau, double* vectors, int64_t count, const double* directions,
              int64_t stride) {
        if (is_flow) return push_flow(x, t, tau, vectors, count, directions, stride);
        find(x, t, tau);
        for (int64_t v = 0; v < count; ++v) {
            double* const vector = vectors + v * n;
            std::fill(change.begin(), change.end(), 0.0);
            std::fill(total.begin(), total.end(), 0.0);
            std::copy_n(directions + v * stride, table.own, arguments.data() + size + n);
            for (int k = 0; k < STAGES; ++k) {
                std::copy_n(states.data() + k * n, n, arguments.data());
                for (int64_t i = 0; i < n; ++i) arguments[size + i] = fma(NODE[k] * tau, change[i], vector[i]);
                derivative(1, fma(NODE[k], tau, t), change.data());
                for (int64_t i = 0; i < n; ++i) total[i] = fma(WEIGHT[k], change[i], total[i]);
            }
            for (int64_t i = 0; i < n; ++i) vector[i] = fma(tau, total[i], vector[i]);
        }
    }

    void pull(const double* x, double t, double tau, double* row, double* by_coefficients) {
        is_flow ? begin_flow(x, tau, row) : find(x, t, tau);
        if (is_flow) derivative(0, t, found.data()), std::copy_n(found.data(), n, row);
        for (int64_t c = 0; is_flow && c < table.own; ++c) by_coefficients[c] += found[n + c];
        if (is_flow) return;
        std::copy_n(row, n, total.data());
        std::fill(change.begin(), change.end(), 0.0);  // the cotangent of the state of the stage behind
        for (int k = STAGES - 1; k >= 0; --k) {
            const double behind = k < STAGES - 1 ? NODE[k + 1] * tau : 0.0;
            std::copy_n(states.data() + k * n, n, arguments.data());
            for (int64_t i = 0; i < n; ++i) arguments[size + i] = fma(WEIGHT[k] * tau, row[i], behind * change[i]);
            derivative(0, fma(NODE[k], tau, t), found.data());
            for (int64_t i = 0; i < n; ++i) change[i] = found[i], total[i] += found[i];
            for (int64_t c = 0; c < table.own; ++c) by_coefficients[c] += found[n + c];
        }
        std::copy_n(total.data(), n, row);
    }

  private:
    static constexpr int STAGES = 4;
    static constexpr double NODE[] = {0.0, 0.5, 0.5, 1.0}, WEIGHT[] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
    Force& flow;
    const ForceDerivatives& table;
    const bool is_flow;
    const int64_t n, size;
    std::vector<double> states, slopes, arguments, found, change, total;

    void push_flow(const double* x, double t, double tau, double* vectors, int64_t count, const double* directions,
                   int64_t stride) {
        for (int64_t v = 0; v < count; ++v) {
            begin_flow(x, tau, vectors + v * n);
            std::copy_n(directions + v * stride, table.own, arguments.data() + size + n);
            derivative(1, t, vectors + v * n);
        }
    }

    void begin_flow(const double* x, double tau, const double* vector) {
        std::copy_n(x, n, arguments.data()), std::copy_n(vector, n, arguments.data() + size), arguments[n] = tau;
    }

    // The states of the stages, as `Force::push_by_state`.
    void find(const double* x, double t, double tau) {
        for (int k = 0; k < STAGES; ++k) {
            double* const state = states.data() + k * n;
            for (int64_t i = 0; i < n; ++i) state[i] = k ? fma(NODE[k] * tau, slopes[i], x[i]) : x[i];
            if (k < STAGES - 1) flow.call_at(state, fma(NODE[k], tau, t), slopes.data());
        }
    }

    void derivative(int number, double t, double* out) {
        InterruptCheck::of_this_call().after(WORK_OF_A_CALL);
        call(table.functions[number], arguments.data(), t, out);
    }
};

}  // namespace coadjoint
