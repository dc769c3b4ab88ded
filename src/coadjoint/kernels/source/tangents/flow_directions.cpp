// The loop over the steps of programs with tangent vectors that are saved, for Python.
#include "flows/compiled_rows.hpp"
#include "tangents/flow_tangents.hpp"
#include "tangents/members.hpp"

namespace coadjoint {

// Members as lanes, each with all of its vectors, or one member with its vectors as lanes.
template <class A, class V, class C>
static void run_members(const FlowCotangents& all, const C& constants, const ForwardRun& run, int64_t first,
                        int64_t count, InterruptCheck& interrupts) {
    const FlowTables& tables = all.base;
    constexpr bool of_members = Numbers<A>::lanes == Numbers<V>::lanes;
    constexpr int64_t per_block = of_members ? 1 : Numbers<V>::lanes;
    const int64_t size = run.size, side = run.square > 0 ? tables.group.size : 0, square = side * side;
    const int64_t rows = (run.carried + per_block - 1) / per_block;
    const int64_t coefficients = CoefficientCotangents<A>::count(tables.terms);
    const MembersOfRun<of_members> members{first, of_members ? count : 1};
    AlignedArray<A> x(2 * size), finished(2 * size), group(square), finished_group(square);
    AlignedArray<V> vectors(size * rows), copies(size * rows), of_group(square * rows), copies_of_group(square * rows);
    AlignedArray<V> directions(coefficients * rows);
    FlowTangentState<A, V, C> tangents(tables, constants, all.hessians, size, rows);
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
    FlowsOfRows<typename C::template Constant<A>, C> flows_of(tables, constants, square > 0, true);
    const auto opening = flows_of(rows_of_step(tables, 1));
    const auto repeated = flows_of(rows_of_step(tables, 2));
    const auto finish = flows_of(finishing_rows(tables));
    const int64_t work = (2 + 4 * rows) * Numbers<A>::lanes * work_of_flows(tables);
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

// Carry the tangent vectors of the members first to last - 1; return zero or the outcome.
static int64_t carry_forward(const FlowCotangents& tables, const ForwardRun& run, int64_t first, int64_t last,
                             InterruptCheck& interrupts) {
    typedef Lanes<NATIVE> Members;  // the vectors of a member hide the latency
    return run_in_lanes<NATIVE>(
        tables, run.size, first, last, interrupts, [&](auto together, const auto& constants, auto&&... rest) {
            typedef std::conditional_t<together(), Members, double> A;
            run_members<A, std::conditional_t<together(), Members, TangentLanes>>(tables, constants, run, rest...);
        });
}

EXPORT_DERIVATIVES(flow_directions, FlowCotangents, ForwardRun, carry_forward)

}  // namespace coadjoint
