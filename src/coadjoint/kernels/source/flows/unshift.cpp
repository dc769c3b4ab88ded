// The effect on the group element of a Casimir that was subtracted from the Hamiltonian: g(t) = g0 exp(t X)
// g_shifted(t), X constant and linear in the initial momentum. The components of X and their kinds are in the tables,
// computed once for a system (`coadjoint.program.group_correction`, which documents them); only numbers are
// computed here.
#include <limits>

#include "numbers/arithmetic.hpp"
#include "flows/skew_planes.hpp"
#include "boundary/codes.hpp"
#include "recording/saved_steps.hpp"

namespace coadjoint {

namespace {

constexpr int64_t TAYLOR = 20;   // the remainder of the series, 1/21! = 2e-20, is below rounding for norms up to 1
constexpr int64_t POWERS = 5;    // powers of D from which the series is summed

void add(double factor, const Matrix& from, Matrix& to) {
    for (size_t e = 0; e < from.size(); ++e) to[e] += factor * from[e];
}

// sinh(w t)/w and (cosh(w t) - 1)/w^2 for w^2 = lam of either sign, root = |w|: t and t^2/2 if lam is 0.
Rotation<double> entire_rotation(double lam, double root, double t) {
    const double z = lam * t * t;
    if (absolute(z) < 0.25) {
        const Rotation<double> series = entire_series(z);
        return {t * series.sine, t * t * (absolute(z) < 1e-30 ? 0.5 : series.cosm1 / z)};
    }
    const Rotation<double> rotation = lam < 0.0 ? rotation_by(root * t) : hyperbolic_rotation(root * t);
    return {rotation.sine / root, rotation.cosm1 / lam};
}

// A component of X, D times a power of two, and its exp(t X) - 1.
class Component {
  public:
    Component(const UnshiftTables& tables, int64_t b, const double* x)
        : m(tables.begin[b + 1] - tables.begin[b]),
          coordinates(tables.coordinate + tables.begin[b]),
          kind(tables.kind[b]),
          order(tables.order[b]),
          D(m * m),
          increment(m * m) {
        for (uint32_t f = tables.form[b]; f < tables.form[b + 1]; ++f) {
            double sum = 0.0;
            for (uint32_t e = tables.entry[f]; e < tables.entry[f + 1]; ++e)
                sum = fma(tables.weight[e], x[tables.column[e]], sum);
            D[tables.cell[f]] = sum;
        }
        double largest = 0.0;
        for (double value : D) largest = std::max(largest, absolute(value));
        zero = largest == 0.0;
        if (zero) return;
        // So that its squares neither overflow nor underflow.
        int exponent;
        std::frexp(largest, &exponent);
        exponent = std::max(exponent - 1, -1023);
        scale = std::ldexp(1.0, exponent);
        const double factor = std::ldexp(1.0, -exponent);
        for (double& value : D) value *= factor;
        if (tables.leaning[b]) set_fixed_vector(x);
        if (kind == turns::NILPOTENT || kind == turns::GENERAL) find_powers();
        if (kind == turns::PLANE && m == 2) find_plane();
        if (kind == turns::CUBIC) find_cubic();
        if (kind == turns::PAIR) find_pair();
        if (kind == turns::SKEW) find_planes(tables.metric[b] < 0 ? nullptr : tables.metrics + tables.metric[b]);
    }

    // Compute exp(t X) - 1.
    void move_to(double time) {
        if (zero) return;
        const double t = time * scale;
        std::fill(increment.begin(), increment.end(), 0.0);
        if (kind == turns::NILPOTENT) {
            double power = 1.0;
            for (const Matrix& next : powers) add(power *= t, next, increment);
        }
        if (kind == turns::PLANE) plane_at(t);
        if (kind == turns::CUBIC) {
            const Rotation<double> rotation = entire_rotation(lam, root, t);
            for (int64_t e = 0; e < m * m; ++e) increment[e] = fma(rotation.sine, D[e], rotation.cosm1 * powers[0][e]);
        }
        if (kind == turns::PAIR) pair_at(t);
        if (kind == turns::SKEW) planes_at(t);
        if (kind == turns::GENERAL) series_at(t);
        if (!fixed_vector.empty()) {
            // X leaves x unchanged. Rounded, X would move x away linearly in time.
            change.assign(m, 0.0);
            add_product(increment.data(), fixed_vector.data(), change.data(), m, m, 1);
            for (int64_t j = 0; j < m; ++j)
                for (int64_t i = 0; i < m; ++i) increment[j * m + i] -= change[i] * fixed_vector[j];
        }
    }

    // w += (exp(t X) - 1) v, for matrices of `size` rows and columns.
    void apply(const double* v, double* w, int64_t size) {
        if (zero) return;
        if (m == size) return add_product(increment.data(), v, w, m, m, size);
        selected.resize(m * size);
        change.assign(m * size, 0.0);
        for (int64_t j = 0; j < size; ++j)
            for (int64_t i = 0; i < m; ++i) selected[j * m + i] = v[j * size + coordinates[i]];
        add_product(increment.data(), selected.data(), change.data(), m, m, size);
        for (int64_t j = 0; j < size; ++j)
            for (int64_t i = 0; i < m; ++i) w[j * size + coordinates[i]] += change[j * m + i];
    }

