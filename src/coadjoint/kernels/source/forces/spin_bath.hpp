// Damping and noise on the spheres of spins, eight spins at a time: rotations in closed form.
#pragma once

#include "forces/random.hpp"
#include "forces/spin_rows.hpp"
#include "numbers/arithmetic.hpp"
#include "recording/watching.hpp"

namespace coadjoint {

class SpinBath {
  public:
    int64_t iterations = 0, evaluations = 0;
    double residual = 0.0, change = 0.0;  // the last correction; the change of the energy, if it `measures` it

    SpinBath(const ForceTable& table, const Field& field, const MemberConstants& constants)
        : table(table), field(field), constants(constants) {
        usable = table.shape != FULL && spins.find(field, constants) && in_order();
        if (!usable) return;
        stride = (spins.size() + W - 1) / W * W;
        for (auto* array : {&start, &middle, &next, &slope, &metric, &root, &turn}) array->clear(3 * stride + W);
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) {
                const int64_t i = table.shape == DIAGONAL ? spins.coordinate[a][s] : 0;
                metric[a * stride + s] = table.rate[i];
                root[a * stride + s] = table.aim[i];
                turn[a * stride + s] = spins.turn[s];
            }
        rows.read(field, constants, spins, stride);
        if (rows.empty()) gradients.resize(field.size), point.resize(field.size);
        if (table.amplitude > 0.0) deviates.resize(field.size);
    }

    // Whether the algebra and the metric are supported.
    explicit operator bool() const { return usable; }

    bool measures() const { return !rows.empty(); }

    // Half of the noise, the midpoint rule of the damping, and half of the noise, as `Force::stay_on_orbit`.
    int64_t flow(double* x, double t, double tau, int64_t member, FieldWorkspace<double>& workspace) {
        by_component(x, start);
        const double before = measures() ? rows.energy(start.at, stride) : 0.0;
        if (table.amplitude > 0.0) shake(t, tau, 0, member);
        if (rows.empty()) std::copy_n(x, field.size, point.data());
        const int64_t status = settle(t + 0.5 * tau, tau, workspace);
        if (status != DONE) return status;
        if (table.amplitude > 0.0) shake(t, tau, 1, member);
        if (measures()) change = rows.energy(start.at, stride) - before;
        to_coordinates(start, x);
        return finite(field.size, x) ? DONE : OVERFLOWED;
    }

  private:
    typedef SpinRows::A A;
    static constexpr int W = SpinRows::W;
    static constexpr int64_t MOST_MIDPOINTS = 192;
    static constexpr double NEAR_ROUND_OFF = 0x1p-40, GROWN = 0x1p20, REST = 0x1p-52, SMALL_SQUARE = 0x1p-6;
    // Aligned to vectors.
    struct Components {
        AlignedArray<A> lanes{0};
        double* at = nullptr;
        void clear(int64_t count) { lanes.clear((count + W - 1) / W), at = reinterpret_cast<double*>(lanes.at); }
        INLINE double& operator[](int64_t k) { return at[k]; }
    };

    const ForceTable& table;
    const Field& field;
    const MemberConstants constants;
    Spins spins;
    SpinRows rows;
    bool usable = false;
    int64_t stride = 0;
    Components start, middle, next, slope, metric, root, turn;
    std::vector<double> deviates, gradients, point;

    // Whether the sets of a noise apply the directions of each spin in the order of its coordinates.
    bool in_order() const {
        std::vector<int64_t> set_of(field.size, -1);
        for (int64_t set = 0; set < table.sets; ++set)
            for (int64_t e = table.begin[set]; e < table.begin[set + 1]; ++e) set_of[table.direction[e]] = set;
        for (int64_t s = 0; s < spins.size(); ++s) {
            int64_t last = -1;
            for (int a = 0; a < 3; ++a) {
                const int64_t set = set_of[spins.coordinate[a][s]];
                if (set < 0) continue;
                if (set <= last) return false;
                last = set;
            }
        }
        return true;
    }

