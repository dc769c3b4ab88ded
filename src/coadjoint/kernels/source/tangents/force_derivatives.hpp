// Derivatives of the flows of forces by the state, and by the coefficients on which they depend.
#pragma once

#include <map>

#include "tangents/decay_derivatives.hpp"
#include "tangents/law_derivatives.hpp"
#include "tangents/matrix_orbit_derivatives.hpp"
#include "tangents/noise_derivatives.hpp"
#include "tangents/orbit_derivatives.hpp"
#include "tangents/shift_factor.hpp"

namespace coadjoint {

// The flow of a force: when it begins, how long, which one, on which side of which substep, by which of the inner loops.
struct FlowTime {
    double t, tau;
    int64_t flow, side, loop, member, substep;

    int64_t place() const { return 2 * substep + side; }
};

// The flow `flow` of the member from the state x, called in Python: with `count` vectors, which become their tangents with
// the changes by directions (count, called) of the coefficients; with none, the cotangent `vectors`, which is pulled back,
// and the cotangents of the coefficients, which are added to `directions`. A negative flow, -1 - flow, is differentiated by
// the state too. A negative count, -1 - k, asks for the derivative by the coefficient k, in place of the vectors. Zero
// unless it raised an exception.
typedef int64_t (*DerivativeInPython)(int64_t flow, int64_t side, int64_t member, double t, double tau, const double* x,
                                      int64_t count, double* vectors, double* directions);

struct NotDifferentiated {};  // thrown if a derivative is not found

class ForceDerivative {
  public:
    ForceDerivative(const ForceDerivatives& table, Force& flow, const StepTables& tables, const ForcedDerivatives& all)
        : table(table), plain(flow), force(flow.table), all(all), n(tables.field.size), moved(n), sum(n), beside(2 * n),
          unit(n), direction(n), square(tables.group.size * tables.group.size), turned(square), turned_by(square) {
        if (force.kind == DAMPING && table.kind == derivatives::AFFINE && force.shape == FULL)
            exponential.reset(new MatrixExponential(n));
        if (table.kind == derivatives::ALONG && !table.along) law.reset(new LawDerivative(flow, table, n));
        if (table.kind == derivatives::ALONG && table.along)
            along.reset(new Force(*reinterpret_cast<const ForceTable*>(table.along), tables.field, tables.group, SHARED, 2 * n));
        if (table.kind == derivatives::ON_ORBIT && force.kind == HAMILTONIAN_NOISE)
            noise.reset(new NoiseDerivative(force, tables.field, tables.group, table));
        else if (table.kind == derivatives::ON_ORBIT && force.kind == SELECTIVE_DECAY)
            decay.reset(new DecayDerivative(force, tables.field, table));
        else if (table.kind == derivatives::ON_ORBIT && (force.kind == ON_MATRIX_ORBIT || is_matrix_noise()))
            on_matrices = matrix_orbit_derivative(force, table);
        else if (table.kind == derivatives::ON_ORBIT)
            orbit.reset(new OrbitDerivative(force, tables.field, table));
        if (force.kind == MODE_RATES && !force.function[1]) modes.reset(new ModeForce(force));
        if (force.kind == KICKS || is_noisy()) drawn.resize(std::max(n, force.extent));
        // The streams of a decay and of a damping of matrices are differentiated.
        by_nodes = force.kind == ON_MATRIX_ORBIT || (decay && force.extent) ? 0 : table.moved;
        for (int64_t k = 0; k < NODES * by_nodes; ++k)
            nearby.emplace_back(new Force(*reinterpret_cast<const ForceTable*>(table.nearby[k]), tables.field, tables.group, SHARED));
        slopes.resize(modes ? table.moved : 0);
    }

