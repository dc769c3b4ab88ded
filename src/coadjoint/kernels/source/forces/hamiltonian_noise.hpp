// Hamiltonian noise: exponentials of linear functions, and midpoint rules of others, each over a random time; of one
// member, or of members as lanes.
#pragma once

#include <deque>
#include <memory>

#include "forces/increments.hpp"
#include "forces/orbit_exponential.hpp"
#include "forces/spin_rows.hpp"
#include "numbers/arithmetic.hpp"

namespace coadjoint {

// The fraction k of an increment in one flow, or in five, those of Suzuki, of order four.
inline double fraction_of(int64_t k, int64_t count) {
    constexpr double OUTER = 0.41449077179437573714;  // 1/(4 - 4^(1/3))
    return count == 1 ? 1.0 : k == 2 ? 1.0 - 4.0 * OUTER : OUTER;
}

template <class A, class C>
class HamiltonianNoise {
  public:
    typedef typename Numbers<A>::Mask Mask;
    OrbitExponential<A, C> exponential;

    // Of the table: `extent` Brownian motions in `sets`; set s has those with the numbers direction[begin[s]] to
    // direction[begin[s + 1] - 1]. aim[s] is zero for one exponential, a number of midpoint rules, or minus a number of
    // symmetric compositions of exponentials. Behind the sets `begin` has a row for each Brownian motion, whose columns
    // follow the numbers in `direction`, with coefficients in `rate`: of coordinates, or of the functions whose fields
    // are at `function`. Increments are sums of 2^position. Members may differ in `rate`, not in `aim` and functions.
    HamiltonianNoise(const ForceTable& table, const Field& field, const GroupField& group, const C& constants)
        : exponential(field, group, constants), has_group(group.size > 0), table(table), constants(constants),
          first(constants.of_lane(0)), n(field.size),
          rows(table.begin + table.sets + 1), columns(table.direction + table.extent), v(n), middle(n), slope(n) {
        int64_t functions = 0;
        for (int64_t set = 0; set < table.sets; ++set)
            for (int64_t b = table.direction[table.begin[set]], q = rows[b]; aim(set) != 0.0 && q < rows[b + 1]; ++q)
                functions = std::max(functions, columns[q] + 1);
        for (int64_t k = 0; k < functions; ++k) {
            fields.push_back(reinterpret_cast<const Field*>(first.address(table.function, k, 0)));
            workspaces.emplace_back(new FieldWorkspace<A>(*fields.back()));
        }
        of_spins = spins.find(field, first);
        for (int64_t set = 0; set < table.sets && !of_spins; ++set) {
            std::vector<bool> used(n, false);
            for (int64_t e = table.begin[set]; e < table.begin[set + 1] && aim(set) == 0.0; ++e)
                for (int64_t q = rows[table.direction[e]]; q < rows[table.direction[e] + 1]; ++q) used[columns[q]] = true;
            products.emplace_back(field, constants, used);
        }
    }

    // The noise of a step with these increments, on the side of it on which it acts, for the members that are `moving`:
    // in order before it (side 0), and in reversed order after it. A group element moves with the state. Returns statuses.
    A flow(A* x, double* element, double t, const A* sums, int64_t side, Mask moving) {
        exponential.iterations = exponential.evaluations = A(0.0);
        exponential.residual = A(std::numeric_limits<double>::quiet_NaN());
        A status = double(DONE);
        for (int64_t k = 0; k < table.sets && any(moving); ++k) {
            const int64_t set = side ? table.sets - 1 - k : k, midpoints = int64_t(aim(set));
            const int64_t first = table.direction[table.begin[set]];
            if (midpoints < 0)
                by_parts(x, element, t, sums, first, -midpoints, moving, status);
            else if (midpoints > 0)
                by_midpoints(x, element, t, sums, first, midpoints, moving, status);
            else
                together(x, element, sums, set, moving, status);
        }
        return status;
    }

    // Whether another noise of the same structure has the same functions.
    bool shares_functions(const HamiltonianNoise& other) const { return fields == other.fields; }

  private:
    const bool has_group;
    const ForceTable& table;
    const C constants;
    const MemberConstants first;
    const int64_t n;
    Spins spins;
    bool of_spins = false;  // whether the algebra is a sum of so(3), where exponentials are rotations
    const int64_t *rows, *columns;
    AlignedArray<A> v, middle, slope;
    std::deque<RestrictedField<C>> products;  // of each set of linear functions
    std::vector<const Field*> fields;
    std::vector<std::unique_ptr<FieldWorkspace<A>>> workspaces;

    double aim(int64_t set) const { return first.number_at<double>(table.aim, set); }

    // Linear functions that commute.
    void together(A* x, double* element, const A* sums, int64_t set, Mask& moving, A& status) {
        std::fill_n(v.at, n, A(0.0));
        for (int64_t e = table.begin[set]; e < table.begin[set + 1]; ++e) {
            const int64_t b = table.direction[e];
            for (int64_t q = rows[b]; q < rows[b + 1]; ++q) v.at[columns[q]] += sums[b] * constants.template number_at<A>(table.rate, q);
        }
        if (of_spins) rotate_spins(x, moving);
        move(x, element, moving, status, of_spins, of_spins ? nullptr : &products[set]);
    }

    // Move a state, unless it is `moved`, and the group element by exponentials of v. Members that fail stop moving.
    void move(A* x, double* element, Mask& moving, A& status, bool moved = false,
              const RestrictedField<C>* restricted = nullptr) {
        Mask defined = moving;
        if (!moved)
            defined = restricted ? exponential(v.at, 1.0, x, x, moving, restricted->products())
                                 : exponential(v.at, 1.0, x, x, moving);
        if constexpr (Numbers<A>::lanes == 1)
            if (has_group) defined = defined && exponential.turn(v.at, element);
        if (any(moving & !defined)) stop_members(moving & !defined, exponential.failed(v.at), moving, status);
    }