    // Half of the noise of the time tau: rotations about the axes, one after the other, in the second half in reversed
    // order.
    void shake(double t, double tau, int half, int64_t member) {
        InterruptCheck::of_this_call().after(64 * field.size);
        const double size = table.amplitude * std::sqrt(0.5 * tau);
        normal_deviates(uint64_t(table.seed), uint64_t(table.stream + member), t, uint64_t(half), field.size,
                        deviates.data());
        by_component(deviates.data(), slope);
        share(stride, [&](int64_t first, int64_t last) {
            for (int64_t s = first; s < last; s += W) {
                A x[3];
                for (int a = 0; a < 3; ++a) x[a] = load<A>(&start[a * stride + s]);
                const A turning = load<A>(&turn[s]);
                for (int k = 0; k < 3; ++k) {
                    const int a = half ? 2 - k : k, b = (a + 1) % 3, c = (a + 2) % 3;
                    const A length = A(size) * load<A>(&slope[a * stride + s]);
                    const Rotation<A> rotation = rotation_by(turning * (load<A>(&root[a * stride + s]) * length));
                    const A one = x[b], two = x[c];
                    x[b] = one + fma(rotation.cosm1, one, rotation.sine * two);
                    x[c] = two + fma(rotation.cosm1, two, -(rotation.sine * one));
                }
                for (int a = 0; a < 3; ++a) store(&start[a * stride + s], x[a]);
            }
        });
    }

    // Copy numbers of the coordinates of spins, spin after spin, to components side by side, and back.
    void by_component(const double* from, Components& to) {
        for (int a = 0; a < 3; ++a)
            share(spins.size(), [&](int64_t first, int64_t last) {
                for (int64_t s = first; s < last; ++s) to[a * stride + s] = from[spins.coordinate[a][s]];
            });
    }
    void to_coordinates(Components& from, double* to) {
        for (int a = 0; a < 3; ++a)
            share(spins.size(), [&](int64_t first, int64_t last) {
                for (int64_t s = first; s < last; ++s) to[spins.coordinate[a][s]] = from[a * stride + s];
            });
    }

    // sin(w)/w and (1 - cos(w))/w^2 for the square of w, each lane by itself.
    static INLINE void rotation_by_square(const A& square, A& first, A& second) {
        first = second = A(0.0);
        for (int k = 4; k >= 0; --k) {
            first = fma(-square, first, A(INVERSE_FACTORIALS[2 * k + 1].high));
            second = fma(-square, second, A(INVERSE_FACTORIALS[2 * k + 2].high));
        }
        const auto small = square <= A(SMALL_SQUARE);
        if (__builtin_expect(all(small), 1)) return;
        const A w = square_root(square);
        const Rotation<A> rotation = rotation_by(w);
        first = select(small, first, rotation.sine / w);
        second = select(small, second, -(rotation.cosm1 / square));
    }

    // Set out to D_v x = turn x cross v.
    static INLINE void turned(const A& turning, const A* x, const A* v, A* out) {
        for (int a = 0; a < 3; ++a) {
            const int b = (a + 1) % 3, c = (a + 2) % 3;
            out[a] = turning * fma(x[b], v[c], -(x[c] * v[b]));
        }
    }

    // Set out to exp(D_v) x for v of eight spins.
    static INLINE void rotate(const A& turning, const A* v, const A* x, A* out) {
        A across[3], back[3], first, second;
        rotation_by_square(turning * turning * dot(v, v), first, second);
        turned(turning, x, v, across);
        turned(turning, across, v, back);
        for (int a = 0; a < 3; ++a) out[a] = x[a] + fma(first, across[a], second * back[a]);
    }

    static INLINE A dot(const A* v, const A* w) { return fma(v[0], w[0], fma(v[1], w[1], v[2] * w[2])); }

