// Derivatives of the noise of Hamiltonians in a step, by the state and by its coefficients: `HamiltonianNoise` for one member.
#pragma once

#include "forces/hamiltonian_noise.hpp"
#include "tangents/orbit_derivatives.hpp"
#include "tangents/shift_factor.hpp"

namespace coadjoint {

class NoiseDerivative {
  public:
    NoiseDerivative(const ForceTable& force, const Field& field, const GroupField& group, const ForceDerivatives& table)
        : force(force), field(field), group(group), table(table), n(field.size), d(group.size), rows(force.begin + force.sets + 1),
          columns(force.direction + force.extent), of_spins(spins.find(field, MemberConstants{1, 0})),
          increments(force, force.position, force.extent, 0), now(n), v(n), slope(n), of_v(n), first(n), before(n),
          through(n), dv(n), dm(n), row(n), turning(d * d), turned(d * d), product(d * d) {
        int64_t functions = 0, terms = 0;
        for (int64_t set = 0; set < force.sets; ++set)
            for (int64_t b = motion_of(set), q = rows[b]; force.aim[set] != 0.0 && q < rows[b + 1]; ++q)
                functions = std::max(functions, columns[q] + 1);
        for (int64_t k = 0; k < functions; ++k) {
            const Field& own = *reinterpret_cast<const Field*>(force.function[k]);
            energies.emplace_back(new Energy{own, table.hessians + terms, FieldWorkspace<double>(own), HessianWorkspace<double>(own.terms)});
            terms += own.terms.size;
        }
    }

    // Replace vectors at a state before the noise on a side of a step from t of length h by their tangents after it, along
    // directions of the coefficients, which are those of the table, and those of the group element, if there is one; false
    // as of `OrbitDerivative`.
    bool push(const double* x, double t, double h, int64_t member, int64_t side, double* vectors, int64_t count,
              const double* directions, int64_t stride, const double* element, double* of_elements) {
        if (!find(x, t, h, member, side)) return false;
        if (element) find_turns(element);
        for (int64_t r = 0; r < count; ++r) {
            double* const dx = vectors + r * n;
            const double* const along = directions + r * stride;
            for (size_t k = 0; k < used; ++k) {
                Part& part = *parts[k];
                std::fill(first.begin(), first.end(), 0.0);
                const auto add = [&](int64_t q, int64_t i, double factor) { first[i] = fma(factor, along[q], first[i]); };
                if (table.own) each_coefficient_of(part, add);
                if (part.kind == IMPLICIT) {
                    std::fill(dv.begin(), dv.end(), 0.0);
                    const auto change = iterate(dv, before, [&] {
                        std::copy_n(dx, n, dm.data());
                        for (double& entry : dv) entry *= 0.5;
                        part.half.push(dv.data(), dm.data());
                        dv = first;
                        add_hessian(part, t, dm.data(), dv.data());
                        return true;
                    });
                    if (!change) return false;
                } else {
                    dv = first;
                    add_hessian(part, t, dx, dv.data());
                }
                part.whole.push(dv.data(), dx);
                if (!element) continue;
                double* const of_element = of_elements + r * d * d;
                set_generator(dv);
                part.exponential->along(turning.data(), turned.data());
                std::fill(product.begin(), product.end(), 0.0);
                add_matrix_product(d, 1.0, turned.data(), part.element.data(), product.data());
                add_matrix_product(d, 1.0, part.turn, of_element, product.data());
                std::copy_n(product.data(), d * d, of_element);
            }
        }
        return true;
    }

