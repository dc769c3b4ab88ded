"""Every system, scheme, force and option of a run is stored in datasets, files and configurations, and read back."""

import copy
import dataclasses
import inspect
import json
import pickle
import re
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
import xarray
from stored_systems import (
    BODY,
    FREE,
    MATRICES,
    SPHERE,
    SYSTEMS,
    P,
    Q,
    described,
    is_matrix,
    own,
    read_back,
    start,
)

import coadjoint as co
from configuration_files import READY_MADE
from matrix.forces import first_fitting
from refusals import refused
from same_runs import check_same, same_bits
from satellite_forces import CASES
from served import FLUID, serves, state_of

X = (0.3, -0.2, 0.5)
SCHEMES = {name: co.methods.registry.scheme(name) for name in co.methods.names()}


# Systems.


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", SYSTEMS)
def test_runs_of_own_systems_are_repeated_and_loaded(name, tmp_path):
    """Their systems are equal, also copied and pickled, and no function is said to be lost."""
    system = SYSTEMS[name]
    matrix = name in MATRICES
    method = co.IsospectralGauss() if matrix else co.GaussLegendre(2)
    options = {} if matrix or "batch" in name else {"attitude": "coadjoint"}
    sol = co.integrate(system, start(system), (0.25, 0.75), 0.125, method, save_every=2, **options)
    dataset = sol.to_xarray()
    assert "not_stored" not in dataset.attrs
    again = co.results.rebuild(dataset)
    check_same(again, sol)
    dataset.to_netcdf(tmp_path / "run.nc")
    loaded = co.load(tmp_path / "run.nc")
    check_same(loaded, sol)
    wanted = described(system)
    for found in (again.system, loaded.system, read_back(system), copy.deepcopy(system), _pickled(system)):
        assert described(found) == wanted
    assert again.to_xarray().attrs["system"] == dataset.attrs["system"]


def _pickled(system):
    return pickle.loads(pickle.dumps(system))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_random_systems_are_repeated(seed):
    """On the Euclidean algebra, in a representation that is not symmetric."""
    rng, algebra = np.random.default_rng(seed), co.algebras.e(3)
    B, turn = rng.uniform(-1.0, 1.0, (6, 6)), np.eye(4) + np.triu(rng.integers(-2, 3, (4, 4)).astype(float), 1)
    rho = np.linalg.inv(turn).round() @ algebra.representation @ turn
    casimirs = {"p": co.Polynomial({tuple(2 * int(i == k) for i in range(6)): Fraction(1, 3) for k in (3, 4, 5)})}
    H = co.Quadratic(B + B.T, linear=rng.uniform(-1.0, 1.0, 6), constant=1.5)
    system = co.LiePoissonSystem(algebra, H, casimirs=casimirs, representation=rho)
    assert described(read_back(system)) == described(system)
    sol = co.integrate(system, np.full(6, 0.25), (0.0, 0.5), 0.125, attitude=True)
    check_same(co.results.rebuild(sol.to_xarray()), sol)


