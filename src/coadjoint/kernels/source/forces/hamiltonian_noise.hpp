// Hamiltonian noise: exponentials of linear functions, and midpoint rules of others, each over a random time.
#pragma once

#include <memory>

#include "forces/increments.hpp"
#include "forces/orbit_exponential.hpp"
#include "forces/spin_rows.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

class HamiltonianNoise {
  public:
    OrbitExponential exponential;

    // Of the table: `extent` Brownian motions in `sets`; set s has those with the numbers direction[begin[s]] to
    // direction[begin[s + 1] - 1]. aim[s] is zero for one exponential, a number of midpoint rules, or minus a number of
    // symmetric compositions of exponentials. Behind the sets `begin` has a row for each Brownian motion, whose columns
    // follow the numbers in `direction`, with coefficients in `rate`: of coordinates, or of the functions whose fields
    // are at `function`. Increments are sums of 2^position.
    HamiltonianNoise(const ForceTable& table, const Field& field, const GroupField& group,
                     const MemberConstants& constants)
        : exponential(field, group, constants), has_group(group.size > 0), table(table), n(field.size),
          rows(table.begin + table.sets + 1), columns(table.direction + table.extent), v(n), middle(n), slope(n),
          increments(table, table.position, table.extent, 0) {
        int64_t functions = 0;
        for (int64_t set = 0; set < table.sets; ++set)
            for (int64_t b = table.direction[table.begin[set]], q = rows[b]; table.aim[set] != 0.0 && q < rows[b + 1]; ++q)
                functions = std::max(functions, columns[q] + 1);
        for (int64_t k = 0; k < functions; ++k) {
            fields.push_back(reinterpret_cast<const Field*>(table.function[k]));
            workspaces.emplace_back(new FieldWorkspace<double>(*fields.back()));
        }
        of_spins = spins.find(field, constants);
    }

    // Whether the noise of a step from t of length h acts before it (side 0) or after it (1), by a fair coin.
    bool acts(double t, double h, int64_t member, int64_t side) {
        return increments.of(t, h, member).first == (side == 0);
    }

    // The noise of a step on the side on which it acts: in order before it, and in reversed order after it. A group
    // element moves with the state.
    int64_t flow(double* x, double* element, double t, double h, int64_t member, int64_t side) {
        exponential.iterations = exponential.evaluations = 0;
        exponential.residual = std::numeric_limits<double>::quiet_NaN();
        sums = increments.of(t, h, member).sums.data();
        for (int64_t k = 0; k < table.sets; ++k) {
            const int64_t set = side ? table.sets - 1 - k : k, midpoints = int64_t(table.aim[set]);
            const int64_t first = table.direction[table.begin[set]];
            if (midpoints) {
                const int64_t status = midpoints < 0 ? by_parts(x, element, t, first, -midpoints)
                                                     : by_midpoints(x, element, t, first, midpoints);
                if (status != DONE) return status;
                continue;
            }
            std::fill_n(v.data(), n, 0.0);
            for (int64_t e = table.begin[set]; e < table.begin[set + 1]; ++e) {
                const int64_t b = table.direction[e];
                for (int64_t q = rows[b]; q < rows[b + 1]; ++q) v[columns[q]] += sums[b] * table.rate[q];
            }
            if (of_spins)
                rotate_spins(x);
            else if (!exponential(v.data(), 1.0, x, x))
                return exponential.failed(v.data());
            if (has_group && !exponential.turn(v.data(), element)) return exponential.failed(v.data());
        }
        return DONE;
    }

  private:
    const bool has_group;
    const ForceTable& table;
    const int64_t n;
    Spins spins;
    bool of_spins = false;  // whether the algebra is a sum of so(3), where exponentials are rotations
    const int64_t *rows, *columns;
    std::vector<double> v, middle, slope;
    BrownianIncrements increments;
    const double* sums = nullptr;  // increments of the step
    std::vector<const Field*> fields;
    std::vector<std::unique_ptr<FieldWorkspace<double>>> workspaces;