    // Replace vectors (count, n) at a state, which the flow moves to `end`, by their tangents after it, along directions
    // (count, all coefficients). Its midpoint is given if it has one. A flow around a step also moves the `element` of the
    // group, and so its tangents (count, d, d).
    void push(const FlowTime& at, const double* x, const double* end, const double* middle, double* vectors, int64_t count,
              const double* directions, const double* element = nullptr, double* of_elements = nullptr) {
        const double* const own = directions + table.first;
        images.resize(count * n);
        const auto vector_of = [&](int64_t v) { return vectors + v * n; };
        const bool whole = is_in_python(at, x, end, count, vector_of, [&](int64_t v, const double* image) {
            std::copy_n(image, n, images.data() + v * n);
        });
        if (table.kind == derivatives::AFFINE) push_affine(at, x, vectors, count, own);
        if (along && !whole) std::copy_n(images.data(), count * n, vectors);
        if (law) law->push(x, at.t, at.tau, vectors, count, own, all.coefficients);
        if (orbit && !orbit->push(x, end, middle, at.t, at.tau, at.member, vectors, count, own, all.coefficients))
            throw NotDifferentiated();
        if (noise && !noise->push(x, at.t, at.tau, at.member, at.side, vectors, count, own, all.coefficients, element, of_elements))
            throw NotDifferentiated();
        if (decay && !decay->push(x, end, at.t, at.tau, vectors, count, own, all.coefficients)) throw NotDifferentiated();
        if (on_matrices && !on_matrices->push(x, end, at.t, at.tau, at.member, at.place(), vectors, count, own, all.coefficients))
            throw NotDifferentiated();
        if (whole || table.depends) {
            called.resize(count * all.called);
            for (int64_t v = 0; v < count; ++v)
                std::copy_n(directions + v * all.coefficients + all.inner_coefficients, all.called,
                            called.data() + v * all.called);
            call(at, whole, x, count, vectors, called.data());
        }
        for (int64_t k = 0; k < by_nodes; ++k) {
            const double* along = own + table.own + k;
            bool directed = false;
            for (int64_t v = 0; v < count; ++v) directed = directed || along[v * all.coefficients] != 0.0;
            if (!directed) continue;
            difference(at, x, end, k, element);
            for (int64_t v = 0; v < count; ++v) {
                const double by = along[v * all.coefficients];
                for (int64_t i = 0; i < n; ++i) vectors[v * n + i] = fma(by, sum[i], vectors[v * n + i]);
                for (int64_t e = 0; element && e < square; ++e)
                    of_elements[v * square + e] = fma(by, turned_by[e], of_elements[v * square + e]);
            }
        }
    }

    // Replace the cotangent of the `end` after the flow by that of the state x before; add those of the coefficients.
    void pull(const FlowTime& at, const double* x, const double* end, const double* middle, double* row,
              double* by_coefficients, const double* element = nullptr, double* of_element = nullptr) {
        double* const own = by_coefficients + table.first;
        images.resize(n);
        const auto vector_of = [&](int64_t v) {
            std::fill(unit.begin(), unit.end(), 0.0);
            unit[v] = 1.0;
            return unit.data();
        };
        const bool whole = is_in_python(at, x, end, n, vector_of, [&](int64_t v, const double* image) {
            images[v] = 0.0;
            for (int64_t i = 0; i < n; ++i) images[v] = fma(image[i], row[i], images[v]);
        });
        for (int64_t k = 0; k < by_nodes; ++k) {
            difference(at, x, end, k, element);
            double& to = own[table.own + k];
            for (int64_t i = 0; i < n; ++i) to = fma(sum[i], row[i], to);
            for (int64_t e = 0; element && e < square; ++e) to = fma(turned_by[e], of_element[e], to);
        }
        if (whole || table.depends) call(at, whole, x, 0, row, by_coefficients + all.inner_coefficients);
        if (table.kind == derivatives::AFFINE) pull_affine(at, x, row, own);
        if (along && !whole) std::copy_n(images.data(), n, row);
        if (law) law->pull(x, at.t, at.tau, row, own);
        if (orbit && !orbit->pull(x, end, middle, at.t, at.tau, at.member, row, own)) throw NotDifferentiated();
        if (noise && !noise->pull(x, at.t, at.tau, at.member, at.side, row, own, element, of_element))
            throw NotDifferentiated();
        if (decay && !decay->pull(x, end, at.t, at.tau, row, own)) throw NotDifferentiated();
        if (on_matrices && !on_matrices->pull(x, end, at.t, at.tau, at.member, at.place(), row, own)) throw NotDifferentiated();
    }