# Values of parameters, where a multiple of the default is none.
OTHERS = {
    ("matrix_body", "inertia"): {"inertia": (1.0, 2.0, 4.0)},
    ("clebsch_body", "inertia"): {"inertia": (2.0, 2.0, 2.0)},
    ("clebsch_body", "inverse_mass"): {"inverse_mass": (2.0, 2.5, 4.0)},
    ("kirchhoff_body", "coupling"): {"coupling": ((0.1, 0.0, 0.2), (0.0, -0.1, 0.0), (0.0, 0.0, 0.3))},
    ("decorated_particles", "pair"): {"pair": (0.0, 0.0, 0.5)},
    ("so_n_body", "inertia"): {"inertia": (1.0, 2.0, 4.0)},
    ("manakov_top", "a"): {"a": (1.0, 3.0, 4.0, 7.0)},
    ("manakov_top", "b"): {"b": (2.0, 3.0, 2.5, 5.0)},
    ("spin_lattice", "lattice"): {"lattice": "ring", "shape": 3},
    ("spin_lattice", "shape"): {"shape": 3},
    ("spin_lattice", "periodic"): {"shape": 3, "periodic": True},
    ("spin_lattice", "dm"): {"dm": (0.1, 0.2, 0.3)},
    ("spin_lattice", "field"): {"field": (0.1, 0.2, 0.3)},
    ("vlasov_moments", "degree"): {"degree": 6},
    ("vlasov_moments", "potential"): {"potential": "1/4*x20 + 0.1*x20^2"},
    ("separable_cosh", "algebra"): {"algebra": "sl(2)"},
    ("separable_cosh", "constants"): {"algebra": "A3,7", "constants": {"a": 0.5}},
    ("gravitating_bodies", "order"): {"order": 0},
    ("rigid_molecules", "sites"): {"sites": ((0, 0, 0), (0.1, 0, 0), (0, 0, 0.1))},
    ("rigid_molecules", "lj"): {"lj": ((0.5, 0.25), (0, 0), (0.125, 0.25))},
    ("rigid_molecules", "box"): {"box": (2, 3, 4), "cutoff": 0.75},
    ("rigid_molecules", "cutoff"): {"cutoff": 0.75},
    ("rigid_molecules", "switch_from"): {"cutoff": 0.75, "switch_from": 0.5},
    ("rigid_molecules", "dielectric"): {"cutoff": 0.75, "dielectric": 80.0},
    ("rigid_molecules", "mixing"): {"mixing": "geometric"},
    ("body", "wheels"): {"wheels": [[0.1, 0.0, 0.0]]},
    ("body", "gyros"): {"gyros": [[[0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]]},
    ("sphere_euler", "rotation"): {"N": 4, "rotation": 0.75},
    ("passive_scalar", "rotation"): {"N": 4, "rotation": 0.75},
    ("layered_qg", "gamma"): {"N": 5, "gamma": ((2.0, -1.0), (-1.0, 1.0))},
    ("layered_qg", "thicknesses"): {"N": 5, "thicknesses": (2.0, 2.0)},
    ("layered_qg", "lamb"): {"N": 5, "lamb": ((2.0, -2.0), (-2.0, 2.0))},
    ("layered_qg", "rotation"): {"N": 5, "rotation": 0.75},
    ("thermal_qg", "gamma"): {"N": 5, "gamma": 2.0},
    ("thermal_qg", "rotation"): {"N": 5, "rotation": 0.75},
    ("thermal_qg", "topography"): {"N": 5, "topography": ((2.0, 1.0, 0.1, 0.0),)},
    ("thermal_qg", "bathymetry"): {"N": 5, "bathymetry": ((2.0, 1.0, 0.1, 0.0),)},
    ("thermal_qg", "lamb"): {"N": 5, "lamb": 2.0},
    ("thermal_qg", "surface"): {"N": 5, "surface": "torus"},
    ("point_vortices", "surface"): {"surface": "sphere"},
    ("point_vortices", "radius"): {"radius": 0.5},
}  # fmt: skip
OTHERS |= {(name, "surface"): {"N": 5, "surface": "torus"} for name in ("reduced_mhd", "passive_scalar", "layered_qg")}
SIZED = {
    "sphere_euler": 4,
    "torus_euler": 5,
    "reduced_mhd": 5,
    "passive_scalar": 5,
    "sphere_qg": 4,
    "torus_qg": 5,
    "surface_qg": 4,
    "layered_qg": 5,
    "thermal_qg": 5,
}


def variants(name):
    """Return a system with its defaults, and with another value of each parameter."""
    make, small = getattr(co.systems, name), {"N": SIZED[name]} if name in SIZED else {}
    yield small
    for key, parameter in inspect.signature(make).parameters.items():
        if key == "N":
            continue
        default = parameter.default
        if (name, key) in OTHERS:
            yield OTHERS[name, key]
        elif isinstance(default, int) and not isinstance(default, bool):
            yield {key: default + 1}
        elif np.ndim(default) or isinstance(default, float):
            values = np.asarray(default, dtype=float)
            values = values if values.any() else values + 0.75
            yield {key: (values * (1.25 + 0.125 * np.arange(values.size).reshape(values.shape))).tolist()}
            if key == "inertia" and values.shape == (3,) and name in ("rigid_body", "heavy_top"):
                yield {key: [[2.0, 0.1, 0.2], [0.1, 3.0, -0.3], [0.2, -0.3, 4.0]]}


# Functions take seconds to compile.
SLOW = {"double_spherical_pendulum", "rigid_molecules", "satellite", "separable_cosh", "sklyanin"}


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n in SLOW else n for n in co.systems.names()]
)
@pytest.mark.filterwarnings("ignore:inertia")
def test_ready_made_systems_are_stored_with_every_parameter(name):
    make, seen = getattr(co.systems, name), []
    for arguments in variants(name):
        system = make(**arguments)
        again = read_back(system)
        wanted = described(system)
        assert described(again) == wanted and wanted not in seen, arguments
        seen.append(wanted)
        x, times = start(system), (0.0, 0.25)
        exact = [_exact(one, x, times[1]) for one in (again, system)]
        assert np.array_equal(*exact)
    options = {} if is_matrix(system) or system.algebra is None else {"attitude": "coadjoint"}
    sol = co.integrate(system, x, times, 0.125, **options)
    check_same(co.results.rebuild(sol.to_xarray()), sol)


