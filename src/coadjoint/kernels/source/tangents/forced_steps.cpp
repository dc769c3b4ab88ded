// Whole runs with forces with their derivatives, for Python: half flows of the forces around steps of another loop.
#include "flows/finished_step.hpp"
#include "steps/forced_layout.hpp"
#include "steps/inner_step.hpp"
#include "tangents/force_derivatives.hpp"
#include "tangents/members.hpp"
#include "tangents/stage_equations.hpp"

namespace coadjoint {

namespace {

// The functions that carry tangents and cotangents of members through steps of a loop, and its tables.
struct InnerDerivative {
    typedef int64_t (*Carry)(const void* tables, const void* run, int64_t first, int64_t last, std::unique_ptr<Kept>* kept);
    Carry forward, backward;
    const void* tables;
    std::unique_ptr<Kept> kept;

    template <class Run>
    void operator()(Carry carry, const Run& run, int64_t first, int64_t last) {
        const int64_t outcome = carry(tables, &run, first, last, &kept);
        if (outcome == NO_MEMORY) throw std::bad_alloc();
        if (outcome == INTERRUPTED) throw Interrupted{};
        if (outcome) throw NotDifferentiated();
    }
};

// The inner loops of members with the same tables, or with columns of them, and their derivatives.
struct InnerLoops {
    // One of both for each length, as in runs.
    std::vector<std::unique_ptr<FinishedStep<double>>> programs;
    std::vector<std::unique_ptr<InnerStep>> steps;
    std::vector<InnerDerivative> derivatives;

    InnerLoops(const ForcedDerivatives& all, int64_t size, int64_t square, int64_t members, bool shifted,
               const LaneConstants& columns) {
        const ForcedLayout layout(reinterpret_cast<const StepTables*>(all.forced)->whole);
        located.reserve(layout.loops.size());
        for (size_t k = 0; k < layout.loops.size(); ++k) {
            std::vector<int64_t> plain(layout.loops[k], layout.loops[k] + ForcedLayout::ADDRESSES);
            if (shifted) plain.back() = 0;
            const bool alone = !square && members == 1 && !columns.stride && size <= WIDEST;
            programs.push_back(alone ? FinishedStep<double>::of(plain.data(), size) : nullptr);
            steps.emplace_back(programs.back() ? nullptr : new InnerStep(plain.data(), size, square, members, columns));
            const void* tables = reinterpret_cast<const void*>(all.inner[3 * k + 2]);
            if (columns.stride) {
                located.push_back(*static_cast<const FlowCotangents*>(tables));
                located.back().column = columns.first;
                tables = &located.back();
            }
            derivatives.push_back({reinterpret_cast<InnerDerivative::Carry>(all.inner[3 * k]),
                                   reinterpret_cast<InnerDerivative::Carry>(all.inner[3 * k + 1]), tables, nullptr});
        }
    }

    int64_t take(int64_t loop, double* x, double* group, double t, double h) {
        if (!programs[loop]) return steps[loop]->take(x, group, t, h);
        programs[loop]->take(x, t, h, true);
        return int64_t(programs[loop]->status);
    }

  private:
    std::vector<FlowCotangents> located;  // whose columns are those of the first member on
};

// The flows and loops of one member, or of all with the same tables.
struct MemberFlows {
    const StepTables& tables;
    ShiftFactor shift;
    InnerLoops loops;
    std::vector<std::unique_ptr<Force>> forces;
    std::vector<std::unique_ptr<ForceDerivative>> flows;

