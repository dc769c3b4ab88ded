// The verb `act`: exp(theta D) of one part on vectors side by side (a state, or the rows of a group element).
//
// An angle is an A, a component of a vector is a V: both one number, or both lanes of members, or one angle for the
// rows of a group element as lanes. Component i of vector r stands at i * rows + r.
#pragma once

#include <algorithm>

#include "arithmetic.hpp"
#include "tables.hpp"

constexpr int SCALE = 0, ROTATE = 1, PLANE = 2, SHEAR = 3, CUBIC = 4;
// Rotations by tan(phi/2) := half the angle: the same blocks, with another sine and cosine.
constexpr int RATIONAL = 8, RATIONAL_ROTATE = ROTATE + RATIONAL, RATIONAL_CUBIC = CUBIC + RATIONAL;
constexpr int CUBIC_HEADER = 6;  // constants of a CUBIC block before the values of its entries
constexpr double MOST_SUBSTEPS = 1.0e6;

constexpr uint32_t MANY = 4;  // blocks of one angle that are worth a call

enum Care { PLAIN, COMPENSATED, CORRECTED };

// Add an increment to a component of known value; with compensation what rounding lost is kept and added the next time.
template <Care care, class V>
INLINE void add(V* vectors, V* errors, int64_t place, const V& old, V increment) {
    if constexpr (care == PLAIN) {
        vectors[place] = old + increment;
    } else {
        increment = increment + errors[place];
        V now = old + increment;
        V kept = now - old;
        errors[place] = (old - (now - kept)) + (increment - kept);
        vectors[place] = now;
    }
}

// Add an increment with compensation; keep besides what the increment owes and what adding the error to it lost. The
// next rotation does not wait for any of that.
template <class V>
INLINE void add_owing(V* vectors, V* errors, int64_t place, const V& old, const V& increment, const V& error,
                      const V& owed) {
    V whole = increment + error;
    V now = old + whole;
    V kept = now - old;
    // Where the error is the larger of the two, the increment is so small that what their sum loses does not matter.
    errors[place] = (old - (now - kept)) + (whole - kept) + ((increment - whole) + error) + owed;
    vectors[place] = now;
}

// What an action is applied to: `rows` vectors, their compensation, and room for three times their length.
template <class V>
struct Vectors {
    V *at, *errors;
    int64_t rows;
    V* room;
};

// Many blocks that turn by one angle: their coordinates are disjoint, so that loads need not wait for stores.
NOINLINE inline void rotate_many(double sine, double lowered, const uint32_t* index, uint32_t repeat, double* x) {
    constexpr int together = 4;
    uint32_t block = 0;
    for (; block + together <= repeat; block += together, index += 2 * together) {
        double a[together], b[together];
#pragma GCC unroll 4
        for (int k = 0; k < together; ++k) a[k] = x[index[2 * k]], b[k] = x[index[2 * k + 1]];
#pragma GCC unroll 4
        for (int k = 0; k < together; ++k) {
            x[index[2 * k]] = a[k] + fma(lowered, a[k], -(sine * b[k]));
            x[index[2 * k + 1]] = b[k] + fma(lowered, b[k], sine * a[k]);
        }
    }
    for (; block < repeat; ++block, index += 2) {
        const double a = x[index[0]], b = x[index[1]];
        x[index[0]] = a + fma(lowered, a, -(sine * b));
        x[index[1]] = b + fma(lowered, b, sine * a);
    }
}

template <Care care, class A, class V>
INLINE void rotate(const Rotation<A>& turn, const uint32_t* index, uint32_t repeat, const Vectors<V>& x) {
    if constexpr (care == PLAIN && Numbers<V>::lanes == 1)
        if (repeat >= MANY) return rotate_many(turn.sine, turn.lowered, index, repeat, x.at);
    const V sine(turn.sine), lowered(turn.lowered);
    const V dearth(care == CORRECTED ? shortfall(turn.sine, -turn.lowered, A(1.0)) : A(0.0));
    for (uint32_t block = 0; block < repeat; ++block, index += 2) {
        int64_t i = index[0] * x.rows, j = index[1] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V a = x.at[i + row], b = x.at[j + row];
            V forth = sine * a, back = sine * b;
            if constexpr (care == CORRECTED) {
                // The rotation of the errors, the rounding of a product, and the shortfall.
                V e = x.errors[i + row], f = x.errors[j + row];
                V first = fma(lowered, e, -fma(sine, f, fma(sine, b, -back))) - dearth * a;
                V second = fma(lowered, f, fma(sine, e, fma(sine, a, -forth))) - dearth * b;
                add_owing(x.at, x.errors, i + row, a, fma(lowered, a, -back), e, first);
                add_owing(x.at, x.errors, j + row, b, fma(lowered, b, forth), f, second);
            } else {
                add<care>(x.at, x.errors, i + row, a, fma(lowered, a, -back));
                add<care>(x.at, x.errors, j + row, b, fma(lowered, b, forth));
            }
        }
    }
}

