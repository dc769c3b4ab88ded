// The rows of a program with tangent vectors beside the momentum: dx <- act(theta, dx) + (D x) dtheta.
#pragma once

#include "flows/flow_alone.hpp"
#include "tangents/second_derivatives.hpp"
#include "tangents/bundle.hpp"

namespace coadjoint {

// Add D_a x times the change of its angle to the vectors, for all angles of a part (the operation `apply`).
template <class A, class V>
NOINLINE void add_angle_changes(const Action& action, uint32_t part, const A* x, const V* changes, V* vectors,
                                int64_t rows) {
    for (uint32_t run = action.run[part]; run < action.run[part + 1]; ++run) {
        const int kind = action.kind[run] % RATIONAL;
        const uint32_t repeat = action.repeat[run], count = action.angles[run];
        const uint32_t* index = action.indices + action.position[run];
        const double* constants = action.constants + action.constant[run];
        const V* change = changes + action.angle[run] * rows;
        const auto gain = [&](uint32_t i, const A& moved) {
            const V by(moved);
            for (int64_t b = 0; b < rows; ++b) vectors[i * rows + b] = fma(by, change[b], vectors[i * rows + b]);
        };
        if (kind == CUBIC || kind == SERIES) {
            const BlockRows block(action, run);
            const double* values = constants + (kind == CUBIC ? CUBIC_HEADER : 1);
            for (uint32_t k = 0; k < block.width; ++k) {
                A moved(0.0);
                for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry)
                    moved = fma(A(values[entry]), x[block.coordinates[block.columns[entry]]], moved);
                gain(block.coordinates[k], moved);
            }
            continue;
        }
        for (uint32_t q = 0; q < count; ++q, change += rows)
            for (uint32_t b = 0; b < repeat; ++b) {
                if (kind == SCALE) {
                    gain(index[0], constants[q] * x[index[0]]);
                } else if (kind == ROTATE) {
                    gain(index[0], -(constants[q] * x[index[1]]));
                    gain(index[1], constants[q] * x[index[0]]);
                } else if (kind == SHEAR) {
                    gain(index[0], constants[q * repeat + b] * x[index[1]]);
                } else {
                    const double* plane = constants + 4 * q;
                    const A one = x[index[0]], other = x[index[1]];
                    gain(index[0], fma(A(plane[0] + plane[1]), one, plane[2] * other));
                    gain(index[1], fma(A(plane[3]), one, (plane[0] - plane[1]) * other));
                }
                index += kind == SCALE ? 1 : 2;
            }
    }
}

// One member of a flow method, or many as lanes. Momenta have the same bits as without tangent vectors.
template <Summation summation, class A, class V>
struct FlowTangentState {
    const FlowTables& tables;
    const Tangents& tangents;
    const int64_t size, rows;
    AlignedArray<A> scratch;
    AlignedArray<V> wide, changes;
    AngleWorkspace<A> angles;
    HessianWorkspace<A> hessians;

    FlowTangentState(const FlowTangents& tangent_tables, int64_t size, int64_t rows)
        : tables(tangent_tables.base), tangents(tangent_tables.tangents), size(size), rows(rows), scratch(3 * size),
          wide(3 * size * rows), changes(tables.longest * rows), angles(tables.longest), hessians(tables.longest) {}

    void sweep(uint32_t first, uint32_t last, A* x, A* dx, V* vectors, const A& t, double h) {
        for (uint32_t r = first; r < last; ++r) row(r, x, dx, vectors, t, h);
    }

  private:
    void row(uint32_t r, A* x, A* dx, V* vectors, const A& t, double h) {
        const Terms& terms = tables.terms;
        const uint32_t part = tables.part[r], low = tables.share[part], high = tables.share[part + 1];
        const int64_t base = terms.row[low], count = terms.row[high] - base;
        const bool single = tables.only[part] >= 0;
        const double tau = tables.tau[r];
        const A moment = t + A(tables.moment[r] * h);
        A* theta = angles.theta.at;
        if (is_called(tables, part)) {
            for (uint32_t k = low; k < high; ++k)
                called_changes(tables, tables.called[k], tau, x, vectors, rows,
                               changes.at + (terms.row[k] - base) * rows);
            const Rotations<A> rotations = rotations_of_part(tables, SharedConstants{}, part, tau, x, angles);
            if (rotates_bonds_directly<summation>(tables, part))
                rotate_bonds(tables, SharedConstants{}, part, tau, x);
            else
                act_called<summation>(tables.state, SharedConstants{}, part, rotations,
                                      Vectors<A>{x, dx, 1, scratch.at}, size);
            act_called<PLAIN>(tables.state, SharedConstants{}, part, rotations,
                              Vectors<V>{vectors, nullptr, rows, wide.at}, size);
        } else {
            for (uint32_t k = low; k < high; ++k) {
                gradient_rows(terms, SharedConstants{}, tables.addresses, k, x, moment, theta, base,
                              angles.arguments.at, angles.calls.data());
                gradient_changes(terms, tangents.hessians, k, x, moment, vectors, rows, changes.at, base, hessians);
            }
            for (int64_t a = 0; a < count; ++a) {
                // A rational rotation by phi rotates by 2 atan(phi/2).
                const A half = 0.5 * tables.frequency[base + a] * (tau * theta[a]);
                const V by(A(tau) / fma(half, half, A(1.0)));
                for (int64_t b = 0; b < rows; ++b) changes.at[a * rows + b] *= by;
            }
            const A single_angle = single ? theta[0] : A(0.0);
            CachedRotation<A> cached;
            act<summation, false>(tables.state, SharedConstants{}, part, tau, single, single_angle, theta, cached,
                                  Vectors<A>{x, dx, 1, scratch.at});
            act<PLAIN, true>(tables.state, SharedConstants{}, part, tau, single, single_angle, theta, cached,
                             Vectors<V>{vectors, nullptr, rows, wide.at});
        }
        add_angle_changes(tables.state, part, x, changes.at, vectors, rows);
    }
};

}  // namespace coadjoint