    MemberFlows(const ForcedDerivatives& all, int64_t size, int64_t square, int64_t members)
        : tables(*reinterpret_cast<const StepTables*>(all.forced)),
          shift(size, square ? tables.group.size : 0, square ? all.casimirs : 0, all.factors, all.turning),
          loops(all, size, square, square ? 1 : members, square && all.casimirs, {0, 0}) {
        const ForcedLayout layout(tables.whole);
        for (size_t j = 0; j < layout.forces.size(); ++j) {
            forces.emplace_back(new Force(*layout.forces[j], tables.field, tables.group, MemberConstants{1, 0}));
            flows.emplace_back(new ForceDerivative(*reinterpret_cast<const ForceDerivatives*>(all.flows[j]), *forces.back(), tables,
                                                   all));
        }
    }
};

// Some members of a run, side by side.
class ForcedSteps {
  public:
    ForcedSteps(const ForcedDerivatives& all, int64_t size, int64_t square, int64_t first, int64_t count, int64_t threads)
        : all(all), tables_of_first(all.apart ? *reinterpret_cast<const ForcedDerivatives*>(all.members[first]) : all),
          tables(*reinterpret_cast<const StepTables*>(tables_of_first.forced)), layout(tables.whole), n(size), square(square),
          d(square ? tables.group.size : 0), first(first), count(count), threads(threads), shifted(square && all.casimirs),
          x(count * n), groups(count * square), started(count * square), zeros(count * std::max(n, square)), status(count),
          states(count), work(count * (16 * work_of(tables.field) + 64 * n * int64_t(1 + layout.forces.size()))) {
        for (int64_t b = 0; b < (all.apart ? count : 1); ++b)
            own.emplace_back(new MemberFlows(all.apart ? *reinterpret_cast<const ForcedDerivatives*>(all.members[first + b]) : all,
                                             n, square, all.apart ? 1 : count));
        if (all.apart && all.stride && n <= WIDEST && count >= MIN_LANES)
            columns.reset(new InnerLoops(all, n, square, square ? 1 : count, shifted, {all.stride, first}));
        together = columns ? columns.get() : all.apart ? nullptr : &own[0]->loops;
    }

    void forward(const ForwardRun& run) {
        const int64_t carried = run.carried, rows = run.apart ? count * carried : carried;
        const double* const directions = run.coefficients + (run.apart ? first * carried * all.coefficients : 0);
        std::vector<double> of_inner(rows * all.inner_coefficients);
        for (int64_t r = 0; r < rows; ++r)
            std::copy_n(directions + r * all.coefficients, all.inner_coefficients,
                        of_inner.data() + r * all.inner_coefficients);
        double* const vectors = run.tangents + first * carried * n;
        double* const of_groups = run.group_tangents + first * carried * square;
        std::vector<double> moved(count * carried * n), after(count * carried * square), started_with(after), changes,
            product(square), start(n), midpoint, before_turn(square), before, along_momenta;
        begin(run);
        int64_t mark = 0;
        const auto along = [&](int64_t b) { return directions + (run.apart ? b * carried * all.coefficients : 0); };
        const auto push = [&](const FlowTime& at, int64_t b) {
            double* const state = x.data() + b * n;
            double* const element = turned_by(at, groups.data() + b * square);
            std::copy_n(state, n, start.data());
            if (element) std::copy_n(element, square, before_turn.data());
            midpoint = start;
            apply(at, b, state, element, midpoint.data());
            of(b).flows[at.flow]->push(at, start.data(), state, midpoint_of(at, midpoint.data()), vectors + b * carried * n, carried, along(b),
                                 element ? before_turn.data() : nullptr, of_groups + b * carried * square);
        };
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            each_substep(run.t0 + double(k - 1) * run.h, run.h, [&](const Substep& one, double t, double h) {
                each_flow(one, 0, run.t0 + double(k - 1) * run.h, run.h, push);
                before = x;
                take(one, t, h);
                std::copy_n(vectors, moved.size(), moved.data());
                if (!shifted) std::copy_n(of_groups, after.size(), started_with.data());
                else std::fill(started_with.begin(), started_with.end(), 0.0);
                const ForwardRun of_step{n, square, count, carried, t, h, 0, 1, before.data(),
                                         zeros.data(), started.data(), 1, &ONE_STEP, vectors, after.data(), moved.data(),
                                         started_with.data(), of_inner.data(), threads, run.apart};
                // The vectors before the step are still needed for the factor of the shift.
                if (shifted) along_momenta.assign(vectors, vectors + moved.size());
                carry(one.loop, &InnerDerivative::forward, of_step);
                if (!shifted) {
                    std::copy_n(after.data(), after.size(), of_groups);
                } else {
                    for (int64_t b = 0; b < count; ++b) {
                        const double* const factor = of(b).shift.at(before.data() + b * n, h);
                        changes.resize(carried * square);
                        of(b).shift.along(carried, along_momenta.data() + b * carried * n, along(b) + first_factor(),
                                    all.coefficients, changes.data());
                        for (int64_t v = 0; v < carried; ++v)
                            shifted_tangent(b, factor, changes.data() + v * square, after.data() + (b * carried + v) * square,
                                            of_groups + (b * carried + v) * square, product.data());
                        shifted_group(b, factor, product.data());
                    }
                }
                each_flow(one, 1, run.t0 + double(k - 1) * run.h, run.h, push);
            });
            if (mark == run.marked || run.marks[mark] != k) continue;
            const int64_t saved = (mark++ * run.members + first) * carried;
            std::copy_n(vectors, count * carried * n, run.at_points + saved * n);
            std::copy_n(of_groups, count * carried * square, run.at_groups + saved * square);
        }
    }

