"""Comparison of samples with check-cases: errors, and the diagnosis of each mistake, by making it."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import fresnel

import coadjoint as co
from refusals import refused

RATES, QUATERNION = ("wx", "wy", "wz"), ("qw", "qx", "qy", "qz")


def case_of(name="free_body_products", **parameters):
    return co.checkcases.get(name, **parameters)


def rates(table):
    return np.column_stack([table[name] for name in RATES])


def attitudes(table):
    return Rotation.from_quat(np.column_stack([table[name] for name in ("qx", "qy", "qz", "qw")]))


def table_of(t, w, turned):
    q = np.roll(turned.as_quat(), 1, axis=1)
    return {"t": np.asarray(t), **dict(zip(RATES, w.T, strict=True)), **dict(zip(QUATERNION, q.T, strict=True))}


def simulated(case, tensor, w0=None, t=None, euler=lambda I, w: np.cross(I @ w, w)):
    """Samples of a simulator with another tensor or another law, by DOP853."""
    t = case.times if t is None else t

    def field(t, y):
        w, (a, *v) = y[:3], y[3:]
        return np.concatenate([np.linalg.solve(tensor, euler(tensor, w)), [-(v @ w) / 2], (a * w + np.cross(v, w)) / 2])

    start = np.concatenate([case.body.rates if w0 is None else w0, [1, 0, 0, 0]])
    y = solve_ivp(field, (0, t[-1]), start, "DOP853", t_eval=t, rtol=1e-11, atol=1e-13).y.T
    return table_of(t, y[:, :3], Rotation.from_quat(np.roll(y[:, 3:], -1, axis=1)))


def exchanged(table, order):
    return dict(zip(QUATERNION, [table[name] for name in order], strict=True))


def conjugated(case, table):
    return {name: -table[name] for name in QUATERNION[1:]}


def scalar_last(case, table):
    return exchanged(table, ("qx", "qy", "qz", "qw"))


def conjugated_scalar_last(case, table):
    return scalar_last(case, table | conjugated(case, table))


def in_space(case, table):
    return dict(zip(RATES, attitudes(table).apply(rates(table)).T, strict=True))


def scaled(factor):
    return lambda case, table: {name: factor * table[name] for name in RATES}


def momenta(case, table):
    return dict(zip(RATES, (rates(table) @ case.body.inertia).T, strict=True))


def axes_exchanged(case, table):
    return {"wy": table["wz"], "wz": -table["wy"]}


def products(case, table):
    I = case.body.inertia
    return simulated(case, 2 * np.diag(np.diag(I)) - I)


def one_product(case, table):
    return simulated(case, case.body.inertia * np.array([[1, 1, -1], [1, 1, 1], [-1, 1, 1]]))


def other_start(case, table):
    return simulated(case, case.body.inertia, w0=np.array([1.0, 2.0, 0.55]))


def without_products(case, table):
    return simulated(case, np.diag(np.diag(case.body.inertia)))


def transposed(case, table):
    moments, R = case.parameters["moments"][0], case.body.principal_axes
    return simulated(case, R.T @ np.diag(moments) @ R)


def moments_exchanged(case, table):
    return simulated(case, case.body.inertia[np.ix_([1, 0, 2], [1, 0, 2])])


def not_gyroscopic(case, table):
    return simulated(case, case.body.inertia, euler=lambda I, w: 0 * w)


def offset(case, table):
    t = table["t"][:-5]
    return {name: values[: len(t)] for name, values in (case.reference(t + 0.0137) | {"t": t}).items()}


def only_rates_offset(case, table):
    return {name: offset(case, table)[name] for name in RATES} | {name: table[name][:-5] for name in ("t", *QUATERNION)}


def slow_clock(case, table):
    return case.reference(0.9998 * table["t"]) | {"t": table["t"]}


def precessing(case, table):
    L = attitudes(table).apply(rates(table) @ case.body.inertia)[0]
    spun = Rotation.from_rotvec(0.002 * table["t"][:, None] * L / np.linalg.norm(L))
    return table_of(table["t"], rates(table), spun * attitudes(table))


def turning_frame(case, table):
    spun = Rotation.from_rotvec(-7.292e-5 * table["t"][:, None] * [0, 0, 1])
    return table_of(table["t"], rates(table), spun * attitudes(table))


def other_axes(case, table):
    return table_of(table["t"], rates(table), Rotation.from_euler("x", 180, degrees=True) * attitudes(table))


MISTAKES = {
    conjugated: "quaternion is conjugated",
    scalar_last: "scalar last",
    conjugated_scalar_last: "scalar last: the columns hold x, y, z, w; and it is conjugated",
    in_space: "axes of space",
    scaled(180 / math.pi): "degrees per second",
    scaled(30 / math.pi): "revolutions per minute",
    scaled(-1): "opposite sign",
    scaled(1.01): "1.01 times as large",
    momenta: "angular momenta",
    axes_exchanged: "wx, wy, wz hold wx, wz, -wy",
    products: "products of inertia have the opposite sign",
    one_product: "product of inertia I_xz has the opposite sign",
    other_start: "rates at the start are (1, 2, 0.55), not (1, 2, 0.5) rad/s",
    without_products: "products of inertia are left out",
    transposed: "tensor is transposed",
    moments_exchanged: "moments are exchanged",
    not_gyroscopic: "gyroscopic torque w x I w is missing",
    offset: "sample t is the motion at t +0.0137 s",
    only_rates_offset: "those of the rates are of other times: sample t is the motion at t +0.0137 s",
    slow_clock: "0.9998 times as fast",
    precessing: "precesses about the angular momentum at another rate: +0.002 rad/s",
    turning_frame: "axes that turn by (0, 0, 7.29e-05) rad/s in space",
    other_axes: "other axes of space, turned by 180 degrees",
}


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda each: f"{each.__name__}-{MISTAKES[each][:9]}")
def test_each_mistake_is_found_and_nothing_else(mistake):
    case = case_of()
    mine = case.reference()
    found = case.compare(mine | mistake(case, mine))
    assert not found.passed and not found.unexplained
    assert len(found.diagnosis) == 1 and MISTAKES[mistake] in found.diagnosis[0], found.diagnosis


@pytest.mark.parametrize(
    ("name", "rate"), [("free_body", 0.17), ("free_body", -3.0), ("pitch_libration", 0.0005), ("coning", 0.5)]
)
@pytest.mark.parametrize("start", [0.0, 1.2])
def test_axes_that_turn_by_many_revolutions_are_found(name, rate, start):
    """Attitudes relative to axes that turn about z, such as those of the Earth or of an orbit, at any total angle."""
    case = case_of(name)
    mine = case.reference()
    turned = Rotation.from_rotvec((rate * mine["t"] + start)[:, None] * [0, 0, 1])
    found = case.compare(table_of(mine["t"], rates(mine), turned.inv() * attitudes(mine)))
    assert len(found.diagnosis) == 1 and f"turn by (0, 0, {rate:.3g}) rad/s in space" in found.diagnosis[0]
    assert (f"turned by {math.degrees(start):.6g} degrees at t = 0" in found.diagnosis[0]) == (start > 0)


def test_axes_are_not_fitted_to_few_samples():
    """Two attitudes are on a steady rotation with a start, whatever they are."""
    case = case_of("free_body")
    q = np.random.default_rng(1).normal(size=(4, 2))
    found = case.compare({"t": [0.5, 1.0], **dict(zip(QUATERNION, q, strict=True))})
    assert not found.diagnosis and found.unexplained


@pytest.mark.parametrize(
    "mistake", [scaled(180 / math.pi), conjugated, "without torque"], ids=["degrees", "conjugated", "free"]
)
def test_an_energy_that_the_case_changes_is_not_said_to_drift(mistake):
    case = case_of("spin_up")
    mine = case.reference()
    free = case_of("free_body", inertia=(2.0, 2.0, 1.5), rates=(0.0, 0.0, 0.5), end=30.0, samples=301).reference()
    found = case.compare(free if mistake == "without torque" else mine | mistake(case, mine))
    assert not found.passed and not any("steadily" in text for text in found.diagnosis), found.diagnosis
    assert ("torque is missing" in found.diagnosis[0]) == (mistake == "without torque")


def test_rates_of_other_times_are_not_another_start():
    """One parameter, the offset, is simpler than three rates; attitudes alone have no rates at the start."""
    case = case_of()
    mine = case.reference()
    found = case.compare({name: offset(case, mine)[name] for name in ("t", *RATES)})
    assert found.diagnosis == ("the samples are of other times: sample t is the motion at t +0.0137 s",)
    found = case.compare({name: other_start(case, mine)[name] for name in ("t", *QUATERNION)})
    assert not any("at the start" in text for text in found.diagnosis)
    found = case.compare({name: other_start(case, mine)[name] for name in ("t", *RATES)})
    assert len(found.diagnosis) == 1 and MISTAKES[other_start] in found.diagnosis[0]


@pytest.mark.parametrize("order, words", [((1, 2, 0), "wy, wz, wx"), ((2, 0, 1), "wz, wx, wy")])
def test_axes_in_a_cycle_are_named_in_their_order(order, words):
    """A cycle is not its own inverse, as an exchange of two axes is."""
    case = case_of("free_body")
    mine = case.reference()
    found = case.compare(mine | {RATES[k]: mine[RATES[m]] for k, m in enumerate(order)})
    assert f"wx, wy, wz hold {words}" in found.diagnosis[0], found.diagnosis


def test_two_mistakes_are_found():
    case = case_of("free_body")
    mine = case.reference()
    found = case.compare(mine | conjugated(case, mine) | scaled(180 / math.pi)(case, mine))
    assert {MISTAKES[conjugated] in text or "degrees per second" in text for text in found.diagnosis} == {True}
    assert len(found.diagnosis) == 2


@pytest.mark.thinned(3)
@pytest.mark.parametrize("factor", [1.0, 1e-3, 50.0])
def test_an_unknown_difference_is_no_known_mistake(factor):
    """Rates of an unrelated motion, small ones too, are not degrees, nor another order of the axes."""
    case = case_of("free_body")
    mine = case.reference()
    other = case_of("free_body", rates=(0.9, -0.3, 1.1), inertia=(1.0, 1.7, 2.2)).reference()
    found = case.compare(mine | {name: factor * other[name] for name in RATES})
    assert not found.passed
    assert not any("degrees" in text or "exchanged" in text for text in found.diagnosis), found.diagnosis
    assert found.unexplained.startswith("none of the known mistakes") and "--step" in str(found)
    with_step = case.compare(mine | {name: factor * other[name] for name in RATES}, step=0.1)
    assert with_step.unexplained == "none of the known mistakes explains this"


def stepped(case, h, scheme):
    """Samples of a plain loop over steps, for a free body."""
    I = case.body.inertia
    inverse = np.linalg.inv(I)

    def rate(w):
        return inverse @ np.cross(I @ w, w)

    def field(y):
        w, a, v = y[:3], y[3], y[4:]
        return np.concatenate([rate(w), [-(v @ w) / 2], (a * w + np.cross(v, w)) / 2])

    y, rows = np.concatenate([case.body.rates, [1, 0, 0, 0]]), []
    for _ in range(round(case.end / h) + 1):
        rows.append(y)
        if scheme == "euler":
            y = y + h * field(y)
        elif scheme == "semi-implicit":
            w = y[:3] + h * rate(y[:3])
            turned = Rotation.from_quat(np.roll(y[3:], -1)) * Rotation.from_rotvec(h * w)
            y = np.concatenate([w, np.roll(turned.as_quat(), 1)])
        elif scheme == "linearly implicit":
            # The derivative of (I w) x w is that of v -> (I v) x w + (I w) x v.
            J = inverse @ np.column_stack([np.cross(I @ e, y[:3]) + np.cross(I @ y[:3], e) for e in np.eye(3)])
            w = y[:3] + h * np.linalg.solve(np.eye(3) - h * J, rate(y[:3]))
            turned = Rotation.from_quat(np.roll(y[3:], -1)) * Rotation.from_rotvec(h * w)
            y = np.concatenate([w, np.roll(turned.as_quat(), 1)])
        elif scheme == "rk4":
            a = field(y)
            b = field(y + h / 2 * a)
            c = field(y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + field(y + h * c))
        elif scheme == "heun":
            a = field(y)
            y = y + h / 2 * (a + field(y + h * a))
        y = np.concatenate([y[:3], y[3:] / np.linalg.norm(y[3:])])
    rows = np.array(rows)
    t = h * np.arange(len(rows))
    return table_of(t, rows[:, :3], Rotation.from_quat(np.roll(rows[:, 3:], -1, axis=1)))


@pytest.mark.parametrize(
    ("scheme", "order", "words"),
    [
        ("euler", 1, "explicit Euler steps of rates"),
        ("semi-implicit", 1, "semi-implicit Euler steps, rotations"),
        ("linearly implicit", 1, "linearly implicit Euler"),
        ("heun", 2, "Heun"),
        ("rk4", 4, "classical Runge-Kutta"),
    ],
)
def test_schemes_of_low_order_are_found_by_their_step(scheme, order, words):
    case = case_of("free_body", end=4.0)
    h = 0.02
    mine = stepped(case, h, scheme)
    found = case.compare(mine, step=h, tolerance=1e-8)
    assert f"of order {order}" in found.diagnosis[0] and words in found.diagnosis[0], found.diagnosis
    assert len(found.diagnosis) == 1 and not found.unexplained
    without_step = case.compare(mine, tolerance=1e-8)
    assert not any("scheme" in text for text in without_step.diagnosis)
    if scheme == "euler":
        assert any("energy is gained steadily" in text for text in without_step.diagnosis)
        assert "none of the known mistakes" in str(without_step) and "--step" in without_step.unexplained


def test_samples_of_a_heavy_top_by_a_scheme_of_low_order():
    """The emulation has the torque of the case, here of gravity; half of a step is named."""
    case = case_of("lagrange_top", end=0.3)
    mine = case.reference(case.times[:-1] + 0.0005) | {"t": case.times[:-1]}
    found = case.compare(mine, step=0.001)
    assert any("+0.0005 s, 0.5 steps later" in text for text in found.diagnosis), found.diagnosis


def test_published_simulators_of_the_brick():
    """Two agree with the closed form, and the sixth is half a millisecond ahead in its rates."""
    case = case_of("brick")
    found = {name[-2:]: case.compare(samples) for name, samples in case.published.items()}
    assert {name: each.passed for name, each in found.items()} == {
        "01": True, "02": False, "04": True, "05": False, "06": False
    }  # fmt: skip
    assert any("rates are of other times" in text and "+0.0005" in text for text in found["06"].diagnosis) or any(
        "+0.00049999" in text for text in found["06"].diagnosis
    )
    largest = {name: np.degrees(each.errors[1].largest) for name, each in found.items()}
    assert largest["01"] < 1e-8 and largest["04"] < 1e-8 and 3 < largest["02"] < 4 and largest["05"] < 2e-4


@pytest.mark.parametrize(
    "name", ["spin_chain", "rossby_haurwitz", "damped_spin", pytest.param("two_asteroids", marks=pytest.mark.long)]
)
def test_cases_of_other_kinds_find_offsets_and_signs(name):
    case = case_of(name)
    times = case.times[1:-12:2]
    shift = 0.37 * (case.times[1] - case.times[0])
    found = case.compare(case.reference(times + shift) | {"t": times})
    assert not found.passed and any("the motion at t +" in text for text in found.diagnosis), found.diagnosis
    assert case.compare(case.reference(times)).passed


@pytest.mark.parametrize(
    ("mistake", "kept"), [(conjugated, QUATERNION), (scalar_last, QUATERNION), (in_space, RATES), (offset, RATES)]
)
def test_parts_of_a_motion_are_enough(mistake, kept):
    """Attitudes alone or rates alone, at times that begin after the start and are not evenly spaced."""
    case = case_of()
    times = np.sort(np.random.default_rng(5).uniform(3.0, 15.0, 60))
    mine = case.reference(times)
    found = case.compare({name: (mine | mistake(case, mine))[name] for name in ("t", *kept)})
    assert [each.name for each in found.errors if each.unit in ("rad", "rad/s")] == [
        "attitude" if kept is QUATERNION else "rates"
    ]
    assert (
        not found.passed
        and MISTAKES[mistake] in found.diagnosis[0]
        and any("not compared" in note for note in found.notes)
    )


def test_errors_have_the_sizes_that_were_made():
    case = case_of("free_body")
    mine = case.reference()
    turned = Rotation.from_rotvec([0, 0, 1e-3])
    moved = table_of(mine["t"], rates(mine) + [1e-4, 0, 0], turned * attitudes(mine))
    found = {each.name: each for each in case.compare(moved).errors}
    largest = np.linalg.norm(rates(mine), axis=1).max()
    assert np.allclose(found["attitude"].absolute, 1e-3, rtol=1e-9)
    assert np.allclose(found["rates"].absolute, 1e-4, rtol=1e-9) and found["rates"].unit == "rad/s"
    assert np.isclose(found["rates"].largest, 1e-4 / largest)
    energy = 0.5 * np.einsum("ki,ij,kj->k", rates(moved), case.body.inertia, rates(moved))
    certain = 0.5 * np.einsum("ki,ij,kj->k", rates(mine), case.body.inertia, rates(mine))
    assert np.allclose(found["energy"].absolute, abs(energy - certain), atol=1e-14)


def test_tolerance_is_a_bound_on_both_sides():
    case = case_of("free_body")
    mine = case.reference()
    moved = mine | {"wx": mine["wx"] + 1e-5}
    largest = max(each.largest for each in case.compare(moved, tolerance=1.0).errors)
    assert 1e-6 < largest < 1e-3
    assert case.compare(moved, tolerance=1.001 * largest).passed
    assert not case.compare(moved, tolerance=0.999 * largest).passed


@pytest.mark.parametrize("size", [1e-7, 1e30])
def test_units_have_no_effect(size):
    """Inertias of other sizes give the same errors and the same diagnosis."""
    case = case_of("free_body", inertia=(size, 2 * size, 2.5 * size))
    mine = case.reference()
    found = case.compare(mine | in_space(case, mine))
    assert found.diagnosis == ("the rates are along the axes of space, not of the body",)
    assert case.compare(mine).passed and case.accuracy == case_of("free_body").accuracy


def test_speed_scales_the_time():
    slow, fast = case_of("free_body"), case_of("free_body", rates=(1e3, 2e3, 5e2), end=0.02)
    a, b = slow.reference([3.0, 7.0, 20.0]), fast.reference([0.003, 0.007, 0.02])
    assert np.allclose(rates(b), 1e3 * rates(a), rtol=1e-10)
    assert (attitudes(a).inv() * attitudes(b)).magnitude().max() < 1e-10


def test_period_of_the_flip():
    case = case_of("middle_axis_flip")
    ((period, unit),) = case.results.values()
    assert unit == "s"
    x = case.reference([0.4, 0.4 + period])
    assert np.allclose(rates(x)[0], rates(x)[1], atol=1e-8)
    half = case.reference([0.4, 0.4 + period / 2])
    assert np.isclose(half["wy"][0], -half["wy"][1])
    with refused(ValueError, "separatrix"):
        case_of("middle_axis_flip", rates=(0.0, 5.0, 0.0))


def test_spin_up_by_fresnel_integrals():
    """Across the axis of a symmetric body, W' = i n W + torque/transverse with W = wx + i wy and n linear in time."""
    case = case_of("spin_up")
    across, along, torque, w = (np.asarray(case.parameters[k][0]) for k in ("transverse", "axial", "torque", "rates"))
    x = case.reference()
    spin, rate = w[2], torque[2] / along
    assert np.allclose(x["wz"], spin + rate * x["t"], atol=1e-11)
    # The phase is a (t + b)^2 + constant, and the integral of exp(-i a s^2) is that of Fresnel.
    a, b = 0.5 * (along - across) / across * rate, spin / rate

    def integral(s):
        sine, cosine = fresnel(s * math.sqrt(2 * abs(a) / math.pi))
        return math.sqrt(math.pi / (2 * abs(a))) * (cosine - 1j * math.copysign(1.0, a) * sine)

    s = x["t"] + b
    across_axis = (w[0] + 1j * w[1]) * np.exp(-1j * a * b**2)
    across_axis = across_axis + (torque[0] + 1j * torque[1]) / across * (integral(s) - integral(b))
    across_axis = across_axis * np.exp(1j * a * s**2)
    assert np.allclose(x["wx"] + 1j * x["wy"], across_axis, atol=1e-10)