    // The midpoint rule on the orbits: x_new = exp(D_v) x, with v = tau P J(y) grad H(y) at y = exp(D_v / 2) x.
    int64_t settle(double t, double tau, FieldWorkspace<double>& workspace) {
        std::copy_n(start.at, 3 * stride, middle.at);
        double last = std::numeric_limits<double>::infinity(), first = last;
        const double scale = largest_of_blocks([&](int64_t s) {
            A largest(0.0);
            for (int a = 0; a < 3; ++a) largest = larger(largest, absolute(load<A>(&start[a * stride + s])));
            return largest;
        });
        iterations = evaluations = 0;
        for (;;) {
            if (++iterations > MOST_MIDPOINTS) return NOT_CONVERGED;
            ++evaluations;
            InterruptCheck::of_this_call().after(work_of(field) + 64 * field.size);
            if (rows.empty()) general_gradient(t, workspace);
            residual = largest_of_blocks([&](int64_t s) {
                A x[3], y[3], u[3], v[3], half[3], most(0.0);
                const A turning = load<A>(&turn[s]);
                for (int a = 0; a < 3; ++a) {
                    x[a] = load<A>(&start[a * stride + s]);
                    y[a] = load<A>(&middle[a * stride + s]);
                    u[a] = rows.empty() ? load<A>(&slope[a * stride + s]) : rows(middle.at, s, a);
                }
                turned(turning, y, u, v);
                for (int a = 0; a < 3; ++a) {
                    v[a] = load<A>(&metric[a * stride + s]) * (A(tau) * v[a]);
                    half[a] = 0.5 * v[a];
                }
                A now[3];
                rotate(turning, half, x, now);
                for (int a = 0; a < 3; ++a) {
                    most = larger(most, absolute(now[a] - y[a]));
                    store(&next[a * stride + s], now[a]);
                    store(&slope[a * stride + s], v[a]);
                }
                return most;
            });
            std::swap(middle.at, next.at);
            if (!(residual - residual == 0.0)) return OVERFLOWED;
            if (iterations == 1) first = residual;
            // Stop if the next correction, extrapolated, is round-off, or if corrections are, and have stopped falling.
            const bool falling = residual < 0.5 * last;
            if (residual == 0.0 || (!falling && residual <= NEAR_ROUND_OFF * scale)) break;
            if (falling && iterations > 1 && residual * (residual / last) <= REST * scale) break;
            if (residual > GROWN * (first + scale)) return NOT_CONVERGED;
            last = residual;
        }
        share(stride, [&](int64_t first, int64_t last) {
            for (int64_t s = first; s < last; s += W) {
                A x[3], v[3], now[3];
                for (int a = 0; a < 3; ++a)
                    x[a] = load<A>(&start[a * stride + s]), v[a] = load<A>(&slope[a * stride + s]);
                rotate(load<A>(&turn[s]), v, x, now);
                for (int a = 0; a < 3; ++a) store(&start[a * stride + s], now[a]);
            }
        });
        return DONE;
    }

    // The largest number that `visit` returns for eight spins, for all of them; NaN if any is.
    template <class Visit>
    double largest_of_blocks(const Visit& visit) {
        AlignedArray<A> found((stride + SUMMED - 1) / SUMMED);
        shared_sum<A>(stride, [&](int64_t first, int64_t last) {
            A most(0.0), sum(0.0);
            for (int64_t s = first; s < last; s += W) {
                const A one = visit(s);
                most = larger(most, one);
                sum += one;
            }
            found.at[first / SUMMED] = most + 0.0 * sum;
            return most;
        });
        A most(0.0), sum(0.0);
        for (int64_t b = 0; b < (stride + SUMMED - 1) / SUMMED; ++b) {
            most = larger(most, found.at[b]);
            sum += 0.0 * found.at[b];
        }
        return all(sum == A(0.0)) ? largest_lane(most) : std::numeric_limits<double>::quiet_NaN();
    }

    // The gradient of any H at the middle.
    void general_gradient(double t, FieldWorkspace<double>& workspace) {
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) point[spins.coordinate[a][s]] = middle[a * stride + s];
        gradient(field, constants, point.data(), t, gradients.data(), workspace);
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) slope[a * stride + s] = gradients[spins.coordinate[a][s]];
    }
};

}  // namespace coadjoint
