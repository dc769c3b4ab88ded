"""Matrix states in datasets, records, configuration files and the command."""

import json

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.cli import main
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.files.datasets.export import rebuild
from coadjoint.files.datasets.variables import STATE_DIMENSIONS, split_complex, state_dimensions
from coadjoint.files.datasets.variables import state_of as stored_state
from coadjoint.files.records.records import record_of, system_of
from coadjoint.systems.matrices.streams import Circulants, DiagonalSolve, Inverse, Weights
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem
from served import state_of

G = co.MatrixAlgebra
SPHERE, TORUS = co.systems.sphere_euler(N=4), co.systems.torus_euler(N=3)
WEIGHTS = np.add.outer(np.arange(1.0, 5.0), np.arange(1.0, 5.0))


def own(kind, *args, **options):
    g = G(kind, *args) if isinstance(kind, str) else kind
    return co.MatrixSystem(g, Weights(np.full((g.N, g.N), 0.5) + 0.1 * np.eye(g.N)[::-1]), name="own", **options)


OWN = {
    "sphere": SPHERE,
    "torus": TORUS,
    "body": co.systems.matrix_body((1.0, 2.0, 4.0)),
    "weights": co.MatrixSystem(G("gl", 4), Weights(WEIGHTS), np.diag([1.0, -0.5, 0.25, 0.0]), energy_sign=-1, powers=2),
    "signature": co.MatrixSystem(G("so", 4, 1), Weights(WEIGHTS), name="lorentz"),
    "unitary": co.MatrixSystem(G("u", 4), Weights(WEIGHTS), 1j * np.diag([1.0, 2.0, 0.5, 0.0]), name="u's, of 4"),
    "sum": co.MatrixSystem(G.sum(G("so", 2), G("u", 2)), Weights(WEIGHTS), powers=1),
    "solve": co.MatrixSystem(G("su", 4), DiagonalSolve(SPHERE.stream.main, SPHERE.stream.beside, -0.5)),
    "two layers": TwoLayerSystem(G("u", 4), Weights(WEIGHTS), Weights(2.0 * WEIGHTS), energy_sign=-1, powers=2),
    "passive": TwoLayerSystem(G("su", 4), SPHERE.stream),
    "currents": TwoLayerSystem(G("su", 4), SPHERE.stream, Inverse(SPHERE.stream), name="currents"),
    "circulants": co.MatrixSystem(G("su", 3), Circulants(2.0 * TORUS.stream.spectrum)),
}


def assert_same_system(one, other):
    W = state_of(one)
    assert type(one) is type(other) and one.algebra == other.algebra and one.name == other.name
    assert one.energy(W) == other.energy(W) and np.array_equal(one.vector_field(W), other.vector_field(W))
    assert list(one.casimirs) == list(other.casimirs) and one.parameters == other.parameters
    assert one.energy_sign == other.energy_sign and one.powers == other.powers


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("name", "members"), [(name, 1 + 2 * (k % 2)) for k, name in enumerate(OWN)])
def test_matrix_run_is_rebuilt(name, members):
    system = OWN[name]
    x0 = state_of(system) if members == 1 else np.array([state_of(system, m) for m in range(members)])
    sol = co.integrate(system, x0, (0.25, 1.0), 0.125, co.IsospectralGauss(2), save_every=2)
    dataset = sol.to_xarray()
    parts = ("part",) if system.complex else ()
    member = ("member",) if members > 1 else ()
    layers = ("layer",) if len(system.shape) == 3 else ()
    assert dataset["x"].dims == ("time", *member, *layers, "row", "column", *parts)
    assert dataset["x0"].dims == (*member, *layers, "row", "column", *parts) and "component" not in dataset.coords
    x = dataset["x"].sel(part="real").values + 1j * dataset["x"].sel(part="imaginary").values if parts else dataset["x"]
    assert np.array_equal(x, sol.x) and dataset.attrs["watch"] == 0
    again = rebuild(dataset)
    assert_same_system(again.system, system)
    assert np.array_equal(again.x, sol.x) and np.array_equal(again.energy, sol.energy)
    assert all(np.array_equal(again.casimirs[key], values) for key, values in sol.casimirs.items())
    assert_same_system(system_of(json.loads(json.dumps(record_of(system)))), system)


def test_vectors_of_matrices_are_rebuilt():
    system = SPHERE.in_numbers
    sol = co.integrate(system, SPHERE.to_vector(state_of(SPHERE)), (0.0, 1.0), 0.25)
    dataset = sol.to_xarray()
    assert sol.x.shape == (5, 32) and dataset["x"].dims == ("time", "component")
    again = rebuild(dataset)
    assert np.array_equal(again.x, sol.x) and again.system.shape == (32,)


def stream(W):
    return 2.0 * W


def energy(W):
    return np.sum(np.abs(W) ** 2)