def test_results_of_other_cases():
    case = case_of("pitch_libration")
    ((period, _),) = case.results.values()
    n = case.parameters["mean_motion"][0]
    x = case.reference([100.0, 100.0 + period])
    pitch = 2 * np.arctan2(x["qz"], x["qw"]) - n * x["t"]
    assert np.isclose(np.sin(pitch[0]), np.sin(pitch[1]), atol=1e-9) and np.isclose(x["wz"][0], x["wz"][1], rtol=1e-9)
    coning = case_of("coning")
    precession, nutation, angle = (value for value, _ in coning.results.values())
    t = 2 * math.pi / nutation
    y = coning.reference([0.0, abs(t)])
    assert np.allclose(rates(y)[0], rates(y)[1], atol=1e-12)
    L = coning.body.inertia @ coning.body.rates
    assert np.isclose(precession, np.linalg.norm(L) / 2) and np.isclose(math.cos(angle), L[2] / np.linalg.norm(L))


COMPILED = {"eccentric_libration", "water_dimer"}  # by Numba, in some seconds
NAMES = [pytest.param(name, marks=[pytest.mark.long] if name in COMPILED else []) for name in co.checkcases.names()]


@pytest.mark.parametrize("name", NAMES)
def test_statements_name_every_parameter_and_column(name):
    case = case_of(name)
    text = str(case)
    assert all(f"{key} = " in text for key in case.parameters) and all(column in text for column in case.columns)
    assert case.columns[0] == "t" and case.times[0] == 0.0 and case.source and case.basis
    assert set(case.reference([0.0, case.end])) == set(case.columns)


