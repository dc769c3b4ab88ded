// The tables that the loops read. Their fields, in this order, are exported to Python, which fills them by name.
#pragma once

#include <cstdint>

namespace coadjoint {

#if defined(_WIN32)
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

// Types of fields. If the constants of members differ, `constants` and `addresses` (of compiled functions) hold a
// column for each member; everything else is shared.
typedef int64_t integer;
typedef double number;
typedef int64_t flag;
typedef uint8_t* bytes;
typedef uint32_t* indices;
typedef int64_t* integers;
typedef int64_t* addresses;
typedef double* numbers;
typedef double* constants;

// Qualified, so that a field may have the name of a type.
#define DECLARE_FIELD(type, name) coadjoint::type name;
#define DESCRIBE_FIELD(type, name) #type " " #name ";"
#define TABLE(Name, FIELDS)    \
    struct Name {              \
        FIELDS(DECLARE_FIELD)  \
    };                         \
    constexpr char Name##_fields[] = "table " #Name ":" FIELDS(DESCRIBE_FIELD) "\n";

// With `repeated`, of linear terms for flows and values alone, row r has the entries of shape[r], whose columns are
// relative to target[r], modulo 2^32; `offset` has a number for each shape if `repeated` is 2, otherwise for each row.
#define TERMS_FIELDS(_)                                                                                              \
    _(integer, size) _(bytes, kind) _(indices, row) _(indices, target) _(constants, offset) _(indices, entry)         \
    _(indices, column) _(constants, weight) _(indices, monomial) _(constants, coefficient) _(indices, factor)           \
    _(indices, factor_row) _(indices, exponent) _(integer, repeated) _(indices, shape)
TABLE(Terms, TERMS_FIELDS)

// A function of logarithms, angles and quotients of polynomials: see `field/forms.hpp`.
#define FORMS_FIELDS(_)                                                                                              \
    _(integer, size) _(integers, role) _(numbers, weight) _(integers, first) _(numbers, coefficient)                \
    _(integers, begin) _(integers, coordinate)
TABLE(Forms, FORMS_FIELDS)

// A function of the user that is a sum of shares: the compiled one at `address` takes the number of a share as its time.
#define SHARED_FIELDS(_) _(integer, address) _(integer, shares) _(integer, results)
TABLE(SharedFunction, SHARED_FIELDS)

// A convolution of vectors on cells with tensors, or half of its product with the vectors: see
// `matrices/cell_convolution.cpp`. It begins as a `TableFunction`. Vector i is at place[i] of the cells, if these are
// `placed`, and multiplied by factor[i], if `scaled`. A cell of three axes has `sites` vectors; axes are periodic with the
// lengths `padded`, `steps` are the distances of cells in numbers. `tensors` are real with one site, symmetric matrices of
// waves, eight waves of the last axis side by side: the rows of their upper triangles, and for several sites each followed
// by its imaginary part.
#define CONVOLUTION_FIELDS(_)                                                                                         \
    _(integer, code) _(number, norm) _(flag, summed) _(integer, vectors) _(integer, sites) _(integers, sizes)        \
    _(integers, padded) _(integers, steps) _(flag, placed) _(integers, place) _(flag, scaled) _(numbers, factor)     \
    _(number, strength) _(numbers, tensors)
TABLE(CellConvolution, CONVOLUTION_FIELDS)

#define ACTION_FIELDS(_)                                                                                             \
    _(integer, size) _(indices, run) _(bytes, kind) _(indices, angles) _(indices, repeat) _(indices, angle)          \
    _(indices, position) _(indices, constant) _(indices, width) _(indices, entries) _(indices, degree)              \
    _(indices, indices) _(constants, constants)
TABLE(Action, ACTION_FIELDS)

// called[k] is the free body evaluated by share k, else -1. Body b has six entries of body_column and fifteen of body.
// The bits of `properties` are in `flows/called_parts.hpp`.
// `tau` belongs to steps of the length `step`; those of another length are scaled to it.
#define FLOW_FIELDS(_)                                                                                               \
    _(integer, longest) _(integers, only) _(bytes, bent) _(constants, frequency) _(indices, part) _(numbers, tau)      \
    _(numbers, moment) _(indices, section) _(indices, share) _(Terms, terms) _(addresses, addresses)                 \
    _(Action, state) _(Action, group) _(flag, compensated) _(integers, called) _(indices, body_column)               \
    _(constants, body) _(bytes, properties) _(number, step)
TABLE(FlowTables, FLOW_FIELDS)

#define WATCH_FIELDS(_)                                                                                              \
    _(integer, size) _(Terms, terms) _(addresses, addresses) _(indices, first) _(constants, constant)                  \
    _(constants, period) _(integer, longest)
TABLE(Watch, WATCH_FIELDS)

// Event functions, and records of their zeros. For every event: its `direction`, and for each member how many crossings
// are `left` until it ends its run (0: it does not). For every member: the last step of its run, `limit`; its finished
// states one and two steps ago, `before`, and the last three `values` of the events. Of the recorded steps, `recorded`
// so far of at most `capacity`: in `found` its member, its number, and a code for each event; in `records` the state
// before it, and the values of the events before and after it.
#define EVENT_FIELDS(_)                                                                                              \
    _(Watch, watch) _(integers, direction) _(integers, left) _(integers, limit) _(numbers, before) _(numbers, values) \
    _(integer, capacity) _(integers, recorded) _(integers, found) _(numbers, records)
TABLE(EventTables, EVENT_FIELDS)

#define EXTENT_FIELDS(_)                                                                                             \
    _(integer, members) _(integer, points) _(integer, size) _(integer, square) _(integer, invariants)               \
    _(integer, memory_size)
TABLE(Extent, EXTENT_FIELDS)

// The saved steps are the `marked` steps at `marks`, ascending; without marks every save_every-th from 0 on, and the
// last. The first `passed` of them are already saved, and have no memory in a resumed run. With `starts` and `lengths`
// every member takes a single step: from that time, of that length, with the noise of the member in `numbers`. `events`
// is the address of `EventTables`, or zero. `threads` may share the work of one member.
#define SCHEDULE_FIELDS(_)                                                                                           \
    _(number, t0) _(number, h) _(integer, steps) _(integer, save_every) _(integer, passed) _(flag, watching)  \
    _(integer, marked) _(integers, marks) _(numbers, starts) _(numbers, lengths) _(integers, numbers)                \
    _(integer, events) _(integer, threads)
TABLE(Schedule, SCHEDULE_FIELDS)

// The arguments of a call that takes all steps of a run, except its arrays; all but the range of members are addresses.
// A call from Python takes a fifth of a microsecond less than with each of them as an argument.
#define WHOLE_RUN_FIELDS(_)                                                                                          \
    _(integer, tables) _(integer, watch) _(integer, members) _(integer, first) _(integer, last) _(integer, stride)    \
    _(integer, extent) _(integer, schedule) _(integer, stop)
TABLE(WholeRun, WHOLE_RUN_FIELDS)

// The number of a member in the run, by which noise is drawn.
inline int64_t number_of(const Schedule& schedule, int64_t member) {
    return schedule.numbers ? schedule.numbers[member] : member;
}

// The length of the steps of a member, and the time at which its step k begins; step k + 1 begins where step k ends.
inline double length_of(const Schedule& schedule, int64_t member) {
    return schedule.lengths ? schedule.lengths[member] : schedule.h;
}
inline double start_of(const Schedule& schedule, int64_t member, int64_t k) {
    return schedule.starts ? schedule.starts[member] + double(k - 1) * schedule.lengths[member]
                           : schedule.t0 + double(k - 1) * schedule.h;
}

// If `separated`, the field at a point is the sum of other products, without those that cancel: own_first to
// `own_constant`. Their columns from `size` on are partial components of the gradient, each the sum of some rows of terms:
// partial[k] gets the row partial_row[k], ascending.
#define FIELD_FIELDS(_)                                                                                              \
    _(integer, size) _(number, sign) _(indices, first) _(indices, column) _(indices, state) _(constants, constant)     \
    _(flag, nonlinear) _(addresses, structure) _(Terms, terms) _(addresses, addresses) _(integer, longest)            \
    _(flag, separated) _(indices, own_first) _(indices, own_column) _(indices, own_state) _(constants, own_constant)   \
    _(integer, partials) _(integer, partial_rows) _(indices, partial) _(indices, partial_row)
TABLE(Field, FIELD_FIELDS)

#define GROUP_FIELD_FIELDS(_)                                                                                        \
    _(integer, size) _(integer, entries) _(indices, element) _(indices, row) _(indices, column) _(constants, value)
TABLE(GroupField, GROUP_FIELD_FIELDS)

#define RUNGE_KUTTA_FIELDS(_)                                                                                        \
    _(Field, field) _(GroupField, group) _(integer, stages) _(integer, substeps) _(integer, solver)                  \
    _(integer, iterations) _(flag, direct) _(numbers, node) _(numbers, scale) _(numbers, mix) _(numbers, out)        \
    _(numbers, forecast) _(constants, quadratic) _(integer, band) _(indices, position) _(numbers, fraction)            \
    _(numbers, moment)
TABLE(RungeKuttaTables, RUNGE_KUTTA_FIELDS)

#define STEP_FIELDS(_)                                                                                               \
    _(Field, field) _(addresses, values) _(GroupField, group) _(Watch, restored) _(integers, whole)                  \
    _(numbers, coefficients)
TABLE(StepTables, STEP_FIELDS)

// A force. `shape` is that of `rate`, a matrix, and of its root in `aim`; else `aim` is a vector. Its changes of the
// first `work_integrals` invariants are accumulated behind the coordinates, from index `work_integral` on. The directions
// of a noise, columns of the root, form `sets` that commute: direction[begin[s]] to direction[begin[s + 1]].
// For a force on modes of a matrix of `extent` rows, at `position` of a state, `shape` selects the modes; on the
// diagonal d they are those with the numbers direction[begin[d]] to direction[begin[d + 1] - 1], with as many entries
// of `rate`, and of `turning` if they may rotate. If `sets` is one, they are those of the matrix minus that of `aim`.
// `basis` is described in matrices/modes.hpp. The flow of a function of the state is extrapolated in `extent` columns, or
// is a step of the classical Runge-Kutta method if that is zero. A given flow also takes the deviates of `sets` laws that
// measure with noise: each twice `extent`, by the seed and the stream in `direction`, and the period in `rate`. The table
// of a noise of Hamiltonians is described in forces/hamiltonian_noise.hpp, and that of additive noise in forces/force.hpp.
// The selective decay of a matrix of `extent` rows, at `position`, has the integers and numbers of its stream in
// `direction`, with what forces/selective_decay.hpp adds, and in `basis`; that of a vector has an extent of zero.
#define FORCE_FIELDS(_)                                                                                              \
    _(integer, kind) _(integer, work_integral) _(integer, work_integrals) _(integer, shape) _(constants, rate)         \
    _(constants, aim) _(addresses, function) _(constants, amplitude) _(integer, seed) _(integer, stream)               \
    _(integer, sets) _(integers, begin) _(integers, direction) _(integer, extent) _(integer, position)               \
    _(constants, turning) _(constants, basis)
TABLE(ForceTable, FORCE_FIELDS)

#define STEPPING_FIELDS(_)                                                                                           \
    _(integers, step) _(integer, substeps) _(numbers, fraction) _(numbers, moment) _(StepTables, tables)            \
    _(integer, serial)
TABLE(Stepping, STEPPING_FIELDS)

// Tangent vectors beside a state of `size` components: `carried` of them, orthonormalized after every `every`-th step.
// They start as `frame`, vector after vector. Second derivatives of functions of the user are at `hessians`, one for
// each term, and the derivative of a structure matrix given as a function at `derivative`.
#define TANGENTS_FIELDS(_)                                                                                           \
    _(integer, size) _(integer, carried) _(integer, every) _(numbers, frame) _(addresses, hessians) _(addresses, derivative)
TABLE(Tangents, TANGENTS_FIELDS)

#define FLOW_TANGENTS_FIELDS(_) _(FlowTables, base) _(Tangents, tangents)
TABLE(FlowTangents, FLOW_TANGENTS_FIELDS)

#define RUNGE_KUTTA_TANGENTS_FIELDS(_) _(RungeKuttaTables, base) _(Tangents, tangents)
TABLE(RungeKuttaTangents, RUNGE_KUTTA_TANGENTS_FIELDS)

// Cotangents of a program. `dual` moves them as minus the transposes of the generators of `base.state`, `group_dual` as
// those of `base.group`. The part `added`, unless it is negative, moves nothing: its angles are components of a gradient
// whose coefficients are differentiated, by those of functions with their derivatives at `hessians`. With a `stride` the
// constants of members are columns, as many as that, from `column` on.
#define FLOW_COTANGENTS_FIELDS(_)                                                                                    \
    _(FlowTables, base) _(Action, dual) _(Action, group_dual) _(addresses, hessians) _(integer, added)            \
    _(integer, stride) _(integer, column)
TABLE(FlowCotangents, FLOW_COTANGENTS_FIELDS)

// A Runge-Kutta method whose steps are differentiated. `added` are the terms of the derivative of the energy by
// parameters, with coefficients of zero; derivatives of functions by their coefficients are at `functions`.
#define RUNGE_KUTTA_COTANGENTS_FIELDS(_)                                                                             \
    _(RungeKuttaTables, base) _(addresses, hessians) _(addresses, derivative) _(Terms, added) _(addresses, functions)
TABLE(RungeKuttaCotangents, RUNGE_KUTTA_COTANGENTS_FIELDS)

// The steps k0 + 1 to k1 of the members with tangent vectors, `carried` for each, of the state and of the group element
// (members, carried, n) and (members, carried, d, d), which end as those of unfinished states. Those of the states finished
// after the steps `marks`, ascending, are `at_points` (marked, members, carried, n) and `at_groups`. All vectors have the
// directions `coefficients` (carried, number) of the offsets, weights and coefficients of the terms, or if `apart` each
// member has its own, (members, carried, number). `threads` may share the work of one member.
#define FORWARD_RUN_FIELDS(_)                                                                                        \
    _(integer, size) _(integer, square) _(integer, members) _(integer, carried) _(number, t0) _(number, h)            \
    _(integer, k0) _(integer, k1) _(numbers, momenta) _(numbers, errors) _(numbers, groups) _(integer, marked)       \
    _(integers, marks) _(numbers, at_points) _(numbers, at_groups) _(numbers, tangents) _(numbers, group_tangents)   \
    _(numbers, coefficients) _(integer, threads) _(flag, apart)
TABLE(ForwardRun, FORWARD_RUN_FIELDS)

// The steps k0 + 1 to k1 of the members, backward. Given are the unfinished states after step k0, with their errors, from
// which the steps are repeated, or if `undone` those after step k1, from which they are undone, and the cotangents
// `at_points` (marked, members, n) and `at_groups` (marked, members, d, d) of the states finished after the steps
// `marks`, ascending. Accumulated are `cotangents` (members, n) and `group_cotangents` (members, d, d) of the
// unfinished states, and the derivatives by the offsets, weights and coefficients of the terms (members, their number).
// `deviations` (members), which may be null, become at least the largest distance, relative to its size, of a state from
// which flows were undone to that before the step.
#define BACKWARD_RUN_FIELDS(_)                                                                                       \
    _(integer, size) _(integer, square) _(integer, members) _(number, t0) _(number, h) _(integer, k0) _(integer, k1)  \
    _(numbers, momenta) _(numbers, errors) _(numbers, groups) _(numbers, group_errors) _(integer, marked)            \
    _(integers, marks) _(numbers, at_points) _(numbers, at_groups) _(numbers, cotangents)                            \
    _(numbers, group_cotangents) _(numbers, coefficients) _(numbers, deviations) _(flag, undone) _(integer, threads)
TABLE(BackwardRun, BACKWARD_RUN_FIELDS)

// How the flow of a force is differentiated. Its coefficients are `own` from `first` on, and then `moved` more:
// AFFINE: those of a damping are its rates and its aim, and those of a constant torque its components; that of another
// kind is x -> x + E x + b, and `matrix` has E, of a shape, for each of the inner loops. ALONG: at `along` is the table of
// the flow of a state and a vector side by side, which becomes its tangent. ON_ORBIT: second derivatives of functions in H
// are at `hessians`; the coefficients are the logarithms of the directions of the noise and of the damping, by
// coordinate, and those of the terms `added` of the derivative of H, by `functions`. IN_PYTHON: by `function`, which other
// kinds call for coefficients `called` alone, if the flow `depends` on some, and where they do not agree with differences.
// Tables of flows with moved parameters are at `nearby`, for each of the `moved` coefficients at the nodes 1, -1, 2, ..., -4
// in units of `distance`, and as ALONG after a complex step, or 0; `numbered` are their numbers for Python.
#define FORCE_DERIVATIVES_FIELDS(_)                                                                                  \
    _(integer, kind) _(integer, first) _(integer, own) _(integer, shape) _(numbers, matrix)                        \
    _(integer, along) _(addresses, hessians) _(Terms, added) _(addresses, functions) _(integer, function)            \
    _(flag, depends) _(integer, moved) _(integers, nearby) _(numbers, distance) _(integers, numbered)
TABLE(ForceDerivatives, FORCE_DERIVATIVES_FIELDS)

// Steps with forces that are differentiated: the address of their tables, `StepTables`; for each of the inner loops the
// addresses of the functions that carry tangents and cotangents, and of their tables; of each flow that of
// `ForceDerivatives`; and the factors of the Casimirs subtracted from H, which turn a stored element by the exponential of
// the sum of factors[c] x[j] turning[c, j] times the length. The `coefficients` are those of the inner loops, those by which
// flows are differentiated in Python, `called`, those of the flows, and these factors. If `apart`, each of the `members` has
// such tables of its own, at these addresses; `forced` and `inner` are then those that have `stride` columns, if any.
#define FORCED_DERIVATIVES_FIELDS(_)                                                                                 \
    _(integer, forced) _(integers, inner) _(integers, flows) _(integer, inner_coefficients) _(integer, called)       \
    _(integer, coefficients) _(integer, casimirs) _(numbers, factors) _(numbers, turning) _(flag, apart)             \
    _(integers, members) _(integer, stride)
TABLE(ForcedDerivatives, FORCED_DERIVATIVES_FIELDS)

#define UNSHIFT_FIELDS(_)                                                                                            \
    _(integer, size) _(integer, dim) _(integer, components) _(bytes, kind) _(bytes, leaning) _(indices, order)           \
    _(indices, begin) _(indices, coordinate) _(indices, form) _(indices, cell) _(indices, entry) _(indices, column)  \
    _(numbers, weight) _(integers, metric) _(numbers, metrics)
TABLE(UnshiftTables, UNSHIFT_FIELDS)

// Arrays of a run, (members, n), (members, d, d), (points, members, d*d) and (points, members, d, d), and the members
// and saved points requested. X acts at `rate`. Without the schedule, `elapsed` (points, members) are the times since
// the start.
#define UNSHIFTED_FIELDS(_)                                                                                          \
    _(numbers, momenta) _(numbers, initial) _(numbers, held) _(numbers, out) _(integer, members) _(integer, first)   \
    _(integer, last) _(integer, k0) _(integer, k1) _(number, rate) _(numbers, elapsed)
TABLE(Unshifted, UNSHIFTED_FIELDS)

}  // namespace coadjoint
