// Linear gradients of spins, M x + b, with spins as lanes: component a of spin s is at a * stride + s.
#pragma once

#include <vector>

#include "field/field.hpp"
#include "field/row_lanes.hpp"
#include "numbers/aligned_array.hpp"

namespace coadjoint {

template <class A>
INLINE void cross_of(const A* x, const A* v, A* out) {
    for (int a = 0; a < 3; ++a) {
        const int b = (a + 1) % 3, c = (a + 2) % 3;
        out[a] = fma(x[b], v[c], -(x[c] * v[b]));
    }
}

// Spins: triples of coordinates (ascending) whose brackets are J(x) u = turn x cross u; all other coordinates commute.
struct Spins {
    std::vector<int64_t> coordinate[3];
    std::vector<double> turn;

    int64_t size() const { return int64_t(turn.size()); }

    // Fill in the spins of a field; false if its algebra is not a sum of so(3) and commuting coordinates.
    bool find(const Field& field, const MemberConstants& constants) {
        if (field.nonlinear) return false;
        std::vector<bool> covered(field.size, false);
        for (int64_t i = 0; i < field.size; ++i) {
            const uint32_t q = field.first[i];
            if (covered[i] || q == field.first[i + 1]) continue;
            const int64_t at[3] = {i, std::min(field.column[q], field.state[q]),
                                   std::max(field.column[q], field.state[q])};
            if (at[1] <= i || at[1] == at[2]) return false;
            double common = 0.0;
            for (int a = 0; a < 3; ++a) {
                if (covered[at[a]]) return false;
                if (!is_row(field, constants, at[a], at[(a + 1) % 3], at[(a + 2) % 3], common)) return false;
            }
            for (int a = 0; a < 3; ++a) coordinate[a].push_back(at[a]), covered[at[a]] = true;
            turn.push_back(common);
        }
        return size() > 0;
    }

  private:
    // Whether row i of J(x) u is turn (x_j u_k - x_k u_j); turn is set if it is zero.
    static bool is_row(const Field& field, const MemberConstants& constants, int64_t i, int64_t j, int64_t k,
                       double& turn) {
        if (field.first[i + 1] - field.first[i] != 2) return false;
        for (uint32_t q = field.first[i]; q < field.first[i + 1]; ++q) {
            const double value = constants.number_at<double>(field.constant, q);
            const bool forward = field.state[q] == j && field.column[q] == k;
            if (!forward && !(field.state[q] == k && field.column[q] == j)) return false;
            const double signed_value = forward ? value : -value;
            if (turn == 0.0) turn = signed_value;
            if (signed_value != turn || turn == 0.0) return false;
        }
        return true;
    }
};

// The rows of M, for eight spins at a time. Neighbors of spins in order are mostly in order too: they are one load, or
// two where a row of a lattice ends.
class SpinRows {
  public:
    static constexpr int W = 8;
    typedef Lanes<W> A;

    bool empty() const { return first.empty(); }

    // Read the only term of a field, which must be linear and act on spins alone; else stay empty.
    void read(const Field& field, const MemberConstants& constants, const Spins& spins, int64_t stride) {
        const Terms& terms = field.terms;
        if (terms.size != 1 || terms.kind[0] != LINEAR) return;
        std::vector<int64_t> position(field.size, -1), row_of(field.size, -1);
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) position[spins.coordinate[a][s]] = a * stride + s;
        for (uint32_t row = 0; row < terms.row[1]; ++row) {
            if (position[terms.target[row]] < 0) return;
            row_of[terms.target[row]] = row;
            for (uint32_t e = terms.entry[row]; e < terms.entry[row + 1]; ++e)
                if (position[terms.column[e]] < 0) return;
        }
        first.push_back(0);
        for (int64_t block = 0; block < stride; block += W)
            for (int a = 0; a < 3; ++a) add(terms, constants, spins, block, a, position, row_of);
        positions.clear(int64_t(scattered.size()) / W);
        for (size_t k = 0; k < scattered.size(); ++k) positions.at[k / W].lane[k % W] = scattered[k];
    }

