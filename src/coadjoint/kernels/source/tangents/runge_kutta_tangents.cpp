// Entry points of Runge-Kutta methods with tangent vectors for Python: derivatives of their stages.
#include "stages/runge_kutta_loop.hpp"
#include "tangents/second_derivatives.hpp"
#include "tangents/bundle.hpp"

namespace coadjoint {

typedef Loop<RungeKuttaTangents> RungeKuttaTangentLoop;

// The derivative of a substep with known slopes: dX_i = v + sum_j mix_ij dL_j, with dL_j = W_j dX_j, W_j = h scale_j
// f'(X_j). If a factor of the slopes is frozen at the iterates Z, dL_j depends on dZ_j as well.
class StageChanges {
  public:
    StageChanges(const RungeKuttaTangents& tangent_tables, int64_t rows)
        : tables(tangent_tables.base), field(tangent_tables.base.field), n(field.size), s(tables.stages), rows(rows),
          fields(field), of_vectors(field, tangent_tables.tangents, rows),
          of_units(field, tangent_tables.tangents, blocks(n)), points(s * n), iterates(s * n), slopes(s * n),
          gradients(s * n), vectors(s * n * rows), changes(s * n * rows), units(n * blocks(n)), block(n * blocks(n)),
          matrix(linear() ? s * n * s * n : 0), exchanged(linear() ? s * n : 0),
          right(linear() ? s * n * rows * lanes : 0) {
        for (int64_t i = 0; i < n; ++i) set_lane(units.at[i * blocks(n) + i / lanes], int(i % lanes), 1.0);
    }

    // Move vectors along a substep from x; `found` are its slopes, stage after stage. False if it has no derivative.
    bool move(const double* x, double t, double h, const double* found, TangentLanes* v) {
        start = x, time = t, length = h;
        switch (tables.solver) {
        case EXPLICIT: explicit_changes(found, v); break;
        case ITERATED: iterate(v); field_changes(iterates.at); break;
        case IMPLICIT:
            mix(found, points.at);
            spread(v);
            for (int64_t j = 0; j < s; ++j) set_gradient(j, points.at);
            clear(changes);
            if (!solve([&](int64_t j) { slope_of_field(j, points.at, of_units, units.at, block.at); })) return false;
            break;
        default:
            if (!frozen_changes(found, v)) return false;
        }
        for (int64_t j = 0; j < s; ++j)
            for (int64_t position = 0; position < n * rows; ++position)
                v[position] = fma(TangentLanes(tables.out[j]), changes.at[j * n * rows + position], v[position]);
        return true;
    }

  private:
    static constexpr int64_t lanes = Numbers<TangentLanes>::lanes;
    const RungeKuttaTables& tables;
    const Field& field;
    const int64_t n, s, rows;
    FieldWorkspace<double> fields;
    FieldChanges<TangentLanes> of_vectors, of_units;
    AlignedArray<double> points, iterates, slopes, gradients;
    AlignedArray<TangentLanes> vectors, changes, units, block;
    AlignedArray<double> matrix, exchanged, right;
    const double* start = nullptr;
    double time = 0.0, length = 0.0;

    static int64_t blocks(int64_t count) { return (count + lanes - 1) / lanes; }
    bool linear() const { return tables.solver >= IMPLICIT; }
    double time_of(int64_t j) const { return time + tables.node[j] * length; }
    double length_of(int64_t j) const { return length * tables.scale[j]; }
    static void clear(AlignedArray<TangentLanes>& workspace, int64_t count) {
        std::fill_n(workspace.at, count, TangentLanes(0.0));
    }
    void clear(AlignedArray<TangentLanes>& workspace) const { clear(workspace, s * n * rows); }

    // X_i = x + sum_j mix_ij L_j.
    void mix(const double* found, double* to) const {
        for (int64_t i = 0; i < s; ++i)
            for (int64_t c = 0; c < n; ++c) {
                double total = 0.0;
                for (int64_t j = 0; j < s; ++j) total = fma(tables.mix[i * s + j], found[j * n + c], total);
                to[i * n + c] = start[c] + total;
            }
    }

    // The same for stage i of the vectors.
    void mix_vectors(int64_t i, const TangentLanes* v) {
        TangentLanes* of_stage = vectors.at + i * n * rows;
        std::copy_n(v, n * rows, of_stage);
        for (int64_t j = 0; j < s; ++j)
            if (const double weight = tables.mix[i * s + j])
                for (int64_t position = 0; position < n * rows; ++position)
                    of_stage[position] =
                        fma(TangentLanes(weight), changes.at[j * n * rows + position], of_stage[position]);
    }
    void spread(const TangentLanes* v) {
        for (int64_t i = 0; i < s; ++i) std::copy_n(v, n * rows, vectors.at + i * n * rows);
    }

