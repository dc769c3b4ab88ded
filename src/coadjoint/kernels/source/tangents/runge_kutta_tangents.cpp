// Entry points of Runge-Kutta methods with tangent vectors for Python: derivatives of their stages.
#include "stages/runge_kutta_loop.hpp"
#include "tangents/bends.hpp"
#include "tangents/bundle.hpp"

namespace coadjoint {

typedef Loop<RungeKuttaTangents> RungeKuttaTangentLoop;

// The derivative of a substep with known slopes: dX_i = v + sum_j mix_ij dL_j, with dL_j = W_j dX_j, W_j = h scale_j
// f'(X_j). If a factor of the slopes is frozen at the iterates Z, dL_j depends on dZ_j as well.
class StageChanges {
  public:
    StageChanges(const RungeKuttaTangents& given, int64_t rows)
        : tables(given.base), field(given.base.field), n(field.size), s(tables.stages), rows(rows),
          fields(field), of_vectors(field, given.tangents, rows), of_units(field, given.tangents, blocks(n)),
          points(s * n), iterates(s * n), slopes(s * n), gradients(s * n), vectors(s * n * rows), changes(s * n * rows),
          units(n * blocks(n)), block(n * blocks(n)), matrix(linear() ? s * n * s * n : 0),
          exchanged(linear() ? s * n : 0), right(linear() ? s * n * rows * lanes : 0) {
        for (int64_t i = 0; i < n; ++i) set_lane(units.at[i * blocks(n) + i / lanes], int(i % lanes), 1.0);
    }

    // Move vectors along a substep from x; `found` are its slopes, stage after stage. False if it has no derivative.
    bool move(const double* x, double t, double h, const double* found, Abreast* v) {
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
            for (int64_t place = 0; place < n * rows; ++place)
                v[place] = fma(Abreast(tables.out[j]), changes.at[j * n * rows + place], v[place]);
        return true;
    }

  private:
    static constexpr int64_t lanes = Numbers<Abreast>::lanes;
    const RungeKuttaTables& tables;
    const Field& field;
    const int64_t n, s, rows;
    FieldRoom<double> fields;
    FieldChanges<Abreast> of_vectors, of_units;
    Room<double> points, iterates, slopes, gradients;
    Room<Abreast> vectors, changes, units, block;
    Room<double> matrix, exchanged, right;
    const double* start = nullptr;
    double time = 0.0, length = 0.0;

    static int64_t blocks(int64_t count) { return (count + lanes - 1) / lanes; }
    bool linear() const { return tables.solver >= IMPLICIT; }
    double time_of(int64_t j) const { return time + tables.node[j] * length; }
    double length_of(int64_t j) const { return length * tables.scale[j]; }
    static void clear(Room<Abreast>& room, int64_t count) { std::fill_n(room.at, count, Abreast(0.0)); }
    void clear(Room<Abreast>& room) const { clear(room, s * n * rows); }

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
    void mix_vectors(int64_t i, const Abreast* v) {
        Abreast* own = vectors.at + i * n * rows;
        std::copy_n(v, n * rows, own);
        for (int64_t j = 0; j < s; ++j)
            if (const double weight = tables.mix[i * s + j])
                for (int64_t place = 0; place < n * rows; ++place)
                    own[place] = fma(Abreast(weight), changes.at[j * n * rows + place], own[place]);
    }
    void spread(const Abreast* v) {
        for (int64_t i = 0; i < s; ++i) std::copy_n(v, n * rows, vectors.at + i * n * rows);
    }

    void set_gradient(int64_t j, const double* at) {
        gradient(field, Shared{}, at + j * n, time_of(j), gradients.at + j * n, fields);
    }

    // out = h scale_j f'(X_j) times vectors, with the gradient of the stage.
    void slope_of_field(int64_t j, const double* at, FieldChanges<Abreast>& changes_of, const Abreast* from,
                        Abreast* out) {
        changes_of.of_gradient(at + j * n, at + j * n, time_of(j), from, length_of(j), out, fields);
        changes_of.of_structure(at + j * n, gradients.at + j * n, from, length_of(j), out);
    }

    void field_changes(const double* at) {
        for (int64_t j = 0; j < s; ++j) {
            set_gradient(j, at);
            slope_of_field(j, at, of_vectors, vectors.at + j * n * rows, changes.at + j * n * rows);
        }
    }

    void explicit_changes(const double* found, const Abreast* v) {
        mix(found, points.at);
        clear(changes);
        for (int64_t j = 0; j < s; ++j) {
            mix_vectors(j, v);
            set_gradient(j, points.at);
            slope_of_field(j, points.at, of_vectors, vectors.at + j * n * rows, changes.at + j * n * rows);
        }
    }