REFUSALS = [
    ({"t": [0.0, 1.0]}, "wx=NAME"),
    ({"wx": [0.0, 1.0], "wy": [0.0, 1.0], "wz": [0.0, 1.0]}, "t=NAME"),
    ({"t": [0.0, 1.0], "wx": [0.0, 1.0], "wy": [0.0, 1.0]}, "wz"),
    ({"t": [0.0, 0.0], "wx": [0.0, 1.0], "wy": [0.0, 1.0], "wz": [0.0, 1.0]}, "increasing"),
    ({"t": [0.0], "wx": [0.0], "wy": [0.0], "wz": [0.0]}, "two or more"),
    ({"t": [0.0, 1e3], "wx": [0.0, 1.0], "wy": [0.0, 1.0], "wz": [0.0, 1.0]}, "1000"),
    ({"t": [-1.0, 1.0], "wx": [0.0, 1.0], "wy": [0.0, 1.0], "wz": [0.0, 1.0]}, "-1"),
    ({"t": [0.0, 1.0], "wx": [0.0, math.nan], "wy": [0.0, 1.0], "wz": [0.0, 1.0]}, "sample 2"),
    ({"t": [0.0, 1.0], "wx": [0.0, 1.0, 2.0], "wy": [0.0, 1.0], "wz": [0.0, 1.0]}, "lengths"),
    ({"t": [0.0, 1.0], "qw": [1.0, 0.0], "qx": [0.0, 0.0], "qy": [0.0, 0.0], "qz": [0.0, 0.0]}, "no rotation"),
    ({"t": [0.0, 1.0], "a": [1.0, 0.0]}, "no columns of wx, wy, wz, qw, qx, qy, qz"),
]
UNORDERED = {f"q{k}": [1.0, 0.0] for k in (1, 2, 3, 4)}


