// The codes and limits that Python and the kernels share, defined here once and exported to Python by name.
#pragma once

#include <cstdint>

namespace coadjoint {

#define DECLARE_CODE(name, value) constexpr int64_t name = value;
#define DESCRIBE_CODE(name, value) #name " " #value ";"
#define CODES(Name, LIST) \
    LIST(DECLARE_CODE)    \
    constexpr char Name##_codes[] = "codes " #Name ":" LIST(DESCRIBE_CODE) "\n";

// Status of a step. UNDEFINED: its scheme does not define it. PARALLEL: a tangent vector depends linearly on the
// others. ENDED: an event ended the run of the member before. TOO_LONG: a flow needs more than MOST_SUBSTEPS.
#define STATUSES(_) \
    _(DONE, 0) _(NOT_CONVERGED, 1) _(OVERFLOWED, 2) _(UNDEFINED, 3) _(PARALLEL, 4) _(ENDED, 5) _(TOO_LONG, 6)
CODES(Status, STATUSES)

// Return values of a loop that did not complete all steps.
#define OUTCOMES(_) _(INTERRUPTED, -1) _(NO_MEMORY, -2) _(UNSOLVED, -3)
CODES(Outcome, OUTCOMES)

// Records of an event in a step: its function g rises through zero, or falls; it may have crossed zero and back; it is
// NaN; or its series has one zero crossing between two points of the step.
namespace crossings {
#define CROSSINGS(_) _(NONE, 0) _(RISING, 1) _(FALLING, 2) _(NEAR, 3) _(UNDEFINED, 4) _(BETWEEN, 5)
CODES(Crossing, CROSSINGS)
}  // namespace crossings

// Terms of a scalar function.
#define TERM_KINDS(_) _(LINEAR, 0) _(POLYNOMIAL, 1) _(FUNCTION, 2)
CODES(TermKind, TERM_KINDS)

// The role of a form in a non-polynomial function: held for the next one, the second polynomial of a term, or the
// argument of a hyperbolic function.
#define ROLES(_) _(HOLD, 0) _(QUOTIENT, 1) _(LOGARITHM, 2) _(ANGLE, 3) _(SINH, 4) _(SINH_SQUARED, 5) _(COSH, 6)
CODES(Role, ROLES)

// How exp(theta D) - 1 acts on a block of the state or of the group element.
#define BLOCK_KINDS(_) _(SCALE, 0) _(ROTATE, 1) _(PLANE, 2) _(SHEAR, 3) _(CUBIC, 4) _(SERIES, 5)
CODES(Kind, BLOCK_KINDS)

// The closed form by which a Casimir subtracted from the Hamiltonian rotates the group element.
namespace turns {
#define TURNS(_) _(NILPOTENT, 0) _(PLANE, 1) _(CUBIC, 2) _(PAIR, 3) _(SKEW, 4) _(GENERAL, 5)
CODES(Turn, TURNS)
}  // namespace turns

// How a matrix W is mapped to its stream matrix: diagonal by diagonal, entry by entry, or by a function; how several
// matrices, the layers of a fluid, are mapped to theirs; or how a buoyancy adds to W, entry by entry.
#define STREAMS(_) \
    _(TRIDIAGONAL, 0) _(CIRCULANT, 1) _(WEIGHTS, 2) _(MULTIPLIED, 3) _(BY_FUNCTION, 4) _(SYMMETRIC, 5) _(LAYERED, 6) \
    _(THERMAL, 7)
CODES(StreamKind, STREAMS)

// Solution of the stages of a Runge-Kutta method.
#define SOLVERS(_) _(EXPLICIT, 0) _(ITERATED, 1) _(IMPLICIT, 2) _(STRUCTURE, 3) _(GRADIENT, 4)
CODES(Solver, SOLVERS)

// Kinds of forces: towards a point; a torque that is constant, or a function of time or of state and time; along
// coadjoint orbits; a flow given as a function; on modes of a matrix, by their own rates or a noise; the noise of
// Hamiltonians; additive noise; along orbits of matrices: a damping or a bath, noise by matrices, and by modes; or a
// decay of a quadratic Casimir.
#define FORCES(_)                                                                                            \
    _(DAMPING, 0) _(CONSTANT, 1) _(OF_TIME, 2) _(OF_STATE, 3) _(ON_ORBIT, 4) _(BY_FLOW, 5) _(MODE_RATES, 6) \
    _(MODE_NOISE, 7) _(HAMILTONIAN_NOISE, 8) _(KICKS, 9) _(ON_MATRIX_ORBIT, 10) _(MATRIX_NOISE, 11)         \
    _(MODE_TRANSPORT, 12) _(SELECTIVE_DECAY, 13)
CODES(ForceKind, FORCES)

// How the flow of a force is differentiated: by its matrix, a flow along vectors, formulas on orbits, or in Python.
namespace derivatives {
#define FLOW_DERIVATIVES(_) _(AFFINE, 0) _(ALONG, 1) _(ON_ORBIT, 2) _(IN_PYTHON, 3)
CODES(FlowDerivative, FLOW_DERIVATIVES)
}  // namespace derivatives

// The modes of a matrix: harmonics of the sphere, or waves of the torus.
#define MODES(_) _(HARMONICS, 0) _(WAVES, 1)
CODES(ModeKind, MODES)

// Storage of a matrix: a multiple of the unit, its diagonal, or the full matrix.
#define SHAPES(_) _(MULTIPLE, 0) _(DIAGONAL, 1) _(FULL, 2)
CODES(Shape, SHAPES)

// TENTHS: pieces of a run with separate largest deviations. RATIONAL: added to the kind of a rotation by tan(angle/2)
// := half the angle. CUBIC_HEADER: constants of a CUBIC block before the values of its entries. MOST_SUBSTEPS: of norm
// one, in a step of a series; its angle depends on the state, so it multiplies rounding errors by their number, and after
// five longer flows float64 has no digits left. LARGEST_DENSE: unknowns of Newton's method
// with a dense matrix; above, a band or no matrix is used. LARGEST_DIRECT: unknowns of a linear scheme; above,
// iterating costs less than LU factors, and the matrix is not stored. WIDEST: largest dimension in which members are
// lanes, since lanes of states stay in the cache. MOST_LANES: largest number of members as lanes on any processor; the
// members of a call begin at a multiple of it. STATE_VERSION: version of the state of a run between two steps; to be
// raised if the meaning of an array of the state changes. PROJECTION_EXACT: the defect left by rounding, in round-offs
// of the sum of the terms of x . dC/dx. PROJECTION_STAGNANT: multiple of that for the defect accepted if corrections
// stagnate. PROJECTION_CORRECTIONS: the most of them. DEPENDENT_BITS: a gradient counts as a combination of the
// previous ones if the square of its remainder is smaller than its own by this many bits. GROWTH_BITS: an iteration is
// abandoned if a correction is larger than the first by this many bits.
#define LIMITS(_)                                                                                             \
    _(TENTHS, 10) _(RATIONAL, 8) _(CUBIC_HEADER, 6) _(MOST_SUBSTEPS, 4096) _(LARGEST_DENSE, 200)              \
    _(LARGEST_DIRECT, 160) _(WIDEST, 1024) _(MOST_LANES, 32) _(STATE_VERSION, 1) _(PROJECTION_EXACT, 4)       \
    _(PROJECTION_STAGNANT, 256) _(PROJECTION_CORRECTIONS, 64) _(DEPENDENT_BITS, 36) _(GROWTH_BITS, 64)
CODES(Limit, LIMITS)

}  // namespace coadjoint
