// `SpinBath` of a few spins, of members as lanes, each with the bits that it has alone.
#pragma once

#include "forces/spin_bath.hpp"

namespace coadjoint {

// `C` are the constants of one table, or those of each member.
template <class C>
class SpinBathOfLanes {
  public:
    typedef Lanes<MEMBER_LANES> A;
    typedef Numbers<A>::Mask Mask;
    A iterations, evaluations, residual, change;

    // More spins than this fill the lanes of `SpinBath`.
    static constexpr int64_t MOST_SPINS = SpinBath::W - 1;

    // The flows of each member alone.
    SpinBathOfLanes(SpinBath* const* baths, const C& constants)
        : iterations(0.0), evaluations(0.0), residual(0.0), change(0.0), bath(*baths[0]), table(bath.table),
          field(bath.field), constants(constants), spins(bath.spins.size()), start(3 * spins + 1), middle(3 * spins + 1),
          gradients(3 * spins), half(3 * spins), inverse(spins), deviates(field.size), point(field.size),
          slope(field.size), workspace(field), metric(3 * spins), root(3 * spins), added(3 * spins), turn(spins),
          offset(3 * spins), weight(0), size(0.0) {
        for (int64_t k = 0; k < 3 * spins && bath.measures(); ++k) {
            first.push_back(int64_t(column.size()));
            bath.rows.each_entry(k % spins, int(k / spins), [&](double, int64_t place) {
                const int64_t a = place / bath.stride, s = place % bath.stride;
                column.push_back(a < 3 && s < spins ? a * spins + s : 3 * spins);
            });
        }
        first.push_back(int64_t(column.size()));
        weight.clear(int64_t(column.size()));
        for (int lane = 0; lane < (is_shared ? 1 : lanes); ++lane) read(*baths[lane], lane);
    }

    // As `SpinBath::flow`; `draw(half, deviates)` draws those of all coordinates. Returns the statuses of the members that
    // are `moving`.
    template <class Draw>
    A flow(A* x, double t, double tau, const Mask& moving, const Draw& draw) {
        for (int64_t k = 0; k < 3 * spins; ++k) start.at[k] = x[coordinate(k)];
        if (bath.adds) find_lengths();
        const A before = bath.measures() ? energy() : A(0.0);
        const Number drawn = size * Number(std::sqrt(0.5 * tau));
        const bool random = lane_of(drawn, 0) > 0.0;
        if (random) draw(0, deviates.at), shake(drawn, 0);
        A scale(0.0);
        for (int64_t k = 0; k < 3 * spins; ++k) scale = larger(scale, absolute(start.at[k]));
        if (!bath.measures()) std::copy_n(x, field.size, point.at);
        const A status = settle(t + 0.5 * tau, tau, scale, moving);
        const Mask done = moving & (status == A(double(DONE)));
        for (int64_t s = 0; s < spins; ++s) {
            A y[3], v[3], now[3];
            for (int a = 0; a < 3; ++a) y[a] = start.at[a * spins + s], v[a] = 2.0 * half.at[a * spins + s];
            SpinBath::rotate(v, y, now);
            for (int a = 0; a < 3; ++a) start.at[a * spins + s] = now[a];
        }
        if (random) draw(1, deviates.at), shake(drawn, 1);
        if (bath.measures()) change = energy() - before;
        for (int64_t k = 0; k < 3 * spins; ++k) x[coordinate(k)] = select(done, start.at[k], x[coordinate(k)]);
        return select(done & !finite(field.size, x), A(double(OVERFLOWED)), status);
    }

  private:
    static constexpr int lanes = MEMBER_LANES;
    static constexpr bool is_shared = std::is_same_v<C, SharedConstants>;
    typedef typename C::template Constant<A> Number;
    SpinBath& bath;
    const ForceTable& table;
    const Field& field;
    const C constants;
    const int64_t spins;
    // `start` and `middle` end with a zero, which empty entries of rows multiply.
    AlignedArray<A> start, middle, gradients, half, inverse, deviates, point, slope;
    FieldWorkspace<A> workspace;
    // Rows of a linear gradient: component a of spin s is row a * spins + s.
    std::vector<int64_t> first, column;
    // Of each component, spin or entry.
    AlignedArray<Number> metric, root, added, turn, offset, weight;
    Number size;  // of the noise

    int64_t coordinate(int64_t k) const { return bath.spins.coordinate[k / spins][k % spins]; }

    void read(SpinBath& one, int lane) {
        int64_t e = 0;
        for (int64_t k = 0; k < 3 * spins; ++k) {
            const int64_t at = k / spins * bath.stride + k % spins;
            set_lane(metric.at[k], lane, one.metric[at]);
            set_lane(root.at[k], lane, one.root[at]);
            if (bath.adds) set_lane(added.at[k], lane, one.added[at]);
            if (k < spins) set_lane(turn.at[k], lane, one.turn[k]);
            if (!bath.measures()) continue;
            set_lane(offset.at[k], lane, one.rows.each_entry(k % spins, int(k / spins), [&](double value, int64_t) {
                set_lane(weight.at[e++], lane, value);
            }));
        }
        set_lane(size, lane, one.amplitude());
    }