@pytest.mark.parametrize(("samples", "words"), REFUSALS, ids=[words for _, words in REFUSALS])
def test_samples_that_cannot_be_compared_are_refused(samples, words):
    with refused(ValueError, words):
        case_of("free_body").compare(samples)


@pytest.mark.parametrize("others", [(), RATES, ("p", "q", "r")], ids=str)
@pytest.mark.parametrize("time", ["t", "Time [s]"])
def test_quaternions_of_unknown_order_are_refused(others, time):
    """Also where rates are there or named; columns of the attitude, or the names of all columns, resolve it."""
    case = case_of("free_body")
    mine = case.reference()
    samples = {time: mine["t"], **{name: mine[w] for name, w in zip(others, RATES, strict=False)}}
    samples |= {f"q{k}": mine[name] for k, name in enumerate(("qx", "qy", "qz", "qw"), 1)}
    named = ",".join(f"{w}={name}" for w, name in zip(RATES, others, strict=False))
    for columns in (None, named or None):
        with refused(ValueError, "q1, q2, q3, q4", "unknown order", "qw=q4,qx=q1"):
            case.compare(samples, columns=columns)
    found = case.compare(samples, columns="qw=q4,qx=q1,qy=q2,qz=q3")
    assert found.passed and "attitude" in {each.name for each in found.errors}
    if others:
        found = case.compare(samples, columns="t,wx,wy,wz,-,-,-,-")
        assert found.passed and "not compared, since the samples lack it: attitude (qw, qx, qy, qz)" in found.notes
        assert "ignored columns of the samples: 'q1', 'q2', 'q3', 'q4'" in str(found)