    // The function iterates and their derivatives.
    void iterate(const Abreast* v) {
        for (int64_t j = 0; j < s; ++j) std::copy_n(start, n, iterates.at + j * n);
        spread(v);
        for (int64_t passed = 0; passed < tables.iterations; ++passed) {
            field_changes(iterates.at);
            for (int64_t j = 0; j < s; ++j)
                product(field, Shared{}, iterates.at + j * n, gradients.at + j * n, length_of(j), slopes.at + j * n,
                        fields);
            mix(slopes.at, iterates.at);
            for (int64_t i = 0; i < s; ++i) mix_vectors(i, v);
        }
    }

    // dL_j = W_j dX_j + the effect of the change of the frozen factor, which is computed first.
    bool frozen_changes(const double* found, const Abreast* v) {
        const bool of_structure = tables.solver == STRUCTURE;
        iterate(v);
        mix(found, points.at);
        const double *frozen = iterates.at, *free = points.at;
        for (int64_t j = 0; j < s; ++j) {
            Abreast *own = vectors.at + j * n * rows, *out = changes.at + j * n * rows;
            set_gradient(j, of_structure ? free : frozen);
            if (of_structure) {
                std::fill_n(out, n * rows, Abreast(0.0));
                of_vectors.of_structure(frozen + j * n, gradients.at + j * n, own, length_of(j), out);
            } else {
                of_vectors.of_gradient(free + j * n, frozen + j * n, time_of(j), own, length_of(j), out, fields);
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
        Hearing::of_this_call().after(edge * edge * (edge + count));
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
static void follow_member(const RungeKuttaTangentLoop& loop, Single& one, StageChanges& stages,
                          Bundle<double, Abreast>& bundle,
                          int64_t member) {
    const RungeKuttaTables& tables = loop.tables.base;
    const Schedule& schedule = loop.schedule;
    const Arrays& arrays = loop.arrays;
    const int64_t n = arrays.size, own = remembered_by(tables);
    double* memory = loop.memory_of(member);
    std::copy_n(arrays.momenta + member * n, n, one.x);
    std::copy_n(arrays.errors + member * n, n, one.dx);
    one.iterations = one.evaluations = 0;
    if (own > 0) one.newton = memory[0], one.read_slopes(memory + 1);
    bundle.begin(memory + own, loop.k0 == 0);
    AlreadyFinished nothing;
    MemberRecorder<Side, Shared, AlreadyFinished> recorder(loop.watch, arrays, schedule, Shared{}, nothing);
    recorder.begin(member, Shared{}, loop.k0);
    std::vector<double> found(remembered_slopes(tables));
    const RungeKuttaLoop plain{tables, loop.watch, schedule, arrays, loop.hearing, loop.k0, loop.k1};
    const int64_t work = (1 + 4 * bundle.rows) * work_of_step(plain);
    for (int64_t k = loop.k0 + 1; k <= loop.k1; ++k) {
        loop.hearing.after(work);
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
    bundle.end(1, [&](int) { return memory + own; }, [](Abreast*) {});
    arrays.iterations[member] += one.iterations;
    arrays.evaluations[member] += one.evaluations;
    std::copy_n(one.x, n, arrays.momenta + member * n);
    std::copy_n(one.dx, n, arrays.errors + member * n);
    if (own > 0) memory[0] = one.newton, one.write_slopes(memory + 1);
}

static void follow(const RungeKuttaTangentLoop& loop, const Crew& crew) {
    typedef Lanes<CROWD> Crowd;
    const RungeKuttaTables& tables = loop.tables.base;
    Bundle<double, Abreast> bundle(loop.tables.tangents);
    StageChanges stages(loop.tables, bundle.rows);
    const auto one = single_of(tables, Shared{});
    for (int64_t place = crew.first; place < crew.last; ++place) {
        const int64_t member = crew.members[place];
        if (loop.arrays.status[member] != DONE) continue;
        if (tables.field.size <= WIDEST)
            follow_member<Crowd>(loop, *one, stages, bundle, member);
        else
            follow_member<double>(loop, *one, stages, bundle, member);
    }
}

static int64_t remembered_by(const RungeKuttaTangents& tables) {
    return remembered_by(tables.base) + remembered_by(tables.tangents);
}

EXPORT_LOOP(runge_kutta_tangents_advance, RungeKuttaTangents, follow, remembered_by)

}  // namespace coadjoint
