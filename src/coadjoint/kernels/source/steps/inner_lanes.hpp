// One step of another loop, of members as lanes, with the bits of `InnerStep`.
#pragma once

#include "flows/finished_step.hpp"
#include "steps/inner_step.hpp"

namespace coadjoint {

// `C` are the constants of one table, or those of each member.
template <class C>
class InnerLanes {
  public:
    typedef Lanes<MEMBER_LANES> A;
    A status, evaluations, iterations, residual;

    // A program moves lanes directly; other loops read members one after the other.
    InnerLanes(const int64_t* addresses, int64_t size, const C& constants)
        : status(0.0), evaluations(0.0), iterations(0.0), residual(std::numeric_limits<double>::quiet_NaN()), size(size),
          program(FinishedStep<A, C>::of(addresses, size, constants)) {
        if (program) return;
        rows.resize(lanes * size);
        if constexpr (in_columns)
            members.reset(new InnerStep(addresses, size, 0, lanes, constants));
        else
            members.reset(new InnerStep(addresses, size, 0, lanes));
    }

    // Move the states of the members that are `moving`.
    void take(A* x, double t, double h, const Numbers<A>::Mask& moving) {
        if (!program) return take_members(x, t, h, moving);
        program->take(x, t, h, moving);
        status = program->status;
        evaluations = program->evaluations;
    }

  private:
    static constexpr int lanes = MEMBER_LANES;
    static constexpr bool in_columns = std::is_same_v<C, LaneConstants>;
    const int64_t size;
    const std::unique_ptr<FinishedStep<A, C>> program;
    std::unique_ptr<InnerStep> members;
    std::vector<double> rows;

    void take_members(A* x, double t, double h, const Numbers<A>::Mask& moving) {
        double* states[lanes];
        int64_t found[lanes], count = 0, place[lanes];
        for (int lane = 0; lane < lanes; ++lane) {
            if (!at(moving, lane) && !in_columns) continue;  // a column is that of the place
            for (int64_t i = 0; i < size; ++i) rows[count * size + i] = x[i][lane];
            states[count] = rows.data() + count * size;
            place[count++] = lane;
        }
        members->take_all(states, count, t, h, found);
        for (int64_t k = 0; k < count; ++k) {
            const int lane = int(place[k]);
            if (!at(moving, lane)) continue;
            for (int64_t i = 0; i < size; ++i) x[i].set(lane, states[k][i]);
            status.set(lane, double(found[k]));
            evaluations.set(lane, double(members->evaluations_of(k)));
            iterations.set(lane, double(members->iterations_of(k)));
            residual.set(lane, members->residual_of(k));
        }
    }
};

}  // namespace coadjoint