  private:
    static constexpr MemberConstants SHARED{1, 0};
    // Weights of the value at zero that belongs to a difference.
    static constexpr double AT_ZERO[] = {4.0 / 5.0, -2.0 / 5.0, 4.0 / 35.0, -1.0 / 70.0};
    static constexpr double SMOOTH = 0x1p-23, ROUNDING = 0x1p-49;  // part of the change and of the state by which it is off
    static constexpr double AGREEMENT = 0x1p-20;  // of tangents and differences, as for flows in Python
    static constexpr double ONE_SIDED = 0x1p-26;  // about the square root of the unit round-off: the best accuracy
    const ForceDerivatives& table;
    Force& plain;
    const ForceTable& force;
    const ForcedDerivatives& all;
    const int64_t n;
    const double* growth = nullptr;
    double grown_for = std::numeric_limits<double>::quiet_NaN();  // the duration of `grown`
    std::unique_ptr<MatrixExponential> exponential;
    std::unique_ptr<Force> along;
    std::unique_ptr<OrbitDerivative> orbit;
    std::unique_ptr<NoiseDerivative> noise;
    std::unique_ptr<DecayDerivative> decay;
    std::unique_ptr<MatrixOrbitDerivative> on_matrices;
    std::unique_ptr<LawDerivative> law;
    std::unique_ptr<ModeForce> modes;  // of rates
    int64_t by_nodes = 0;  // moved parameters of which flows at nodes are taken
    std::vector<std::unique_ptr<Force>> nearby;
    // The derivative by a moved parameter of the flow of modes in a time: of each mode, if some change, and of the state
    // zero.
    struct ModeSlope {
        bool known = false;
        std::vector<Complex> factors;
        std::vector<double> constant;
    };
    std::vector<std::map<double, ModeSlope>> slopes;
    std::vector<double> moved, sum, beside, called, grown, changes, scaled, images, unit, direction, tangent, drawn;
    const int64_t square;  // numbers of the element of the group, its value at a node, and its derivative
    std::vector<double> turned, turned_by;

    // Set `growth` to E of x -> x + E (x - aim) + b.
    void find_growth(const FlowTime& at) {
        if (force.kind != DAMPING) {
            growth = table.matrix + at.loop * entries_of(table.shape);
            return;
        }
        if (at.tau == grown_for) return;
        grown_for = at.tau;
        const int64_t count = entries_of(force.shape);
        grown.resize(count);
        if (!exponential)
            for (int64_t i = 0; i < count; ++i) grown[i] = growth_by(-at.tau * force.rate[i]).expm1;
        else {
            std::copy_n(exponential->of(-at.tau, force.rate), count, grown.data());
            for (int64_t i = 0; i < n; ++i) grown[i * (n + 1)] -= 1.0;
        }
        growth = grown.data();
    }

    int64_t entries_of(int64_t shape) const { return shape == FULL ? n * n : shape == DIAGONAL ? n : 1; }
    int64_t shape() const { return force.kind == DAMPING ? force.shape : table.shape; }

    // to += factor matrix from
    void apply(const double* matrix, const double* from, double* to, double factor = 1.0) const {
        for (int64_t i = 0; i < n; ++i)
            if (shape() == FULL)
                for (int64_t j = 0; j < n; ++j) to[i] = fma(factor * matrix[i * n + j], from[j], to[i]);
            else
                to[i] = fma(factor * matrix[shape() == DIAGONAL ? i : 0], from[i], to[i]);
    }

    bool is_matrix_noise() const { return force.kind == MATRIX_NOISE || force.kind == MODE_TRANSPORT; }
    bool is_noisy() const { return force.kind == DAMPING && force.amplitude[0] > 0.0; }

    // The deviates of a flow, with which `Force` moves the state.
    void draw(const FlowTime& at) {
        const DeviateStream stream(uint64_t(force.seed), uint64_t(force.stream + at.member), at.t, 0);
        force.kind == KICKS ? stream.draw(0, force.extent, drawn.data()) : stream.fill(n, drawn.data());
    }

    // The coefficients of a damping are its rates, its aim, and those of the root of the covariance of its noise; those of a
    // constant torque its components, and those of kicks their factors.
    void push_affine(const FlowTime& at, const double* x, double* vectors, int64_t count, const double* directions) {
        if (force.kind == KICKS) return push_kicks(at, x, vectors, count, directions);
        for (int64_t v = 0; modes && v < count; ++v) modes->carry(vectors + v * n, at.tau, false);
        if (modes) return;
        find_growth(at);
        if (table.own && is_noisy()) draw(at);
        for (int64_t v = 0; v < count; ++v) {
            double* const vector = vectors + v * n;
            const double* along = directions + v * all.coefficients;
            std::copy_n(vector, n, moved.data());
            apply(growth, moved.data(), vector);
            if (!table.own) continue;
            if (force.kind == DAMPING) {
                push_rates(at, x, along, vector);
                along += entries_of(force.shape);
                apply(growth, along, vector, -1.0);
                if (is_noisy())
                    each_deviate(at, [&](int64_t i, int64_t e, double by_root, double by_rate) {
                        vector[i] += by_root * along[n + e] + by_rate * along[i - entries_of(force.shape)];
                    });
            } else {
                for (int64_t i = 0; i < n; ++i) vector[i] = fma(at.tau, along[i], vector[i]);
            }
        }
    }

