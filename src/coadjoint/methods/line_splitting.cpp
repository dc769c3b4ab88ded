// A splitting of the fluid on the torus into the exact flows of lines of modes, {j k} for a direction k mod n.
//
// W has the entries sum over j of v(j, d) omega^(j (d + 2 a)) at (a, a + d), omega = exp(2 pi i / n), all mod n. A
// change of both indices by a matrix of determinant one, (j, d) -> j k + d l, is an automorphism, which makes the modes
// of a line diagonal matrices. Their flow multiplies the entries (a, b) by exp(i h (theta_a - theta_b)), where i theta
// is the diagonal of the stream of the line: a Fourier transform along each coset d of the line, a product, and the
// inverse transform.
#include "boundary/interrupts.hpp"
#include "matrices/compiled_transforms.hpp"
#include "numbers/thread_team.hpp"
#include "steps/step_scheme.hpp"

namespace coadjoint {

namespace {

constexpr int64_t L = SIDE_BY_SIDE;

struct LineSplitting final : StepScheme {
    struct Line {
        int64_t k1, k2, l1, l2;
    };

    const int64_t n, half, groups, lines;
    const Line* line;
    const double *factor, *constant;  // the stream of a mode: its factor times the mode, and a constant
    Fourier<double> one;
    Fourier<Eight> eight;
    // Modes at the start of the step and their increments, n x n, real and imaginary parts separate.
    std::vector<double> re, im, added_re, added_im;
    // exp(i h theta) - 1 at s, and at -s, beyond one period.
    std::vector<double> up_re, up_im, down_re, down_im;
    std::vector<double> move_re, move_im;

    explicit LineSplitting(const StepTables& tables, const MemberConstants&)
        : n(tables.whole[0]), half(n / 2), groups((half + L - 1) / L), lines(n + 1),
          line(reinterpret_cast<const Line*>(tables.whole + 2)), factor(tables.coefficients),
          constant(tables.whole[1] ? factor + n * n : nullptr), one(n), eight(n), re(n * n), im(n * n),
          added_re(n * n), added_im(n * n), up_re(3 * n + L), up_im(up_re), down_re(up_re), down_im(up_re),
          move_re(n), move_im(n) {
        work = 4 * n * n;
    }

    int64_t step(double* x, double* dx, double*, double*, double, double h) override {
        evaluations = 2 * lines - 1;
        const Complex* W = reinterpret_cast<const Complex*>(x);
        to_modes(W);
        std::fill(added_re.begin(), added_re.end(), 0.0);
        std::fill(added_im.begin(), added_im.end(), 0.0);
        for (int64_t k = 0; k < lines; ++k) flow(line[k], k + 1 < lines ? 0.5 * h : h);
        for (int64_t k = lines - 2; k >= 0; --k) flow(line[k], 0.5 * h);
        add_modes(x, dx);
        return DONE;
    }

  private:
    int64_t wrapped(int64_t k) const { return k < n ? k : k - n; }
    int64_t opposite(int64_t k) const { return k ? n - k : 0; }

    // v of W: eight cyclic diagonals side by side. Those of -d are minus the conjugates of those of d.
    void to_modes(const Complex* W) {
        share_with_copies(eight, half / L + 1, [&](Fourier<Eight>& own, int64_t group) {
            ComplexNumber<Eight>* row = own.input();
            const int64_t first = group * L, lanes = std::min(L, half + 1 - first);
            std::fill_n(numbers_of(row[0]), 2 * L * n, 0.0);
            for (int64_t lane = 0; lane < lanes; ++lane)
                for (int64_t a = 0; a < n; ++a) {
                    const int64_t d = first + lane;
                    double* to = numbers_of(row[(d + 2 * a) % n]) + lane;
                    to[0] = W[a * n + wrapped(a + d)].real();
                    to[L] = W[a * n + wrapped(a + d)].imag();
                }
            row = own.transform(row);
            for (int64_t j = 0; j < n; ++j)
                for (int64_t lane = 0; lane < lanes; ++lane) {
                    const int64_t d = first + lane, at = j * n + d, mirrored = opposite(j) * n + opposite(d);
                    if (d == 0 && j > half) continue;
                    re[at] = numbers_of(row[j])[lane] / double(n);
                    im[at] = numbers_of(row[j])[L + lane] / double(n);
                    re[mirrored] = -re[at];
                    im[mirrored] = im[at];
                }
        });
        re[0] = im[0] = 0.0;  // the unit matrix, which is constant
    }