template <Care care, class A, class V>
INLINE void shear(const A& factor, const uint32_t* index, const Vectors<V>& x) {
    const V by(factor);
    int64_t i = index[0] * x.rows, j = index[1] * x.rows;
    for (int64_t row = 0; row < x.rows; ++row) {
        V source = x.at[j + row];
        V moved = by * source;
        if constexpr (care == CORRECTED) {
            V owed = fma(by, x.errors[j + row], fma(by, source, -moved));
            add_owing(x.at, x.errors, i + row, x.at[i + row], moved, x.errors[i + row], owed);
        } else {
            add<care>(x.at, x.errors, i + row, x.at[i + row], moved);
        }
    }
}

template <Care care, class A, class V>
INLINE void scale(const A& factor, const uint32_t* index, uint32_t repeat, const Vectors<V>& x) {
    const V by(factor);
    for (uint32_t block = 0; block < repeat; ++block) {
        int64_t i = index[block] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row)
            add<care == PLAIN ? PLAIN : COMPENSATED>(x.at, x.errors, i + row, x.at[i + row], by * x.at[i + row]);
    }
}

// exp(theta B) = e^(theta mean) (C + S N), N = B - mean, N^2 = delta: entire in delta theta^2, of either sign.
template <Care care, class A, class V>
NOINLINE void plane(const A& mean, const A& half, const A& upper, const A& lower,
                                     const uint32_t* index, uint32_t repeat, const A& theta, const Vectors<V>& x) {
    A delta = fma(half, half, upper * lower);
    Rotation<A> pair = entire_pair(theta * theta * delta);
    // Not from expm1 alone: where the mean decays and cosh grows, what 1 + expm1 lost would be amplified.
    const Growth<A> growth = growth_by(theta * mean);
    const V diagonal(fma(growth.whole, pair.lowered, growth.beyond)), s(growth.whole * (theta * pair.sine));
    for (uint32_t block = 0; block < repeat; ++block, index += 2) {
        int64_t i = index[0] * x.rows, j = index[1] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V a = x.at[i + row], b = x.at[j + row];
            constexpr Care kept = care == PLAIN ? PLAIN : COMPENSATED;
            add<kept>(x.at, x.errors, i + row, a, fma(diagonal, a, s * fma(V(half), a, V(upper) * b)));
            add<kept>(x.at, x.errors, j + row, b, fma(diagonal, b, s * fma(V(lower), a, -(V(half) * b))));
        }
    }
}

// A CUBIC or SERIES block: its coordinates and the compressed sparse rows of D in them.
struct BlockRows {
    const uint32_t *coordinates, *starts, *columns;
    uint32_t width;
    int64_t constant, entries;

    INLINE BlockRows(const Action& action, uint32_t run)
        : coordinates(action.indices + action.place[run]),
          starts(coordinates + action.width[run]),
          columns(starts + action.width[run] + 1),
          width(action.width[run]),
          constant(action.constant[run]),
          entries(action.entries[run]) {}
};

// target = factor D source in the block's own coordinates (the verb `apply`).
template <class A, class V, class C>
INLINE void apply_block(const Action& action, const C& constants, const BlockRows& block, int64_t values,
                        const V* source, const A& factor, V* target, int64_t rows) {
    for (uint32_t k = 0; k < block.width; ++k) {
        for (int64_t row = 0; row < rows; ++row) {
            V total(0.0);
            for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                V value(constants.template number_at<A>(action.constants, values + entry));
                total = fma(value, source[block.columns[entry] * rows + row], total);
            }
            target[k * rows + row] = V(factor) * total;
        }
    }
}

template <class V>
INLINE void gather(const BlockRows& block, const Vectors<V>& x) {
    for (uint32_t k = 0; k < block.width; ++k)
        for (int64_t row = 0; row < x.rows; ++row)
            x.room[k * x.rows + row] = x.at[block.coordinates[k] * x.rows + row];
}

