"""Members of sweeps compared with references: grids, random numbers, orbits, rows of files, and memory bounds."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.files.configuration.sweeps import replace_values
from coadjoint.files.configuration.swept_settings import move_on_orbit, random_settings
from coadjoint.files.datasets.variables import as_coordinates

BODY = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [2, 1, 3]
[run]
t_span = [0.0, 1.0]
step = 0.125
[sweep]
"""
SPIRAL = """
algebra = {name = "A3,7", parameters = {a = 2.0}}
hamiltonian = {M = [1.0, 2.0, 0.5]}
initial = {x = [0.25, 1.0, -0.5]}
run = {t_span = [0, 1], step = 0.5}
[sweep]
"""


@pytest.fixture
def swept(tmp_path, monkeypatch):
    """Load a sweep from a file outside the working folder."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")

    def read(over, beside="", text=BODY):
        (tmp_path / "run.toml").write_text(f"{text}{beside}\n[sweep.over]\n{over}\n")
        return load(tmp_path / "run.toml")

    return read


def grid_of(swept, kind, ends, count):
    return swept(f'"initial.x[1]" = {{ {kind} = {ends}, count = {count} }}').swept["initial.x[1]"]


@pytest.mark.parametrize("count", [2, 3, 7])
@pytest.mark.parametrize("ends", [[0, 1], [6, -6], [-3, 3.5], [0.1, 0.7], [-0.3, -2.9], [7.1, 1e-3]])
def test_grids_have_both_ends_and_equal_parts(swept, ends, count):
    found, size = grid_of(swept, "linear", ends, count), max(map(abs, ends))
    assert (found[0], found[-1]) == tuple(ends), "exactly"
    # Both sides round a product and a sum of numbers up to twice the size.
    np.testing.assert_allclose(found, np.linspace(*ends, count), rtol=0, atol=8 * 2.0**-53 * size)
    if ends[0] * ends[1] > 0.0:
        found = grid_of(swept, "logarithmic", ends, count)
        assert (found[0], found[-1]) == tuple(ends)
        np.testing.assert_allclose(found, np.geomspace(*ends, count), rtol=1e-14)
    else:
        with pytest.raises(ConfigurationError, match="both ends must be different from zero, and of one sign"):
            grid_of(swept, "logarithmic", ends, count)


def test_integer_grids_stay_integers(swept):
    """Parameters such as a seed or a number of spins are integers."""
    assert [type(k) for k in grid_of(swept, "linear", [-2, 4], 4)] == [int] * 4
    assert grid_of(swept, "linear", [-2, 4], 4) == [-2, 0, 2, 4]
    assert grid_of(swept, "linear", [0, 1], 3) == [0, 0.5, 1]
    assert grid_of(swept, "logarithmic", [1, 4], 3) == [1, 2, 4]


KEYS = (
    "initial.x", "initial.x[0]", "initial.x[1]", "system.parameters.inertia", "system.parameters.inertia[0]",
    "system.parameters.inertia[1]", "forces[0].rate", "forces[1].rate", "hamiltonian.M[1]", "hamiltonian.M[12]",
)  # fmt: skip


@pytest.mark.parametrize(("kind", "spread"), [("uniform", [0.0, 1.0]), ("normal", [0.0, 1.0])])
def test_random_numbers_of_keys_are_independent(kind, spread):
    found = [random_settings(kind, spread, key, 5, 64, ()) for key in KEYS]
    assert len(set(np.concatenate(found).tolist())) == 64 * len(KEYS), "no number occurs twice"
    # Correlations of 64 independent pairs have the deviation 1/8; five of them are exceeded once in a million.
    assert np.all(abs(np.corrcoef(found) - np.eye(len(KEYS))) < 5 / 8)
    vectors = random_settings(kind, spread, "initial.x", 5, 64, (3,))
    assert len(set(vectors.ravel().tolist())) == 3 * 64


def test_components_of_a_state_are_independent(swept):
    over = '"initial.x[0]" = { uniform = [0, 1] }\n"initial.x[1]" = { uniform = [0, 1] }'
    found = swept(over, "samples = 8\nseed = 3")
    assert found.x0.shape == (8, 3), "random keys go together"
    assert len(set(found.x0[:, :2].ravel().tolist())) == 16 and np.all(found.x0[:, 2] == 3.0)


def test_zero_settings_are_used(swept, tmp_path):
    """A seed, a column, a value, an end, a mean and a deviation, also as first and last settings."""
    np.save(tmp_path / "table.npy", [[2.5, 9.0], [2.75, 9.0]])
    over = '"initial.x[0]" = { normal = [0, 1] }\n"initial.x[1]" = { uniform = [0, 2] }\n"initial.x[2]" = [0, 5, 0.0]'
    column = '\n"system.parameters.inertia[2]" = { file = "table.npy", column = 0 }'
    states = {}
    for seed in (0, 1):
        found = swept(over + column, f"samples = 2\nseed = {seed}")
        states[seed] = found.x0.reshape(2, 3, 2, 3)
        for place, (kind, spread) in enumerate((("normal", [0.0, 1.0]), ("uniform", [0.0, 2.0]))):
            wanted = random_settings(kind, spread, f"initial.x[{place}]", seed, 2, ())
            np.testing.assert_array_equal(states[seed][:, 0, 0, place], wanted)
        assert states[seed][0, :, 0, 2].tolist() == [0.0, 5.0, 0.0]
        assert [body.parameters["inertia"][2] for body in found.system] == [2.5, 2.75] * 6
    assert not np.any(states[0][..., :2] == states[1][..., :2])
    assert np.all(swept('"initial.x[0]" = { normal = [7, 0] }', "samples = 3\nseed = 0").x0[:, 0] == 7.0)


def test_orbits_and_spheres_use_normal_numbers():
    normal = random_settings("normal", [0.0, 1.0], "initial.x", 7, 5, (4,))
    np.testing.assert_array_equal(random_settings("orbit", 0.5, "initial.x", 7, 5, (4,)), 0.5 * normal)
    sphere = random_settings("sphere", 3.0, "initial.x", 7, 5, (4,))
    # A norm, a quotient and a product are rounded.
    np.testing.assert_allclose(sphere, 3.0 * normal / np.linalg.norm(normal, axis=1, keepdims=True), rtol=1e-15)
    means, widths = [1.0, 2.0, 0.0, 4.0], [0.5, 0, 1.0, 2.0]
    drawn = random_settings("normal", [means, widths], "initial.x", 7, 5, (4,))
    np.testing.assert_array_equal(drawn, means + np.array(widths) * normal)


@pytest.mark.parametrize("first", ["samples", "grid"])
def test_members_stay_on_orbits_of_their_algebras(swept, first):
    """Samples and an algebra parameter in either order; exp(ad*) by SciPy is the reference."""
    lines = ['"initial.x" = { orbit = 0.75 }', '"algebra.parameters.a" = [0.5, 1.5]']
    order = lines if first == "samples" else lines[::-1]
    found = swept("\n".join(order), "samples = 3\nseed = 1", SPIRAL)
    moves, x = random_settings("orbit", 0.75, "initial.x", 1, 3, (3,)), np.array([0.25, 1.0, -0.5])
    assert len(found.system) == len(found.x0) == 6
    for member, (system, state) in enumerate(zip(found.system, found.x0, strict=True)):
        sample, value = (member // 2, member % 2) if first == "samples" else (member % 3, member // 3)
        assert system.algebra == co.algebras.get("A3,7", a=[0.5, 1.5][value])
        exact = np.array(expm(system.algebra.coadjoint(moves[sample]))) @ x
        np.testing.assert_allclose(state, exact, rtol=0, atol=1e-14 * np.linalg.norm(exact) * math.exp(2))


def test_orbits_of_large_rotations():
    """Several turns: each piece, with exponents up to 1, loses a few units of the last place."""
    g, x = co.algebras.so(3), np.array([0.5, -1.0, 2.0])
    for axis in np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [2.0, -3.0, 6.0], [-6.0, 2.0, -3.0]]):
        u = axis / np.linalg.norm(axis)
        for angle in (3.0, 40.0):
            exact = math.cos(angle) * x + math.sin(angle) * np.cross(u, x) + (1 - math.cos(angle)) * (u @ x) * u
            moved = move_on_orbit(g, x, angle * u)
            np.testing.assert_allclose(moved, exact, rtol=0, atol=16 * 2.0**-53 * 2 * angle * np.linalg.norm(x))
    with pytest.raises(ValueError, match="orbit moves a state by exponents of size"):
        move_on_orbit(g, x, np.array([1e4, 0.0, 0.0]))


def test_integers_do_not_truncate_settings(swept):
    np.testing.assert_array_equal(swept('"initial.x[1]" = [7, 0.25]').x0, [[2.0, 7.0, 3.0], [2.0, 0.25, 3.0]])
    found = swept('"system.parameters.inertia[2]" = [2, 2.75]')
    assert [body.parameters["inertia"] for body in found.system] == [(1.0, 2.0, 2.0), (1.0, 2.0, 2.75)]


def test_states_of_complex_matrices(swept):
    sphere = co.systems.sphere_euler(N=2)
    W = [np.array(sphere.random(seed, degrees=(1, 1))) for seed in (1, 2)]
    pairs = [np.stack([one.real, one.imag], axis=-1).tolist() for one in W]
    text = f'system = {{name = "sphere_euler", parameters = {{N = 2}}}}\ninitial = {{x = {pairs[1]}}}\n'
    found = swept(f'"initial.x" = {pairs}', "", text + "run = {t_span = [0, 1], step = 0.5}\n[sweep]\n")
    np.testing.assert_array_equal(found.x0, W)


def test_paths_are_relative_to_the_configuration(swept, tmp_path):
    """The state of the file, which gives random states their shape, and the settings."""
    np.save(tmp_path / "state.npy", [1.0, 0.0, 2.0])
    np.save(tmp_path / "table.npy", [[2.5, 0.5], [2.75, 0.25]])
    text = BODY.replace("x = [2, 1, 3]", 'x = "state.npy"')
    over = '"initial.x" = {}\n"system.parameters.inertia[2]" = {{ file = "table.npy", column = 1 }}'
    for kind in ("{ orbit = 0.5 }", "{ sphere = 2.0 }", "{ normal = [0, 1] }", "{ uniform = [[0, 1, 2], 3] }"):
        table = over.format(kind).replace("column = 1", "column = 0")
        found = swept(table, "samples = 2\nseed = 1", text)
        assert found.x0.shape == (4, 3) and len(set(found.x0.ravel().tolist())) == 6
        assert [body.parameters["inertia"][2] for body in found.system] == [2.5, 2.75] * 2


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ('"initial.x[1]" = [1.0]\n"initial.x" = [[1.0, 0, 0]]', "sweep.over.initial.x: initial.x[1] is swept too"),
        ('"initial.attitude[0][1]" = [1.0]', "sweep.over.initial.attitude[0][1]: initial.attitude is the same"),
        ('"initial.kind" = ["random"]', "sweep.over.initial.kind: initial.kind is the same"),
        ('"forces_of" = [1.0]', "sweep.over.forces_of: only keys within system.parameters"),
        ('"initials.x" = [1.0]', "sweep.over.initials.x: only keys within system.parameters"),
        ('"initial.x[0]" = { file = "table.npy", column = 3 }', "sweep.over.initial.x[0]: 'table.npy' holds an array "
         "of shape (2, 3)"),
        ('"initial.x" = { file = "empty.npy" }', "sweep.over.initial.x: 'empty.npy' holds an array of shape (0, 3); "
         "its first axis must be the settings"),
        ('"initial.x" = { file = "one.npy" }', "sweep.over.initial.x: 'one.npy' holds an array of shape (); its "),
        ('"initial.x[0]" = { values = [1.0], column = 0 }', "sweep.over.initial.x[0]: column belongs to file"),
        ('"initial.x[0]" = { linear = [0, 1, 2], count = 3 }', "sweep.over.initial.x[0].linear: must be a list of two"),
        ('"initial.x[0]" = {}', "sweep.over.initial.x[0]: has none of values, linear"),
        ('"initial.x[0][1]" = [1.0]', "sweep.over.initial.x[0][1]: the list in the file has no entry 1"),
        ('"system.parameters.inertia[2]" = [3.0, -1.0]\n"initial.x[0]" = [1, 2, 3]', "system: inertia[2] is -1; every "
         "principal moment must be positive (member 3 of the sweep)"),
    ],
)  # fmt: skip
def test_errors_have_the_key(swept, tmp_path, over, message):
    for name, array in (("table", np.ones((2, 3))), ("empty", np.ones((0, 3))), ("one", np.ones(()))):
        np.save(tmp_path / f"{name}.npy", array)
    with pytest.raises(ConfigurationError) as error:
        swept(over)
    assert str(error.value).startswith(f"{tmp_path / 'run.toml'}: {message}"), str(error.value)


@pytest.mark.parametrize(
    ("beside", "over", "message"),
    [
        ("samples = 2", '"initial.x" = { sphere = 1.0 }', "sweep: over 'initial.x' is random; give samples"),
        ("samples = 2", '"initial.x[0]" = [1.0]', "sweep: samples and seed belong to random settings"),
        ("samples = 0\nseed = 1", '"initial.x" = { sphere = 1.0 }', "sweep.samples: must be 1 or more, not 0"),
        ("samples = 2\nseed = -1", '"initial.x" = { sphere = 1.0 }', "sweep.seed: must be 0 or more, not -1"),
        ("samples = 2\nseed = 1", '"initial.x[0]" = { sphere = 1.0 }', "sweep.over.initial.x[0]: sphere applies to"),
        ("samples = 2\nseed = 1", '"initial.x" = { uniform = [[0, 1], 2] }', "sweep.over.initial.x: an end has the "),
        ("samples = 2\nseed = 1", '"initial.x" = { normal = [0, [1, 2]] }', "sweep.over.initial.x: mean or deviation "),
    ],
)  # fmt: skip
def test_errors_of_random_settings_have_the_key(swept, tmp_path, beside, over, message):
    with pytest.raises(ConfigurationError) as error:
        swept(over, beside)
    assert str(error.value).startswith(f"{tmp_path / 'run.toml'}: {message}"), str(error.value)


def test_replacing_values_copies_the_tables():
    raw = {"initial": {"x": [1.0, 2.0]}, "forces": [{"rate": 1.0}]}
    found = replace_values(raw, {"initial.x[1]": 5.0, "forces[0].rate": 2.0, "system.parameters.a": 3}, "run.toml")
    assert found == {"initial": {"x": [1.0, 5.0]}, "forces": [{"rate": 2.0}], "system": {"parameters": {"a": 3}}}
    assert raw == {"initial": {"x": [1.0, 2.0]}, "forces": [{"rate": 1.0}]}


FULL = [[2.0, 0.1, 0.0], [0.1, 3.0, 0.0], [0.0, 0.0, 4.0]]


@pytest.mark.parametrize(
    ("module", "beside", "over", "least"),
    [
        ("sweeps", "", '"initial.x[0]" = [1, 2, 3]\n"initial.x[1]" = [1, 2]', 6 * 8),
        ("sweeps", "", '"initial.x[0]" = [1, 2, 3]\n"initial.x[1]" = [1, 2]', 6 * 3 * 8),
        ("sweeps", "", '"system.parameters.inertia[2]" = [2.5, 3]\n"initial.x[1]" = [1, 2, 3]', 6 * 1000),
        (
            "swept_settings",
            "samples = 5\nseed = 1",
            f'"system.parameters.inertia" = {{ uniform = {[FULL] * 2} }}',
            5 * 9 * 8,
        ),
        ("swept_settings", "", '"initial.x[0]" = { linear = [0, 1], count = 9 }', 9 * 8),
    ],
)
def test_memory_is_checked_for_all_members(swept, monkeypatch, module, beside, over, least):
    """At least the size of the numbers; for bodies, 1000 bytes each."""
    sizes = []
    monkeypatch.setattr(
        f"coadjoint.files.configuration.{module}.check_available_memory", lambda size, what: sizes.append(size)
    )
    swept(over, beside, BODY.replace("[1.0, 2.0, 2.5]", str(FULL)) if "[[" in over else BODY)
    assert max(sizes) >= least


def test_coordinates_of_all_kinds_of_settings():
    found = as_coordinates(
        {
            "algebra.parameters.a": [0.5, 1.0],
            "initial.attitudes": [True, False],
            "initial.x[0]": [1, 2],
            "forces[0].rate": [{"a": 1}, {"a": 2}],
            "hamiltonian.M": [[[1.0, 2.0], [3.0, 4.0]], [[5.0, 6.0], [7.0, 8.0]]],
            "initial.x": [[1.0, 2.0], [3.0, 4.0]],
        }
    )
    assert {name: place for name, (place, _) in found.items()} == {
        "swept_a": "algebra.parameters.a",
        "swept_attitudes": "initial.attitudes",
        "swept_x_0": "initial.x[0]",
        "swept_forces_0_rate": "forces[0].rate",
        **{f"swept_hamiltonian_M_{i}_{j}": f"hamiltonian.M[{i}][{j}]" for i in (0, 1) for j in (0, 1)},
    }
    assert found["swept_attitudes"][1].dtype == bool and found["swept_x_0"][1].dtype.kind == "i"
    assert found["swept_forces_0_rate"][1].tolist() == ["{'a': 1}", "{'a': 2}"]
    assert found["swept_hamiltonian_M_0_1"][1].tolist() == [2.0, 6.0]
    assert found["swept_hamiltonian_M_1_0"][1].tolist() == [3.0, 7.0]


def test_configuration_has_its_path(swept, tmp_path):
    found = swept('"initial.x[0]" = [1.0, 2.0]')
    assert Path(found.path) == tmp_path / "run.toml" and found.swept == {"initial.x[0]": [1.0, 2.0]}
