// L D L^T factors of a sparse symmetric matrix, with the fill-in computed once.
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <vector>

namespace coadjoint {

constexpr double DEPENDENT = 0x1p-36;  // relative to its diagonal entry; a smaller pivot counts as zero

// The diagonal, and the entries below it, column by column.
struct SparseFactors {
    struct Update {
        int64_t target, first, second;  // entry[target] -= entry[first] * entry[second] / d; below zero, diagonal ~target
    };
    int64_t size = 0;
    std::vector<int64_t> column{0}, row, updates_of{0};
    std::vector<Update> updates;
    std::vector<double> diagonal, entry, pivot;
    std::map<std::pair<int64_t, int64_t>, int64_t> position;  // of (row, column)

    // below[j]: the rows under the diagonal in column j.
    void analyse(std::vector<std::set<int64_t>> below) {
        size = int64_t(below.size());
        diagonal.resize(size), pivot.resize(size);
        for (int64_t j = 0; j < size; ++j) {
            for (int64_t i : below[j]) position[{i, j}] = int64_t(row.size()), row.push_back(i);
            column.push_back(int64_t(row.size()));
            if (below[j].empty()) continue;
            // Eliminating j couples all rows coupled to j with each other.
            below[*below[j].begin()].insert(std::next(below[j].begin()), below[j].end());
        }
        for (int64_t j = 0; j < size; ++j) {
            for (int64_t p = column[j]; p < column[j + 1]; ++p)
                for (int64_t q = p; q < column[j + 1]; ++q) updates.push_back({p == q ? ~row[p] : -1, p, q});
            updates_of.push_back(int64_t(updates.size()));
        }
        entry.resize(row.size());
        for (Update& update : updates)
            if (update.first != update.second) update.target = position.at({row[update.second], row[update.first]});
    }

    void factorize() {
        pivot = diagonal;
        for (int64_t j = 0; j < size; ++j) {
            const double inverse = pivot[j] > DEPENDENT * diagonal[j] ? 1.0 / pivot[j] : 0.0;
            for (int64_t k = updates_of[j]; k < updates_of[j + 1]; ++k) {
                const Update& update = updates[k];
                double& target = update.target < 0 ? pivot[~update.target] : entry[update.target];
                target = __builtin_fma(-entry[update.first] * inverse, entry[update.second], target);
            }
            for (int64_t p = column[j]; p < column[j + 1]; ++p) entry[p] *= inverse;
            pivot[j] = inverse;
        }
    }

    void solve(double* y) const {
        for (int64_t j = 0; j < size; ++j)
            for (int64_t p = column[j]; p < column[j + 1]; ++p) y[row[p]] = __builtin_fma(-entry[p], y[j], y[row[p]]);
        for (int64_t j = size - 1; j >= 0; --j) {
            y[j] *= pivot[j];
            for (int64_t p = column[j]; p < column[j + 1]; ++p) y[j] = __builtin_fma(-entry[p], y[row[p]], y[j]);
        }
    }
};

}  // namespace coadjoint
