// The loop over the steps of programs with tangent vectors that are saved, for Python.
#include "flows/compiled_rows.hpp"
#include "tangents/flow_tangents.hpp"
#include "tangents/members.hpp"

namespace coadjoint {

// Members as lanes, each with all of its vectors, or one member with its vectors as lanes.
template <bool of_members, class C>
class StepsForward final : public Kept {
    typedef std::conditional_t<of_members, Lanes<NATIVE>, double> A;  // the vectors of a member hide the latency
    typedef std::conditional_t<of_members, Lanes<NATIVE>, TangentLanes> V;

  public:
    StepsForward(const FlowCotangents& all, const C& constants, const ForwardRun& run, int64_t count,
                 InterruptCheck& interrupts)
        : all(all), tables(all.base), interrupts(interrupts), members{0, of_members ? count : 1}, size(run.size),
          side(run.square > 0 ? tables.group.size : 0), square(side * side), rows((run.carried + per_block - 1) / per_block),
          coefficients(CoefficientCotangents<A>::count(tables.terms)), x(2 * size), finished(2 * size), group(square),
          finished_group(square), vectors(size * rows), copies(size * rows), of_group(square * rows),
          copies_of_group(square * rows), directions(coefficients * rows),
          tangents(tables, constants, all.hessians, size, rows), work((2 + 4 * rows) * Numbers<A>::lanes * work_of_flows(tables)) {
        FlowsOfRows<N, C> flows_of(tables, constants, square > 0, true);
        opening = flows_of(rows_of_step(tables, 1));
        repeated = flows_of(rows_of_step(tables, 2));
        finish = flows_of(finishing_rows(tables));
    }

    // Carry the vectors of the members from `first` on, as many as those of the constructor.
    void take(const ForwardRun& run, int64_t first) {
        members.first = first;
        // Functions of the user are called for all lanes.
        const auto read_numbers = [&](A* to, int64_t length, const double* from) {
            members.each_number(to, length, Numbers<A>::lanes, read_entries(from));
        };
        const auto each_component = [&](V* to, int64_t length, auto&& visit) {
            members.each_component(to, length, run.carried, visit);
        };
        read_numbers(x.at, size, run.momenta);
        read_numbers(x.at + size, size, run.errors);
        each_component(vectors.at, size, read_entries(run.tangents));
        if (square > 0) {
            read_numbers(group.at, square, run.groups);
            each_component(of_group.at, square, read_entries(run.group_tangents));
        }
        V* const of_coefficients = members.read_directions(directions.at, coefficients, run) ? directions.at : nullptr;
        const FurtherTangents<A, V> further{square > 0 ? group.at : nullptr, of_group.at, of_coefficients, all.added};
        int64_t mark = 0;
        SharedSteps shared_steps(of_members ? 1 : run.threads, size);
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            interrupts.after(work);
            shared_steps.begin();
            const A t(run.t0 + double(k - 1) * run.h);
            tangents.sweep(rows_of_step(tables, k), k == 1 ? opening : repeated, x.at, x.at + size,
                           vectors.at, t, run.h, further);
            shared_steps.end();
            if (mark == run.marked || run.marks[mark] != k) continue;
            std::copy_n(x.at, 2 * size, finished.at);
            std::copy_n(vectors.at, size * rows, copies.at);
            std::copy_n(group.at, square, finished_group.at);
            std::copy_n(of_group.at, square * rows, copies_of_group.at);
            tangents.sweep(finishing_rows(tables), finish, finished.at, finished.at + size, copies.at, t, run.h,
                           {square > 0 ? finished_group.at : nullptr, copies_of_group.at, of_coefficients, all.added});
            const int64_t saved = mark++ * run.members * run.carried;
            each_component(copies.at, size, write_entries(run.at_points + saved * size));
            if (square > 0) each_component(copies_of_group.at, square, write_entries(run.at_groups + saved * square));
        }
        each_component(vectors.at, size, write_entries(run.tangents));
        if (square > 0) each_component(of_group.at, square, write_entries(run.group_tangents));
    }

  private:
    typedef typename C::template Constant<A> N;
    static constexpr int64_t per_block = of_members ? 1 : Numbers<V>::lanes;
    const FlowCotangents& all;
    const FlowTables& tables;
    InterruptCheck& interrupts;
    MembersOfRun<of_members> members;
    const int64_t size, side, square, rows, coefficients;
    AlignedArray<A> x, finished, group, finished_group;
    AlignedArray<V> vectors, copies, of_group, copies_of_group, directions;
    FlowTangentState<A, V, C> tangents;
    std::vector<ElementaryFlow<N>> opening, repeated, finish;
    const int64_t work;
};

// Carry the tangent vectors of the members first to last - 1; return zero or the outcome.
static int64_t carry_forward(const FlowCotangents& tables, const ForwardRun& run, int64_t first, int64_t last,
                             InterruptCheck& interrupts, std::unique_ptr<Kept>* kept) {
    return run_in_lanes<NATIVE, StepsForward>(tables, run, first, last, interrupts, kept);
}

EXPORT_DERIVATIVES(flow_directions, FlowCotangents, ForwardRun, carry_forward)

}  // namespace coadjoint