    // Visit the derivatives of the noise of a damping in coordinate i by an entry e of the root, and through it by the rate.
    template <class Visit>
    void each_deviate(const FlowTime& at, const Visit& visit) const {
        for (int64_t i = 0; i < n; ++i) {
            const double decayed = -growth_by(-2.0 * at.tau * force.rate[i]).expm1, spread = std::sqrt(decayed);
            const double by_rate = spread > 0.0 ? at.tau * (1.0 - decayed) / spread : 0.0;
            for (int64_t e = force.begin[i]; e < force.begin[i + 1]; ++e) {
                const double deviate = drawn[force.direction[e]];
                visit(i, e, spread * deviate, by_rate * force.basis[e] * deviate);
            }
        }
    }

    // Visit the kicks: the coordinate that each changes, the one that multiplies it or -1, its number, and its size.
    template <class Visit>
    void each_kick(const FlowTime& at, const Visit& visit) {
        draw(at);
        const double size = std::sqrt(at.tau);
        for (int64_t e = 0; e < force.sets; ++e) {
            const int64_t* const to = force.direction + 3 * e;
            visit(to[0], to[1], e, size * drawn[to[2]]);
        }
    }

    void push_kicks(const FlowTime& at, const double* x, double* vectors, int64_t count, const double* directions) {
        for (int64_t v = 0; v < count; ++v) {
            double* const vector = vectors + v * n;
            const double* const along = directions + v * all.coefficients;
            std::copy_n(vector, n, moved.data());
            each_kick(at, [&](int64_t i, int64_t j, int64_t e, double size) {
                if (j >= 0) vector[i] = fma(force.rate[e] * size, moved[j], vector[i]);
                if (table.own) vector[i] = fma((j < 0 ? 1.0 : x[j]) * size, along[e], vector[i]);
            });
        }
    }

    void pull_kicks(const FlowTime& at, const double* x, double* row, double* by_coefficients) {
        std::copy_n(row, n, moved.data());
        each_kick(at, [&](int64_t i, int64_t j, int64_t e, double size) {
            if (j >= 0) row[j] = fma(force.rate[e] * size, moved[i], row[j]);
            if (table.own) by_coefficients[e] = fma((j < 0 ? 1.0 : x[j]) * size, moved[i], by_coefficients[e]);
        });
    }

    void push_rates(const FlowTime& at, const double* x, const double* along, double* vector) {
        const int64_t count = entries_of(force.shape);
        if (std::all_of(along, along + count, [](double entry) { return entry == 0.0; })) return;
        changes.resize(count), scaled.resize(count);
        for (int64_t i = 0; i < n; ++i) moved[i] = x[i] - force.aim[i];
        for (int64_t i = 0; i < count; ++i) scaled[i] = -at.tau * along[i];
        if (exponential) exponential->along(scaled.data(), changes.data());
        else
            for (int64_t i = 0; i < count; ++i) changes[i] = scaled[i] * (1.0 + growth[i]);
        apply(changes.data(), moved.data(), vector);
    }

    void pull_affine(const FlowTime& at, const double* x, double* row, double* by_coefficients) {
        if (force.kind == KICKS) return pull_kicks(at, x, row, by_coefficients);
        if (modes) {
            // The cotangent of the algebra, whose modes have opposite diagonals in common.
            const int64_t rows = force.extent, square = rows * rows;
            std::copy_n(row, n, moved.data());
            for (int64_t first = 0; first < n; first += 2 * square)
                skew_part(rows, reinterpret_cast<const Complex*>(moved.data() + first), 0.5,
                          reinterpret_cast<Complex*>(row + first), false);
            return modes->carry(row, at.tau, true);
        }
        find_growth(at);
        if (table.own && force.kind == DAMPING) pull_damping(at, x, row, by_coefficients);
        if (table.own && force.kind != DAMPING)
            for (int64_t i = 0; i < n; ++i) by_coefficients[i] = fma(at.tau, row[i], by_coefficients[i]);
        std::copy_n(row, n, moved.data());
        add_transposed(moved.data(), row);
    }