    // Replace the cotangent of the state after the noise by that before, and add those of the coefficients.
    bool pull(const double* x, double t, double h, int64_t member, int64_t side, double* cotangent, double* by_coefficients,
              const double* element, double* of_element) {
        if (!find(x, t, h, member, side)) return false;
        if (element) find_turns(element);
        for (size_t k = used; k-- > 0;) {
            Part& part = *parts[k];
            part.whole.pull(cotangent, of_v.data());
            if (element) pull_turn(part, of_element);
            first = of_v;
            const auto improve = [&] {
                std::fill(through.begin(), through.end(), 0.0);
                add_hessian(part, t, of_v.data(), through.data());
                part.half.pull(through.data(), row.data());
                for (int64_t i = 0; i < n; ++i) of_v[i] = fma(0.5, row[i], first[i]);
                return true;
            };
            if (part.kind == IMPLICIT && !iterate(of_v, before, improve)) return false;
            std::fill(through.begin(), through.end(), 0.0);
            add_hessian(part, t, of_v.data(), through.data());
            if (part.kind == IMPLICIT) part.half.pull(through.data(), row.data());
            for (int64_t i = 0; i < n; ++i) cotangent[i] += through[i];
            const auto add = [&](int64_t q, int64_t i, double factor) {
                by_coefficients[q] = fma(factor, of_v[i], by_coefficients[q]);
            };
            if (table.own) each_coefficient_of(part, add);
        }
        return true;
    }

  private:
    // One exponential of linear functions that commute; of a function whose gradient is constant along its flow; or the
    // midpoint rule of a sum of functions.
    enum Kind { LINEAR, EXPLICIT, IMPLICIT };
    struct Part {
        Kind kind;
        int64_t begin, end;  // the motions in a set, or the rows of a sum
        double size;
        Exponential whole, half;
        std::vector<double> at;  // where the gradients are taken
        std::vector<double> element;  // that of the group before it, which is multiplied by `turn`
        std::unique_ptr<MatrixExponential> exponential;
        const double* turn = nullptr;
        Part(const Field& field, const Spins* spins) : whole(field, spins), half(field, spins) {}
    };
    struct Energy {
        const Field& field;
        const int64_t* hessians;
        FieldWorkspace<double> workspace;
        HessianWorkspace<double> seconds;
    };
    const ForceTable& force;
    const Field& field;
    const GroupField& group;
    const ForceDerivatives& table;
    const int64_t n, d;
    const int64_t *rows, *columns;
    Spins spins;
    const bool of_spins;
    BrownianIncrements increments;
    const double* sums = nullptr;
    std::vector<std::unique_ptr<Energy>> energies;
    std::vector<std::unique_ptr<Part>> parts;
    size_t used = 0;
    std::vector<double> now, v, slope, of_v, first, before, through, dv, dm, row, turning, turned, product;

    int64_t motion_of(int64_t set) const { return force.direction[force.begin[set]]; }

    bool find(const double* x, double t, double h, int64_t member, int64_t side) {
        sums = increments.of(t, h, member).sums.data();
        used = 0;
        std::copy_n(x, n, now.data());
        for (int64_t k = 0; k < force.sets; ++k) {
            const int64_t set = side ? force.sets - 1 - k : k, flows = int64_t(force.aim[set]), b = motion_of(set);
            const int64_t count = rows[b + 1] - rows[b];
            if (!flows && !move(LINEAR, force.begin[set], force.begin[set + 1], 1.0)) return false;
            for (int64_t k = 0; k < std::abs(flows); ++k) {
                const double size = fraction_of(k, std::abs(flows)) * sums[b];
                if (flows > 0 && !move(IMPLICIT, rows[b], rows[b + 1], size)) return false;
                for (int64_t p = 0; flows < 0 && p < 2 * count - 1; ++p) {
                    const int64_t q = rows[b] + (p < count ? p : 2 * count - 2 - p);
                    if (!move(EXPLICIT, q, q + 1, (p == count - 1 ? 1.0 : 0.5) * size)) return false;
                }
            }
        }
        return true;
    }

    // Set `turning` to the generator of a direction.
    void set_generator(const std::vector<double>& direction) {
        std::fill(turning.begin(), turning.end(), 0.0);
        for (int64_t q = 0; q < group.entries; ++q) {
            double& entry = turning[int64_t(group.column[q]) * d + group.row[q]];
            entry = fma(group.value[q], direction[group.element[q]], entry);
        }
    }