  private:
    const int64_t m;
    const uint32_t* coordinates;
    const int kind, order;
    Matrix D, increment, fixed_vector, selected, change, left, right, rotated;
    std::vector<Matrix> powers;
    std::vector<double> frequency;
    double scale = 1.0, lam = 0.0, root = 0.0, mean = 0.0, other_root = 0.0;
    bool zero;

    void set_fixed_vector(const double* x) {
        double largest = 0.0;
        for (int64_t i = 0; i < m; ++i) largest = std::max(largest, absolute(x[coordinates[i]]));
        if (largest == 0.0) return;
        for (int64_t i = 0; i < m; ++i) fixed_vector.push_back(x[coordinates[i]] / largest);
        const double length = std::sqrt(dot(fixed_vector.data(), fixed_vector.data(), m));
        for (double& value : fixed_vector) value /= length;
    }

    // D, D^2/2, D^3/6, ... up to the last that is not zero; for a series the first few powers.
    void find_powers() {
        powers.push_back(D);
        for (int64_t k = 2; k <= (kind == turns::GENERAL ? POWERS : order); ++k) {
            powers.push_back(product(D.data(), powers.back().data(), m));
            if (kind == turns::NILPOTENT)
                for (double& value : powers.back()) value /= double(k);
        }
    }

    void find_plane() {
        mean = 0.5 * (D[0] + D[3]);
        D[0] = 0.5 * (D[0] - D[3]);
        D[3] = -D[0];
        lam = fma(D[0], D[0], D[1] * D[2]);
        root = std::sqrt(absolute(lam));
    }

    void plane_at(double t) {
        if (m == 1) {
            increment[0] = growth_by(t * D[0]).expm1;
            return;
        }
        const Growth<double> growth = growth_by(t * mean);
        const Rotation<double> rotation = entire_rotation(lam, root, t);
        add(growth.exp * rotation.sine, D, increment);
        const double even = fma(growth.exp, rotation.cosm1 * lam, growth.expm1);
        increment[0] += even;
        increment[3] += even;
    }

    // D^3 = lam D: the non-zero eigenvalues are `order` roots of lam.
    void find_cubic() {
        powers.push_back(product(D.data(), D.data(), m));
        for (int64_t i = 0; i < m; ++i) lam += powers[0][i * (m + 1)];
        lam /= order;
        root = std::sqrt(absolute(lam));
    }

    // The two commuting parts of a rotation of four dimensions: the square of each is a multiple of one.
    void find_pair() {
        const auto at = [&](int i, int j) { return D[4 * j + i]; };
        for (double s : {1.0, -1.0}) {
            const double a = 0.5 * (at(0, 1) + s * at(2, 3)), b = 0.5 * (at(0, 2) - s * at(1, 3)),
                         c = 0.5 * (at(0, 3) + s * at(1, 2));
            (s > 0.0 ? root : other_root) = std::sqrt(fma(a, a, fma(b, b, c * c)));
            powers.push_back({0, -a, -b, -c, a, 0, -s * c, s * b, b, s * c, 0, -s * a, c, -s * b, s * a, 0});
        }
        powers.push_back(product(powers[0].data(), powers[1].data(), 4));
    }

    void pair_at(double t) {
        const auto rotation_at_rate = [t](double rate) {
            const Rotation<double> rotation = rotation_by(rate * t);
            return Rotation<double>{rate > 0.0 ? rotation.sine / rate : t, rotation.cosm1};
        };
        const Rotation<double> one = rotation_at_rate(root), other = rotation_at_rate(other_root);
        add(one.sine * (1.0 + other.cosm1), powers[0], increment);
        add(other.sine * (1.0 + one.cosm1), powers[1], increment);
        add(one.sine * other.sine, powers[2], increment);
        const double even = one.cosm1 + other.cosm1 + one.cosm1 * other.cosm1;
        for (int i = 0; i < 4; ++i) increment[5 * i] += even;
    }

    // If a metric L L^T is preserved, L^T D L^-T is the skew matrix.
    void find_planes(const double* metric) {
        Matrix skew = D;
        if (metric) {
            skew = product(product(metric, D.data(), m).data(), metric + m * m, m);
            for (int64_t j = 0; j < m; ++j)
                for (int64_t i = 0; i <= j; ++i) {
                    const double half = 0.5 * (skew[j * m + i] - skew[i * m + j]);
                    skew[j * m + i] = half;
                    skew[i * m + j] = -half;
                }
        }
        SkewPlanes planes = SkewPlanesOf(std::move(skew), m)();
        frequency = std::move(planes.frequency);
        left = std::move(planes.vectors);
        const int64_t count = 2 * int64_t(frequency.size());
        right.resize(m * count);
        rotated.resize(m * count);
        for (int64_t c = 0; c < count; ++c)
            for (int64_t j = 0; j < m; ++j)
                // Row j of L, times a vector; without a metric the vector itself.
                right[j * count + c] = metric ? dot(metric + j * m, &left[c * m], m) : left[c * m + j];
        if (metric) {
            Matrix back(left.size());
            add_product(metric + m * m, left.data(), back.data(), m, m, count);
            left = std::move(back);
        }
    }