// Sine and cosine minus one of root * theta where lam < 0, of their hyperbolic kin elsewhere.
template <class A>
INLINE Rotation<A> cubic_rotation(const A& lam, const A& phi) {
    auto circular = lam < A(0.0);
    if (all(circular)) return rotation_by(phi);
    Rotation<A> hyperbolic = hyperbolic_rotation(phi);
    if (!any(circular)) return hyperbolic;
    Rotation<A> turn = rotation_by(phi);
    return {select(circular, turn.sine, hyperbolic.sine), select(circular, turn.lowered, hyperbolic.lowered)};
}

// D^3 = lam D: exp(theta D) = 1 + S D + C D^2, Rodrigues' formula where lam < 0 and its hyperbolic kin where lam > 0.
template <Care care, class A, class V, class C>
INLINE void cubic(const Action& action, const C& constants, uint32_t run, const A& theta, const Vectors<V>& x) {
    const BlockRows block(action, run);
    auto constant = [&](int64_t place) { return constants.template number_at<A>(action.constants, place); };
    const int64_t base = block.constant, values = base + CUBIC_HEADER, squares = values + block.entries,
                  rests = squares + block.entries;
    const int64_t length = block.width * x.rows;
    gather(block, x);
    const A lam = constant(base), phi = constant(base + 1) * theta;
    Rotation<A> turn = action.kind[run] == RATIONAL_CUBIC ? rational_rotation(phi) : cubic_rotation(lam, phi);
    // What the constants lost by rounding is paid back: it would stretch every step alike.
    const A s = fma(turn.sine, constant(base + 2), turn.sine * constant(base + 3));
    const A c = fma(turn.lowered, constant(base + 4), turn.lowered * constant(base + 5));
    const V along(s), across(c);
    if constexpr (care == CORRECTED) {
        // D (D x) and not D^2 x: the rounding of the entries of D^2 always pulls the same way.
        apply_block(action, constants, block, values, x.room, A(1.0), x.room + length, x.rows);
        apply_block(action, constants, block, values, x.room + length, A(1.0), x.room + 2 * length, x.rows);
        const V dearth(shortfall(s, c, -lam));
        for (uint32_t k = 0; k < block.width; ++k) {
            int64_t i = block.coordinates[k] * x.rows;
            for (int64_t row = 0; row < x.rows; ++row) {
                V first = x.room[length + k * x.rows + row], second = x.room[2 * length + k * x.rows + row];
                add_owing(x.at, x.errors, i + row, x.at[i + row], fma(along, first, across * second),
                          x.errors[i + row], dearth * second);
            }
        }
        return;
    }
    // Rows of D and D^2 are summed in registers, while the processor still works on the sine.
    for (uint32_t k = 0; k < block.width; ++k) {
        int64_t i = block.coordinates[k] * x.rows;
        for (int64_t row = 0; row < x.rows; ++row) {
            V first(0.0), second(0.0), rest(0.0);
            for (uint32_t entry = block.starts[k]; entry < block.starts[k + 1]; ++entry) {
                V v = x.room[block.columns[entry] * x.rows + row];
                first = fma(V(constant(values + entry)), v, first);
                second = fma(V(constant(squares + entry)), v, second);
                rest = fma(V(constant(rests + entry)), v, rest);
            }
            second += rest;
            add<care>(x.at, x.errors, i + row, x.at[i + row], fma(along, first, across * second));
        }
    }
}

// Up to r = REACH[m - 1] the series of norm r is shortened to the degree m: r^m / (m + 1)! is below 2^-65, since what is
// left out has one sign and would add up over the steps.
constexpr double REACH[] = {5.42e-20, 4.03e-10, 8.66e-07, 4.24e-05, 0.000455, 0.00227, 0.00728, 0.0177, 0.0358,
                            0.0635, 0.102, 0.153, 0.217, 0.293, 0.383, 0.485, 0.6, 0.727,
                            0.866, 1.02};

INLINE uint32_t degree_of(double r, uint32_t most) {
    uint32_t degree = 1;
    while (degree < most && r > REACH[degree - 1]) ++degree;
    return degree;
}