def test_unstored_functions_are_named():
    for system, lost in (
        (co.MatrixSystem(G("so", 3), stream), ["stream: stream"]),
        (co.MatrixSystem(G("so", 3), stream, energy=energy), ["stream: stream", "energy: energy"]),
        (own("so", 3, exact=lambda x0, t: x0), ["exact solution: <lambda>"]),
    ):
        record = record_of(system)
        assert record["not_stored"] == lost
        if "exact" in lost[0]:
            assert_same_system(system_of(record), system)
        else:
            with pytest.raises(ValueError, match="functions are not stored"):
                system_of(record)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r["matrices"].update(kind="sq"), "system.matrices: .*kind"),
        (lambda r: r["matrices"].update(N=1), r"system.matrices.N is 1"),
        (lambda r: r["matrices"].update(kind="sum"), "a sum has blocks"),
        (lambda r: r.update(matrices={"blocks": []}), "two MatrixAlgebras"),
        (lambda r: r.update(matrices={"kind": "gl", "N": 4096, "q": 0}), "system"),
        (lambda r: r.update(stream={}), "system.stream has no 'main'"),
        (lambda r: r.update(stream={"weights": [[1.0]]}), "system.stream.weights"),
        (lambda r: r["stream"]["weights"][0].__setitem__(1, 7.0), "system.stream: weights"),
        (lambda r: r["stream"]["weights"][0].__setitem__(1, "x"), r"system.stream.weights\[0\]"),
        (lambda r: r.update(linear=[[[1.0, 0.0], [0.0, 1.0]]]), "system.linear"),
        (lambda r: r.update(energy_sign=0), "system: energy_sign"),
        (lambda r: r.update(powers=-1), "system.powers"),
    ],
)
def test_damaged_records_are_refused_by_name(change, message):
    record = json.loads(json.dumps(record_of(OWN["weights"])))
    change(record)
    with pytest.raises(ValueError, match=message):
        system_of(record)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.assign(x0=d["x0"].isel(part=0, drop=True)), "dimension"),
        (lambda d: d.assign(x0=d["x0"] + 1.0), r"not a matrix of su\(4\)"),
        (lambda d: d.assign(x0=d["x0"].isel(row=slice(0, 3))), "dimension"),
        (lambda d: d.assign(x0=d["x0"].rename(row="line")), "x0 is over"),
        (lambda d: d.assign(x0=d["x0"].isel(part=[0])), "1 parts|dimension"),
        (lambda d: d.assign(x0=d["x0"] * np.nan), "finite"),
        (lambda d: d.drop_vars("x0"), "no variable 'x0'"),
    ],
)
def test_damaged_states_are_refused(change, message):
    dataset = co.integrate(SPHERE, state_of(SPHERE), (0.0, 0.5), 0.25).to_xarray()
    with pytest.raises(ValueError, match=message):
        rebuild(change(dataset.drop_vars("part")))


def written(tmp_path, x, system='{name = "sphere_euler", parameters = {N = 4}}', more=""):
    path = tmp_path / "run.toml"
    lines = [f"system = {system}", f"initial = {{x = {x}}}", "run = {t_span = [0, 1], step = 0.125}", more]
    path.write_text("\n".join(lines))
    return path


def test_matrix_states_in_configurations(tmp_path, monkeypatch):
    W = state_of(SPHERE)
    np.save(tmp_path / "w.npy", W)
    np.save(tmp_path / "ensemble.npy", [W, 2 * W])
    wanted = co.integrate(SPHERE, W, (0, 1), 0.125)
    pairs = np.stack([W.real, W.imag], axis=-1).tolist()
    monkeypatch.chdir(tmp_path.parent)  # paths are relative to the configuration
    for x in ('"w.npy"', str(pairs), f'"{tmp_path}/w.npy"'):
        configuration = load(written(tmp_path, x))
        assert isinstance(configuration.method, co.IsospectralGauss)
        assert np.array_equal(configuration.integrate().x, wanted.x)
    ensemble = load(written(tmp_path, '"ensemble.npy"')).integrate()
    assert np.array_equal(ensemble.x[:, 0], wanted.x) and ensemble.x.shape == (9, 2, 4, 4)
    many = load(written(tmp_path, str([pairs, pairs])))
    assert np.array_equal(many.integrate().x[:, 1], wanted.x)
    body = co.systems.matrix_body((1.0, 2.0, 4.0))
    X = state_of(body)
    table = '{name = "matrix_body", parameters = {inertia = [1, 2, 4]}}'
    found = load(written(tmp_path, str(X.tolist()), table, 'method = {name = "IsospectralGauss", stages = 2}'))
    assert np.array_equal(found.integrate().x, co.integrate(body, X, (0, 1), 0.125, co.IsospectralGauss(2)).x)
    # Vectors too.
    np.save(tmp_path / "v.npy", [1.0, 0.2, 0.3])
    assert load(written(tmp_path, '"v.npy"', '{name = "rigid_body"}')).integrate().x.shape == (9, 3)