def _exact(system, x, t):
    try:
        return np.asarray(system.exact(x, t))
    except (TypeError, ValueError):  # there is none
        return np.zeros(0)


def catalogue():
    """Yield one algebra for each name of the catalogue, with the parameters that it needs."""
    numbers = {"a": 0.5, "b": 0.25, "c": -0.75}
    for name in co.algebras.names():
        given = name.replace("(2n)", "(4)").replace("(n)", "(3)").replace("(p,q)", "(2,1)")
        for needed in ("", "a", "b", "c", "ab", "ac", "bc", "abc"):
            try:
                yield name, co.algebras.get(given, **{key: numbers[key] for key in needed})
                break
            except ValueError:
                continue


def test_algebras_of_the_catalogue_are_stored():
    found = dict(catalogue())
    assert len(found) >= 70
    for algebra in found.values():
        H = co.Quadratic(np.linspace(1.0, 2.0, algebra.dim), constant=0.5)
        system = co.LiePoissonSystem(algebra, H, casimirs={})
        assert described(read_back(system)) == described(system), algebra.name


# Schemes.


def altered(method):
    """Yield a scheme with another value of each parameter, where one is accepted."""
    values = (
        True, False, 1, 2, 3, 4, 6, 8, 0.75, 1e-6, "gradient", "rational", "suzuki4", "coordinates", "runge2",
        [[0, 1], [2]], [[2], [1], [0]], {"order": [1, 0], "shift": {"|x|^2": 0.25}}, (0.25, 0.5, 0.25),
        co.GaussLegendre(3), co.Splitting(order=4),
    )  # fmt: skip
    fields = [field.name for field in dataclasses.fields(method)]
    for name in fields:
        for value in values:
            others = {"order": 1} if name == "adjoint" and "order" in fields else {}
            try:
                other = type(method)(**{key: getattr(method, key) for key in fields} | {name: value} | others)
            except (ValueError, TypeError):
                continue
            if other != method:
                yield other