    // Set x to exp(D_v) x, where D_v x = turn x cross v for each spin: a rotation of x in closed form.
    void rotate_spins(double* x) const {
        for (int64_t s = 0; s < spins.size(); ++s) {
            const int64_t at[3] = {spins.coordinate[0][s], spins.coordinate[1][s], spins.coordinate[2][s]};
            const double w[3] = {spins.turn[s] * v[at[0]], spins.turn[s] * v[at[1]], spins.turn[s] * v[at[2]]};
            const int axes = (w[0] != 0.0) + (w[1] != 0.0) + (w[2] != 0.0);
            if (axes == 0) continue;
            if (axes == 1) {
                const int a = w[0] != 0.0 ? 0 : w[1] != 0.0 ? 1 : 2, b = (a + 1) % 3, c = (a + 2) % 3;
                const Rotation<double> rotation = rotation_by(w[a]);
                const double one = x[at[b]], two = x[at[c]];
                x[at[b]] = one + fma(rotation.cosm1, one, rotation.sine * two);
                x[at[c]] = two + fma(rotation.cosm1, two, -(rotation.sine * one));
                continue;
            }
            const double square = fma(w[0], w[0], fma(w[1], w[1], w[2] * w[2]));
            if (square == 0.0) continue;
            const double angle = std::sqrt(square);
            const Rotation<double> rotation = rotation_by(angle);
            const double first = rotation.sine / angle, second = -(rotation.cosm1 / square);
            double across[3], back[3];
            const double y[3] = {x[at[0]], x[at[1]], x[at[2]]};
            cross(y, w, across);
            cross(across, w, back);
            for (int a = 0; a < 3; ++a) x[at[a]] = y[a] + fma(first, across[a], second * back[a]);
        }
    }

    static void cross(const double* x, const double* w, double* out) {
        for (int a = 0; a < 3; ++a) {
            const int b = (a + 1) % 3, c = (a + 2) % 3;
            out[a] = fma(x[b], w[c], -(x[c] * w[b]));
        }
    }

    static double fraction_of(int64_t k, int64_t count) { return count == 1 ? 1.0 : k == 2 ? 1.0 - 4.0 * OUTER : OUTER; }

    // Functions whose gradients are constant along their flows: these in their order and back, at fractions of the
    // increment.
    int64_t by_parts(double* x, double* element, double t, int64_t b, int64_t count) {
        const int64_t parts = rows[b + 1] - rows[b];
        for (int64_t k = 0; k < count; ++k)
            for (int64_t p = 0; p < 2 * parts - 1; ++p) {
                const int64_t q = rows[b] + (p < parts ? p : 2 * parts - 2 - p);
                const double size = (p == parts - 1 ? 1.0 : 0.5) * fraction_of(k, count) * sums[b] * table.rate[q];
                const Field& field = *fields[columns[q]];
                InterruptCheck::of_this_call().after(work_of(field));
                gradient(field, MemberConstants{1, 0}, x, t, v.data(), *workspaces[columns[q]]);
                for (int64_t i = 0; i < n; ++i) v[i] *= size;
                if (!exponential(v.data(), 1.0, x, x)) return exponential.failed(v.data());
                if (has_group && !exponential.turn(v.data(), element)) return exponential.failed(v.data());
            }
        return DONE;
    }

    // Midpoint rules over fractions of the increment: one, which is exact, or those of Suzuki, of order four.
    int64_t by_midpoints(double* x, double* element, double t, int64_t b, int64_t midpoints) {
        for (int64_t k = 0; k < midpoints; ++k) {
            const double fraction = fraction_of(k, midpoints);
            const int64_t status = exponential.midpoint(x, v.data(), middle.data(), [&](const double* y, double* to) {
                std::fill_n(to, n, 0.0);
                for (int64_t q = rows[b]; q < rows[b + 1]; ++q) {
                    const Field& field = *fields[columns[q]];
                    InterruptCheck::of_this_call().after(work_of(field));
                    gradient(field, MemberConstants{1, 0}, y, t, slope.data(), *workspaces[columns[q]]);
                    for (int64_t i = 0; i < n; ++i) to[i] = fma(table.rate[q], slope[i], to[i]);
                }
                for (int64_t i = 0; i < n; ++i) to[i] *= fraction * sums[b];
            });
            if (status != DONE) return status;
            if (has_group && !exponential.turn(v.data(), element)) return exponential.failed(v.data());
        }
        return DONE;
    }

    static constexpr double OUTER = 0.41449077179437573714;  // 1/(4 - 4^(1/3))
};

}  // namespace coadjoint