    // The exponentials of the parts by which the element moves.
    void find_turns(const double* element) {
        turned.assign(element, element + d * d);
        for (size_t k = 0; k < used; ++k) {
            Part& part = *parts[k];
            if (!part.exponential) part.exponential.reset(new MatrixExponential(d));
            set_generator(part.whole.v);
            part.turn = part.exponential->of(1.0, turning.data());
            part.element = turned;
            std::fill(turned.begin(), turned.end(), 0.0);
            add_matrix_product(d, 1.0, part.turn, part.element.data(), turned.data());
        }
    }

    // Replace the cotangent of the element after a part by that before; add that of the direction.
    void pull_turn(const Part& part, double* of_element) {
        transpose_matrix(d, part.element.data(), turned.data());
        std::fill(product.begin(), product.end(), 0.0);
        add_matrix_product(d, 1.0, of_element, turned.data(), product.data());
        part.exponential->pull(product.data(), turning.data());
        for (int64_t q = 0; q < group.entries; ++q) {
            double& to = of_v[group.element[q]];
            to = fma(group.value[q], turning[int64_t(group.column[q]) * d + group.row[q]], to);
        }
        transpose_matrix(d, part.turn, turned.data());
        std::fill(product.begin(), product.end(), 0.0);
        add_matrix_product(d, 1.0, turned.data(), of_element, product.data());
        std::copy_n(product.data(), d * d, of_element);
    }

    bool move(Kind kind, int64_t begin, int64_t end, double size) {
        if (used == parts.size()) parts.emplace_back(new Part(field, of_spins ? &spins : nullptr));
        Part& part = *parts[used++];
        part.kind = kind, part.begin = begin, part.end = end, part.size = size, part.at = now;
        const auto improve = [&] {
            find_direction(part);
            if (!part.half.of(v.data(), 0.5, now.data())) return false;
            part.at = part.half.end;
            return true;
        };
        if (kind != IMPLICIT)
            find_direction(part);
        else if (!iterate(part.at, before, improve))
            return false;
        if (!part.whole.of(v.data(), 1.0, now.data())) return false;
        now = part.whole.end;
        return true;
    }

    void find_direction(const Part& part) {
        std::fill(v.begin(), v.end(), 0.0);
        each_coefficient_of(part, [&](int64_t q, int64_t i, double factor) { v[i] = fma(force.rate[q], factor, v[i]); });
    }

    // Visit the derivatives of the direction by the coefficients of a part.
    template <class Visit>
    void each_coefficient_of(const Part& part, const Visit& visit) {
        for (int64_t e = part.begin; e < part.end; ++e) {
            if (part.kind == LINEAR) {
                const int64_t b = force.direction[e];
                for (int64_t q = rows[b]; q < rows[b + 1]; ++q) visit(q, columns[q], sums[b]);
                continue;
            }
            Energy& energy = *energies[columns[e]];
            InterruptCheck::of_this_call().after(work_of(energy.field));
            gradient(energy.field, MemberConstants{1, 0}, part.at.data(), 0.0, slope.data(), energy.workspace);
            for (int64_t i = 0; i < n; ++i) visit(e, i, part.size * slope[i]);
        }
    }

    // out += the derivative of the direction by where the gradients are taken, times y; it is symmetric.
    void add_hessian(const Part& part, double t, const double* y, double* out) {
        for (int64_t q = part.begin; part.kind != LINEAR && q < part.end; ++q) {
            Energy& energy = *energies[columns[q]];
            const Terms& terms = energy.field.terms;
            const double size = part.size * force.rate[q];
            InterruptCheck::of_this_call().after(work_of(energy.field));
            for (int64_t k = 0; k < terms.size; ++k)
                each_second_derivative(terms, SharedConstants{}, energy.hessians, k, part.at.data(), t, energy.seconds, false,
                                       [&](int64_t place, uint32_t coordinate, double number, const auto& product) {
                                           double& to = out[terms.target[place]];
                                           to = fma(size * product(number), y[coordinate], to);
                                       });
        }
    }
};

}  // namespace coadjoint