    void set_gradient(int64_t j, const double* at) {
        gradient(field, SharedConstants{}, at + j * n, time_of(j), gradients.at + j * n, fields);
    }

    // out = h scale_j f'(X_j) times vectors, with the gradient of the stage.
    void slope_of_field(int64_t j, const double* at, FieldChanges<TangentLanes>& changes_of, const TangentLanes* from,
                        TangentLanes* out) {
        changes_of.of_gradient(at + j * n, at + j * n, time_of(j), from, length_of(j), out, fields);
        changes_of.of_structure(at + j * n, gradients.at + j * n, from, length_of(j), out);
    }

    void field_changes(const double* at) {
        for (int64_t j = 0; j < s; ++j) {
            set_gradient(j, at);
            slope_of_field(j, at, of_vectors, vectors.at + j * n * rows, changes.at + j * n * rows);
        }
    }

    void explicit_changes(const double* found, const TangentLanes* v) {
        mix(found, points.at);
        clear(changes);
        for (int64_t j = 0; j < s; ++j) {
            mix_vectors(j, v);
            set_gradient(j, points.at);
            slope_of_field(j, points.at, of_vectors, vectors.at + j * n * rows, changes.at + j * n * rows);
        }
    }

    // The function iterates and their derivatives.
    void iterate(const TangentLanes* v) {
        for (int64_t j = 0; j < s; ++j) std::copy_n(start, n, iterates.at + j * n);
        spread(v);
        for (int64_t passed = 0; passed < tables.iterations; ++passed) {
            field_changes(iterates.at);
            for (int64_t j = 0; j < s; ++j)
                slope_at(field, SharedConstants{}, iterates.at + j * n, time_of(j), length_of(j), gradients.at + j * n,
                         slopes.at + j * n, fields);
            mix(slopes.at, iterates.at);
            for (int64_t i = 0; i < s; ++i) mix_vectors(i, v);
        }
    }

    // dL_j = W_j dX_j + the effect of the change of the frozen factor, which is computed first.
    bool frozen_changes(const double* found, const TangentLanes* v) {
        const bool of_structure = tables.solver == STRUCTURE;
        iterate(v);
        mix(found, points.at);
        const double *frozen = iterates.at, *free = points.at;
        for (int64_t j = 0; j < s; ++j) {
            TangentLanes *of_stage = vectors.at + j * n * rows, *out = changes.at + j * n * rows;
            set_gradient(j, of_structure ? free : frozen);
            if (of_structure) {
                std::fill_n(out, n * rows, TangentLanes(0.0));
                of_vectors.of_structure(frozen + j * n, gradients.at + j * n, of_stage, length_of(j), out);
            } else {
                of_vectors.of_gradient(free + j * n, frozen + j * n, time_of(j), of_stage, length_of(j), out, fields);
            }
        }
        for (int64_t i = 0; i < s; ++i) mix_vectors(i, v);
        return solve([&](int64_t j) {
            if (of_structure) {
                of_units.of_gradient(frozen + j * n, free + j * n, time_of(j), units.at, length_of(j), block.at, fields);
            } else {
                clear(block, n * blocks(n));
                of_units.of_structure(free + j * n, gradients.at + j * n, units.at, length_of(j), block.at);
            }
        });
    }

