// The flow of one force on members as lanes, of one table or with constants of their own, each with the bits that it has
// alone.
#pragma once

#include "forces/force.hpp"
#include "forces/spin_bath_lanes.hpp"

namespace coadjoint {

// `C` are the constants of one table, or those of each member.
template <class C>
class ForceLanes {
  public:
    typedef Lanes<MEMBER_LANES> A;
    typedef Numbers<A>::Mask Mask;
    // Of each member after a flow; counts are whole numbers. `change` is that of the energy, if the force measures it.
    A status, evaluations, iterations, residual, change;

    ForceLanes(Force& force, const GroupField& group, const C& constants, const int64_t* number)
        : status(0.0), evaluations(0.0), iterations(0.0), residual(0.0), change(0.0), constants(constants),
          table(force.table), n(force.n), number(number), one(n), two(std::max(n, table.extent)), before(n), row(n),
          grown(0), spread(0) {
        for (int lane = 0; lane < lanes; ++lane) {
            const bool shared = lane == 0 || std::is_same_v<C, SharedConstants>;
            if (!shared) own.emplace_back(new Force(table, force.field, group, constants.of_lane(lane)));
            alone[lane] = shared ? &force : own.back().get();
        }
        if (table.kind == HAMILTONIAN_NOISE) {
            increments.reset(new IncrementsOfLanes<A>(table, table.position, table.extent));
            // Members with functions of their own act one by one.
            const bool shared = std::all_of(own.begin(), own.end(), [&](const std::unique_ptr<Force>& one) {
                return one->noise->shares_functions(*force.noise);
            });
            if (shared)
                noise.reset(new HamiltonianNoise<A, C>(table, force.field, group, constants));
        }
        if (force.orbit) orbit.reset(new OrbitBath<A, C>(table, force.field, group, constants));
        if (!force.spins || force.spins->size() > SpinBathOfLanes<C>::MOST_SPINS) return;
        SpinBath* baths[lanes];
        for (int lane = 0; lane < lanes; ++lane) baths[lane] = alone[lane]->spins.get();
        spins.reset(new SpinBathOfLanes<C>(baths, constants));
    }

    // Prepare for a step of the members from t of length h.
    void begin(double t, double h) {
        if (increments) increments->draw(t, h, number);
    }

    // Whether it acts on one side of whole steps, and where on this side of the step.
    bool around_steps() const { return increments != nullptr; }
    Mask acts(int64_t side) const { return increments->first == A(side == 0 ? 1.0 : 0.0); }

    // Apply the flow to the members that are `moving`, as `Force::flow`; others stay as they are.
    void flow(A* x, double t, double tau, int64_t side, const Mask& moving) {
        status = A(double(DONE));
        evaluations = iterations = A(0.0);
        residual = A(std::numeric_limits<double>::quiet_NaN());
        switch (table.kind) {
            case DAMPING: return move(x, moving, [&](A* y) { damp(y, t, tau); });
            case CONSTANT: return move(x, moving, [&](A* y) { alone[0]->push(y, tau, table.aim, constants); });
            case OF_TIME: return own.empty() ? push_by_time(x, t, tau, moving) : one_by_one(x, t, tau, side, moving);
            case KICKS: return move(x, moving, [&](A* y) { kick(y, t, tau); });
        }
        if (noise)
            shake(x, t, side, moving);
        else if (spins)
            rotate_spins(x, t, tau, moving);
        else if (orbit)
            stay_on_orbit(x, t, tau, moving);
        else
            one_by_one(x, t, tau, side, moving);
    }

  private:
    static constexpr int lanes = MEMBER_LANES;
    const C constants;
    const ForceTable& table;
    const int64_t n;
    const int64_t* const number;  // of the members in the run
    AlignedArray<A> one, two, before;
    std::vector<double> row;
    std::vector<std::unique_ptr<Force>> own;  // of members with constants of their own, after the first
    Force* alone[lanes];
    AlignedArray<A> grown, spread;  // of each member, for this time
    double grown_for = std::numeric_limits<double>::quiet_NaN(), spread_for = grown_for;
    std::unique_ptr<HamiltonianNoise<A, C>> noise;
    std::unique_ptr<IncrementsOfLanes<A>> increments;
    std::unique_ptr<SpinBathOfLanes<C>> spins;
    std::unique_ptr<OrbitBath<A, C>> orbit;