def toml(value):
    """Format a value as TOML; what is None is left out."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(v)}" for key, v in value.items() if v is not None) + "}"
    return "[" + ", ".join(map(toml, value)) + "]" if isinstance(value, list) else json.dumps(value)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.filterwarnings("ignore")
def test_schemes_are_stored_and_configured_with_every_parameter(name, files):
    """Equal in type and value; a configuration with the stored table runs the same."""
    examples = SCHEMES[name].examples()
    tried = list(dict.fromkeys([*examples, *altered(examples[0])]))
    for field in dataclasses.fields(examples[0]):
        known = {repr(getattr(method, field.name)) for method in tried}
        assert len(known) > 1 or field.name == "speed", f"no value of {field.name} is tried"
    configured = set()
    for method in tried:
        system = BODY if serves(method, BODY) else FLUID
        x0 = X if system is BODY else state_of(FLUID)
        try:
            sol = co.integrate(system, x0, (0.0, 0.5), 0.125, method)
        except (ValueError, co.IntegrationError):
            continue  # parts of another system, or a step that the scheme cannot take
        dataset = sol.to_xarray()
        again = co.results.rebuild(dataset)
        assert again.method == method and repr(again.method) == repr(method)
        check_same(again, sol)
        varied = {key for key in vars(method) if getattr(method, key) != getattr(examples[0], key)}
        if system is BODY and not varied <= configured:  # each parameter in one configuration
            configured |= varied
            table = json.loads(dataset.attrs["method"])
            text = READY_MADE.replace('name = "Splitting"\norder = 4', f'name = "{name}"\nparameters = PARAMETERS')
            text = text.replace("PARAMETERS", toml(table["parameters"]))
            text = text.replace("[1.0, 0.1, 0.5]", str(list(X))).replace("[0, 1]\nstep = 0.1", "[0, 0.5]\nstep = 0.125")
            check_same(files.run(text), sol)


# Forces.

FORCES = {
    "LinearDamping": (((0.1, 0.02, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.3)), (0.0, 0.1, 0.0)),
    "Torque": ((0.0, 0.0, 0.05),),
    "DoubleBracketDamping": (0.1, (1.0, 2.0, 0.5)),
    "HeatBath": (0.1, 1.0, 0.05, 2**62 - 1, 3),
    "Viscosity": (0.1, 2),
    "Friction": (0.1,),
    "BetaPlane": (0.5,),
    "RandomForcing": (0.1, (1, 2), 7, 2),
    "TransportNoise": ((1, 2), 0.3, (1.0, 0.5), 7, 2),
}


ON_SATELLITES = {name.partition(" ")[0] for name in CASES}  # stored in tests of their own


@pytest.mark.parametrize("name", [name for name in co.forces.names() if name not in {"OwnForce", *ON_SATELLITES}])
def test_forced_runs_are_repeated_with_their_work(name, tmp_path):
    fitting = first_fitting(name)
    force = getattr(co.forces, name)(*FORCES[name]) if name in FORCES else fitting.forces[0]
    system = co.systems.torus_euler(N=5) if (fluid := fitting.has_matrices) else fitting.unforced
    x = FLUID.random(1) if fluid else np.resize(X, system.dim)
    forced = system.with_forces(force)
    sol = co.integrate(forced, np.array([x, x]), (0, 1), 0.125, co.IsospectralGauss() if fluid else co.GaussLegendre(2))
    dataset = sol.to_xarray()
    assert "drift" not in dataset and "not_stored" not in dataset.attrs
    again = co.results.rebuild(dataset)
    assert again.system.forces == (force,)
    check_same(again, sol)
    assert np.array_equal(sol.x[-1, 0], sol.x[-1, 1]) != force.random, "members have independent noise"
    dataset.to_netcdf(tmp_path / "run.nc")
    check_same(co.load(tmp_path / "run.nc"), sol)


def test_accounts_of_work_have_the_names_of_forces_and_invariants(tmp_path):
    """The account is one text in files; names may contain its separator, and forces occur twice."""
    square = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
    casimirs = {"b": square, "a: b": 2 * square, "": 3 * square, "b: energy": square**2}
    forces = co.forces.LinearDamping(0.1), co.forces.DoubleBracketDamping(0.1), co.forces.LinearDamping(0.2)
    forced = own(co.Quadratic([1.0, 0.5, 0.25]), casimirs=casimirs).with_forces(*forces)
    sol = co.integrate(forced, X, (0.7, 1.7), 0.125, co.GaussLegendre(2), archive=tmp_path / "run.zarr")
    sol.to_xarray().to_netcdf(tmp_path / "run.nc")
    for name in ("run.nc", "run.zarr"):
        found = co.load(tmp_path / name)
        assert {force: list(done) for force, done in found.work.items()} == {
            "LinearDamping": ["energy", *casimirs],
            "DoubleBracketDamping": ["energy"],
            "LinearDamping 2": ["energy", *casimirs],
        }
        for force, done in sol.work.items():
            assert all(np.array_equal(found.work[force][each], values) for each, values in done.items())
        assert found.balance() == sol.balance() and list(found.balance()) == ["energy", *casimirs]


# Options of runs, and events.

QUARTER = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
FAR = co.Polynomial({(2, 0, 0): 1, (0, 0, 0): -0.125})
OPTIONS = {
    "x0": [[0.5, 0.25, -1.0], [[0.5, 0.25, -1.0], [0.1, 0.2, 0.3]]],
    "t_span": [(1.0, -0.5), (0.25, 0.25)],
    "step": [0.0625],
    "method": [co.GaussLegendre(3)],
    "save_every": [3, 100],
    "attitude": [True, "coadjoint", QUARTER],
    "watch": [False],
    "accuracy": [1e-6],
    "t_eval": [[0.125, 0.3, 1.4]],
    "events": [
        co.Event(1),
        co.Event(co.Polynomial.variable(1, 3)),  # which is printed as the name of a coordinate
        [co.Event("x2"), co.Event(FAR, count=2, terminal=True)],
        [co.Event(co.Quadratic([1, 0, 0], [0, Fraction(1, 3), 0], -Fraction(1, 8)), name="far"), co.Event(0, -1)],
        *[co.Event(co.Quadratic([0, 1, 0], constant=-0.02), way, count=1, terminal=True) for way in (1, -1)],
    ],
    "observe": [
        {"height": co.Polynomial.variable(1, 3), "form": co.Quadratic([1, 0, 0], [0, Fraction(1, 3), 0])},
        {"wave": co.formula("sin(x1) - x2*x3/2", dim=3)},
    ],
}
# Parameters that change no number of a solution.
WITHOUT_EFFECT = {"system", "threads", "progress", "archive"}


def test_every_parameter_of_a_run_is_stored():
    assert set(inspect.signature(co.integrate).parameters) == set(OPTIONS) | WITHOUT_EFFECT
    inputs = co.results.solution_inputs(co.integrate(BODY, X, (0.0, 0.5), 0.125).to_xarray())
    assert set(inputs) == {"system", *OPTIONS} - {"accuracy"}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("parameter", OPTIONS)
def test_options_of_runs_are_stored(parameter, tmp_path):
    usual = {"x0": X, "t_span": (0.0, 20.0 if parameter == "events" else 1.5), "step": 0.125, "method": co.Splitting(4)}
    for value in OPTIONS[parameter]:
        arguments = {**usual, parameter: value}
        if parameter == "accuracy":
            del arguments["step"], arguments["method"]
        sol = co.integrate(BODY, **arguments)
        dataset = sol.to_xarray()
        again = co.results.rebuild(dataset)
        check_same(again, sol)
        if parameter == "events":
            kinds = [type(one.g) for one in again.events.asked]
            assert kinds == [type(one.g) for one in sol.events.asked] and len(sol.events) >= 1
        inputs = co.results.solution_inputs(dataset)
        if sol.carried != "coadjoint":
            check_same(co.integrate(**inputs), sol)
        dataset.to_netcdf(tmp_path / "run.nc")
        loaded = co.load(tmp_path / "run.nc")
        check_same(loaded, sol)
        assert repr(loaded) == repr(sol)
        check_same(_pickled(loaded), sol)
        xarray.testing.assert_identical(loaded.to_xarray(), dataset)


def element_of(system):
    """Return a coadjoint matrix other than the unit matrix."""
    return scipy.linalg.expm(system.algebra.coadjoint([0.1, 0.25, 0.4]))


PAIR = co.batch([co.systems.rigid_body((1, 2, c)) for c in (2.5, 3.0)])
A37 = co.systems.paper_a37()
ELEMENTS = np.stack([element_of(BODY), np.eye(3)])
STARTED = {
    "one": (BODY, co.Splitting(order=4), X, (0.0, 1.0), element_of(BODY), {}),
    "own algebra": (A37, None, X, (0.0, 1.0), element_of(A37), {"t_eval": [0.03, 0.5]}),
    "members": (BODY, co.GaussLegendre(2), [X, X[::-1]], (1.0, -1.0), ELEMENTS, {"save_every": 3}),
    "shared": (BODY, co.Taylor(), [X, X[::-1]], (2.5, 3.0), element_of(BODY), {}),
    "batch": (PAIR, None, X, (1.0, 0.0), ELEMENTS, {}),
    "event": (BODY, None, X, (0.0, 20.0), element_of(BODY), {"events": co.Event("x1", terminal=True)}),
    "force": (BODY.with_forces(co.forces.LinearDamping(0.1)), None, X, (0.0, 1.0), element_of(BODY), {}),
}


@pytest.mark.parametrize("name", STARTED)
def test_an_initial_coadjoint_matrix_is_stored(name, tmp_path):
    system, method, x0, span, element, options = STARTED[name]
    sol = co.prepare(system, method, 0.05, attitude="coadjoint").run(x0, span, attitude=element, **options)
    dataset = sol.to_xarray()
    check_same(co.results.rebuild(dataset), sol)
    with refused(ValueError, "coadjoint matrix"):
        co.results.solution_inputs(dataset)
    dataset.to_netcdf(tmp_path / "run.nc")
    read = co.load(tmp_path / "run.nc")
    assert same_bits(read.attitude0, sol.attitude0)
    if name != "batch":
        found, wanted = (one.at(np.mean(sol.t[:2])) for one in (read, sol))
        np.testing.assert_array_equal(found.attitude, wanted.attitude)


def test_a_failed_run_fails_again_at_the_same_step(tmp_path):
    growing = co.LiePoissonSystem(co.algebras.get("A2_1"), co.Quadratic(0.0, linear=[1.0, 0.0]), sign=-1)
    for every, members in ((500, [(1.0, 1.0), (1.0, 0.0)]), (1000, (1.0, 1.0))):
        with pytest.raises(co.IntegrationError) as first:
            co.integrate(growing, members, (0.0, 1000.0), 1.0, save_every=every)
        partial = first.value.partial
        dataset = co.results.mark_failed(partial.to_xarray(), first.value)
        assert co.results.solution_inputs(dataset)["t_span"] == (0.0, 1000.0)
        assert dataset.attrs["failed_step"] == first.value.step
        with pytest.raises(co.IntegrationError) as again:
            co.results.rebuild(dataset)
        assert again.value.step == first.value.step == 710
        if every == 500:
            assert dataset["failed"].values.tolist() == [True, False]
            assert dataset["x"].sel(member=1).notnull().all()
            lost = dataset["x"].sel(member=0).isnull().any(dim="component")
            assert lost.values.tolist() == [False, False, True]
        dataset.to_netcdf(tmp_path / "run.nc")
        found = co.load(tmp_path / "run.nc")
        assert same_bits(found.x, partial.x) and found.stats == partial.stats


# Functions are not stored.


def value(x):
    return x[0] * x[0]


def slope(x):
    return np.array([2 * x[0], 0.0, 0.0])


def cross(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


class Torque(co.forces.Torque):
    """A force of another class with a known name."""


class Changing(co.systems.Weights):
    """A stream of another class."""


FUNCTION = own(co.Hamiltonian(value, slope))
LATE = co.forces.Torque(lambda t: np.array([0.0, 0.0, np.sin(t)]))
COSH = co.SplitHamiltonian([((2, 0), co.Quadratic([1.0, 2.0])), ((1,), co.Separable({0: (np.cosh, np.sinh)}))])
LOST = {
    "split": (own(COSH, FREE), ["hamiltonian: cosh"]),
    "sum": (own(Q + co.Hamiltonian(value, slope)), ["hamiltonian: value"]),
    "batch": (co.batch([own(Q), FUNCTION, own(P), FUNCTION]), ["hamiltonian: value (member 1)"]),
    "forces": (FUNCTION.with_forces(co.forces.LinearDamping(0.1), LATE), ["hamiltonian: value", "force: Torque"]),
    "another force": (BODY.with_forces(Torque((0.0, 0.0, 0.1))), ["force: Torque"]),
    "an own force": (BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x, "drag")), ["force: "]),
    "forces of members": (
        co.batch([BODY.with_forces(co.forces.Torque((0, 0, 1.0))), BODY.with_forces(LATE)]),
        ["force: Torque (member 1)"],
    ),
    "a layer": (co.TwoLayerSystem(co.MatrixAlgebra("su", 4), SPHERE.stream, Changing(np.ones((4, 4)))), ["stream: C"]),
    "a stream": (co.MatrixSystem(co.MatrixAlgebra("so", 3), lambda W: 2.0 * W), ["stream: <lambda>"]),
    "a bracket": (co.PoissonSystem(cross, Q, dim=3), ["structure matrix: cross"]),
}


def pages_without_times(sol):
    """Return what notebooks show, without the seconds, which files round."""
    return re.sub(r"; [^<]*", "", sol._repr_html_())


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", LOST)
def test_functions_are_named_and_given_again_to_load(name, tmp_path):
    system, lost = LOST[name]
    method = co.IsospectralGauss() if "layer" in name or "stream" in name else co.GaussLegendre(2)
    sol = co.integrate(system, start(system), (0, 0.25), 0.125, method)
    dataset = sol.to_xarray()
    said = dataset.attrs["not_stored"].removeprefix("functions are not stored: ").split(", ")
    assert len(said) == len(lost) and all(map(str.startswith, said, lost)), said
    for repeat in (co.results.rebuild, co.results.solution_inputs):
        with refused(ValueError, "functions"):
            repeat(dataset)
    dataset.to_netcdf(tmp_path / "run.nc")
    loaded = co.load(tmp_path / "run.nc")
    assert same_bits(loaded.x, sol.x)
    assert repr(loaded) == repr(sol) and loaded.method == method
    assert pages_without_times(loaded) == pages_without_times(sol).replace("drift of energy", "change of energy")
    archived = co.integrate(system, start(system), (0, 0.25), 0.125, method, archive=tmp_path / "run.zarr")
    for other in (loaded, co.load(tmp_path / "run.zarr"), archived):
        for invariant, change in sol.change().items():
            np.testing.assert_array_equal(other.change()[invariant].scale, change.scale)
            assert other.change()[invariant] == change
    with refused(ValueError, "system", "load"):
        _ = loaded.system
    assert co.load(tmp_path / "run.nc", system=system).system is system


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_another_system_than_that_of_the_run_is_refused(suffix, tmp_path):
    states, path = np.array([X, X, X]), tmp_path / f"run.{suffix}"
    kept = {"archive": path} if suffix == "zarr" else {}
    sol = co.integrate(FUNCTION, states, (0, 0.25), 0.125, co.GaussLegendre(2), **kept)
    if not kept:
        sol.to_xarray().to_netcdf(path)
    for fitting in (FUNCTION, co.batch([FUNCTION, own(Q), own(P)])):
        assert co.load(path, system=fitting).at(0.2).x.shape == (3, 3)
    with refused(TypeError, "system", "'body'"):
        co.load(path, system="body").at(0.2)
    with refused(ValueError, "heavy_top", "(6,)", "(3, 3)"):
        co.load(path, system=co.systems.heavy_top()).at(0.2)
    with refused(ValueError, "2 members", "(3, 3)"):
        co.load(path, system=co.batch([FUNCTION, own(Q)])).at(0.2)


def test_functions_that_do_not_move_a_run_are_named_and_left_out():
    invariant = co.Invariant(lambda x: 3.0)
    square = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
    system = own(
        co.Quadratic([1.0, 1.0, 2.0]),
        casimirs={"f": invariant, "C": square},
        integrals={"g": invariant, "x3": co.Polynomial({(0, 0, 1): 1})},
        exact=lambda x0, t, attitude: x0,
    )
    observe = {"both": lambda x: x[..., 0]}
    event = co.Event(lambda x: x[1], name="mine")
    sol = co.integrate(system, X, (0.0, 20.0), 0.125, observe=observe, events=event)
    dataset = sol.to_xarray()
    said = dataset.attrs["not_stored"]
    for each in ("casimir: f", "integral: g", "exact solution: <lambda>", "observed: both", "event: mine"):
        assert each in said
    again = co.results.rebuild(dataset)
    assert same_bits(again.x, sol.x) and list(again.casimirs) == ["C"] and list(again.system.integrals) == ["x3"]
    with refused(TypeError, "own"):
        again.system.exact(np.array(X), 1.0)
    spiral = co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic([1.0, 2.0, 0.01]))
    dataset = co.integrate(spiral, X, (0.0, 1.0), 0.1).to_xarray()
    assert dataset.attrs["not_stored"].endswith("casimir: log C") and list(co.results.rebuild(dataset).casimirs) == []
    ended = co.integrate(BODY, X, (0.0, 40.0), 0.125, events=co.Event(lambda x: x[1], name="mine", terminal=True))
    with refused(ValueError, "event", "mine"):
        co.results.rebuild(ended.to_xarray())


@pytest.mark.thinned(1)
@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("first", [True, False])
def test_loaded_crossings_of_functions_have_their_names(tmp_path, first, terminal):
    own_event = co.Event(lambda x: x[0] - 0.25, name="mine", count=3, terminal=terminal)
    events = [own_event, co.Event("x2")] if first else [co.Event("x2"), own_event]
    starts = [(0.1, 1.0, 0.1), (0.2, 1.0, 0.1)]
    sol = co.integrate(co.systems.rigid_body((1, 2, 3)), starts, (0.5, 40.5), 0.125, events=events)
    sol.to_xarray().to_netcdf(tmp_path / "body.nc")
    loaded = co.load(tmp_path / "body.nc")
    check_same(loaded, sol)
    assert np.array_equal(loaded.events.ends(2), sol.events.ends(2), equal_nan=True)
    asked = loaded.events.asked[loaded.events.names.index("mine")]
    assert (asked.count, asked.terminal, asked.direction) == (3, terminal, 0)
    with refused(ValueError, "stored"):
        asked.g(np.ones(3), 0.0)
