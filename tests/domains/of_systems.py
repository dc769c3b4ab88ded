"""Domains of the parameters of ready-made systems, as documented."""

from __future__ import annotations

import math

import numpy as np

import coadjoint as co
from domains.kinds import (
    Case,
    Domain,
    case_of,
    choice,
    flag,
    not_negative,
    one_of,
    optional,
    positive,
    real,
    structured,
    vector,
    whole,
    with_entry,
)

SKEWED = [[2.0, 0.25, 0.0], [0.5, 3.0, 0.0], [0.0, 0.0, 4.0]]
INDEFINITE = [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 4.0]]
FULL = [[2.0, 0.25, -0.125], [0.25, 3.0, 0.5], [-0.125, 0.5, 4.0]]
TENSORS = (SKEWED, INDEFINITE, np.diag([1.0, 2.0, 0.0]), np.eye(2), np.eye(4), [[1.0, 2.0], [3.0]])
NOT_A_TENSOR = (*TENSORS, with_entry(FULL, (1, 1), math.nan), with_entry(FULL, (1, 1), 1j), np.eye(3, dtype=bool))
INERTIA = vector((1.0, 2.0, 2.5), positive()).plus(FULL, (1, 1, 1), outside=NOT_A_TENSOR)
PARALLEL = (0.0, 0.0)
MOMENTS = vector((1.0, 2.0, 3.0, 4.0), real(), any_length=True)  # the sum of any two is positive


def cosine(x):
    return math.cos(x)


def minus_sine(x):
    return -math.sin(x)


def minus_cosine(x):
    return -math.cos(x)


def sine(x):
    return math.sin(x)


EVEN = (cosine, minus_sine, minus_cosine, sine)
ODD = (sine, cosine, minus_sine, minus_cosine)
POTENTIAL = vector((0.0, 0.0, 0.5), real(), EVEN, any_length=True).plus(
    outside=(cosine, EVEN[:3], (*EVEN[:3], cosine), (1.0, cosine, 1.0, 1.0), [0.0] * 22)
)
LATTICES = choice("chain", "ring", "square", "triangular", "honeycomb", "kagome", "cubic", "complete")
NO_EDGES = ([[0, 0]], [[0, 1], [1, 0]], [[0, 3]], [[-1, 0]], [[0.5, 1]], [0, 1], [[0, 1, 1]], [[0, True]], [[0, 1j]])
MATRIX_OF_BOND = vector((1.0, 1.0, 0.5), real(), FULL, SKEWED, [FULL] * 2).plus(outside=(np.eye(2), np.ones((3, 3, 3))))


def constant_height(first, second):
    return 0.1 * np.sin(second) * np.cos(first)


def on_a_lattice(lattice, shape, **others):
    """Take a shape with as many axes as the lattice has, where the shape is the usual one."""
    axes = {"square": 2, "triangular": 2, "honeycomb": 2, "kagome": 2, "cubic": 3}.get(repr(lattice)[1:-1], 1)
    return co.systems.spin_lattice(lattice, (2,) * axes if axes > 1 and shape == 3 else shape, **others)


def spring(r, A):
    return ((r[0] + A[0, :, 2] - r[1]) ** 2).sum() / 2


def spring_slopes(r, A):
    ends = r[0] + A[0, :, 2] - r[1]
    by_r, by_A = np.zeros((2, 3)), np.zeros((2, 3, 3))
    by_r[0], by_r[1], by_A[0, :, 2] = ends, -ends, ends
    return by_r, by_A


def spring_curvatures(r, A):
    result = np.zeros((24, 24))
    for k in range(3):
        for i, one in ((18 + k, 1.0), (21 + k, -1.0), (3 * k + 2, 1.0)):
            for j, other in ((18 + k, 1.0), (21 + k, -1.0), (3 * k + 2, 1.0)):
                result[i, j] = one * other
    return result


PAIR = vector(((1.0, 2.0, 2.5), (1.0, 1.25, 1.5)), positive(), [FULL, (1, 1, 1)], [(2, 2, 0), np.eye(3)]).plus(
    [(1, 1, 1), (0, 0, 0)], outside=((FULL,), ((1, 2, 0), (1, 1, 1)), ((0, 0, 1), (1, 1, 1)), (SKEWED, FULL))
)
# Physical numbers, of the range of float64.
SIZE = positive().plus(1e-60, 1e60, outside=(1e-310, 1e308))
TWO_MASSES = vector((1.0, 0.5), SIZE).plus(None, without=(None,))

