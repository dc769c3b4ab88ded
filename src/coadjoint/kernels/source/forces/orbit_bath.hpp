// Damping and noise on the coadjoint orbit, of one member, or of members as lanes: x' = sign J(x) b with
// b = P sign J(x) grad H, P >= 0, between two halves of the noise in b. All maps are exponentials, so every Casimir is
// preserved, even if an iteration ends early.
#pragma once

#include <deque>

#include "forces/orbit_exponential.hpp"

namespace coadjoint {

template <class A, class C>
class OrbitBath {
  public:
    typedef typename Numbers<A>::Mask Mask;
    OrbitExponential<A, C> exponential;

    OrbitBath(const ForceTable& table, const Field& field, const GroupField& group, const C& constants)
        : exponential(field, group, constants), table(table), field(field), constants(constants), n(field.size), v(n),
          deviates(n), middle(n), slope(n), u(n), workspace(field) {
        std::vector<bool> used(n);
        for (int64_t set = 0; set < table.sets; ++set) {
            used.assign(n, false);
            for (int64_t e = table.begin[set]; e < table.begin[set + 1]; ++e)
                for (int64_t i = table.direction[e]; i < (table.shape == FULL ? n : table.direction[e] + 1); ++i)
                    used[i] = true;
            products.emplace_back(field, constants, used);
        }
    }

    // The flow of the members that are `moving`; `draw(half, deviates)` draws n deviates. Returns statuses.
    template <class Draw>
    A flow(A* x, double t, double tau, Mask moving, const Draw& draw) {
        const bool random = MemberConstants(constants.of_lane(0)).number_at<double>(table.amplitude, 0) > 0.0;
        exponential.iterations = exponential.evaluations = A(0.0);
        exponential.residual = A(std::numeric_limits<double>::quiet_NaN());
        A status = double(DONE);
        if (random) draw(0, deviates.at), shake(x, tau, 0, moving, status);
        if (!any(moving)) return status;
        settle(x, t, tau, moving, status);
        if (random && any(moving)) draw(1, deviates.at), shake(x, tau, 1, moving, status);
        return status;
    }

  private:
    const ForceTable& table;
    const Field& field;
    const C constants;
    const int64_t n;
    AlignedArray<A> v, deviates, middle, slope, u;
    FieldWorkspace<A> workspace;
    std::deque<RestrictedField<C>> products;  // of each set

    // Half of the noise of the time tau. Commuting directions are applied together, by an exponential with the exact
    // distribution; the sets are applied one after the other, in the second half in reversed order: a symmetric
    // splitting, of weak order two.
    void shake(A* x, double tau, int half, Mask& moving, A& status) {
        const A size = constants.template number_at<A>(table.amplitude, 0) * A(std::sqrt(0.5 * tau));
        for (int64_t k = 0; k < table.sets && any(moving); ++k) {
            const int64_t set = half ? table.sets - 1 - k : k;
            std::fill_n(v.at, n, A(0.0));
            for (int64_t e = table.begin[set]; e < table.begin[set + 1]; ++e) {
                const int64_t a = table.direction[e];
                const A length = size * deviates.at[a];
                if (table.shape == FULL)
                    for (int64_t i = a; i < n; ++i) v.at[i] = fma(constants.template number_at<A>(table.aim, i * n + a), length, v.at[i]);
                else
                    v.at[a] = constants.template number_at<A>(table.aim, table.shape == DIAGONAL ? a : 0) * length;
            }
            const Mask defined = exponential(v.at, 1.0, x, x, moving, products[set].products());
            if (const Mask failing = moving & !defined; any(failing))
                stop_members(failing, exponential.failed(v.at), moving, status);
        }
    }

    void settle(A* x, double t, double tau, Mask& moving, A& status) {
        const A found = exponential.midpoint(x, v.at, middle.at, moving, [&](const A* y, A* to) {
            slope_at(field, constants, y, A(t + 0.5 * tau), A(tau), u.at, slope.at, workspace);
            apply_metric(slope.at, to);
        });
        if (const Mask failing = moving & !(found == A(double(DONE))); any(failing)) stop_members(failing, found, moving, status);
    }

    // Set out to P y.
    void apply_metric(const A* y, A* out) const {
        for (int64_t i = 0; i < n; ++i) {
            if (table.shape != FULL) {
                out[i] = constants.template number_at<A>(table.rate, table.shape == DIAGONAL ? i : 0) * y[i];
                continue;
            }
            A sum(0.0);
            for (int64_t j = 0; j < n; ++j) sum = fma(constants.template number_at<A>(table.rate, i * n + j), y[j], sum);
            out[i] = sum;
        }
    }
};

}  // namespace coadjoint