@pytest.mark.parametrize(
    ("x", "more", "message"),
    [
        ('"none.npy"', "", "initial.x: 'none.npy' cannot be read"),
        ('"run.txt"', "", "initial.x: must be a list of numbers"),
        ('"run.npy"', "", "initial.x: 'run.npy'"),
        ("[[1.0, 0.0], [0.0, 1.0]]", "", "initial.x: x0 has the shape"),
        ('"ones.npy"', "", r"initial.x: x0 is not a matrix of su\(4\)"),
        ('"objects.npy"', "", "initial.x"),
        ('"w.npy"', 'observe = {a = "x1"}', "observe.a: a polynomial needs coordinates"),
        ('"w.npy"', 'method = {name = "Splitting"}', "method: sphere_euler has matrix states"),
    ],
)
def test_invalid_matrix_states_have_the_key(tmp_path, x, more, message):
    (tmp_path / "run.npy").write_text("no array")
    np.save(tmp_path / "ones.npy", np.ones((4, 4)))
    np.save(tmp_path / "w.npy", state_of(SPHERE))
    np.save(tmp_path / "objects.npy", np.array([None]), allow_pickle=True)
    with pytest.raises(ConfigurationError, match=message) as refused:
        load(written(tmp_path, x, more=more))
    assert "\n" not in str(refused.value)


def test_commands_accept_matrices(tmp_path, capsys):
    np.save(tmp_path / "w.npy", state_of(SPHERE))
    path = written(tmp_path, '"w.npy"', more=f'output = {{file = "{tmp_path}/run.nc"}}')
    assert main(["run", str(path)]) == 0
    output = capsys.readouterr().out
    assert "sphere_euler, IsospectralGauss(stages=1): 8 steps" in output and "over the saved points" in output
    with xarray.open_dataset(tmp_path / "run.nc") as dataset:
        assert rebuild(dataset.load()).x.shape == (9, 4, 4)
    table = '{name = "matrix_body", parameters = {inertia = [1, 2, 4]}}'
    body = written(tmp_path, str(state_of(co.systems.matrix_body((1.0, 2.0, 4.0))).tolist()), table)
    assert main(["certify", str(body), "--steps", "20"]) == 0
    assert "Poisson bracket" in capsys.readouterr().out
    assert main(["systems", "matrix_body"]) == 0
    assert "so(5)" in capsys.readouterr().out


# State variables of datasets.

SHAPES = {"component": (3,), "matrix": (2, 4), "layers": (3, 2, 4)}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("members", [None, 1, 5])
@pytest.mark.parametrize("kind", [float, complex])
def test_state_variables_preserve_bits(shape, members, kind):
    rng, member = np.random.default_rng(2), () if members is None else (members,)
    states = rng.standard_normal((*member, *SHAPES[shape])).astype(kind)
    if kind is complex:
        states += 1j * rng.standard_normal(states.shape)
    dims = (*("member",)[: len(member)], *state_dimensions(states, len(member)))
    dataset = xarray.Dataset({"x0": (dims, split_complex(states))})
    assert dims[-1:] == ("part",) * (kind is complex) or kind is float
    found = stored_state(dataset, "x0", STATE_DIMENSIONS)
    assert found.dtype == states.dtype and found.tobytes() == states.tobytes() and found.shape == states.shape


def test_integer_states_become_floats():
    found = stored_state(xarray.Dataset({"x0": ("component", np.arange(3))}), "x0", STATE_DIMENSIONS)
    assert found.dtype == np.float64 and found.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("dims", "values", "message"),
    [
        (("time",), np.zeros(3), "x0 is over .*; it must be over"),
        (("component", "member"), np.zeros((3, 2)), "x0 is over"),
        (("member",), np.zeros(2), "x0 is over"),
        (("part",), np.zeros(2), "x0 is over"),
        (("row", "column", "part", "more"), np.zeros((2, 2, 2, 1)), "x0 is over"),
        (("component",), np.zeros(0), "x0 is over"),
        (("member", "component"), np.zeros((0, 3)), "x0 is over"),
        (("component",), np.array(["a", "b"]), "finite numbers"),
        (("component",), np.array([True, False]), "finite numbers"),
        (("component",), np.array([1.0, np.nan]), "finite numbers"),
        (("member", "component"), np.array([[1.0, 2.0], [np.inf, 0.0]]), "finite numbers"),
        (("component", "part"), np.zeros((3, 1)), "x0 has 1 parts; complex numbers have 2"),
        (("component", "part"), np.zeros((3, 3)), "x0 has 3 parts; complex numbers have 2"),
    ],
)
def test_damaged_state_variables_are_refused(dims, values, message):
    dataset = xarray.Dataset({"x0": (dims, values)})
    with pytest.raises(ValueError, match=message):
        stored_state(dataset, "x0", STATE_DIMENSIONS)
    with pytest.raises(ValueError, match="no variable 'x1'"):
        stored_state(dataset, "x1", STATE_DIMENSIONS)
