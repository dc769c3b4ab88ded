// Damping and noise on the spheres of spins, eight spins at a time: rotations in closed form. If `extent` of the table is
// one, `turning` are multiples of the Hamiltonian field that are added, and `rate` is divided by the length of each spin.
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
        adds = table.extent == 1;
        if (adds) inverse.clear(stride + W), added.clear(3 * stride + W);
        largest.clear(W * ((stride + ALIGNED - 1) / ALIGNED));
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) {
                const int64_t i = table.shape == DIAGONAL ? spins.coordinate[a][s] : 0;
                metric[a * stride + s] = constants.number_at<double>(table.rate, i);
                root[a * stride + s] = constants.number_at<double>(table.aim, i);
                turn[a * stride + s] = spins.turn[s];
                if (adds) added[a * stride + s] = constants.number_at<double>(table.turning, i);
            }
        rows.read(field, constants, spins, stride);
        if (rows.empty()) gradients.resize(field.size), point.resize(field.size);
        side_by_side = true;
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) side_by_side = side_by_side && spins.coordinate[a][s] == 3 * s + a;
        if (amplitude() > 0.0 && !side_by_side) deviates.resize(field.size);
    }

    // Whether the algebra and the metric are supported.
    explicit operator bool() const { return usable; }

    bool measures() const { return !rows.empty(); }

    // Copy the midpoints of the last flow to their coordinates.
    void copy_midpoint(double* to) const {
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) to[spins.coordinate[a][s]] = midpoint[a * stride + s];
    }

    int64_t size() const { return spins.size(); }

    // Half of the noise, the midpoint rule of the damping, and half of the noise, as `Force::stay_on_orbit`. Threads wait
    // for one another only where spins need their neighbors.
    int64_t flow(double* x, double t, double tau, int64_t member, FieldWorkspace<double>& workspace) {
        share(stride, [&](int64_t first, int64_t last) {
            by_component(x, first, last, start);
            if (adds) by_length(first, last);
        });
        const double before = measures() ? rows.energy(start.at, stride) : 0.0;
        const Noise first_half = noise_of(t, tau, 0, member);
        const double scale = largest_of([&](int64_t first, int64_t last) {
            A most(0.0);
            if (first_half.size > 0.0) shake(first_half, 0, first, last);
            for (int a = 0; a < 3; ++a)
                for (int64_t s = first; s < last; s += W) most = larger(most, absolute(load<A>(&start[a * stride + s])));
            return most;
        });
        if (rows.empty()) std::copy_n(x, field.size, point.data());
        const int64_t status = settle(t + 0.5 * tau, tau, scale, workspace);
        if (status != DONE) return status;
        const Noise second_half = noise_of(t, tau, 1, member);
        share(stride, [&](int64_t first, int64_t last) {
            for (int64_t low = first; low < last; low += ALIGNED) {
                const int64_t high = std::min(last, low + ALIGNED);
                turn_by_slope(low, high);
                if (second_half.size > 0.0) shake(second_half, 1, low, high);
            }
        });
        if (measures()) change = rows.energy(start.at, stride) - before;
        share(stride, [&](int64_t first, int64_t last) { to_coordinates(start, first, last, x); });
        return finite(field.size, x) ? DONE : OVERFLOWED;
    }

  private:
    template <class C>
    friend class SpinBathOfLanes;
    typedef SpinRows::A A;
    static constexpr int W = SpinRows::W;
    // Midpoint iterations: some ten converge.
    static constexpr int64_t MOST_MIDPOINTS = 192;
    // Of the state: residuals that may stagnate as round-off, multiple of the first one that diverges, and predicted
    // residual that ends the iteration. Squares of angles up to SMALL_SQUARE have a series.
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
    bool side_by_side = false;  // whether the coordinates of the spins follow one another
    bool adds = false;  // whether multiples of the Hamiltonian field are added, and rates divided by lengths of spins
    Components start, middle, next, slope, metric, root, turn, largest, inverse, added;
    std::vector<double> deviates, gradients, point;
    const double* midpoint = nullptr;  // of the last flow, by component

    double amplitude() const { return constants.number_at<double>(table.amplitude, 0); }

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

    struct Noise {
        DeviateStream stream;
        double size;
    };

    // The noise of one half of the time tau; its deviates are drawn now unless each thread draws those of its spins.
    Noise noise_of(double t, double tau, int half, int64_t member) {
        const Noise noise{DeviateStream(uint64_t(table.seed), uint64_t(table.stream + member), t, uint64_t(half)),
                          amplitude() * std::sqrt(0.5 * tau)};
        if (noise.size > 0.0) InterruptCheck::of_this_call().after(64 * field.size);
        if (noise.size > 0.0 && !side_by_side) noise.stream.fill(field.size, deviates.data());
        return noise;
    }

    // Half of the noise of at most `ALIGNED` spins: rotations about the axes, one after the other, in the second half in
    // reversed order.
    INLINE void shake(const Noise& noise, int half, int64_t first, int64_t last) {
        double drawn[3 * ALIGNED];
        if (side_by_side) noise.stream.draw(3 * first, std::min(field.size, 3 * last), drawn);
        by_component(side_by_side ? drawn - 3 * first : deviates.data(), first, last, slope);
        for (int64_t s = first; s < last; s += W) {
            A x[3];
            for (int a = 0; a < 3; ++a) x[a] = load<A>(&start[a * stride + s]);
            const A turning = load<A>(&turn[s]);
            for (int k = 0; k < 3; ++k) {
                const int a = half ? 2 - k : k, b = (a + 1) % 3, c = (a + 2) % 3;
                const A length = A(noise.size) * load<A>(&slope[a * stride + s]);
                A angle = load<A>(&root[a * stride + s]) * length;
                if (adds) angle *= square_root(load<A>(&inverse[s]));
                const Rotation<A> rotation = rotation_by(turning * angle);
                const A one = x[b], two = x[c];
                x[b] = one + fma(rotation.cosm1, one, rotation.sine * two);
                x[c] = two + fma(rotation.cosm1, two, -(rotation.sine * one));
            }
            for (int a = 0; a < 3; ++a) store(&start[a * stride + s], x[a]);
        }
    }

    // Copy numbers of the coordinates of spins, spin after spin, to components side by side, and back.
    INLINE void by_component(const double* from, int64_t first, int64_t last, Components& to) {
        last = std::min(last, spins.size());
        for (int a = 0; a < 3; ++a)
            for (int64_t s = first; s < last; ++s) to[a * stride + s] = from[spins.coordinate[a][s]];
    }
    INLINE void to_coordinates(Components& from, int64_t first, int64_t last, double* to) {
        last = std::min(last, spins.size());
        for (int a = 0; a < 3; ++a)
            for (int64_t s = first; s < last; ++s) to[spins.coordinate[a][s]] = from[a * stride + s];
    }

    // The inverse lengths of spins; zero for those that are zero, which do not move.
    INLINE void by_length(int64_t first, int64_t last) {
        last = std::min(last, spins.size());
        for (int64_t s = first; s < last; ++s) {
            const double x[] = {start[s], start[stride + s], start[2 * stride + s]};
            const double length = std::sqrt(fma(x[0], x[0], fma(x[1], x[1], x[2] * x[2])));
            inverse[s] = length > 0.0 ? 1.0 / length : 0.0;
        }
    }

    // sin(w)/w and (1 - cos(w))/w^2 for the square of w, each lane by itself.
    template <class B>
    static INLINE void rotation_by_square(const B& square, B& first, B& second) {
        first = second = B(0.0);
        for (int k = 4; k >= 0; --k) {
            first = fma(-square, first, B(INVERSE_FACTORIALS[2 * k + 1].high));
            second = fma(-square, second, B(INVERSE_FACTORIALS[2 * k + 2].high));
        }
        const auto small = square <= B(SMALL_SQUARE);
        if (__builtin_expect(all(small), 1)) return;
        const B w = square_root(square);
        const Rotation<B> rotation = rotation_by(w);
        first = select(small, first, rotation.sine / w);
        second = select(small, second, -(rotation.cosm1 / square));
    }

    // Set out to x of eight spins rotated by v: exp(D_v) x for the bracket J(x) v = x cross v.
    template <class B>
    static INLINE void rotate(const B* v, const B* x, B* out) {
        B across[3], back[3], first, second;
        rotation_by_square(dot(v, v), first, second);
        cross_of(x, v, across);
        cross_of(across, v, back);
        for (int a = 0; a < 3; ++a) out[a] = x[a] + fma(first, across[a], second * back[a]);
    }

    template <class B>
    static INLINE B dot(const B* v, const B* w) { return fma(v[0], w[0], fma(v[1], w[1], v[2] * w[2])); }

    // The midpoint rule on the orbits: x_new = exp(D_v) x, with v = tau P J(y) grad H(y) at y = exp(D_v / 2) x, where
    // D_v x = turn x cross v. Leaves turn v / 2 in `slope`.
    int64_t settle(double t, double tau, double scale, FieldWorkspace<double>& workspace) {
        double last = std::numeric_limits<double>::infinity(), first = last;
        iterations = evaluations = 0;
        const double* y = start.at;
        for (;;) {
            if (++iterations > MOST_MIDPOINTS) return NOT_CONVERGED;
            ++evaluations;
            InterruptCheck::of_this_call().after(work_of(field) + 64 * field.size);
            if (rows.empty()) general_gradient(y, t, workspace);
            double* const better = y == middle.at ? next.at : middle.at;
            residual = largest_of([&](int64_t first, int64_t last) { return iterate(y, tau, first, last, better); });
            midpoint = y = better;
            if (!(residual - residual == 0.0)) return OVERFLOWED;
            if (iterations == 1) first = residual;
            // Stop if the next correction, extrapolated, is round-off, or if corrections are, and have stopped falling.
            const bool falling = residual < 0.5 * last;
            if (residual == 0.0 || (!falling && residual <= NEAR_ROUND_OFF * scale)) return DONE;
            if (falling && iterations > 1 && residual * (residual / last) <= REST * scale) return DONE;
            if (residual > GROWN * (first + scale)) return NOT_CONVERGED;
            last = residual;
        }
    }

    // Set `better` to exp(D_v / 2) x for v at y, for some spins; return the largest corrections. If a component is not a
    // number, the others are not either.
    INLINE A iterate(const double* y_at, double tau, int64_t first, int64_t last, double* better) {
        A most(0.0), sum(0.0);
        for (int64_t s = first; s < last; s += W) {
            A x[3], y[3], u[3], half[3], now[3];
            const A turning = load<A>(&turn[s]), factor = A(0.5 * tau) * (turning * turning);
            for (int a = 0; a < 3; ++a) {
                x[a] = load<A>(&start[a * stride + s]);
                y[a] = load<A>(y_at + a * stride + s);
                u[a] = rows.empty() ? load<A>(&slope[a * stride + s]) : rows(y_at, s, a);
            }
            cross_of(y, u, half);
            for (int a = 0; a < 3; ++a) half[a] = load<A>(&metric[a * stride + s]) * (factor * half[a]);
            if (adds)
                for (int a = 0; a < 3; ++a)
                    half[a] = fma(A(0.5 * tau) * turning * load<A>(&added[a * stride + s]), u[a],
                                  load<A>(&inverse[s]) * half[a]);
            rotate(half, x, now);
            for (int a = 0; a < 3; ++a) {
                most = larger(most, absolute(now[a] - y[a]));
                store(better + a * stride + s, now[a]);
                store(&slope[a * stride + s], half[a]);
            }
            sum += now[0];
        }
        return most + 0.0 * sum;
    }

    INLINE void turn_by_slope(int64_t first, int64_t last) {
        for (int64_t s = first; s < last; s += W) {
            A x[3], v[3], now[3];
            for (int a = 0; a < 3; ++a) x[a] = load<A>(&start[a * stride + s]), v[a] = 2.0 * load<A>(&slope[a * stride + s]);
            rotate(v, x, now);
            for (int a = 0; a < 3; ++a) store(&start[a * stride + s], now[a]);
        }
    }

    // The largest number that `visit` returns for slices of at most `ALIGNED` spins; NaN if any is.
    template <class Visit>
    double largest_of(const Visit& visit) {
        share(stride, [&](int64_t first, int64_t last) {
            for (int64_t low = first; low < last; low += ALIGNED)
                store(&largest[low / ALIGNED * W], visit(low, std::min(last, low + ALIGNED)));
        });
        A most(0.0), sum(0.0);
        for (int64_t low = 0; low < stride; low += ALIGNED) {
            const A one = load<A>(&largest[low / ALIGNED * W]);
            most = larger(most, one);
            sum += 0.0 * one;
        }
        return all(sum == A(0.0)) ? largest_lane(most) : std::numeric_limits<double>::quiet_NaN();
    }

    // The gradient of any H at y.
    void general_gradient(const double* y, double t, FieldWorkspace<double>& workspace) {
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) point[spins.coordinate[a][s]] = y[a * stride + s];
        gradient(field, constants, point.data(), t, gradients.data(), workspace);
        for (int a = 0; a < 3; ++a)
            for (int64_t s = 0; s < spins.size(); ++s) slope[a * stride + s] = gradients[spins.coordinate[a][s]];
    }
};

}  // namespace coadjoint