    void pull_damping(const FlowTime& at, const double* x, const double* row, double* by_coefficients) {
        const int64_t count = entries_of(force.shape);
        changes.assign(count, 0.0), scaled.resize(count);
        for (int64_t i = 0; i < n; ++i) {
            moved[i] = x[i] - force.aim[i];
            if (force.shape != FULL) changes[force.shape == DIAGONAL ? i : 0] += row[i] * moved[i];
        }
        for (int64_t i = 0; exponential && i < n; ++i)
            for (int64_t j = 0; j < n; ++j) changes[i * n + j] = row[i] * moved[j];
        if (exponential) exponential->pull(changes.data(), scaled.data());
        else
            for (int64_t i = 0; i < count; ++i) scaled[i] = changes[i] * (1.0 + growth[i]);
        for (int64_t i = 0; i < count; ++i) by_coefficients[i] = fma(-at.tau, scaled[i], by_coefficients[i]);
        std::fill(sum.begin(), sum.end(), 0.0);
        add_transposed(row, sum.data());
        for (int64_t i = 0; i < n; ++i) by_coefficients[count + i] -= sum[i];
        if (!is_noisy()) return;
        draw(at);
        each_deviate(at, [&](int64_t i, int64_t e, double by_root, double by_rate) {
            by_coefficients[count + n + e] += by_root * row[i];
            by_coefficients[i] += by_rate * row[i];
        });
    }

    // to += E^T from
    void add_transposed(const double* from, double* to) const {
        for (int64_t i = 0; i < n; ++i)
            if (shape() == FULL)
                for (int64_t j = 0; j < n; ++j) to[j] = fma(growth[i * n + j], from[i], to[j]);
            else
                to[i] = fma(growth[shape() == DIAGONAL ? i : 0], from[i], to[i]);
    }

    // Return the tangent of a vector.
    const double* image_of(const FlowTime& at, const double* x, const double* vector) {
        beside.assign(x, x + n);
        beside.insert(beside.end(), vector, vector + n);
        if (along->flow(beside.data(), nullptr, at.t, at.tau, at.member, at.side) != DONE) throw NotDifferentiated();
        return beside.data() + n;
    }

    // Set `sum` to the derivative of the flow by the moved parameter k, of order eight, unless the value at zero that belongs
    // to it is not that of the flow, so that nearer ones are taken in Python; and `turned_by` to that of the element.
    void difference(const FlowTime& at, const double* x, const double* end, int64_t k, const double* element) {
        if (modes) {
            const ModeSlope& slope = slope_of(at, k);
            if (slope.known) {
                sum = slope.constant;
                if (!slope.factors.empty()) modes->add(slope.factors, x, sum.data());
                return;
            }
        }
        std::fill(sum.begin(), sum.end(), 0.0);
        std::fill(turned_by.begin(), turned_by.end(), 0.0);
        beside.assign(n, 0.0);
        for (int64_t node = 0; node < NODES; ++node) {
            if (element) turned.assign(element, element + square);
            move(*nearby[k * NODES + node], at, x, moved, element ? turned.data() : nullptr);
            const double weight = difference_weight(node);
            for (int64_t e = 0; element && e < square; ++e) turned_by[e] = fma(weight, turned[e], turned_by[e]);
            for (int64_t i = 0; i < n; ++i) {
                sum[i] = fma(weight, moved[i], sum[i]);
                beside[i] = fma(AT_ZERO[node / 2], moved[i], beside[i]);
            }
        }
        double off = 0.0, change = 0.0, size = 0.0;
        for (int64_t i = 0; i < n; ++i) {
            off = larger(off, absolute(beside[i] - end[i]));
            change = larger(change, absolute(sum[i]));
            size = larger(size, absolute(end[i]));
        }
        if (off <= SMOOTH * change + ROUNDING * size) {
            for (int64_t i = 0; i < n; ++i) sum[i] /= table.distance[k];
            for (double& entry : turned_by) entry /= table.distance[k];
            return;
        }
        if (element) throw NotDifferentiated();
        call(at, false, x, -1 - table.numbered[k], sum.data(), nullptr);
    }