def test_a_quantity_is_not_left_out_beside_columns_that_are_not_recognized():
    case = case_of("free_body")
    mine = case.reference()
    strange = {f"att{k}": mine[name] for k, name in enumerate(QUATERNION)}
    samples = {"t": mine["t"], **{name: mine[name] for name in RATES}, **strange}
    for columns in (None, "t=t"):
        with refused(ValueError, "attitude (qw, qx, qy, qz)", "'att0', 'att1', 'att2', 'att3'", "wx=NAME"):
            case.compare(samples, columns=columns)
    assert len(case.compare(samples, columns="qw=att0,qx=att1,qy=att2,qz=att3").errors) == 4
    found = case.compare(samples, columns="wx=wx,wy=wy,wz=wz")
    assert found.passed and "ignored columns of the samples: 'att0', 'att1', 'att2', 'att3'" in found.notes
    found = case.compare({**mine, "temperature": mine["t"]})
    assert found.passed and found.notes == ("ignored columns of the samples: 'temperature'",)
    assert case.compare(mine).notes == ()


def test_arguments_that_cannot_be_used_are_refused():
    case = case_of("free_body")
    mine = case.reference()
    with refused(ValueError, "known to 1e-12"):
        case.compare(mine, tolerance=1e-14)
    with refused(ValueError, "step"):
        case.compare(mine, step=-1.0)
    with refused(ValueError, "wa"):
        case.compare(mine, columns="wa=wx")
    with refused(ValueError, "once"):
        case.compare(mine, columns="wx=wx,wx=wy")
    with refused(ValueError, "once"):
        case.compare(mine, columns={"wx": "wx", "wy": "wx"})
    with refused(ValueError, "nothere"):
        case.compare(mine, columns={"wx": "nothere"})
    with refused(ValueError, "furlong"):
        case.compare({**mine, "p [furlong]": mine["wx"]}, columns="wx=p [furlong]")
    with refused(ValueError, "shape"):
        case.reference(1.0)
    with refused(ValueError, "20"):
        case.reference([21.0])
    with refused(TypeError, "samples"):
        case.compare(3)
    with refused(ValueError, "free_body"):
        co.checkcases.get("fre_body")
    with refused(TypeError, "speed"):
        co.checkcases.get("free_body", speed=3)
    with refused(ValueError, "inertia"):
        co.checkcases.get("free_body", inertia=(1, 2))
    with refused(ValueError, "samples"):
        co.checkcases.get("free_body", samples=1)
    with refused(ValueError, "pitch"):
        co.checkcases.get("pitch_libration", pitch=2.0)
    with refused(ValueError, "eccentricity"):
        co.checkcases.get("eccentric_libration", eccentricity=0.7)