    template <class Move>
    void move(A* x, const Mask& moving, const Move& apply) {
        if (all(moving)) return apply(x);
        std::copy_n(x, n, before.at);
        apply(x);
        for (int64_t i = 0; i < n; ++i) x[i] = select(moving, x[i], before.at[i]);
    }

    void defined(const A* x, int64_t otherwise) {
        status = select(finite(n, x), A(double(DONE)), A(double(otherwise)));
    }

    void draw(double t, int64_t count, A* out, int part = 0) const {
        InterruptCheck::of_this_call().after(64 * lanes * count);
        DeviatesOfLanes<A>(uint64_t(table.seed), table.stream, number, t, uint64_t(part)).draw(count, out);
    }

    // The numbers of each member, from those of it alone.
    template <class Numbers>
    static void gather(AlignedArray<A>& to, Force* const* alone, const Numbers& numbers) {
        const int64_t count = int64_t(numbers(*alone[0]).size());
        to.clear(count);
        for (int lane = 0; lane < lanes; ++lane)
            for (int64_t i = 0; i < count; ++i) to.at[i].set(lane, numbers(*alone[lane])[i]);
    }

    void damp(A* x, double t, double tau) {
        if (own.empty()) {
            alone[0]->prepare(tau);
            alone[0]->damp_by(alone[0]->expm1.data(), x, one.at, constants);
        } else {
            if (grown_for != tau) {
                for (Force* force : alone) force->prepare(tau);
                gather(grown, alone, [](Force& force) -> const std::vector<double>& { return force.expm1; });
                grown_for = tau;
            }
            alone[0]->damp_by(grown.at, x, one.at, constants);
        }
        if (!(alone[0]->number(table.amplitude, 0) > 0.0)) return;
        draw(t, n, two.at);
        if (own.empty()) {
            alone[0]->prepare_spread(tau);
            alone[0]->spread_out(alone[0]->spread.data(), x, two.at, constants);
        } else {
            if (spread_for != tau) {
                for (Force* force : alone) force->prepare_spread(tau);
                gather(spread, alone, [](Force& force) -> const std::vector<double>& { return force.spread; });
                spread_for = tau;
            }
            alone[0]->spread_out(spread.at, x, two.at, constants);
        }
        defined(x, OVERFLOWED);
    }

    void push_by_time(A* x, double t, double tau, const Mask& moving) {
        alone[0]->evaluations = 0;
        const double* const torque = alone[0]->mean_torque(t, tau);
        evaluations = A(double(alone[0]->evaluations));
        move(x, moving, [&](A* y) { alone[0]->push(y, tau, torque, SharedConstants{}); });
        defined(x, UNDEFINED);
    }

    void kick(A* x, double t, double tau) {
        draw(t, table.extent, two.at);
        alone[0]->add_kicks(x, two.at, one.at, tau, constants);
        defined(x, UNDEFINED);
    }

    void shake(A* x, double t, int64_t side, const Mask& moving) {
        status = noise->flow(x, nullptr, t, increments->sums.at, side, moving);
        count(noise->exponential);
    }

    void rotate_spins(A* x, double t, double tau, const Mask& moving) {
        status = spins->flow(x, t, tau, moving, [&](int half, A* deviates) { draw(t, n, deviates, half); });
        count(*spins);
        change = spins->change;
    }

    void stay_on_orbit(A* x, double t, double tau, const Mask& moving) {
        status = orbit->flow(x, t, tau, moving, [&](int half, A* deviates) { draw(t, n, deviates, half); });
        count(orbit->exponential);
    }

    template <class Part>
    void count(const Part& part) {
        evaluations = part.evaluations;
        iterations = part.iterations;
        residual = part.residual;
    }

    NOINLINE void one_by_one(A* x, double t, double tau, int64_t side, const Mask& moving) {
        for (int lane = 0; lane < lanes; ++lane) {
            if (!at(moving, lane)) continue;
            Force& force = *alone[lane];
            for (int64_t i = 0; i < n; ++i) row[i] = x[i][lane];
            status.set(lane, double(force.flow(row.data(), nullptr, t, tau, number[lane], side)));
            for (int64_t i = 0; i < n; ++i) x[i].set(lane, row[i]);
            evaluations.set(lane, double(force.evaluations));
            iterations.set(lane, double(force.iterations));
            residual.set(lane, force.residual);
            if (force.measures()) change.set(lane, force.change());
        }
    }
};

}  // namespace coadjoint