// The sum of theta^k D^k / k!: finite where D is nilpotent, else in substeps of norm at most 1.
template <Care care, class A, class V, class C>
NOINLINE void series(const Action& action, const C& constants, uint32_t run, const A& theta,
                                      const Vectors<V>& x) {
    const BlockRows block(action, run);
    const int64_t length = block.width * x.rows;
    A step = theta, substeps(1.0), degrees(1.0);
    const A norm = constants.template number_at<A>(action.constants, block.constant);
    int64_t most = 1;
    uint32_t longest = 1;
    for (int lane = 0; lane < Numbers<A>::lanes; ++lane) {
        double needed = std::ceil(absolute(lane_of(theta, lane)) * lane_of(norm, lane));
        if (needed <= MOST_SUBSTEPS) {
            double own = needed > 1.0 ? needed : 1.0;
            const double reached = absolute(lane_of(theta, lane)) * lane_of(norm, lane) / own;
            const uint32_t degree = reached > 0.0 ? degree_of(reached, action.degree[run]) : action.degree[run];
            set_lane(step, lane, lane_of(theta, lane) / own);
            set_lane(substeps, lane, own);
            set_lane(degrees, lane, double(degree));
            longest = std::max(longest, degree);
            most = own > double(most) ? int64_t(own) : most;
        } else {
            // No step of an integration needs more; near a blow-up it would run for ever: no number, so that it stops.
            set_lane(step, lane, NAN);
        }
    }
    for (int64_t done = 0; done < most; ++done) {
        auto going = A(double(done)) < substeps;
        // In Horner's order: added one by one, terms below half a unit in the last place would all be lost alike.
        gather(block, x);
        V *start = x.room, *inner = x.room + length, *total = x.room + 2 * length;
        std::copy_n(start, length, inner);
        for (uint32_t k = longest; k > 0; --k) {
            apply_block(action, constants, block, block.constant + 1, inner, step / double(k), total, x.rows);
            const auto begun = A(double(k)) <= degrees;
            for (int64_t place = 0; k > 1 && place < length; ++place) {
                inner[place] = start[place] + total[place];
                if constexpr (Numbers<A>::lanes > 1) inner[place] = select(begun, inner[place], start[place]);
            }
        }
        for (uint32_t k = 0; k < block.width; ++k) {
            int64_t i = block.coordinates[k] * x.rows;
            for (int64_t row = 0; row < x.rows; ++row) {
                V before = x.at[i + row], error = care == PLAIN ? before : x.errors[i + row];
                add<care == PLAIN ? PLAIN : COMPENSATED>(x.at, x.errors, i + row, before, total[k * x.rows + row]);
                if constexpr (Numbers<A>::lanes > 1) {
                    x.at[i + row] = select(going, x.at[i + row], before);
                    if constexpr (care != PLAIN) x.errors[i + row] = select(going, x.errors[i + row], error);
                }
            }
        }
    }
}

// The last lone angle of a part and its sine: other blocks of the part, and the group element, turn by the same angle or
// its opposite.
template <class A>
struct Turned {
    A phi = A(NAN);
    Rotation<A> turn;

    INLINE Rotation<A> by(const A& angle, bool again) {
        if (again) {
            if (all(angle == phi)) return turn;
            if (all(angle == -phi)) return {-turn.sine, turn.lowered};
        }
        phi = angle;
        return turn = rotation_by(angle);
    }
};

constexpr int SPREAD = 8;  // rotations of one trajectory whose sines are computed side by side

// The rotations of a run, each with an angle of its own.
template <Care care, class A, class V, class C>
NOINLINE void rotate_several(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                             Vectors<V> x) {
    const uint32_t repeat = action.repeat[run], count = action.angles[run];
    const uint32_t* index = action.indices + action.place[run];
    const int64_t place = action.constant[run];
    uint32_t q = 0;
    if constexpr (Numbers<A>::lanes == 1) {
        for (; q + SPREAD <= count; q += SPREAD) {
            typedef Lanes<SPREAD> Spread;
            const Spread phi = load<Spread>(theta + q) * (Spread(tau) * load<Spread>(action.constants + place + q));
            const Rotation<Spread> turns = rotation_by(phi);
            double sines[SPREAD], lowereds[SPREAD];
            store(sines, turns.sine);
            store(lowereds, turns.lowered);
            for (int lane = 0; lane < SPREAD; ++lane, index += 2 * repeat)
                rotate<care>(Rotation<A>{A(sines[lane]), A(lowereds[lane])}, index, repeat, x);
        }
    }
    for (; q < count; ++q, index += 2 * repeat)
        rotate<care>(rotation_by(theta[q] * (tau * constants.template number_at<A>(action.constants, place + q))), index,
                     repeat, x);
}