def test_names_of_others_are_understood_with_their_units():
    case = case_of("free_body")
    mine = case.reference()
    degrees = {"p_deg_s": np.degrees(mine["wx"]), "q_deg_s": np.degrees(mine["wy"]), "r_deg_s": np.degrees(mine["wz"])}
    found = case.compare({"Time (s)": mine["t"], **degrees})
    assert found.passed and any("converted from deg/s" in note for note in found.notes)
    assert any("not compared" in note and "qw" in note for note in found.notes)
    quaternion = {f"q{k}": mine[name] for k, name in enumerate(QUATERNION)}
    assert case.compare({"time": mine["t"], **quaternion}).passed
    ms = {"t": 1e3 * mine["t"], **{name: mine[name] for name in RATES}}
    assert case.compare(ms, columns="t=t[ms]").passed
    two = {**mine, "p": mine["wx"], "q": mine["wy"], "r": mine["wz"]}
    assert case.compare(two).passed  # the exact names come first
    several = {f"omega_{a}": mine[f"w{a}"] for a in "xyz"} | {"p": mine["wx"], "q": mine["wy"], "r": mine["wz"]}
    with refused(ValueError, "could be", "omega_x", "p q r"):
        case.compare({"t": mine["t"], **several})


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "column, unit, size",
    [
        ("wx", "rpm", 2 * math.pi / 60),
        ("wx", "rev/s", 2 * math.pi),
        ("wx", "Hz", 2 * math.pi),
        ("wx", "deg/h", math.radians(1) / 3600),
        ("t", "us", 1e-6),
        ("t", "ns", 1e-9),
        ("t", "ps", 1e-12),
        ("t", "fs", 1e-15),
        ("t", "min", 60),
        ("t", "h", 3600),
        ("t", "d", 86400),
    ],
)
def test_units_have_their_sizes(column, unit, size):
    case = case_of("free_body")
    mine = case.reference()
    found = case.compare(mine | {column: mine[column] / size}, columns={column: f"{column}[{unit}]"})
    assert found.passed and any(f"converted from {unit}" in note for note in found.notes)