    // The derivative of the flow of modes by the moved parameter k; not known where it is not smooth.
    const ModeSlope& slope_of(const FlowTime& at, int64_t k) {
        const auto known = slopes[k].find(at.tau);
        if (known != slopes[k].end()) return known->second;
        ModeSlope& slope = slopes[k][at.tau];
        const std::vector<Complex> own = modes->factors(at.tau);
        std::vector<Complex> change(own.size()), middle(own.size());
        std::vector<double> constant(n), zero(n);
        for (int64_t node = 0; node < NODES; ++node) {
            Force& flow = *nearby[k * NODES + node];
            if (!modes->has_modes_of(flow.table)) return slope;
            const std::vector<Complex> there = ModeForce(flow.table).factors(at.tau);
            const double weight = difference_weight(node);
            move(flow, at, zero.data(), moved);
            for (int64_t i = 0; i < n; ++i) constant[i] += weight / table.distance[k] * moved[i];
            for (size_t e = 0; e < own.size(); ++e) {
                change[e] += weight * there[e];
                middle[e] += AT_ZERO[node / 2] * there[e];
            }
        }
        double off = 0.0, most = 0.0, size = 0.0;
        for (size_t e = 0; e < own.size(); ++e) {
            off = larger(off, std::abs(middle[e] - own[e]));
            most = larger(most, std::abs(change[e]));
            size = larger(size, std::abs(own[e]));
            change[e] /= table.distance[k];
        }
        if (most == 0.0) change.clear();
        if (off <= SMOOTH * most + ROUNDING * size) slope = {true, std::move(change), std::move(constant)};
        return slope;
    }

    void move(Force& flow, const FlowTime& at, const double* x, std::vector<double>& to, double* element = nullptr) {
        to.assign(x, x + n);
        if (flow.flow(to.data(), element, at.t, at.tau, at.member, at.side) != DONE) throw NotDifferentiated();
    }

    // Different ones, so that errors do not cancel.
    static double weight_of(int64_t k) { return 0.5 + double(7 * k % 11) / 11.0; }

    // Whether the function in Python differentiates the flow by the state. Otherwise, of functions, take(v, image) has got
    // the tangents of `count` vectors, by complex steps. A sum of them is compared with a difference in its direction, which
    // it agrees with where the function is analytic.
    template <class VectorOf, class Take>
    bool is_in_python(const FlowTime& at, const double* x, const double* end, int64_t count, const VectorOf& vector_of,
                      const Take& take) {
        if (!along) return table.kind == derivatives::IN_PYTHON;
        direction.assign(n, 0.0), tangent.assign(n, 0.0);
        for (int64_t v = 0; v < count; ++v) {
            const double *const vector = vector_of(v), *const image = image_of(at, x, vector);
            take(v, image);
            const double size = size_of(vector);
            if (!(size > 0.0)) continue;
            const double weight = weight_of(v) / size;
            for (int64_t i = 0; i < n; ++i) {
                direction[i] = fma(weight, vector[i], direction[i]);
                tangent[i] = fma(weight, image[i], tangent[i]);
            }
        }
        const double length = size_of(direction.data());
        if (!(length > 0.0)) return false;
        for (int64_t i = 0; i < n; ++i) direction[i] /= length, tangent[i] /= length;
        // Behind the state, since complex numbers are compared as if it were moved along the vector: a kink at the state is
        // found. A difference on both sides is more accurate where the function is strongly curved.
        const double size = size_of(x), unit = size > 0.0 ? size : 1.0;
        std::vector<double>& behind = moved;
        move_by(-ONE_SIDED * unit, at, x, behind);
        if (agree(end, behind.data(), ONE_SIDED * unit)) return false;
        move_by(DIFFERENCE * unit, at, x, sum);
        move_by(-DIFFERENCE * unit, at, x, behind);
        return !agree(sum.data(), behind.data(), 2.0 * DIFFERENCE * unit);
    }

    void move_by(double length, const FlowTime& at, const double* x, std::vector<double>& to) {
        beside.assign(x, x + n);
        for (int64_t i = 0; i < n; ++i) beside[i] = fma(length, direction[i], x[i]);
        move(plain, at, beside.data(), to);
    }

    bool agree(const double* end, const double* begin, double length) const {
        for (int64_t i = 0; i < n; ++i) {
            const double difference = (end[i] - begin[i]) / length;
            if (!(absolute(tangent[i] - difference) <= AGREEMENT * (1.0 + absolute(tangent[i])))) return false;
        }
        return true;
    }

    double size_of(const double* vector) const {
        double size = 0.0;
        for (int64_t i = 0; i < n; ++i) size = larger(size, absolute(vector[i]));
        return size;
    }

    void call(const FlowTime& at, bool whole, const double* x, int64_t count, double* vectors, double* directions) const {
        InterruptCheck::of_this_call().after(WORK_OF_A_CALL);
        const auto function = reinterpret_cast<DerivativeInPython>(table.function);
        if (function(whole ? -1 - at.flow : at.flow, at.side, at.member, at.t, at.tau, x, count, vectors, directions)) throw NotDifferentiated();
    }
};

}  // namespace coadjoint