    void backward(const BackwardRun& run) {
        const int64_t substeps = int64_t(layout.substeps.size()), total = (run.k1 - run.k0) * substeps;
        // The states and elements before each flow and before the step, the midpoints of flows, if some have any, if shifted the
        // elements of the loop after the step, and what it stores.
        const auto& forces = own[0]->forces;
        const bool midpoints = std::any_of(forces.begin(), forces.end(), [](const auto& one) { return one->has_midpoint(); });
        const int64_t slots = slot_of_flow(0, 1) + 1, stored = begin_stored(run), first_midpoint = count * slots * (n + square),
                      first_end = first_midpoint + (midpoints ? count * slots * n : 0), ends_of_each = shifted ? count * square : 0,
                      each = first_end + ends_of_each + count * stored;
        std::vector<double> held(total * each);
        const auto held_at = [&](int64_t k, const Substep& one) {
            return held.data() + ((k - run.k0 - 1) * substeps + (&one - layout.substeps.data())) * each;
        };
        begin(run);
        for (int64_t k = run.k0 + 1; k <= run.k1; ++k) {
            const double start = run.t0 + double(k - 1) * run.h;
            each_substep(start, run.h, [&](const Substep& one, double t, double h) {
                double* const to = held_at(k, one);
                const auto hold = [&](int64_t slot, int64_t b) {
                    std::copy_n(x.data() + b * n, n, state_in(to, slot, b));
                    std::copy_n(groups.data() + b * square, square, element_in(to, slot, b));
                };
                const auto move = [&](const FlowTime& at, int64_t b) {
                    const int64_t slot = slot_of_flow(at.flow, at.side);
                    double* const middle = to + first_midpoint + (slot * count + b) * n;
                    hold(slot, b);
                    if (midpoints) std::copy_n(x.data() + b * n, n, middle);
                    apply(at, b, x.data() + b * n, turned_by(at, groups.data() + b * square), middle);
                };
                each_flow(one, 0, start, run.h, move);
                for (int64_t b = 0; b < count; ++b) hold(slot_of_step(), b);
                for (int64_t b = 0; stored && b < count; ++b)
                    if (!kept_of(one).take(b, x.data() + b * n, t, h, threads, to + each - (count - b) * stored))
                        throw NotDifferentiated();
                if (!stored) take(one, t, h);
                std::copy_n(ends.data(), ends_of_each, to + first_end);
                for (int64_t b = 0; shifted && b < count; ++b)
                    shifted_group(b, of(b).shift.at(state_in(to, slot_of_step(), b), h), change.data());
                each_flow(one, 1, start, run.h, move);
            });
        }
        std::vector<const double*> ends_of_flows;
        for (int64_t b = 0; b < count; ++b) ends_of_flows.push_back(x.data() + b * n);
        double* const rows = run.cotangents + first * n;
        double* const of_groups = run.group_cotangents + first * square;
        double* const by_coefficients = run.coefficients + first * all.coefficients;
        std::vector<double> of_inner(count * all.inner_coefficients), after(count * n), group_after(count * square),
            deviations(count), through(count * n), of_element(count * square);
        int64_t mark = run.marked;
        for (int64_t k = run.k1; k > run.k0; --k) {
            const double start = run.t0 + double(k - 1) * run.h;
            if (mark > 0 && run.marks[mark - 1] == k) {
                const int64_t saved = --mark * run.members + first;
                for (int64_t i = 0; i < count * n; ++i) rows[i] += run.at_points[saved * n + i];
                for (int64_t e = 0; e < count * square; ++e) of_groups[e] += run.at_groups[saved * square + e];
            }
            for (int64_t s = substeps; s-- > 0;) {
                const Substep& one = layout.substeps[s];
                double* const from = held_at(k, one);
                const double t = start + one.begin * run.h, h = one.length * run.h;
                InterruptCheck::of_this_call().after(4 * work);
                const auto pull = [&](const FlowTime& at, int64_t b) {
                    const int64_t slot = slot_of_flow(at.flow, at.side);
                    const double* const state = state_in(from, slot, b);
                    const double* const middle = midpoint_of(at, from + first_midpoint + (slot * count + b) * n);
                    of(b).flows[at.flow]->pull(at, state, ends_of_flows[b], middle, rows + b * n,
                                               by_coefficients + b * all.coefficients, turned_by(at, element_in(from, slot, b)),
                                               of_groups + b * square);
                    ends_of_flows[b] = state;
                };
                each_flow(one, 1, start, run.h, pull, true);
                double* const before = state_in(from, slot_of_step(), 0);
                double* const element = element_in(from, slot_of_step(), 0);
                for (int64_t b = 0; b < count; ++b) ends_of_flows[b] = before + b * n;
                for (int64_t b = 0; stored && b < count; ++b)
                    kept_of(one).pull(b, from + each - (count - b) * stored, h, threads, rows + b * n,
                                      of_inner.data() + b * all.inner_coefficients);
                if (stored) {
                    each_flow(one, 0, start, run.h, pull, true);
                    continue;
                }
                std::copy_n(rows, count * n, after.data());
                std::copy_n(of_groups, count * square, group_after.data());
                std::fill_n(rows, count * n, 0.0);
                std::fill_n(through.data(), count * n, 0.0);
                std::copy_n(from + first_end, ends_of_each, ends.data());
                for (int64_t b = 0; shifted && b < count; ++b)
                    shifted_cotangents(b, of(b).shift.at(before + b * n, h), element + b * square, group_after.data() + b * square,
                                       of_groups + b * square, through.data() + b * n,
                                       by_coefficients + b * all.coefficients + first_factor());
                std::vector<double>& elements = shifted ? units() : started;
                if (!shifted) std::copy_n(element, count * square, started.data());
                std::fill(of_element.begin(), of_element.end(), 0.0);
                const BackwardRun of_step{n, square, count, t, h, 0, 1, before, zeros.data(), elements.data(), zeros.data(), 1,
                                          &ONE_STEP, after.data(), group_after.data(), rows, of_element.data(),
                                          of_inner.data(), deviations.data(), 0, threads};
                carry(one.loop, &InnerDerivative::backward, of_step);
                if (!shifted) std::copy_n(of_element.data(), count * square, of_groups);
                for (int64_t i = 0; i < count * n; ++i) rows[i] += through[i];
                each_flow(one, 0, start, run.h, pull, true);
            }
        }
        for (int64_t b = 0; b < count; ++b) {
            for (int64_t c = 0; c < all.inner_coefficients; ++c)
                by_coefficients[b * all.coefficients + c] += of_inner[b * all.inner_coefficients + c];
            if (run.deviations) run.deviations[first + b] = std::max(run.deviations[first + b], deviations[b]);
        }
    }