    // Set x to exp(D_v) x, where D_v x = turn x cross v for each spin: a rotation of x in closed form.
    void rotate_spins(A* x, const Mask& moving) const {
        for (int64_t s = 0; s < spins.size(); ++s) {
            A y[3], w[3];
            for (int a = 0; a < 3; ++a) y[a] = x[spins.coordinate[a][s]], w[a] = A(spins.turn[s]) * v.at[spins.coordinate[a][s]];
            if (alike(w))
                rotate_parts<Part>(w, y);
            else
                rotate_parts<double>(w, y);
            for (int a = 0; a < 3; ++a) x[spins.coordinate[a][s]] = select(moving, y[a], x[spins.coordinate[a][s]]);
        }
    }

    typedef std::conditional_t<Numbers<A>::lanes == 1, double, Lanes<NATIVE>> Part;  // lanes that stay in registers

    // Rotate as many members at once as B has lanes.
    template <class B>
    static void rotate_parts(const A* w, A* x) {
        for (int first = 0; first < Numbers<A>::lanes; first += Numbers<B>::lanes) {
            B part[3], about[3];
            for (int a = 0; a < 3; ++a) {
                part[a] = load<B>(reinterpret_cast<const double*>(x + a) + first);
                about[a] = load<B>(reinterpret_cast<const double*>(w + a) + first);
            }
            rotate(about, part);
            for (int a = 0; a < 3; ++a) store(reinterpret_cast<double*>(x + a) + first, part[a]);
        }
    }

    // Whether `rotate` takes the same operations for all members.
    static bool alike(const A* w) {
        int axes = 0;
        for (int a = 0; a < 3; ++a) {
            const Mask none = w[a] == A(0.0);
            if (any(none) && !all(none)) return false;
            axes += !all(none);
        }
        return axes < 2 || Numbers<A>::lanes == 1 || !any(squared(w) == A(0.0));
    }

    template <class B>
    static B squared(const B* w) { return fma(w[0], w[0], fma(w[1], w[1], w[2] * w[2])); }

    template <class B>
    static INLINE void rotate(const B* w, B* x) {
        bool turns[3];
        for (int a = 0; a < 3; ++a) turns[a] = !all(w[a] == B(0.0));
        const int axes = turns[0] + turns[1] + turns[2];
        if (axes == 0) return;
        if (axes == 1) {
            const int a = turns[0] ? 0 : turns[1] ? 1 : 2, b = (a + 1) % 3, c = (a + 2) % 3;
            const Rotation<B> rotation = rotation_by(w[a]);
            const B one = x[b], two = x[c];
            x[b] = one + fma(rotation.cosm1, one, rotation.sine * two);
            x[c] = two + fma(rotation.cosm1, two, -(rotation.sine * one));
            return;
        }
        const B square = squared(w);
        if (all(square == B(0.0))) return;
        const B angle = square_root(square);
        const Rotation<B> rotation = rotation_by(angle);
        const B first = rotation.sine / angle, second = -(rotation.cosm1 / square);
        B across[3], back[3];
        cross_of(x, w, across);
        cross_of(across, w, back);
        for (int a = 0; a < 3; ++a) x[a] = x[a] + fma(first, across[a], second * back[a]);
    }

    // Functions whose gradients are constant along their flows: these in their order and back, at fractions of the
    // increment.
    void by_parts(A* x, double* element, double t, const A* sums, int64_t b, int64_t count, Mask& moving, A& status) {
        const int64_t parts = rows[b + 1] - rows[b];
        for (int64_t k = 0; k < count; ++k)
            for (int64_t p = 0; p < 2 * parts - 1 && any(moving); ++p) {
                const int64_t q = rows[b] + (p < parts ? p : 2 * parts - 2 - p);
                const A size = A((p == parts - 1 ? 1.0 : 0.5) * fraction_of(k, count)) * sums[b] * constants.template number_at<A>(table.rate, q);
                gradient_of(columns[q], x, t, v.at);
                for (int64_t i = 0; i < n; ++i) v.at[i] *= size;
                move(x, element, moving, status);
            }
    }

    // Midpoint rules over fractions of the increment: one, which is exact, or those of Suzuki, of order four.
    void by_midpoints(A* x, double* element, double t, const A* sums, int64_t b, int64_t midpoints, Mask& moving,
                      A& status) {
        for (int64_t k = 0; k < midpoints && any(moving); ++k) {
            const A size = A(fraction_of(k, midpoints)) * sums[b];
            const A found = exponential.midpoint(x, v.at, middle.at, moving, [&](const A* y, A* to) {
                std::fill_n(to, n, A(0.0));
                for (int64_t q = rows[b]; q < rows[b + 1]; ++q) {
                    gradient_of(columns[q], y, t, slope.at);
                    for (int64_t i = 0; i < n; ++i) to[i] = fma(constants.template number_at<A>(table.rate, q), slope.at[i], to[i]);
                }
                for (int64_t i = 0; i < n; ++i) to[i] *= size;
            });
            if (const Mask failing = moving & !(found == A(double(DONE))); any(failing)) stop_members(failing, found, moving, status);
            if (any(moving)) move(x, element, moving, status, true);
        }
    }

    void gradient_of(int64_t k, const A* x, double t, A* out) {
        InterruptCheck::of_this_call().after(Numbers<A>::lanes * work_of(*fields[k]));
        gradient(*fields[k], MemberConstants{1, 0}, x, A(t), out, *workspaces[k]);
    }
};

}  // namespace coadjoint