    // Solve Y_i = sum_j mix_ij W_j Y_j + (stage i of the vectors), and add W_j Y_j to the changes; `fill(j)` sets the
    // block to W_j.
    template <class Fill>
    bool solve(Fill fill) {
        const int64_t edge = s * n, wide = blocks(n) * lanes, count = rows * lanes;
        InterruptCheck::of_this_call().after(edge * edge * (edge + count));
        const double* W = reinterpret_cast<const double*>(block.at);
        std::vector<double> all(s * n * n);
        for (int64_t j = 0; j < s; ++j) {
            fill(j);
            for (int64_t a = 0; a < n; ++a) std::copy_n(W + a * wide, n, all.data() + (j * n + a) * n);
            for (int64_t i = 0; i < s; ++i)
                for (int64_t a = 0; a < n; ++a)
                    for (int64_t b = 0; b < n; ++b)
                        matrix.at[(i * n + a) * edge + j * n + b] =
                            fma(-tables.mix[i * s + j], W[a * wide + b], i == j && a == b ? 1.0 : 0.0);
        }
        if (!factorize(matrix.at, edge, exchanged.at)) return false;
        std::copy_n(reinterpret_cast<const double*>(vectors.at), edge * count, right.at);
        substitute(matrix.at, edge, exchanged.at, right.at, count);
        double* out = reinterpret_cast<double*>(changes.at);
        for (int64_t j = 0; j < s; ++j)
            for (int64_t a = 0; a < n; ++a)
                for (int64_t b = 0; b < n; ++b) {
                    const double entry = all[(j * n + a) * n + b];
                    if (entry == 0.0) continue;
                    for (int64_t c = 0; c < count; ++c) {
                        double& here = out[(j * n + a) * count + c];
                        here = fma(entry, right.at[(j * n + b) * count + c], here);
                    }
                }
        return true;
    }
};

template <class Side>
static void advance_member(const RungeKuttaTangentLoop& loop, Single& one, StageChanges& stages,
                           TangentBundle<double, TangentLanes>& bundle, int64_t member) {
    const RungeKuttaTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size, offset = memory_size(tables);
    double* memory = loop.memory_of(member);
    std::copy_n(arrays.momenta + member * n, n, one.x);
    std::copy_n(arrays.errors + member * n, n, one.dx);
    one.iterations = one.evaluations = 0;
    if (offset > 0) one.newton = memory[0], one.read_slopes(memory + 1);
    bundle.begin(memory + offset, loop.k0 == 0);
    AlreadyFinished nothing;
    MemberRecorder<Side, SharedConstants, AlreadyFinished> recorder(loop.watch, arrays, schedule, SharedConstants{},
                                                                    nothing);
    recorder.begin(member, SharedConstants{}, loop.k0);
    std::vector<double> found(slope_memory_size(tables));
    const RungeKuttaLoop plain{tables, loop.watch, schedule, arrays, loop.interrupts, loop.k0, loop.k1};
    const int64_t work = (1 + 4 * bundle.rows) * work_of_step(plain);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.interrupts.after(work);
        const double from = schedule.t0 + double(k - 1) * schedule.h;
        bool converged = true, moved = true;
        for (int64_t part = 0; part < tables.substeps && converged && moved; ++part) {
            const double t = from + tables.moment[part] * schedule.h, h = tables.fraction[part] * schedule.h;
            converged = one.solve(t, h, part);
            if (!converged) break;
            one.write_slopes(found.data());
            moved = stages.move(one.x, t, h, found.data() + tables.substeps, bundle.held());
            one.add();
        }
        if (!converged) {
            loop.fail(member, k, failure_of(one.residual), one.residual);
            break;
        }
        if (!finite(n, one.x)) {
            loop.overflow(member, k);
            break;
        }
        recorder.after(k, one.x, one.dx, [](int64_t, double*) { return true; });
        if (!moved || !bundle.after(k)) {
            loop.fail(member, k, PARALLEL, std::numeric_limits<double>::quiet_NaN());
            break;
        }
    }
    recorder.flush();
    bundle.end(1, [&](int) { return memory + offset; }, [](TangentLanes*) {});
    arrays.iterations[member] += one.iterations;
    arrays.evaluations[member] += one.evaluations;
    std::copy_n(one.x, n, arrays.momenta + member * n);
    std::copy_n(one.dx, n, arrays.errors + member * n);
    if (offset > 0) memory[0] = one.newton, one.write_slopes(memory + 1);
}

static void advance(const RungeKuttaTangentLoop& loop, const MemberRange& range) {
    typedef Lanes<MEMBER_LANES> LaneNumbers;
    const RungeKuttaTables& tables = loop.tables.base;
    TangentBundle<double, TangentLanes> bundle(loop.tables.tangents);
    StageChanges stages(loop.tables, bundle.rows);
    const auto one = single_of(tables, SharedConstants{});
    for (int64_t position = range.first; position < range.last; ++position) {
        const int64_t member = range.members[position];
        if (loop.arrays.status[member] != DONE) continue;
        if (tables.field.size <= WIDEST)
            advance_member<LaneNumbers>(loop, *one, stages, bundle, member);
        else
            advance_member<double>(loop, *one, stages, bundle, member);
    }
}

static int64_t memory_size(const RungeKuttaTangents& tables) {
    return memory_size(tables.base) + memory_size(tables.tangents);
}

EXPORT_LOOP(runge_kutta_tangents_advance, RungeKuttaTangents, advance, memory_size)

}  // namespace coadjoint