  private:
    const ForcedDerivatives &all, &tables_of_first;
    const StepTables& tables;
    const ForcedLayout layout;
    const int64_t n, square, d, first, count, threads;
    const bool shifted;
    std::vector<double> x, groups, started, zeros, change = std::vector<double>(2 * square), ones;
    std::vector<int64_t> status;
    std::vector<double*> states;
    std::vector<std::unique_ptr<MemberFlows>> own;  // of each member, or of all
    std::unique_ptr<InnerLoops> columns;
    InnerLoops* together = nullptr;  // of all members
    const int64_t work;
    int64_t ONE_STEP = 1;

    int64_t first_factor() const { return all.coefficients - all.casimirs; }

    MemberFlows& of(int64_t b) const { return *own[all.apart ? b : 0]; }

    template <class Run>
    void carry(int64_t loop, InnerDerivative::Carry InnerDerivative::*way, const Run& run) {
        const auto by = [&](InnerDerivative& one, int64_t begin, int64_t end) { one(one.*way, run, begin, end); };
        if (together) return by(together->derivatives[loop], 0, count);
        for (int64_t b = 0; b < count; ++b) by(of(b).loops.derivatives[loop], b, b + 1);
    }

    Kept& kept_of(const Substep& one) const { return *together->derivatives[one.loop].kept; }

