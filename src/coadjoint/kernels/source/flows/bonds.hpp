// The bonds of a part: in each, two momenta rotate about their sum, which is conserved.
#pragma once

#include "flows/called_parts.hpp"

namespace coadjoint {

// The change of z over the time tau if z and w rotate about their sum by the angle strength tau |z + w|.
template <class A>
INLINE void bond_change(const A& strength, double tau, const A* z, const A* w, A* change) {
    A sum[3], across[3], back[3];
    for (int i = 0; i < 3; ++i) sum[i] = z[i] + w[i];
    const A size = larger(absolute(sum[0]), larger(absolute(sum[1]), absolute(sum[2])));
    const A power = leading_power(size), inverse = inverse_power(power);
    for (int i = 0; i < 3; ++i) sum[i] = sum[i] * inverse;
    const A square = select(A(0.0) < size, dot(sum, sum), A(1.0)), length = square_root(square);
    const Rotation<A> rotation = rotation_by((strength * (A(tau) * power)) * length);
    const A sine = rotation.sine / length, cosm1 = rotation.cosm1 / square;
    cross(sum, z, across);
    cross(sum, across, back);
    for (int i = 0; i < 3; ++i) change[i] = fma(-cosm1, back[i], sine * across[i]);
}

template <class A, class C>
INLINE void rotate_bond(const FlowTables& tables, const C& constants, int64_t bond, double tau, A* x) {
    const uint32_t* column = tables.body_column + BODY_COLUMNS * bond;
    const A z[3] = {x[column[0]], x[column[1]], x[column[2]]}, w[3] = {x[column[3]], x[column[4]], x[column[5]]};
    A change[3];
    bond_change(constants.template number_at<A>(tables.body, BODY_CONSTANTS * bond), tau, z, w, change);
    for (int i = 0; i < 3; ++i) x[column[i]] = z[i] + change[i], x[column[3 + i]] = w[i] - change[i];
}

// Rotate the momenta by the bonds of the shares k to last - 1, which are disjoint and have basis elements of unit scale.
// The many bonds of one trajectory on a lattice are lanes.
template <class A, class C>
NOINLINE void rotate_shares(const FlowTables& tables, const C& constants, uint32_t k, uint32_t last, double tau, A* x) {
    if constexpr (Numbers<A>::lanes == 1) {
        for (; k + WIDTH <= last; k += WIDTH) {
            double strength[WIDTH], momenta[6][WIDTH];
            for (int lane = 0; lane < WIDTH; ++lane) {
                const int64_t bond = tables.called[k + lane];
                strength[lane] = constants.template number_at<double>(tables.body, BODY_CONSTANTS * bond);
                for (int i = 0; i < 6; ++i) momenta[i][lane] = x[tables.body_column[BODY_COLUMNS * bond + i]];
            }
            const Wide z[3] = {load<Wide>(momenta[0]), load<Wide>(momenta[1]), load<Wide>(momenta[2])};
            const Wide w[3] = {load<Wide>(momenta[3]), load<Wide>(momenta[4]), load<Wide>(momenta[5])};
            Wide change[3];
            bond_change(load<Wide>(strength), tau, z, w, change);
            for (int i = 0; i < 3; ++i) store(momenta[i], z[i] + change[i]), store(momenta[3 + i], w[i] - change[i]);
            for (int lane = 0; lane < WIDTH; ++lane)
                for (int i = 0; i < 6; ++i)
                    x[tables.body_column[BODY_COLUMNS * tables.called[k + lane] + i]] = momenta[i][lane];
        }
    }
    for (; k < last; ++k) rotate_bond(tables, constants, tables.called[k], tau, x);
}

// The same for all bonds of a part.
template <class A, class C>
INLINE void rotate_bonds(const FlowTables& tables, const C& constants, uint32_t part, double tau, A* x) {
    const uint32_t begin = tables.share[part];
    share(tables.share[part + 1] - begin, [&](int64_t first, int64_t last) {
        rotate_shares(tables, constants, begin + uint32_t(first), begin + uint32_t(last), tau, x);
    });
}

}  // namespace coadjoint