    void find_lengths() {
        for (int64_t s = 0; s < spins; ++s) {
            const A x[3] = {start.at[s], start.at[spins + s], start.at[2 * spins + s]};
            const A length = square_root(SpinBath::dot(x, x));
            inverse.at[s] = select(length > A(0.0), 1.0 / length, A(0.0));
        }
    }

    A row(const A* y, int64_t k) const {
        A sum(offset.at[k]);
        for (int64_t e = first[k]; e < first[k + 1]; ++e) sum = fma(A(weight.at[e]), y[column[e]], sum);
        return sum;
    }

    // In the order of `SpinRows::energy`.
    A energy() const {
        A sums[SpinBath::W] = {A(0.0), A(0.0), A(0.0), A(0.0), A(0.0), A(0.0), A(0.0), A(0.0)};
        for (int64_t k = 0; k < 3 * spins; ++k)
            sums[k % spins] = fma(start.at[k], 0.5 * (row(start.at, k) + A(offset.at[k])), sums[k % spins]);
        return ((sums[0] + sums[4]) + (sums[2] + sums[6])) + ((sums[1] + sums[5]) + (sums[3] + sums[7]));
    }

    void shake(const Number& size, int side) {
        for (int64_t s = 0; s < spins; ++s) {
            A x[3];
            for (int a = 0; a < 3; ++a) x[a] = start.at[a * spins + s];
            for (int k = 0; k < 3; ++k) {
                const int a = side ? 2 - k : k, b = (a + 1) % 3, c = (a + 2) % 3;
                const A length = A(size) * deviates.at[bath.spins.coordinate[a][s]];
                A angle = A(root.at[a * spins + s]) * length;
                if (bath.adds) angle *= square_root(inverse.at[s]);
                const Rotation<A> rotation = rotation_by(A(turn.at[s]) * angle);
                const A one = x[b], two = x[c];
                x[b] = one + fma(rotation.cosm1, one, rotation.sine * two);
                x[c] = two + fma(rotation.cosm1, two, -(rotation.sine * one));
            }
            for (int a = 0; a < 3; ++a) start.at[a * spins + s] = x[a];
        }
    }

    void find_gradients(const A* y, double t) {
        if (bath.measures()) {
            for (int64_t k = 0; k < 3 * spins; ++k) gradients.at[k] = row(y, k);
            return;
        }
        for (int64_t k = 0; k < 3 * spins; ++k) point.at[coordinate(k)] = y[k];
        gradient(field, constants, point.at, A(t), slope.at, workspace);
        for (int64_t k = 0; k < 3 * spins; ++k) gradients.at[k] = slope.at[coordinate(k)];
    }

    // As `SpinBath::settle`.
    A settle(double t, double tau, const A& scale, const Mask& moving) {
        A status = double(NOT_CONVERGED), last(std::numeric_limits<double>::infinity()), begun = last;
        Mask running = moving;
        iterations = evaluations = A(0.0);
        residual = A(std::numeric_limits<double>::quiet_NaN());
        std::copy_n(start.at, 3 * spins, middle.at);
        for (int64_t k = 1; k <= SpinBath::MOST_MIDPOINTS && any(running); ++k) {
            iterations = select(running, A(double(k)), iterations);
            evaluations = iterations;
            InterruptCheck::of_this_call().after(Numbers<A>::lanes * (work_of(field) + 64 * field.size));
            find_gradients(middle.at, t);
            const A change = iterate(tau, running);
            residual = select(running, change, residual);
            const Mask valid = change - change == A(0.0);
            status = select(running & !valid, A(double(OVERFLOWED)), status);
            if (k == 1) begun = change;
            const Mask falling = change < 0.5 * last;
            Mask settled = (change == A(0.0)) | (!falling & (change <= A(SpinBath::NEAR_ROUND_OFF) * scale));
            if (k > 1) settled = settled | (falling & (change * (change / last) <= A(SpinBath::REST) * scale));
            status = select(running & valid & settled, A(double(DONE)), status);
            running = running & valid & !settled & !(change > A(SpinBath::GROWN) * (begun + scale));
            last = change;
        }
        iterations = select(running, iterations + 1.0, iterations);
        return status;
    }

    // As `SpinBath::iterate`; of the members that are not `running` `half` stays.
    A iterate(double tau, const Mask& running) {
        A most(0.0), sum(0.0);
        for (int64_t s = 0; s < spins; ++s) {
            A x[3], y[3], u[3], v[3], now[3];
            const A turning(turn.at[s]), factor = A(0.5 * tau) * (turning * turning);
            for (int a = 0; a < 3; ++a) {
                x[a] = start.at[a * spins + s];
                y[a] = middle.at[a * spins + s];
                u[a] = gradients.at[a * spins + s];
            }
            cross_of(y, u, v);
            for (int a = 0; a < 3; ++a) v[a] = A(metric.at[a * spins + s]) * (factor * v[a]);
            for (int a = 0; bath.adds && a < 3; ++a)
                v[a] = fma(A(0.5 * tau) * turning * A(added.at[a * spins + s]), u[a], inverse.at[s] * v[a]);
            SpinBath::rotate(v, x, now);
            for (int a = 0; a < 3; ++a) {
                most = larger(most, absolute(now[a] - y[a]));
                middle.at[a * spins + s] = now[a];
                half.at[a * spins + s] = select(running, v[a], half.at[a * spins + s]);
            }
            sum += now[0];
        }
        return most + 0.0 * sum;
    }
};

}  // namespace coadjoint