    // W += the increments of its modes, with compensation.
    void add_modes(double* x, double* dx) {
        share_with_copies(eight, half / L + 1, [&](Fourier<Eight>& own, int64_t group) {
            ComplexNumber<Eight>* row = own.input();
            const int64_t first = group * L, lanes = std::min(L, half + 1 - first);
            std::fill_n(numbers_of(row[0]), 2 * L * n, 0.0);
            for (int64_t j = 0; j < n; ++j)
                for (int64_t lane = 0; lane < lanes; ++lane) {
                    numbers_of(row[j])[lane] = added_re[j * n + first + lane];
                    numbers_of(row[j])[L + lane] = added_im[j * n + first + lane];
                }
            row = own.transform(row);
            for (int64_t lane = 0; lane < lanes; ++lane)
                for (int64_t a = 0; a < n; ++a) {
                    const int64_t d = first + lane, b = wrapped(a + d), at = 2 * (a * n + b), other = 2 * (b * n + a);
                    const double* from = numbers_of(row[opposite((d + 2 * a) % n)]) + lane;
                    if (d) two_sum(x[at], from[0] + dx[at], x[at], dx[at]);
                    two_sum(x[at + 1], from[L] + dx[at + 1], x[at + 1], dx[at + 1]);
                    if (d == 0) continue;
                    x[other] = -x[at];
                    dx[other] = -dx[at];
                    x[other + 1] = x[at + 1];
                    dx[other + 1] = dx[at + 1];
                }
        });
    }

    // The exact flow of the modes of one line.
    void flow(const Line& k, double h) {
        set_phases(k, h);
        share_with_copies(eight, groups, [&](Fourier<Eight>& own, int64_t group) {
            ComplexNumber<Eight>* row = own.input();
            const int64_t first = 1 + group * L, lanes = std::min(L, half + 1 - first);
            gather(k, first, lanes, row);
            row = own.transform(row);
            for (int64_t s = 0; s < n; ++s) rotate(row[s], s, first);
            row = own.transform(row);
            scatter(k, first, lanes, row);
        });
        InterruptCheck::of_this_call().after(groups * L * (2 * eight.work() + 8 * n));
    }

    // exp(i h theta) - 1, theta from the modes of the line.
    void set_phases(const Line& k, double h) {
        ComplexNumber<double>* theta = one.input();
        for (int64_t j = 0, a = 0, b = 0; j < n; ++j, a = wrapped(a + k.k1), b = wrapped(b + k.k2)) {
            const int64_t at = a * n + b;
            theta[j] = {factor[at] * (re[at] + added_re[at]), factor[at] * (im[at] + added_im[at])};
            if (constant) theta[j] = theta[j] + ComplexNumber<double>{constant[2 * at], constant[2 * at + 1]};
        }
        theta = one.transform(theta);
        for (int64_t s = 0; s < n; ++s) {
            const Rotation<double> rotation = rotation_by(h * theta[s].im);
            for (int64_t at = s; at < int64_t(up_re.size()); at += n) {
                up_re[at] = rotation.cosm1;
                up_im[at] = rotation.sine;
            }
            for (int64_t at = opposite(s); at < int64_t(up_re.size()); at += n) {
                down_re[at] = rotation.cosm1;
                down_im[at] = rotation.sine;
            }
        }
    }