@pytest.mark.parametrize(
    "column, name, size",
    [
        ("t", "clock_ms", 1e-3),
        ("t", "log time milliseconds", 1e-3),
        ("t", "stampUs", 1e-6),
        ("t", "elapsed_hours", 3600),
        ("t", "clock_s", 1),
        ("wx", "roll_rpm", 2 * math.pi / 60),
        ("wx", "rollRateDps", math.radians(1)),
        ("wx", "att1", 1),
    ],
)
@pytest.mark.parametrize("is_text", [False, True])
def test_units_end_the_names_that_are_given(column, name, size, is_text):
    case = case_of("free_body")
    mine = case.reference()
    mine[name] = mine.pop(column) / size
    found = case.compare(mine, columns=f"{column}={name}" if is_text else {column: name})
    assert found.passed and any("converted" in note for note in found.notes) == (size != 1)


@pytest.mark.parametrize(
    "column, name, unit",
    [("t", "clock_h", "h"), ("t", "t_min", "min"), ("t", "ms_clock", "ms"), ("wx", "gyro_100_hz", "Hz")],
)
def test_units_in_names_that_may_mean_something_else_are_refused(column, name, unit):
    case = case_of("free_body")
    mine = case.reference()
    mine[name] = mine.pop(column)
    with refused(ValueError, repr(name), f"{name}[{unit}]", f"{name}[{'s' if column == 't' else 'rad/s'}]"):
        case.compare(mine, columns={column: name})
    assert case.compare(mine, columns={column: f"{name}[{'s' if column == 't' else 'rad/s'}]"}).passed


def test_times_beyond_the_span_are_perhaps_of_another_unit():
    case = case_of("free_body")
    mine = case.reference()
    with refused(ValueError, "20000 s", "t=NAME[ms]", "--columns"):
        case.compare(mine | {"t": 1e3 * mine["t"]})


@pytest.mark.parametrize("norm", [1.5, 0.5])
def test_quaternions_of_other_norms_are_normalized_and_noted(norm):
    case = case_of("free_body")
    mine = case.reference()
    found = case.compare(mine | {name: norm * mine[name] for name in QUATERNION})
    assert found.passed and any("normalized" in note and "0.5" in note for note in found.notes)


def test_figure_and_columns_of_a_comparison():
    case = case_of("free_body")
    found = case.compare(case.reference())
    assert {line.get_label() for line in found.plot().axes[0].get_lines()} >= {"attitude [rad]", "rates, relative"}
    assert set(found.columns()) == {"t", *(each.name for each in found.errors)}
    assert "within" in str(found) and "largest" in str(found)
