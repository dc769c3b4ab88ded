// Dual numbers with three derivatives, for exact differentiation.
#pragma once

#include <type_traits>

#include "numbers/arithmetic.hpp"

namespace coadjoint {

template <class A>
struct Dual {
    A value, slope[3];

    INLINE Dual() = default;
    INLINE Dual(const A& value) : value(value), slope{A(0.0), A(0.0), A(0.0)} {}
    INLINE Dual(const A& value, const A& one, const A& two, const A& three) : value(value), slope{one, two, three} {}
    template <class B, class = std::enable_if_t<std::is_same<B, double>::value && !std::is_same<A, double>::value>>
    INLINE Dual(B value) : Dual(A(value)) {}

    // The value f, and its derivative at the value.
    INLINE Dual mapped(const A& f, const A& rate) const {
        return {f, rate * slope[0], rate * slope[1], rate * slope[2]};
    }
    INLINE friend Dual operator-(const Dual& a) { return a.mapped(-a.value, A(-1.0)); }
    INLINE friend Dual operator+(const Dual& a, const Dual& b) {
        return {a.value + b.value, a.slope[0] + b.slope[0], a.slope[1] + b.slope[1], a.slope[2] + b.slope[2]};
    }
    INLINE friend Dual operator-(const Dual& a, const Dual& b) { return a + -b; }
    INLINE friend Dual operator*(const Dual& a, const Dual& b) {
        const auto slope = [&](int k) { return fma(a.value, b.slope[k], a.slope[k] * b.value); };
        return {a.value * b.value, slope(0), slope(1), slope(2)};
    }
    INLINE friend Dual operator/(const Dual& a, const Dual& b) {
        const A inverse = 1.0 / b.value, whole = a.value * inverse;
        const auto slope = [&](int k) { return (a.slope[k] - whole * b.slope[k]) * inverse; };
        return {whole, slope(0), slope(1), slope(2)};
    }
    INLINE friend Dual fma(const Dual& a, const Dual& b, const Dual& c) { return a * b + c; }
    INLINE friend Dual square_root(const Dual& a) {
        const A root = square_root(a.value);
        return a.mapped(root, 0.5 / root);
    }
    INLINE friend Rotation<Dual> rotation_by(const Dual& phi) {
        const Rotation<A> rotation = rotation_by(phi.value);
        return {phi.mapped(rotation.sine, rotation.cosm1 + 1.0), phi.mapped(rotation.cosm1, -rotation.sine)};
    }
    template <class Mask>
    INLINE friend Dual select(const Mask& where, const Dual& a, const Dual& b) {
        const auto slope = [&](int k) { return select(where, a.slope[k], b.slope[k]); };
        return {select(where, a.value, b.value), slope(0), slope(1), slope(2)};
    }
};

}  // namespace coadjoint
