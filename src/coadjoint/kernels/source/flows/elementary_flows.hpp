// Rows that only rotate and shear by linear forms, preprocessed when a loop starts, so that their data are contiguous
// and few instructions remain. Those for the group element overlap with the latency of the sine for the momentum.
#pragma once

#include "flows/flow_rows.hpp"

namespace coadjoint {

// The blocks of one angle theta of a part: rotations by factor theta, or shears by factor theta times a constant each. Or
// a CUBIC block, the only run of a part with one angle. A constant is an N.
template <class N>
struct AngleBlocks {
    N factor;
    const double* constants;
    const uint32_t* pairs;
    uint32_t repeat, angle;
    int kind;
    uint32_t run;
};

// theta = offset + weight . x, row `angle` of the terms, and the blocks it moves; or a whole row of the program, if that
// is more.
template <class N>
struct ElementaryFlow {
    int kind;
    uint32_t row, entries;
    N offset;
    const double* weight;
    const uint32_t* column;
    AngleBlocks<N> momentum, group;
    uint32_t angle;
};
// In place of a kind: the row is not one elementary flow.
constexpr int WHOLE_ROW = -1;

template <class N, class C>
class FlowsOfRows {
  public:
    // CUBIC blocks are whole rows unless `with_cubic`.
    FlowsOfRows(const FlowTables& tables, const C& constants, bool with_group, bool with_cubic = false)
        : tables(tables), constants(constants), with_group(with_group), with_cubic(with_cubic) {}

    // The flows of rows, one after the other. Empty if all would be whole rows; then the tables are read.
    NOINLINE std::vector<ElementaryFlow<N>> operator()(RowRange rows) {
        std::vector<ElementaryFlow<N>> flows;
        bool some = false;
        for (uint32_t r = rows.first; r < rows.last; ++r) {
            const size_t before = flows.size();
            if (append(r, flows)) {
                some = true;
            } else {
                flows.resize(before);
                flows.push_back({WHOLE_ROW, r, 0, N(0.0), nullptr, nullptr, {}, {}, 0});
            }
        }
        return some ? flows : std::vector<ElementaryFlow<N>>();
    }

  private:
    const FlowTables& tables;
    const C constants;
    const bool with_group, with_cubic;
    std::vector<uint32_t> moved_by;  // the last row that moved a coordinate
    std::vector<AngleBlocks<N>> momentum, group;

    // Whether a part only rotates and shears, with too few angles for lanes, or is one CUBIC block; its blocks, in order.
    bool blocks_of(const Action& action, uint32_t part, double tau, std::vector<AngleBlocks<N>>& found) const {
        found.clear();
        const uint32_t only = action.run[part];
        if (with_cubic && action.run[part + 1] == only + 1 && action.kind[only] == CUBIC && tables.only[part] >= 0) {
            found.push_back({N(tau), nullptr, nullptr, 0, 0, CUBIC, only});
            return true;
        }
        for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
            const int kind = action.kind[run];
            if ((kind != ROTATE && kind != SHEAR) || action.angles[run] >= SPREAD) return false;
            const uint32_t repeat = action.repeat[run], *pairs = action.indices + action.position[run];
            const double* values = constants.from(action.constants, action.constant[run]);
            for (uint32_t q = 0; q < action.angles[run]; ++q, pairs += 2 * repeat) {
                const N factor = kind == ROTATE ? tau * constants.template number_at<N>(values, q) : N(tau);
                found.push_back({factor, constants.from(values, q * repeat), pairs, repeat, action.angle[run] + q, kind,
                                 run});
            }
        }
        return true;
    }

    // A part computes all its angles before it moves anything. So no flow of a part may move what a later one of its
    // angles reads.
    bool append(uint32_t r, std::vector<ElementaryFlow<N>>& flows) {
        const Terms& terms = tables.terms;
        const uint32_t part = tables.part[r], low = tables.share[part], high = tables.share[part + 1];
        if (terms.repeated) return false;
        for (uint32_t k = low; k < high; ++k)
            if (terms.kind[k] != LINEAR || tables.called[k] >= 0) return false;
        if (!blocks_of(tables.state, part, tables.tau[r], momentum)) return false;
        if (with_group && !blocks_of(tables.group, part, tables.tau[r], group)) return false;
        if (with_group && group.size() != momentum.size()) return false;
        if (moved_by.empty()) moved_by.resize(tables.state.size, ~uint32_t(0));
        for (size_t k = 0; k < momentum.size(); ++k) {
            const AngleBlocks<N> of_momentum = momentum[k], of_group = with_group ? group[k] : of_momentum;
            if (of_group.kind != of_momentum.kind || of_group.angle != of_momentum.angle) return false;
            const uint32_t row = terms.row[low] + of_momentum.angle, entry = terms.entry[row],
                           stop = terms.entry[row + 1];
            for (uint32_t e = entry; e < stop; ++e)
                if (moved_by[terms.column[e]] == r) return false;
            for (uint32_t e = 0; e < 2 * of_momentum.repeat; e += of_momentum.kind == SHEAR ? 2 : 1)
                moved_by[of_momentum.pairs[e]] = r;  // not by a CUBIC block, the only one of its part
            flows.push_back({of_momentum.kind, r, stop - entry, constants.template number_at<N>(terms.offset, row),
                             constants.from(terms.weight, entry), terms.column + entry, of_momentum, of_group, row});
        }
        return true;
    }
};

template <Summation summation, class N, class C, class A, class V>
INLINE void shear_blocks(const AngleBlocks<N>& blocks, const C& constants, const A& theta, const Vectors<V>& x) {
    const A scaled = blocks.factor * theta;
    for (uint32_t block = 0; block < blocks.repeat; ++block)
        shear<summation>(scaled * constants.template number_at<N>(blocks.constants, block),
                         blocks.pairs + 2 * block, x);
}

// The rotations of a flow that was applied, with which derivatives undo it.
template <class A>
struct AppliedRotations {
    Rotation<A> momentum, group;
};

// The angle of a flow at x.
template <class N, class C, class A>
INLINE A angle_of(const ElementaryFlow<N>& flow, const C& constants, const A* x) {
    A theta(flow.offset);
    for (uint32_t entry = 0; entry < flow.entries; ++entry)
        theta = fma(constants.template number_at<A>(flow.weight, entry), x[flow.column[entry]], theta);
    return theta;
}

// Apply a flow that rotates or shears, and unless null, store its rotations.
template <Summation summation, bool with_group, class N, class C, class A, class G>
INLINE void apply_flow(const ElementaryFlow<N>& flow, const C& constants, const Vectors<A>& x, const Vectors<G>& group,
                       AppliedRotations<A>* applied = nullptr) {
    const A theta = angle_of(flow, constants, x.at);
    if (__builtin_expect(flow.kind == ROTATE, 1)) {
        CachedRotation<A> cached;
        const Rotation<A> of_momentum = cached.by(theta * flow.momentum.factor, false);
        rotate<summation>(of_momentum, flow.momentum.pairs, flow.momentum.repeat, x);
        if (applied) applied->momentum = of_momentum;
        if constexpr (with_group) {
            const Rotation<A> of_group = cached.by(theta * flow.group.factor, true);
            rotate<CORRECTED>(of_group, flow.group.pairs, flow.group.repeat, group);
            if (applied) applied->group = of_group;
        }
    } else {
        shear_blocks<summation>(flow.momentum, constants, theta, x);
        if constexpr (with_group) shear_blocks<CORRECTED>(flow.group, constants, theta, group);
    }
}

}  // namespace coadjoint