    // The energy without its constant.
    double energy(const double* x, int64_t stride) const {
        return sum_of_lanes(shared_sum<A, SUMMED_SPINS>(stride, [&](int64_t first, int64_t last) {
            A sum(0.0);
            for (int64_t block = first; block < last; block += W)
                for (int a = 0; a < 3; ++a) {
                    const A linear = load<A>(offset.data() + 3 * block + W * a);
                    sum = fma(load<A>(x + a * stride + block), 0.5 * ((*this)(x, block, a) + linear), sum);
                }
            return sum;
        }));
    }

    // Component a of the gradient for the spins `block` to block + 7, from the components x of all of them, which are
    // followed by eight zeros.
    INLINE A operator()(const double* x, int64_t block, int a) const {
        const int64_t row = 3 * (block / W) + a;
        A sum = load<A>(offset.data() + W * row);
        for (int64_t e = first[row]; e < first[row + 1]; ++e) {
            const Entry& entry = entries[e];
            A at = entry.base >= 0 ? load<A>(x + entry.base) : take<W>(x, positions.at[entry.gathered]);
            if (entry.split < W) at = select(load<A>(NUMBERS) < A(entry.split), at, load<A>(x + entry.other));
            sum = fma(entry.uniform ? A(entry.weight) : load<A>(weights.data() + W * e), at, sum);
        }
        return sum;
    }

    // Let `visit(weight, position)` have the entries of one row of the first eight spins, in their order; return its offset.
    template <class Visit>
    double each_entry(int64_t spin, int a, const Visit& visit) const {
        for (int64_t e = first[a]; e < first[a + 1]; ++e) {
            const Entry& entry = entries[e];
            visit(entry.uniform ? entry.weight : weights[W * e + spin],
                  entry.base < 0 ? scattered[W * entry.gathered + spin]
                                 : (double(spin) < entry.split ? entry.base : entry.other) + spin);
        }
        return offset[W * a + spin];
    }

  private:
    static constexpr int64_t SUMMED_SPINS = 256;  // of a block of a sum
    static constexpr double NUMBERS[W] = {0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0};
    // `base`: the position of the first lane, if the others follow it, those from `split` on as if the first were at
    // `other`; else negative.
    struct Entry {
        double weight;
        int64_t base, other, gathered;
        double split;
        bool uniform;
    };
    std::vector<int64_t> first;
    std::vector<Entry> entries;
    std::vector<double> offset, weights;
    std::vector<int64_t> scattered;  // positions, eight for each entry without a base
    AlignedArray<Positions<W>> positions{0};

    void add(const Terms& terms, const MemberConstants& constants, const Spins& spins, int64_t block, int a,
             const std::vector<int64_t>& position, const std::vector<int64_t>& row_of) {
        int64_t row[W];
        uint32_t longest = 0;
        for (int lane = 0; lane < W; ++lane) {
            const int64_t s = block + lane;
            row[lane] = s < spins.size() ? row_of[spins.coordinate[a][s]] : -1;
            offset.push_back(row[lane] < 0 ? 0.0 : constants.number_at<double>(terms.offset, row[lane]));
            if (row[lane] >= 0) longest = std::max(longest, terms.entry[row[lane] + 1] - terms.entry[row[lane]]);
        }
        for (uint32_t e = 0; e < longest; ++e) {
            double weight[W];
            int64_t at[W];
            bool uniform = true;
            for (int lane = 0; lane < W; ++lane) {
                const bool has = row[lane] >= 0 && e < terms.entry[row[lane] + 1] - terms.entry[row[lane]];
                const int64_t from = has ? terms.entry[row[lane]] + e : 0;
                weight[lane] = has ? constants.number_at<double>(terms.weight, from) : 0.0;
                at[lane] = has ? position[terms.column[from]] : lane ? at[lane - 1] + 1 : 0;
                uniform = uniform && weight[lane] == weight[0];
            }
            int64_t split = 1, ordered;
            while (split < W && at[split] == at[split - 1] + 1) ++split;
            for (ordered = split + 1; ordered < W && at[ordered] == at[ordered - 1] + 1;) ++ordered;
            const int64_t other = split < W ? at[split] - split : 0;
            const bool in_order = ordered >= W && other >= 0;
            entries.push_back({weight[0], in_order ? at[0] : -1, other, int64_t(scattered.size()) / W,
                               double(in_order ? split : W), uniform});
            weights.insert(weights.end(), weight, weight + W);
            if (!in_order) scattered.insert(scattered.end(), at, at + W);
        }
        first.push_back(int64_t(entries.size()));
    }
};

}  // namespace coadjoint