    // y := (exp(i h (theta_(s + d) - theta_(s - d))) - 1) y, from small numbers with equally small rounding.
    INLINE void rotate(ComplexNumber<Eight>& y, int64_t s, int64_t d) const {
        Eight a_re, a_im, b_re, b_im;
        std::memcpy(&a_re, up_re.data() + s + d, sizeof(Eight));
        std::memcpy(&a_im, up_im.data() + s + d, sizeof(Eight));
        std::memcpy(&b_re, down_re.data() + (n - s) + d, sizeof(Eight));
        std::memcpy(&b_im, down_im.data() + (n - s) + d, sizeof(Eight));
        const Eight real = (a_re + b_re) + fma(a_re, b_re, a_im * b_im);
        const Eight imaginary = (a_im - b_im) + fma(a_im, b_re, -(a_re * b_im));
        y = y.times(real, imaginary);
    }

    // For each row j of eight cosets call `body(j, at, back, lane, count, edge)`: from `lane` on, `count` modes are at
    // `at`, ..., and their opposites at `back`, back - 1, ...; if the first one is at the edge, in column 0, its
    // opposite is at back - n.
    template <class Body>
    INLINE void each_row(const Line& k, int64_t first, int64_t lanes, Body body) const {
        const int64_t start1 = first * k.l1 % n, start2 = first * k.l2 % n;
        for (int64_t j = 0, a = start1, b = start2; j < n; ++j, a = wrapped(a + k.k1), b = wrapped(b + k.k2)) {
            if (k.l1 == 0 && k.l2 == 1) {
                if (lanes == L && b + L <= n) {
                    body(j, a * n + b, opposite(a) * n + n - b, 0, L, b == 0);
                    continue;
                }
                const int64_t fit = std::min(lanes, n - b);
                body(j, a * n + b, opposite(a) * n + n - b, 0, fit, b == 0);
                if (fit < lanes) body(j, a * n, opposite(a) * n + n, fit, lanes - fit, true);
                continue;
            }
            for (int64_t lane = 0, c = a, d = b; lane < lanes; ++lane, c = wrapped(c + k.l1), d = wrapped(d + k.l2))
                body(j, c * n + d, opposite(c) * n + n - d, lane, 1, d == 0);
        }
    }

    void gather(const Line& k, int64_t first, int64_t lanes, ComplexNumber<Eight>* row) const {
        if (lanes < L) std::fill_n(numbers_of(row[0]), 2 * L * n, 0.0);
        each_row(k, first, lanes, [&](int64_t j, int64_t at, int64_t, int64_t lane, int64_t count, bool) {
            double *to_re = numbers_of(row[j]) + lane, *to_im = to_re + L;
            for (int64_t c = 0; c < count; ++c) to_re[c] = re[at + c] + added_re[at + c];
            for (int64_t c = 0; c < count; ++c) to_im[c] = im[at + c] + added_im[at + c];
        });
    }

    // The vorticity is real: the mode -n is minus the conjugate of the mode n.
    void scatter(const Line& k, int64_t first, int64_t lanes, const ComplexNumber<Eight>* row) {
        const double size = double(n);
        each_row(k, first, lanes, [&](int64_t j, int64_t at, int64_t back, int64_t lane, int64_t count, bool edge) {
            const double *from_re = numbers_of(row[opposite(j)]) + lane, *from_im = from_re + L;  // forward twice: reversed
            double *to_re = added_re.data() + at, *to_im = added_im.data() + at;
            for (int64_t c = 0; c < count; ++c) to_re[c] += from_re[c] / size;
            for (int64_t c = 0; c < count; ++c) to_im[c] += from_im[c] / size;
            // column 0 is its own opposite
            if (edge) added_re[back - n] = -to_re[0], added_im[back - n] = to_im[0];
            for (int64_t c = edge; c < count; ++c) added_re[back - c] = -to_re[c];
            for (int64_t c = edge; c < count; ++c) added_im[back - c] = to_im[c];
        });
    }
};

}  // namespace

// `whole`: n, whether there is a constant, and (k, l) of each line. Coefficients: n x n factors, n x n constant modes.
STEP_SCHEME(line_splitting, LineSplitting)

}  // namespace coadjoint
