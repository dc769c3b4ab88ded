"""Pictures, variables of datasets and integrals of systems with any number of parts, by other formulas, for 1 to 5."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from drawn_runs import Picture, made, shown
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import coadjoint as co

COUNTS = (1, 2, 3, 5)
S = co.systems
# Systems with a fixed number of parts, and fluids, whose parts are modes.
FIXED = {
    "clebsch_body", "double_spherical_pendulum", "fluid_triad", "goryachev_chaplygin_top", "gyrostat", "heavy_top",
    "kirchhoff_body", "kovalevskaya_top", "lagrange_top", "lorenz_1960", "maxwell_bloch", "paper_a37",
    "paper_rigid_body", "passive_scalar", "reduced_mhd", "riccati", "rigid_body", "satellite", "satellite_on_orbit",
    "thermal_qg", "layered_qg", "separable_cosh", "sklyanin",
    "sphere_euler", "sphere_qg", "surface_qg", "torus_euler", "torus_qg",
}  # fmt: skip
# Their states are matrices.
FLUIDS = {
    "layered_qg", "passive_scalar", "reduced_mhd", "sphere_euler", "sphere_qg", "surface_qg", "torus_euler", "torus_qg",
    "thermal_qg",
}  # fmt: skip


def inertias(count: int) -> list[tuple[float, ...]]:
    return [(1.0 + 0.1 * k, 2.0, 2.5 + 0.2 * k) for k in range(count)]


def masses(count: int) -> np.ndarray:
    return 1.0 + np.arange(count)


def axes(count: int) -> np.ndarray:
    return (0.01 + 0.01 * np.arange(count))[:, None] * np.eye(3)[np.arange(count) % 3]


MADE: dict[str, Callable[[int], Any]] = {
    "bodies": lambda count: S.bodies(inertias(count), masses(count)),
    "body": lambda count: S.body((1.0, 2.0, 2.5), wheels=axes(count)),
    "decorated_particles": lambda count: S.decorated_particles(masses(count)),
    "gravitating_bodies": lambda count: S.gravitating_bodies(inertias(count), masses(count)),
    "manakov_top": lambda count: S.manakov_top(np.arange(count + 2.0), np.arange(count + 2.0) ** 2),
    "matrix_body": lambda count: S.matrix_body(masses(count + 1)),
    "point_vortices": lambda count: S.point_vortices(masses(count)),
    "rigid_molecules": lambda count: S.rigid_molecules(count=count),
    "so_n_body": lambda count: S.so_n_body(masses(count + 2)),
    "spin_lattice": lambda count: S.spin_lattice("chain", count, periodic=False),
    "toda": lambda count: S.toda(count + 1),
    "toda_ring": lambda count: S.toda_ring(count + 1),
    "vlasov_moments": lambda count: S.vlasov_moments(2 * count, "x20"),
}


def test_every_system_has_a_fixed_number_of_parts_or_is_tested_below():
    assert set(S.names()) == FIXED | set(MADE)


def positions_of(x: np.ndarray, count: int) -> np.ndarray:
    """Positions follow 12 numbers of each body, and 3 of each momentum."""
    return np.stack([x[:, 15 * count + 3 * k : 15 * count + 3 * k + 3] for k in range(count)], axis=1)


def distances(x: np.ndarray, count: int) -> dict[str, np.ndarray]:
    r = positions_of(x, count)
    names = {k: "distance" if count == 2 else f"from 1 to {k + 1}" for k in range(1, count)}
    return {name: np.sqrt(((r[:, k] - r[:, 0]) ** 2).sum(axis=1)) for k, name in names.items()}


def librations(x: np.ndarray, count: int) -> dict[str, np.ndarray]:
    r, found = positions_of(x, count)[..., :2] @ (1.0, 1.0j), {}
    for k in range(1, count):
        axis = x[:, 12 * k + 3] + 1.0j * x[:, 12 * k + 6]  # X1 and Y1: the first axis of the body in the plane
        name = "libration" if count == 2 else f"libration[{k + 1}]"
        found[name] = np.degrees(np.angle(axis / (r[:, k] - r[:, 0])))
    return found


def evenly(x: np.ndarray, count: int) -> list[np.ndarray]:
    """At most eight coordinates."""
    n = x.shape[1]
    return [x[:, i] for i in np.unique(np.linspace(0, n - 1, min(n, 8)).round().astype(int))]


def of_particles(x: np.ndarray, count: int) -> list[np.ndarray]:
    """Positions, then second moments, of four particles."""
    few = range(min(count, 4))
    return [*(x[:, a] for a in few), *(x[:, 2 * count + 1 :].reshape(len(x), count, 3)[:, a, 0] for a in few)]


# The lines of the panel "components"; names where the system gives some.
LINES: dict[str, Callable[[np.ndarray, int], Any]] = {
    "bodies": lambda x, count: [x[:, i] for i in range(3)],
    "body": lambda x, count: [x[:, 6 + i] for i in range(3)],
    "decorated_particles": of_particles,
    "gravitating_bodies": lambda x, count: librations(x, count) or evenly(x, count),
    "manakov_top": evenly,
    "matrix_body": lambda x, count: [
        x.reshape(-1, count + 1, count + 1)[:, i, j] for i, j in zip(*np.triu_indices(count + 1, 1), strict=True)
    ][:8],
    "point_vortices": lambda x, count: [x[:, i] for i in range(min(2 * count, 4))],
    "rigid_molecules": lambda x, count: distances(x, count) or evenly(x, count),
    "so_n_body": evenly,
    "spin_lattice": lambda x, count: dict(zip(("S1", "S2", "S3"), x.reshape(-1, count, 3).mean(axis=1).T, strict=True)),
    "toda": evenly,
    "toda_ring": lambda x, count: [x[:, i] for i in range(count + 1)],
    "vlasov_moments": evenly,
}


def lines_of(panel: Any) -> dict[str, np.ndarray]:
    return {line.get_label(): line.get_ydata() for line in panel.lines if not line.get_label().startswith("_")}


def declared(run: Any, name: str) -> Any:
    """Return the axes of a kind of picture as the system declares it."""
    axes = Figure().add_subplot()
    run.plot([name], axes=axes)
    return axes


def drawn_run(name: str, count: int) -> Any:
    """Return a run of random states, which no step connects."""
    system = MADE[name](count)
    x = np.random.default_rng(count).normal(size=(7, *system.shape))
    return made(x - np.swapaxes(x, 1, 2) if x.ndim == 3 else x, system, method=co.Splitting(), step=0.01)


@pytest.mark.thinned(1)  # the second of two parts may be the only one that is right
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", sorted(MADE))
def test_components_are_those_of_each_part(name, count):
    run = drawn_run(name, count)
    wanted = LINES[name](run.x.reshape(len(run.t), -1), count)
    found = lines_of(declared(run, "components"))
    if isinstance(wanted, dict):
        plain = {label.translate(str.maketrans("", "", "$_{}")): values for label, values in found.items()}
        assert list(plain) == list(wanted)
    assert len(found) == len(wanted)
    for values, expected in zip(found.values(), wanted.values() if isinstance(wanted, dict) else wanted, strict=True):
        np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)


def roots(x: np.ndarray) -> dict[str, np.ndarray]:
    """Both roots of x1 w^2 - 2 x2 w - x3; v is the smaller one if x1 is positive."""
    pairs = np.array([np.roots([a, -2.0 * b, -c]) for a, b, c in x])
    pairs = np.where((np.abs(pairs) < 6.0) & (pairs.imag == 0.0), pairs.real, np.nan)
    ordered = np.where(x[:, :1] > 0.0, np.sort(pairs, axis=1), -np.sort(-pairs, axis=1))
    return {"v": ordered[:, 0], "w": ordered[:, 1]}


# The lines of systems with a fixed number of parts that are no coordinates.
FUNCTIONS: dict[str, Callable[[np.ndarray], dict[str, np.ndarray]]] = {
    "riccati": roots,
    "satellite": lambda x: {"pitch": np.degrees(np.angle(x[:, 6] + 1j * x[:, 7]))},
    "satellite_on_orbit": lambda x: {
        "pitch": np.degrees(np.angle(x[:, 3] + 1j * x[:, 4])),
        "tilt of the normal": np.degrees(np.arctan2(np.hypot(x[:, 9], x[:, 10]), x[:, 11])),
    },
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", sorted(FIXED - FLUIDS))
def test_components_of_other_systems_are_coordinates_or_the_functions_of_their_names(name):
    system = S.get(name)
    x = np.random.default_rng(1).normal(size=(7, system.dim))
    if name == "satellite_on_orbit":
        x[:, 9:] /= np.linalg.norm(x[:, 9:], axis=1, keepdims=True)
    found = lines_of(declared(made(x, system, method=co.Splitting(), step=0.01), "components"))
    if name in FUNCTIONS:
        plain = {label.strip("$"): values for label, values in found.items()}
        wanted = FUNCTIONS[name](x)
        assert list(plain) == list(wanted)
        for label, values in wanted.items():
            np.testing.assert_allclose(plain[label], values, rtol=0, atol=1e-10)
    else:
        numbers = [np.flatnonzero((x.T == values).all(axis=1)).tolist() for values in found.values()]
        assert numbers and all(len(number) == 1 for number in numbers) and sorted(numbers) == numbers


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", ["bodies", "gravitating_bodies", "rigid_molecules"])
def test_directions_and_orbits_are_those_of_each_body(name, count):
    run = drawn_run(name, count)
    if name == "gravitating_bodies":
        kinds = [panel.get_title().partition(" (")[0] for panel in run.plot().axes]
        assert ("orbits relative to the first body" in kinds) == (count > 1)
        r = positions_of(run.x, count)
        paths = [line.get_xydata() for line in declared(run, "phase portrait").lines[::2]] if count > 1 else []
        for k, path in enumerate(paths, 1):
            np.testing.assert_allclose(path, (r[:, k] - r[:, 0])[:, :2], rtol=1e-13, atol=1e-13)
        assert len(paths) == count - 1
        return
    offset, what = ((0, 1, 2), "body") if name == "bodies" else ((5, 8, 11), "molecule")
    vectors = {f"{what} {k + 1}": np.eye(run.system.dim)[[12 * k + i for i in offset]] for k in range(count)}
    by_name, by_numbers = declared(run, "directions"), shown(run, Picture("directions", vectors=vectors))
    for one, other in zip(by_name.lines, by_numbers.lines, strict=True):
        assert one.get_label() == other.get_label()
        np.testing.assert_array_equal(one.get_xydata(), other.get_xydata())


@pytest.mark.parametrize("count", COUNTS)
def test_pictures_of_particles_and_lattices_have_each_part(count):
    lumps = drawn_run("decorated_particles", count)
    thin = [line for line in declared(lumps, "phase ellipse").lines if len(line.get_xdata()) == len(lumps.t)]
    for a in range(count):
        np.testing.assert_array_equal(thin[a].get_xdata(), lumps.x[:, a])
        np.testing.assert_allclose(thin[a].get_ydata(), lumps.x[:, count + a] / (1.0 + a), rtol=1e-14)
    toda = drawn_run("toda", count)
    panel = next(panel for panel in toda.plot().axes if panel.get_ylabel() == "position of the particles")
    q = np.array(list(lines_of(panel).values()))
    np.testing.assert_allclose(0.5 * np.exp(2.0 + (q[:-1] - q[1:]) / 2.0), abs(toda.x[:, count + 1 :].T), rtol=1e-12)
    assert len(q) == count + 1 and abs(q.sum(axis=0)).max() < 1e-13


@pytest.mark.parametrize("count", COUNTS)
def test_variables_and_integrals_are_those_of_each_body(count):
    system, rng = MADE["bodies"](count), np.random.default_rng(count)
    A = Rotation.random(count, random_state=count)
    omega, r, v = rng.normal(size=(3, count, 3))
    run = co.integrate(system, system.state(r, v, A, omega), (0, 0.1), 0.1, observe=system.integrals)
    data, I = run.to_xarray(), np.array(inertias(count))
    turned = Rotation.from_matrix(run.x[1, : 12 * count].reshape(count, 12)[:, 3:].reshape(count, 3, 3))
    for k, attitude in enumerate((A, turned)):
        L = run.x[k, : 12 * count].reshape(count, 12)[:, :3]
        np.testing.assert_array_equal(data["angular_momentum"][k], L)
        np.testing.assert_allclose(data["angular_velocity"][k], L / I, rtol=1e-15)
        same = (Rotation.from_quat(data["quaternion"][k]) * attitude.inv()).magnitude()
        assert data["quaternion"].dims == ("time", "body", "component_of_quaternion") and same.max() < 1e-14
        p, r = (run.x[k, b * count : (b + 3) * count].reshape(count, 3) for b in (12, 15))
        total = (np.cross(r, p) + attitude.apply(L)).sum(axis=0)
        found = np.array([values[k] for values in run.observed.values()])
        for component in (*total, *p.sum(axis=0)[: len(found) - 3]):
            assert np.isclose(found, component, rtol=1e-12, atol=1e-12).any()
    for name, values in (("position", run.positions), ("velocity", run.velocities)):
        assert data[name].dims == ("time", "body", "axis") and data[name].attrs["units"] == "1"
        np.testing.assert_array_equal(data[name], values)
    np.testing.assert_array_equal(run.positions[1], run.x[1, 15 * count : 18 * count].reshape(count, 3))
    np.testing.assert_allclose(run.velocities[0], v, rtol=1e-14)


WANTED = Rotation.from_rotvec([0.3, -0.2, 0.4])
LAW = co.forces.Pointing(0.5, 1.5, attitude=WANTED, error="quaternion")
PYRAMID = [[(-q, p, 0), (-0.6 * p, -0.6 * q, 0.8)] for p, q in ((1, 0), (0, 1), (-1, 0), (0, -1))]
INERTIA, PERIOD = (1.0, 2.0, 2.5), 0.5


def slewing(t: float) -> np.ndarray:
    c, s = np.cos(0.1 * t), np.sin(0.1 * t)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


CONTROLLED: dict[str, tuple[Any, dict[str, Any]]] = {
    "direct": (LAW, {}),
    "slewing": (co.forces.Pointing(0.5, 1.5, attitude=slewing), {}),
    "sampled": (co.forces.Sampled(LAW, PERIOD), {}),
    "wheels": (co.forces.ReactionWheels(LAW, PERIOD), {"wheels": 0.01 * np.eye(3)}),
    "thrusters": (co.forces.Thrusters(LAW, PERIOD, max_torque=0.2, min_impulse=0.02), {}),
    "gyros": (co.forces.ControlMomentGyros(LAW, PERIOD), {"gyros": PYRAMID}),
}


def law_at(run: Any, law: Any, rotation: Rotation) -> np.ndarray:
    """The torque of a `Pointing` at the saved states, by quaternions."""
    q = rotation.as_quat(canonical=True)
    angle = 2.0 * np.arctan2(np.linalg.norm(q[:, :3], axis=1), q[:, 3])
    e = rotation.as_rotvec() * np.sinc(angle / np.pi)[:, None] if law.error == "sine" else 2.0 * q[:, :3]
    return -0.5 * e - 1.5 * run.angular_velocity


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "wheels" else pytest.mark.long) for name in CONTROLLED]
)
def test_the_pictures_of_a_controlled_body_are_its_errors_rates_torques_and_rotors(name):
    force, rotors = CONTROLLED[name]
    system = co.systems.body(INERTIA, **rotors).with_forces(force)
    run = co.integrate(system, system.state(Rotation.from_rotvec([0.5, 0.2, 0.1]), (0.1, -0.2, 0.3)), (0, 3), 0.05)
    panels = {panel.get_title(): panel for panel in run.plot().axes}
    law = getattr(force, "law", force)
    wanted = Rotation.from_matrix([slewing(t) for t in run.t]) if name == "slewing" else WANTED
    rotation = wanted.inv() * run.rotation
    (angle,) = lines_of(panels["pointing error"]).values()
    np.testing.assert_allclose(angle, np.degrees(rotation.magnitude()), rtol=1e-9)
    rates = [*lines_of(panels["angular velocity in the frame of the body"]).values()]
    np.testing.assert_array_equal(np.transpose(rates), run.angular_velocity)
    torque = law_at(run, law, rotation)
    sampled = torque[10 * ((np.arange(1, 61) - 1) // 10)]  # of the last sample before each saved state
    title = {"wheels": "torque of the motors", "gyros": "rate of the gimbals"}.get(name, "torque")
    shown_values = np.transpose([*lines_of(panels[title]).values()])
    if name in ("direct", "slewing"):
        np.testing.assert_allclose(shown_values, torque, rtol=1e-12, atol=1e-12)
    elif name != "gyros":
        fires = np.minimum(abs(sampled), 0.2) * PERIOD >= 0.02
        expected = {"sampled": sampled, "wheels": -sampled, "thrusters": np.clip(sampled, -0.2, 0.2) * fires}[name]
        np.testing.assert_allclose(shown_values[1:], expected, rtol=1e-12, atol=1e-12)
    data = run.to_xarray()
    quaternions = data["quaternion"].values
    np.testing.assert_allclose(abs((quaternions * run.rotation.as_quat()).sum(axis=1)), 1.0, rtol=1e-14)
    assert ((quaternions[1:] * quaternions[:-1]).sum(axis=1) > 0.9).all()
    assert ("wheel_speed" in data, "gimbal_angle" in data) == (name == "wheels", name == "gyros")
    if name == "wheels":
        speeds = run.x[:, 12:15] / 0.01 - run.angular_velocity
        np.testing.assert_allclose(data["wheel_speed"], speeds, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(np.transpose([*lines_of(panels["speed of the wheels"]).values()]), speeds, rtol=1e-9)
    if name == "gyros":
        angles = np.angle(run.x[:, 12:20:2] + 1.0j * run.x[:, 13:20:2])
        np.testing.assert_allclose(data["gimbal_angle"], angles, atol=1e-15)
        shown_angles = np.transpose([*lines_of(panels["gimbal angles"]).values()])
        np.testing.assert_allclose(shown_angles, np.unwrap(angles, axis=0), atol=1e-14)
        rate = np.diff(shown_angles, axis=0) / 0.05
        np.testing.assert_allclose(shown_values[1:], rate, rtol=1e-9, atol=1e-12)


def test_molecules_are_drawn_by_their_shapes():
    """Linear ones by their line, atoms by their paths."""
    nitrogen, argon = ((-0.055, 0, 0), (0.055, 0, 0)), ((0, 0, 0),)
    lj = [((0.3, 0.33),) * 2, ((1.0, 0.34),)]
    both = S.rigid_molecules([nitrogen, argon], [(0, 0), (0,)], lj, [(14.0, 14.0), (40.0,)], [2, 1])
    run = made(np.random.default_rng(1).normal(size=(7, both.dim)), both, method=co.Splitting(), step=0.01)
    assert [line.get_label() for line in declared(run, "directions").lines if "mol" in str(line.get_label())] == [
        "molecule 1",
        "molecule 2",
    ]
    along = {f"molecule {k + 1}": [f"{axis}1[{k + 1}]" for axis in "XYZ"] for k in range(2)}
    for one, other in zip(
        declared(run, "directions").lines, shown(run, Picture("directions", vectors=along)).lines, strict=True
    ):
        np.testing.assert_allclose(abs(np.array(one.get_xydata())), abs(np.array(other.get_xydata())), atol=1e-12)
    atoms = S.rigid_molecules(argon, (0,), lj[1], (40.0,), 3)
    run = made(np.random.default_rng(2).normal(size=(7, atoms.dim)), atoms, method=co.Splitting(), step=0.01)
    assert len(declared(run, "phase portrait").lines) == 6 and "directions" not in " ".join(
        panel.get_title() for panel in run.plot().axes
    )
