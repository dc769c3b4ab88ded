// Hamiltonian noise: exponentials of linear functions, and midpoint rules of others, each over a random time.
#pragma once

#include <memory>

#include "forces/orbit_exponential.hpp"
#include "forces/random.hpp"

namespace coadjoint {

class HamiltonianNoise {
  public:
    OrbitExponential exponential;

    // Of the table: `extent` Brownian motions in `sets`; set s has those with the numbers direction[begin[s]] to
    // direction[begin[s + 1] - 1], and aim[s] midpoint rules, or one exponential if that is zero. Behind the sets `begin`
    // has a row for each Brownian motion, whose columns follow the numbers in `direction`, with coefficients in `rate`:
    // of coordinates, or of the functions whose fields are at `function`. Increments are sums of 2^position.
    HamiltonianNoise(const ForceTable& table, const Field& field, const MemberConstants& constants)
        : exponential(field, constants), table(table), n(field.size), rows(table.begin + table.sets + 1),
          columns(table.direction + table.extent), v(n), middle(n), slope(n), drawn(table.extent + 1),
          sums(table.extent) {
        int64_t functions = 0;
        for (int64_t set = 0; set < table.sets; ++set)
            for (int64_t b = table.direction[table.begin[set]], q = rows[b]; table.aim[set] != 0.0 && q < rows[b + 1]; ++q)
                functions = std::max(functions, columns[q] + 1);
        for (int64_t k = 0; k < functions; ++k) {
            fields.push_back(reinterpret_cast<const Field*>(table.function[k]));
            workspaces.emplace_back(new FieldWorkspace<double>(*fields.back()));
        }
    }

    // The noise of a step from t of length h on one side of it, before (0) or after (1): all of it in order or in
    // reversed order, or none, by a fair coin.
    int64_t flow(double* x, double t, double h, int64_t member, int64_t side) {
        exponential.iterations = exponential.evaluations = 0;
        exponential.residual = std::numeric_limits<double>::quiet_NaN();
        if (!(draw(t, h, member) == (side == 0))) return DONE;
        for (int64_t k = 0; k < table.sets; ++k) {
            const int64_t set = side ? table.sets - 1 - k : k, midpoints = int64_t(table.aim[set]);
            const int64_t first = table.direction[table.begin[set]];
            if (midpoints) {
                if (const int64_t status = by_midpoints(x, t, first, midpoints)) return status;
                continue;
            }
            std::fill_n(v.data(), n, 0.0);
            for (int64_t e = table.begin[set]; e < table.begin[set + 1]; ++e) {
                const int64_t b = table.direction[e];
                for (int64_t q = rows[b]; q < rows[b + 1]; ++q) v[columns[q]] += sums[b] * table.rate[q];
            }
            if (!exponential(v.data(), 1.0, x, x)) return exponential.failed(v.data());
        }
        return DONE;
    }

  private:
    const ForceTable& table;
    const int64_t n;
    const int64_t *rows, *columns;
    std::vector<double> v, middle, slope, drawn, sums;
    std::vector<const Field*> fields;
    std::vector<std::unique_ptr<FieldWorkspace<double>>> workspaces;

    // Set `sums` to the increments of a step; return the coin. Increments of equal lengths are the same in steps of
    // other lengths: their number is that of the time in small quanta, in which rounded times agree.
    bool draw(double t, double h, int64_t member) {
        const int64_t parts = int64_t(1) << table.position, count = table.extent;
        const double length = h / double(parts), quantum = length / QUANTA;
        bool first = false;
        std::fill_n(sums.data(), count, 0.0);
        InterruptCheck::of_this_call().after(64 * parts * count);
        for (int64_t k = 0; k < parts; ++k) {
            const double number = std::floor((t + double(k) * length) / quantum + 0.5);
            DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), number, 0).draw(0, count + 1, drawn.data());
            for (int64_t b = 0; b < count; ++b) sums[b] += drawn[b];
            if (k == 0) first = drawn[count] < 0.0;
        }
        const double size = std::sqrt(length);
        for (int64_t b = 0; b < count; ++b) sums[b] *= size;
        return first;
    }

    // Midpoint rules over fractions of the increment: one, which is exact, or those of Suzuki, of order four.
    int64_t by_midpoints(double* x, double t, int64_t b, int64_t midpoints) {
        for (int64_t k = 0; k < midpoints; ++k) {
            const double fraction = midpoints == 1 ? 1.0 : k == 2 ? 1.0 - 4.0 * OUTER : OUTER;
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
        }
        return DONE;
    }

    static constexpr double QUANTA = 0x1p20;
    static constexpr double OUTER = 0.41449077179437573714;  // 1/(4 - 4^(1/3))
};

}  // namespace coadjoint