// The runs that are not on every step's way, or long enough not to mind a call.
template <Care care, class A, class V, class C>
NOINLINE void act_apart(const Action& action, const C& constants, uint32_t run, double tau, const A* theta,
                        Vectors<V> x) {
    auto constant = [&](int64_t place) { return constants.template number_at<A>(action.constants, place); };
    const int kind = action.kind[run];
    const uint32_t repeat = action.repeat[run], count = action.angles[run];
    const uint32_t* index = action.indices + action.place[run];
    int64_t place = action.constant[run];
    if (kind == ROTATE) {
        rotate_several<care>(action, constants, run, tau, theta, x);
    } else if (kind == SHEAR) {
        for (uint32_t q = 0; q < count; ++q) {
            const A turn = tau * theta[q];
            for (uint32_t block = 0; block < repeat; ++block, ++place, index += 2)
                shear<care>(turn * constant(place), index, x);
        }
    } else if (kind == RATIONAL_ROTATE) {
        for (uint32_t q = 0; q < count; ++q, index += 2 * repeat)
            rotate<care>(rational_rotation(theta[q] * (tau * constant(place + q))), index, repeat, x);
    } else if (kind == CUBIC || kind == RATIONAL_CUBIC) {
        cubic<care>(action, constants, run, tau * theta[0], x);
    } else if (kind == SCALE) {
        for (uint32_t q = 0; q < count; ++q, index += repeat) {
            scale<care>(growth_by(theta[q] * (tau * constant(place + q))).beyond, index, repeat, x);
        }
    } else if (kind == PLANE) {
        for (uint32_t q = 0; q < count; ++q, place += 4, index += 2 * repeat)
            plane<care, A, V>(constant(place), constant(place + 1), constant(place + 2), constant(place + 3), index,
                              repeat, tau * theta[q], x);
    } else {
        series<care>(action, constants, run, tau * theta[0], x);
    }
}

// The runs of a part with a lone angle, one after the other.
template <Care care, class A, class V, class C>
NOINLINE void act_in_turn(const Action& action, const C& constants, uint32_t part, double tau, A lone,
                          Turned<A>& turned, Vectors<V> x) {
    for (uint32_t run = action.run[part], last = action.run[part + 1]; run < last; ++run) {
        if (action.kind[run] == ROTATE) {
            const A w = constants.template number_at<A>(action.constants, action.constant[run]);
            const uint32_t* index = action.indices + action.place[run];
            rotate<care>(turned.by(lone * (tau * w), true), index, action.repeat[run], x);
        } else {
            act_apart<care>(action, constants, run, tau, &lone, x);
        }
    }
}

// Move vectors by exp(tau sum theta_a D_a) of one part. CORRECTED pays besides what the increment itself owes, so that
// no rounding keeps its sign. A lone angle with a single run stays in its registers: what passes through memory delays
// the step. With `again` the part has just moved other vectors, by the angle in `turned`.
template <Care care, bool again, class A, class V, class C>
INLINE void act(const Action& action, const C& constants, uint32_t part, double tau, bool single, A lone,
                const A* theta, Turned<A>& turned, const Vectors<V>& x) {
    constexpr bool number = Numbers<V>::lanes == 1;
    const uint32_t run = action.run[part], last = action.run[part + 1];
    const bool alone = single && last == run + 1;
    const int kind = last > run ? action.kind[run] : -1;
    auto constant = [&](int64_t place) { return constants.template number_at<A>(action.constants, place); };
    if (__builtin_expect(alone && kind == ROTATE, 1)) {
        const uint32_t* index = action.indices + action.place[run];
        rotate<care>(turned.by(lone * (tau * constant(action.constant[run])), again), index, action.repeat[run], x);
    } else if (number && alone && kind == SHEAR) {
        const A turn = tau * lone;
        const uint32_t* index = action.indices + action.place[run];
        for (uint32_t block = 0, repeat = action.repeat[run]; block < repeat; ++block, index += 2)
            shear<care>(turn * constant(action.constant[run] + block), index, x);
    } else if (number && alone && kind == CUBIC) {
        cubic<care>(action, constants, run, tau * lone, x);
    } else if (single) {
        Turned<A> apart = turned;
        act_in_turn<care>(action, constants, part, tau, lone, apart, x);
        turned = apart;
    } else {
        for (uint32_t several = run; several < last; ++several)
            act_apart<care>(action, constants, several, tau, theta + action.angle[several], x);
    }
}