TOPOGRAPHY = structured(
    (None, {(1, 1): 0.1}, [[1, 0, 0.1, 0.0]], np.array([[1.0, -1.0, 0.1, 0.05]]), constant_height),
    (np.zeros((4, 4, 4)), np.zeros((2, 3)), {(9, 9): 0.1}, {(0, 0): 0.1}, [[1, 0, math.nan, 0.0]], [[0.5, 0, 1.0, 0.0]],
     [[1, 1, 0.1, 0.0]] * 2, cosine, "heights"),
    r"\btopography\b|\bmodes?\b|\bheights\b|\bends with\b",
    keep=(None, {}),
)  # fmt: skip

# By the name of the parameter, where systems share it.
SHARED = {
    "inertias": PAIR,
    "G": SIZE,
    "N": whole(2, 4096, usual=5, tried=6),
    "surface": choice("sphere", "torus"),
    "inertia": INERTIA,
    "lever": vector((0.75, -0.5), real()),
    "equatorial": positive(1.0),
    "sites": whole(2, usual=3),
    **dict.fromkeys(("constant", "linear", "quadratic", "rotation", "a"), real(2.0)),
    "masses": vector((1.0, -0.5, 0.25), real(), (0, 0, 1)),
    "gravity": positive(1.0),
    "axial": positive(),
    "stiffness": positive(1.0),
}
OWN = {
    "bodies": {
        "potential": Domain((spring,), (None, cosine, "r[0]", 1.0, True, [], spring_slopes), "potential"),
        "gradient": Domain((spring_slopes,), (cosine, spring, 1.0, True, []), "gradient|potential"),
        "hessian": Domain((None, spring_curvatures), (cosine, spring, 1.0, True, []), "hessian|potential"),
    },
    "gravitating_bodies": {
        "order": one_of(4, 0, 2).plus(outside=("polyhedron",)),
        "higher_moments": structured((None, np.full((2, 25), 0.5)), (np.zeros((2, 24)), 1.0, True), keep=(None,)),
        "surfaces": structured((None,), ([None, None], [(np.eye(3), [[0, 1, 2]]), None]), keep=(None,)),
    },
    "body": {
        "attitude": flag(usual=True),
        "inertia": INERTIA.plus((2.0, 2.0, 0.0), outside=((0, 0, 0), (0, 0, 1))),
        "wheels": structured(
            ((), [(0, 0, 0.1)], 0.01 * np.eye(3)),
            ((0, 0, 0.1), [(0, 0, 0)], [(0, 0, 9.0)], [(0, 0, math.nan)], [(0, 0, "1")], [(0, 0, 1j)], 1.0),
            keep=((), []),
        ),
        "gyros": structured(
            ((), [[(1, 0, 0), (0, 1, 0)]]),
            ([(1, 0, 0), (0, 1, 0)], [[(1, 0, 0), (0, 2, 0)]], [[(1, 0, 0), (1, 0, 0)]], [[(0, 0, 0)] * 2], 1.0),
            keep=((), []),
        ),
        "held": whole(0, 4096, usual=0, tried=2).plus(
            ("held1", "integral1"), outside=(("held",), ("a1", "a1"), ("L1",), ("a 1",))
        ),
    },
    "clebsch_body": {
        "inertia": vector((1.0, 1.0, 1.0), positive(), (3, 3, 3), (0.001,) * 3),
        "inverse_mass": vector((1.0, 1.5, 3.0), real(), (-1, 0, 2)),
    },
    "decorated_particles": {
        "weights": vector((1.0, 0.5), positive(), (2,), (0.001, 1, 3), any_length=True),
        "external": POTENTIAL.plus(ODD, [0.0] * 21),
        "pair": POTENTIAL.plus((2.0, 0, 1, 0, 0.25), outside=(ODD, (0.0, 1.0), (0.0, 0.0, 0.5, 0.25))),
    },
    "double_spherical_pendulum": {
        "masses": vector((1.0, 0.5), SIZE, (1e-30, 1), (1, 1e30)),
        "lengths": vector((1.0, 0.5), SIZE, (0.001, 1), (1, 1000.0)),
        "gravity": not_negative().plus(1e-60, 1e60, outside=(1e308, -0.5)),
    },
    "fluid_triad": {
        "first": vector((1.0, 0.0), real(), (-1, 3)).plus(outside=(PARALLEL, (0.5, 1.5), (1e200, 0.0))),
        "second": vector((0.5, 1.5), real(), (0.001, 1)).plus(outside=(PARALLEL, (2.0, 0.0), (0.0, 1e200))),
    },
    "gyrostat": {"rotors": vector((0.25, -0.5, 0.0), real())},
    "heavy_top": {"lever": vector((0.75, -0.5, 0.0), real())},
    "kirchhoff_body": {
        "inertia": vector((1.0, 2.0, 5.0), positive(), FULL).plus(outside=NOT_A_TENSOR),
        "mass": vector((1.5, 2.5, 2.0), positive(), FULL).plus(outside=NOT_A_TENSOR),
        "coupling": vector(np.zeros((3, 3)).tolist(), real(), np.eye(3) / 4, (np.array(SKEWED) / 8).tolist()).plus(
            outside=(9 * np.eye(3), np.zeros((2, 2)), np.zeros(3))
        ),
    },
    "lagrange_top": {"lever": real()},
    "lorenz_1960": {"k": positive(2.0).plus(outside=(1e200, 1e-200)), "l": positive(1.0).plus(outside=(1e200,))},
    "manakov_top": {
        "a": vector((1.0, 2.0, 4.0, -7.0), real(), (0, 1, 2, 3)).but_called(r"\b[ab]\b").plus(
            outside=((1, 2, 4, 1), (1, 2), (1,), (1, 1, 1, 2))
        ),
        "b": vector((1.0, 3.0, -2.0, 5.0), real(), (0, 0, 0, 1)).plus(outside=((1, 2), (1,))),
    },
    "matrix_body": {
        "inertia": MOMENTS.plus(
            (1, 2), (-0.5, 1, 2), (0.0, 0.001), outside=((1,), (-1, 1), (-1, 0.5, 3), (0, 0, 1), np.eye(3))
        ),
    },
    "maxwell_bloch": {"coupling": positive()},
    "layered_qg": {
        "N": whole(3, usual=5),
        "gamma": vector(((1.0, -1.0), (-1.0, 1.0)), real(), ((2.0, -1.0), (-1.0, 1.5)), np.zeros((2, 2))).plus(
            outside=(np.zeros((1, 1)), np.ones((2, 3)), ((1.0, -1.0), (-2.0, 2.0)), ((-1.0, 1.0), (1.0, -1.0)))
        ).but_called(r"\bgamma\b"),
        "thicknesses": optional(vector((2.0, 2.0), positive())).first(None, (2.0, 2.0), [1e-30, 1e-30]).plus(
            outside=((1.0, 2.0), (1.0, 1.0, 1.0))
        ).but_called(r"\bthickness(es)?\b"),
        "lamb": optional(vector(((1.0, -1.0), (-1.0, 1.0)), real())).first(None, ((1.0, -1.0), (-1.0, 1.0))).plus(
            outside=(np.eye(3), ((1.0, 0.0), (0.0, 2.0)))
        ).but_called(r"\blamb\b"),
        "rotation": real(0.0),
    },
    "passive_scalar": {"rotation": real(0.0)},
    "point_vortices": {
        "circulations": vector((1.0, -0.5), real(), (2,), (1e-100, 1e100, 3), any_length=True).plus(
            outside=((1.0, 0.0), (1e-101,), (1e101,), [[1.0]], np.ones(683))
        ),
        "surface": choice("plane", "sphere"),
        "radius": optional(positive(0.5, 1e-100, 1e100)).first(None, 0.5, 1e-100, 1e100).but_called(r"\bradius\b"),
    },
    "rigid_molecules": {
        "sites": vector([[0.0, 0.0, 0.0], [0.08, 0.0, 0.06], [-0.08, 0.0, 0.06]], real()),
        "charges": vector((-0.8, 0.4, 0.4), real(), (0, 0, 0)),
        "lj": vector([[0.6, 0.3], [0.0, 0.0], [0.0, 0.0]], not_negative()),
        "masses": vector((16.0, 1.0, 1.0), not_negative(), (1, 1, 2)).plus(outside=((0, 0, 0), (0, 16, 0))),
        "count": whole(1, 10**5, usual=2, tried=3),
        "box": optional(vector((1.5, 2.0, 1.0), SIZE, 1.25, number=True)).first(
            None, 1.25, (1.5, 2.0, 1.0)
        ).plus(outside=(0.9,)),
        "cutoff": optional(SIZE),
        "switch_from": optional(positive(0.4)).first(None, 0.4, 1e-30).plus(outside=(0.5, 0.75)),
        "dielectric": positive(1.0, 1.0).plus(80.0),
        "mixing": choice("lorentz-berthelot", "geometric"),
        "coulomb": SIZE,
    },
    "satellite": {
        "inertia": INERTIA.plus((0.001,) * 3),
        "mass": positive(100.0),
    },
    "satellite_on_orbit": {
        "mean_motion": SIZE,
        "eccentricity": not_negative(0.0).plus(0.5, outside=(1.0, 1.5)),
    },
    "separable_cosh": {
        "algebra": Domain(
            ("so(3)", "sl(2)", "A3,1"),
            ("", "so(2)", "so(4)", "xo(3)", "A3,7", None, 3, True, ["so(3)"], 1j),
            r"\balgebra\b|^masses",
        ),
        "masses": SHARED["masses"].plus(outside=((0, 0, 0),)),
        "constants": Domain((None, {}), ({"a": 1.0}, [], "a", 1.0, True, ("a", 1)), "constants|no parameter 'a'"),
    },
    "sklyanin": {
        "anisotropy": vector((1.0, 2.0, 4.0), real(), (-1, 0, 0)),
        "masses": vector((1.0, -0.5, 2.0, 1.5), real(), (0, 0, 0, 1)),
    },
    "so_n_body": {
        "inertia": MOMENTS.plus(FULL, (-0.5, 1, 2), (1, 2, 3)).plus(
            outside=((1, 2), (1,), (-1, 1, 2), (-1, 0.5, 3), SKEWED, [[1.0, 2.0], [2.0, 1.0]])
        ),
    },
    "spin_lattice": {
        "lattice": LATTICES.plus([[0, 1]], ((1, 0),), [], outside=NO_EDGES, without=([],)).but_called(
            r"\blattice\b|\bedge 0\b"
        ),
        "shape": whole(1).first(3, 1, 2, (2,), np.int64(2)).plus(outside=((2, 2), (0,), (2.5,), (True,), ("2",))),
        "periodic": flag().plus((True,), [False], without=([True],), outside=((1,), (True, True), ("True",))),
        "exchange": real(1.0).plus(
            [0.5, 1.0], without=([1.0, 2.0],), outside=([0.5, 1.0, 2.0], [0.5], [math.nan], [1j], [True])
        ),
        "tensor": MATRIX_OF_BOND,
        "dm": vector((0.0, 0.25, -1.0), real(), [[0, 0, 1]] * 2),
        "field": vector((0.0, 0.25, -1.0), real(), np.ones((3, 3)), lambda t: np.array([0.0, 0.0, t])).plus(
            outside=(np.ones((4, 3)), len)
        ),
        "on_site": vector((0.0, 0.25, -1.0), real(), FULL, [FULL] * 3).plus(
            outside=(SKEWED, [FULL], [FULL, FULL, SKEWED], np.eye(2))
        ),
        "dipolar": real(0.0),
        "moments": Domain(
            (1.0, 2.5, 1e-100, [0.5, 1.0, 2.0]),
            (0.0, -1.0, 1e-101, 1e101, math.nan, math.inf, "1", None, True, 1j, [], [1.0, 2.0], [1.0, 0.0, 1.0]),
        ),
    },
    "sphere_qg": {
        "N": whole(3, 4096, usual=5, tried=6),
        "lamb": not_negative(2.0),
        "gamma": not_negative(0.5),
        "topography": TOPOGRAPHY,
    },
    "torus_qg": {
        "N": one_of(5, 3).plus(outside=(0, 1, 1002, 1003, -3)).first(5, 3, 7, np.int64(7)),
        "gamma": not_negative(0.5),
        "topography": TOPOGRAPHY,
    },
    "thermal_qg": {
        "N": whole(3, 4096, usual=5, tried=6),
        "gamma": not_negative(0.5),
        "topography": TOPOGRAPHY,
        "surface": choice("sphere"),  # lamb is not for the torus
        "bathymetry": TOPOGRAPHY.but_called(r"\bbathymetry\b|\bmodes?\b|\bheights\b|\bends with\b"),
        "lamb": not_negative(2.0),
    },
    "torus_euler": {"N": one_of(5, 3).plus(outside=(0, 1, 1002, 1003, -3)).first(5, 3, 7, np.int64(7))},
    "vlasov_moments": {
        "degree": whole(2, 100, usual=4, tried=6).plus(8, outside=(3, 5, 99, 102)),
        "potential": Domain(
            ("1/2*x20 + 0.1*x20^2", "x40", co.Polynomial({(1, 0): 1.0}), co.Quadratic(1.0, linear=[1.0, 0.0])),
            ("", "x11", "x21", "x60", "x20^-1", "y", "1/0*x20", None, 1.0, True, [], cosine, 1j, math.nan,
             co.Polynomial({(1,): 1.0}), co.Quadratic((1.0, 2.0, 3.0))),
            r"\bpotential\b|^piece 1\b",
        ),
    },
}  # fmt: skip
OWN["bodies"]["masses"] = OWN["gravitating_bodies"]["masses"] = TWO_MASSES
SYSTEMS = {name: case_of(getattr(co.systems, name), SHARED, **OWN.get(name, {})) for name in co.systems.names()}
SYSTEMS["spin_lattice"] = Case(on_a_lattice, SYSTEMS["spin_lattice"].domains)