    void planes_at(double t) {
        const int64_t pairs = int64_t(frequency.size()), count = 2 * pairs;
        for (int64_t p = 0; p < pairs; ++p) {
            const Rotation<double> rotation = rotation_by(frequency[p] * t);
            for (int64_t j = 0; j < m; ++j) {
                const double u = right[j * count + 2 * p], w = right[j * count + 2 * p + 1];
                rotated[j * count + 2 * p] = fma(rotation.cosm1, u, -(rotation.sine * w));
                rotated[j * count + 2 * p + 1] = fma(rotation.cosm1, w, rotation.sine * u);
            }
        }
        add_product(left.data(), rotated.data(), increment.data(), m, count, m);
    }

    // Taylor's series of exp(t D / 2^k) - 1 in powers of the fifth power of D, and k squarings.
    void series_at(double t) {
        double norm = 0.0;
        for (int64_t j = 0; j < m; ++j) {
            double sum = 0.0;
            for (int64_t i = 0; i < m; ++i) sum += absolute(D[j * m + i]);
            norm = std::max(norm, sum);
        }
        norm *= absolute(t);
        if (!(norm <= std::numeric_limits<double>::max())) {
            std::fill(increment.begin(), increment.end(), std::numeric_limits<double>::quiet_NaN());
            return;
        }
        int squarings;
        std::frexp(norm, &squarings);
        squarings = std::max(squarings, 0);
        const double fraction = std::ldexp(t, -squarings);
        double coefficient[TAYLOR + 1] = {1.0};
        for (int64_t k = 1; k <= TAYLOR; ++k) coefficient[k] = coefficient[k - 1] * fraction / double(k);
        Matrix next(m * m);
        for (int64_t group = TAYLOR / POWERS; group >= 0; --group) {
            std::fill(next.begin(), next.end(), 0.0);
            for (int64_t k = POWERS - 1; k > 0; --k)
                if (group * POWERS + k <= TAYLOR) add(coefficient[group * POWERS + k], powers[k - 1], next);
            if (group)
                for (int64_t i = 0; i < m; ++i) next[i * (m + 1)] += coefficient[group * POWERS];
            add_product(powers[POWERS - 1].data(), increment.data(), next.data(), m, m, m);
            increment.swap(next);
        }
        for (int k = 0; k < squarings; ++k) {
            // (1 + F)^2 - 1
            std::transform(increment.begin(), increment.end(), next.begin(), [](double value) { return 2.0 * value; });
            add_product(increment.data(), increment.data(), next.data(), m, m, m);
            increment.swap(next);
        }
    }
};

bool is_unit(const double* g, int64_t size) {
    for (int64_t e = 0; e < size * size; ++e)
        if (g[e] != (e % (size + 1) ? 0.0 : 1.0)) return false;
    return true;
}

void transpose(const double* from, double* to, int64_t size) {
    for (int64_t i = 0; i < size; ++i)
        for (int64_t j = 0; j < size; ++j) to[i * size + j] = from[j * size + i];
}

}  // namespace

// The group elements of a run from those of its loop. The initial ones have the same bits as the input.
EXPORT void unshift(const UnshiftTables* tables, const Unshifted* run, const Schedule* schedule) {
    const int64_t d = tables->size, square = d * d;
    Matrix moved(square), placed, before;
    std::vector<Component> components;
    components.reserve(tables->components);
    for (int64_t member = run->first; member < run->last; ++member) {
        components.clear();
        for (int64_t b = 0; b < tables->components; ++b)
            components.emplace_back(*tables, b, run->momenta + member * tables->dim);
        const double* initial = run->initial + member * square;
        const bool unit = is_unit(initial, d);
        if (!unit) {
            before.resize(square);
            transpose(initial, before.data(), d);
        }
        for (int64_t k = run->k0; k < run->k1; ++k) {
            const int64_t position = k * run->members + member, here = position * square;
            const double elapsed = run->elapsed ? run->elapsed[position] : double(step_of(*schedule, k)) * schedule->h;
            if (elapsed == 0.0) {
                std::copy_n(initial, square, run->out + here);
                continue;
            }
            const double* group = run->held + here;
            std::copy_n(group, square, moved.begin());
            for (Component& component : components) {
                component.move_to(run->rate * elapsed);
                component.apply(group, moved.data(), d);
            }
            if (!unit) {
                placed.assign(square, 0.0);
                add_product(before.data(), moved.data(), placed.data(), d, d, d);
            }
            transpose(unit ? moved.data() : placed.data(), run->out + here, d);
        }
    }
}

}  // namespace coadjoint