    // How many numbers a step of a member stores, if its loops do, by calls without steps.
    int64_t begin_stored(const BackwardRun& run) {
        if (square || !together || columns) return 0;
        std::vector<double> rows(count * n), of_inner(count * all.inner_coefficients), deviations(count);
        const BackwardRun none{n, 0, count, run.t0, run.h, 0, 0, zeros.data(), zeros.data(), nullptr, nullptr, 0,
                               &ONE_STEP, nullptr, nullptr, rows.data(), nullptr, of_inner.data(), deviations.data(), 0, threads};
        int64_t most = 0;
        for (InnerDerivative& one : together->derivatives) {
            if (!one.kept) carry(&one - together->derivatives.data(), &InnerDerivative::backward, none);
            if (one.kept) most = std::max(most, one.kept->stored());
            if (!most) one.kept.reset();  // which has room for the steps of that call
        }
        return most;
    }

    template <class Run>
    void begin(const Run& run) {
        std::copy_n(run.momenta + first * n, count * n, x.data());
        std::copy_n(run.groups + first * square, count * square, groups.data());
    }

    template <class Visit>
    void each_substep(double start, double h, const Visit& visit) {
        for (const Substep& one : layout.substeps) {
            InterruptCheck::of_this_call().after(work);
            visit(one, start + one.begin * h, one.length * h);
        }
    }

    // Visit the flows of all members that act on a side of a substep of the step from `start` of length h, in their order
    // or backward.
    template <class Visit>
    void each_flow(const Substep& one, int64_t side, double start, double h, const Visit& visit, bool backward = false) {
        const bool end = &one == (side ? &layout.substeps.back() : &layout.substeps.front());
        const double begin = start + one.begin * h, half = 0.5 * (one.length * h);
        const int64_t substep = &one - layout.substeps.data(), flows = int64_t(layout.forces.size());
        for (int64_t k = 0; k < flows; ++k) {
            const int64_t j = (side == 1) != backward ? flows - 1 - k : k;
            for (int64_t b = 0; b < count; ++b) {
                Force& force = *of(b).forces[j];
                const int64_t member = all.apart ? 0 : first + b;  // whose noise it has
                const bool around = force.around_steps();
                if (around && !(end && force.acts(start, h, member, side))) continue;
                visit(around ? FlowTime{start, h, j, side, one.loop, member, substep}
                             : FlowTime{side ? begin + half : begin, half, j, side, one.loop, member, substep}, b);
            }
        }
    }

    // The element, if a flow moves it.
    double* turned_by(const FlowTime& at, double* element) const {
        return square && own[0]->forces[at.flow]->around_steps() ? element : nullptr;
    }

    // Apply a flow, and store its midpoint, if it has one.
    void apply(const FlowTime& at, int64_t b, double* state, double* element, double* midpoint) {
        Force& force = *of(b).forces[at.flow];
        if (force.flow(state, element, at.t, at.tau, at.member, at.side) != DONE) throw NotDifferentiated();
        if (force.has_midpoint()) force.copy_midpoint(midpoint);
    }

    const double* midpoint_of(const FlowTime& at, const double* stored) const {
        return own[0]->forces[at.flow]->has_midpoint() ? stored : nullptr;
    }

    // Of what is held of a substep: the slots of its flows and of the step between them, and a state and an element there.
    int64_t slot_of_step() const { return int64_t(layout.forces.size()); }
    int64_t slot_of_flow(int64_t flow, int64_t side) const { return side ? 2 * slot_of_step() - flow : flow; }
    double* state_in(double* held, int64_t slot, int64_t b) const { return held + slot * count * (n + square) + b * n; }
    double* element_in(double* held, int64_t slot, int64_t b) const {
        return held + slot * count * (n + square) + count * n + b * square;
    }

    std::vector<double>& units() {
        ones.assign(count * square, 0.0);
        for (int64_t e = 0; e < count * square; ++e) ones[e] = e % square % (d + 1) ? 0.0 : 1.0;
        return ones;
    }

    // Take a step of the inner loop. `started` are the elements with which it starts, and `groups`, if not shifted, those
    // after it; if shifted `ends` are those after it.
    void take(const Substep& one, double t, double h) {
        started = shifted ? units() : groups;
        if (shifted) ends = started;
        if (!square && count > 1 && together) {
            for (int64_t b = 0; b < count; ++b) states[b] = x.data() + b * n;
            together->steps[one.loop]->take_all(states.data(), count, t, h, status.data());
        } else {
            for (int64_t b = 0; b < count; ++b)
                status[b] = of(b).loops.take(one.loop, x.data() + b * n, (shifted ? ends : groups).data() + b * square, t, h);
        }
        for (int64_t b = 0; b < count; ++b)
            if (status[b] != DONE) throw NotDifferentiated();
    }

