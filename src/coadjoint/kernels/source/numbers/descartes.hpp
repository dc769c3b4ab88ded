// Roots of a polynomial between 0 and 1, isolated by Descartes' rule of signs in Bernstein form (G. E. Collins, A. G.
// Akritas, SYMSAC 1976): one sign change of the coefficients means one root, no sign change no root.
#pragma once

#include <cstdint>
#include <vector>

namespace coadjoint {

class Isolation {
  public:
    explicit Isolation(int64_t degree)
        : degree(degree), width(degree + 1), binomial(width, 1.0), workspace((DEEPEST + 2) * width) {
        for (int64_t k = 1; k <= degree; ++k) binomial[k] = binomial[k - 1] * double(degree - k + 1) / double(k);
    }

    // Call `found(low, high)` for each interval with one root, in ascending order, of c_0 + c_1 s + ... Roots closer
    // together than 2^-DEEPEST are not separated.
    template <class Found>
    void operator()(const double* c, Found found) {
        double* b = workspace.data();
        for (int64_t k = 0; k <= degree; ++k) b[k] = c[k] / binomial[k];
        for (int64_t level = 1; level <= degree; ++level)
            for (int64_t k = degree; k >= level; --k) b[k] += b[k - 1];
        open[0] = {0.0, 1.0, 0};
        // The left half is on top of the stack.
        for (int64_t top = 0; top >= 0; --top) {
            const Piece here = open[top];
            double* coefficients = workspace.data() + top * width;
            const int64_t changes = changes_of(coefficients);
            if (changes == 0) continue;
            if (changes == 1 || here.depth == DEEPEST) {
                if (coefficients[0] * coefficients[degree] <= 0.0) found(here.low, here.high);
                continue;
            }
            // Not the midpoint: a root at a simple fraction of the step would be missed by both halves.
            const double middle = here.low + CUT * (here.high - here.low);
            halve(coefficients, coefficients + width);
            open[top] = {middle, here.high, here.depth + 1};
            open[top + 1] = {here.low, middle, here.depth + 1};
            top += 2;
        }
    }

  private:
    // Bisections: roots nearer than 2^-30 of the interval count as one.
    static constexpr int64_t DEEPEST = 30;
    // Beside the middle, where roots of symmetric polynomials are; exact in binary.
    static constexpr double CUT = 0.5078125;
    struct Piece {
        double low, high;
        int64_t depth;
    };
    const int64_t degree, width;
    std::vector<double> binomial, workspace;
    Piece open[DEEPEST + 2];

    int64_t changes_of(const double* b) const {
        int64_t changes = 0;
        double last = 0.0;
        for (int64_t k = 0; k <= degree; ++k) {
            if (b[k] == 0.0) continue;
            changes += last * b[k] < 0.0;
            last = b[k] < 0.0 ? -1.0 : 1.0;
        }
        return changes;
    }

    // De Casteljau subdivision: the right half replaces the interval, the left one goes to `left`.
    void halve(double* coefficients, double* left) const {
        for (int64_t k = 0; k <= degree; ++k) {
            left[k] = coefficients[0];
            for (int64_t j = 0; j < degree - k; ++j)
                coefficients[j] = coefficients[j] + CUT * (coefficients[j + 1] - coefficients[j]);
        }
    }
};

}  // namespace coadjoint