    std::vector<double> ends;  // of the loop, after a step that starts at the unit element

    // The stored element after a shifted step is G F s for the element G of the loop, the factor F, and s before.
    void shifted_group(int64_t b, const double* factor, double* product) {
        double* const group = groups.data() + b * square;
        std::fill_n(product, square, 0.0);
        add_matrix_product(d, 1.0, factor, group, product);
        std::fill_n(group, square, 0.0);
        add_matrix_product(d, 1.0, ends.data() + b * square, product, group);
    }

    void shifted_tangent(int64_t b, const double* factor, const double* of_factor, const double* of_end, double* of_group,
                         double* product) {
        const double* const group = groups.data() + b * square;
        std::fill_n(product, square, 0.0);
        add_matrix_product(d, 1.0, of_factor, group, product);
        add_matrix_product(d, 1.0, factor, of_group, product);
        std::fill_n(of_group, square, 0.0);
        add_matrix_product(d, 1.0, ends.data() + b * square, product, of_group);
        std::fill_n(product, square, 0.0);
        add_matrix_product(d, 1.0, factor, group, product);
        add_matrix_product(d, 1.0, of_end, product, of_group);
    }

    // Replace the cotangent of an element after the step by that of the element of the loop; set that of the element
    // before, and add those of the momentum and the factors of the Casimirs.
    void shifted_cotangents(int64_t b, const double* factor, const double* group, double* of_end, double* of_group,
                            double* of_x, double* of_factors) {
        std::vector<double> moved(square), transposed(square), of_factor(square), whole(of_end, of_end + square);
        const double* const end = ends.data() + b * square;
        // of F: G^T W s^T
        transpose_matrix(d, end, transposed.data());
        std::vector<double> pulled(square);
        add_matrix_product(d, 1.0, transposed.data(), whole.data(), pulled.data());
        transpose_matrix(d, group, transposed.data());
        add_matrix_product(d, 1.0, pulled.data(), transposed.data(), of_factor.data());
        of(b).shift.pull(of_factor.data(), of_x, of_factors);
        // of s: F^T G^T W
        transpose_matrix(d, factor, transposed.data());
        std::fill_n(of_group, square, 0.0);
        add_matrix_product(d, 1.0, transposed.data(), pulled.data(), of_group);
        // of G: W (F s)^T
        add_matrix_product(d, 1.0, factor, group, moved.data());
        transpose_matrix(d, moved.data(), transposed.data());
        std::fill_n(of_end, square, 0.0);
        add_matrix_product(d, 1.0, whole.data(), transposed.data(), of_end);
    }
};

template <class Run, class Move>
int64_t in_blocks(const ForcedDerivatives& tables, const Run& run, int64_t first, int64_t last, const int64_t* stop,
                  const Move& move) {
    InterruptCheck interrupts(stop);
    return outcome_of([&]() -> int64_t {
        try {
            for (int64_t m = first; m < last; m += MOST_LANES) {
                ForcedSteps steps(tables, run.size, run.square, m, std::min<int64_t>(MOST_LANES, last - m), run.threads);
                move(steps);
            }
            return 0;
        } catch (const NotDifferentiated&) {
            return UNSOLVED;
        } catch (const NotSolved&) {
            return UNSOLVED;
        }
    });
}

}  // namespace

// Carry tangents of the members first to last - 1; return zero or the outcome.
EXPORT int64_t forced_directions(const ForcedDerivatives* tables, const ForwardRun* run, int64_t first, int64_t last,
                                 const int64_t* stop) {
    return in_blocks(*tables, *run, first, last, stop, [&](ForcedSteps& steps) { steps.forward(*run); });
}

// Carry cotangents of the members first to last - 1 from the last step to the first; return zero or the outcome.
EXPORT int64_t forced_cotangents(const ForcedDerivatives* tables, const BackwardRun* run, int64_t first, int64_t last,
                                 const int64_t* stop) {
    return in_blocks(*tables, *run, first, last, stop, [&](ForcedSteps& steps) { steps.backward(*run); });
}

}  // namespace coadjoint
