"""Sweeps in configuration files: members, their order, and equality with single runs."""

import math
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.linalg import expm

import coadjoint as co
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.files.configuration.swept_settings import move_on_orbit, random_settings
from coadjoint.files.datasets.variables import as_coordinates

BODY = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1.0]
step = 0.125
[sweep]
"""


@pytest.fixture
def written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(text, name="run.toml"):
        Path(name).write_text(text)
        return name

    return write


def swept(over, beside=""):
    return f"{BODY}{beside}\n[sweep.over]\n{over}\n"


def test_last_key_varies_fastest(written):
    over = '"system.parameters.inertia[2]" = { linear = [1.5, 3.0], count = 4 }\n"initial.x[1]" = [0.25, -0.5]'
    found = load(written(swept(over)))
    assert [body.parameters["inertia"][2] for body in found.system] == [1.5, 1.5, 2.0, 2.0, 2.5, 2.5, 3.0, 3.0]
    np.testing.assert_array_equal(found.x0[:, 1], [0.25, -0.5] * 4)
    np.testing.assert_array_equal(found.x0[:, [0, 2]], [[1.0, 0.5]] * 8)


def test_members_equal_single_files(written):
    """A member has the bits of a run from a file without a sweep."""
    over = (
        '"system.parameters.inertia[2]" = [2.5, 2.75]\n"initial.x" = { sphere = 2.0 }\n'
        '"system.parameters.inertia[0]" = { uniform = [0.75, 1.0] }'
    )
    found = load(written(swept(over, "samples = 3\nseed = 1")))
    sol = found.integrate()
    assert sol.x.shape == (9, 6, 3)
    for member in range(6):
        inertia = [found.swept["system.parameters.inertia[0]"][member], 2.0, [2.5, 2.75][member // 3]]
        alone = BODY.replace("[1.0, 2.0, 2.5]", repr(inertia)).replace("[sweep]", "")
        alone = alone.replace("[1.0, 0.1, 0.5]", repr(found.x0[member].tolist()))
        np.testing.assert_array_equal(load(written(alone, "alone.toml")).integrate().x, sol.x[:, member])
    assert len({tuple(x) for x in found.x0.tolist()}) == 3, "the same samples at both values of the grid"


def test_swept_states_share_one_system(written):
    found = load(written(swept('"initial.x[0]" = { logarithmic = [1e-3, 1.0], count = 4 }')))
    assert found.system.parameters["inertia"] == (1.0, 2.0, 2.5)
    np.testing.assert_allclose(found.x0[:, 0], [1e-3, 1e-2, 1e-1, 1.0], rtol=4e-15)
    assert found.x0[0, 0] == 1e-3 and found.x0[3, 0] == 1.0


def test_rows_of_a_file_are_combined(written, tmp_path):
    table = np.array([[2.5, 0.25, 1.0], [3.0, 0.5, 2.0], [2.75, 0.75, 3.0]])
    np.save(tmp_path / "table.npy", table)
    np.save(tmp_path / "states.npy", np.eye(3)[:2])
    over = (
        '"system.parameters.inertia[2]" = { file = "table.npy", column = 0 }\n"initial.x[1]" = { file = "table.npy", '
        "column = 1 }"
    )
    found = load(written(swept(over)))
    assert [body.parameters["inertia"][2] for body in found.system] == [2.5, 3.0, 2.75]
    np.testing.assert_array_equal(found.x0[:, 1], [0.25, 0.5, 0.75])
    found = load(written(swept('"initial.x" = { file = "states.npy" }\n"initial.attitude" = [true]'.split("\n")[0])))
    np.testing.assert_array_equal(found.x0, np.eye(3)[:2])


def test_swept_states_without_an_initial_state(written):
    text = swept('"initial.x" = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]').replace("x = [1.0, 0.1, 0.5]\n", "")
    np.testing.assert_array_equal(load(written(text)).x0, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.5]])


def test_samples_depend_on_seed_key_and_number(written):
    def states(samples, seed, before=""):
        text = swept(f'{before}"initial.x" = {{ normal = [0.0, 1.0] }}', f"samples = {samples}\nseed = {seed}")
        return load(written(text)).x0

    few = states(2, 7)
    np.testing.assert_array_equal(states(5, 7)[:2], few)
    np.testing.assert_array_equal(states(2, 7, '"system.parameters.inertia[2]" = { uniform = [2, 3] }\n'), few)
    assert not np.any(states(2, 8) == few)
    assert not np.any(random_settings("normal", [0.0, 1.0], "initial.y", 7, 2, (3,)) == few)


def test_distributions_have_their_moments():
    """Means of 4000 numbers are within five standard errors."""
    count = 4000
    flat = random_settings("uniform", [[1.0, -2.0], [3.0, 0.0]], "initial.x", 1, count, (2,))
    assert np.all((flat >= [1.0, -2.0]) & (flat < [3.0, 0.0]))
    assert np.all(abs(flat.mean(axis=0) - [2.0, -1.0]) < 5 * 2 / math.sqrt(12 * count))
    bell = random_settings("normal", [[1.0, 0.0], 0.5], "initial.x", 1, count, (2,))
    assert np.all(abs(bell.mean(axis=0) - [1.0, 0.0]) < 5 * 0.5 / math.sqrt(count))
    assert np.all(abs(bell.var(axis=0) - 0.25) < 5 * 0.25 * math.sqrt(2 / count))
    round_ = random_settings("sphere", 2.0, "initial.x", 1, count, (3,))
    np.testing.assert_allclose(np.linalg.norm(round_, axis=1), 2.0, rtol=1e-15)
    assert np.all(abs(round_.mean(axis=0)) < 5 * 2 / math.sqrt(3 * count))


@pytest.mark.parametrize("name", ["so(3)", "e(3)", "sl(2)", "A4,1", "so(4)"])
def test_orbits_preserve_casimirs(name):
    """Exponents of size 2: series of alternating sums lose at most a factor of e^2 for each piece of size 1."""
    g = co.algebras.get(name)
    rng = np.random.default_rng(1)
    x, u = rng.standard_normal(g.dim), 0.5 * rng.standard_normal(g.dim)
    y = move_on_orbit(g, x, u)
    assert np.linalg.norm(y - x) > 0.1
    exact = np.array(expm(g.coadjoint(u)) @ x)
    np.testing.assert_allclose(y, exact, atol=1e-14 * np.linalg.norm(exact) * math.exp(2))
    for casimir in g.casimirs().values():
        assert casimir(y) == pytest.approx(casimir(x), rel=1e-12, abs=1e-12)


def test_sweeps_over_named_states_forces_and_constants(written):
    fluid = """
    system = {name = "torus_euler", parameters = {N = 5}}
    initial = {kind = "random", seed = 1}
    run = {t_span = [0, 1], step = 0.5}
    sweep = {over = {"initial.seed" = {linear = [1, 3], count = 3}}}
    """
    found = load(written(fluid))
    alone = load(written(fluid.replace("seed = 1", "seed = 2").partition("sweep =")[0]))
    np.testing.assert_array_equal(found.x0[1], alone.x0)
    assert found.x0.shape[0] == 3
    spiral = """
    algebra = {name = "A3,7", parameters = {a = 2.0}}
    hamiltonian = {M = [1.0, 2.0, 0.5]}
    initial = {x = [0.1, 1.0, 0.2]}
    forces = [{name = "LinearDamping", rate = 0.1}]
    run = {t_span = [0, 1], step = 0.5}
    sweep = {over = {"algebra.parameters.a" = [0.5, 1.0], "hamiltonian.M[1]" = [2, 3], "forces[0].rate" = [0.1, 0.2]}}
    """
    found = load(written(spiral))
    assert len(found.system) == 8
    assert [system.forces[0].rate for system in found.system] == [0.1, 0.2] * 4
    assert found.integrate().x.shape == (3, 8, 3)


def test_swept_keys_are_dataset_coordinates(written, tmp_path):
    over = '"system.parameters.inertia" = [[1, 2, 3], [1, 2, 2.5]]\n"initial.x[2]" = [0.5, 0.25]'
    found = load(written(swept(over)))
    dataset = found.dataset(found.integrate())
    np.testing.assert_array_equal(dataset["swept_inertia_2"], [3.0, 3.0, 2.5, 2.5])
    np.testing.assert_array_equal(dataset["swept_x_2"], [0.5, 0.25] * 2)
    assert dataset["swept_inertia_2"].attrs["long_name"] == "system.parameters.inertia[2]"
    from coadjoint import cli

    assert cli.main(["run", "run.toml", "--out", "run.nc", "--quiet"]) == 0
    with xarray.open_dataset("run.nc", engine="h5netcdf") as stored:
        assert stored.swap_dims(member="swept_x_2").sizes["swept_x_2"] == 4
        assert stored["swept_inertia_0"].dims == ("member",)


def test_equal_coordinate_names_are_distinguished():
    found = as_coordinates(
        {"hamiltonian.M[1]": [1], "hamiltonian.M.1": [2], "initial.x": [[1, 2]], "initial.kind": ["a"]}
    )
    assert list(found) == ["swept_hamiltonian_M_1", "swept_hamiltonian_M_1_2", "swept_kind"]


@pytest.mark.parametrize(
    ("over", "expected"),
    [
        ("", "sweep: over is empty; give at least one key of the file"),
        ('"initial.x[3]" = [1.0]', "sweep.over.initial.x[3]: the list in the file has no entry 3"),
        ('"initial.x[0]" = []', "sweep.over.initial.x[0]: is an empty list; give at least one value"),
        ('"initial.x[0]" = { linaer = [0, 1], count = 2 }', "sweep.over.initial.x[0].linaer: unknown key; did you"),
        ('"initial.x[0]" = { linear = [0, 1] }', "sweep.over.initial.x[0]: count belongs to a grid"),
        ('"initial.x[0]" = { linear = [0, 1], count = 1 }', "sweep.over.initial.x[0]: count is 1, and a grid has the"),
        ('"initial.x[0]" = { linear = [0, 1], uniform = [0, 1] }', "sweep.over.initial.x[0]: has linear and uniform; "),
        ('"initial.x[0]" = { uniform = [0, 1] }', "sweep: over 'initial.x[0]' is random; give samples (their number)"),
        ('"initial.x[0]" = { logarithmic = [0, 1], count = 3 }', "sweep.over.initial.x[0]: logarithmic is [0, 1]; "),
        ('"initial.x[0]" = { linear = [0, nan], count = 3 }', "sweep.over.initial.x[0]: linear is nan; it must be"),
        ('"initial.x[0]" = { linear = [0, 1], count = 1000000000000 }', "sweep.over.initial.x[0]: a grid of 10000000"),
        ('"initial.x[0]" = ["a"]', "initial.x: must be a list of numbers"),
        ('"initial.x[0]" = [1.0, "a"]', "sweep.over.initial.x[0]: each setting must be of shape (), of numbers"),
        ('"initial.x" = [[1.0, 2.0, 3.0], [1.0, 2.0]]', "sweep.over.initial.x: "),
        ('"initial.x" = [[1.0, 2.0, 3.0], [1.0, inf, 1.0]]', "initial.x: x0 contains NaN or infinity"),
        ('"initial.y" = [1.0]', "initial.y: unknown key; known here: "),
        ('"initial.attitude" = [true]', "sweep.over.initial.attitude: initial.attitude is the same for all members"),
        ('"run.step" = [0.1]', "sweep.over.run.step: only keys within system.parameters, "),
        ('"method.order" = [2, 4]', "sweep.over.method.order: only keys within system.parameters, "),
        ('"system.name" = ["a"]', "sweep.over.system.name: only keys within system.parameters, "),
        ('"initial.x[0" = [1]', "sweep.over.initial.x[0: 'initial.x[0' is no key of a file; give one such as"),
        ('"initial.x" = [[1.0, 0, 0]]\n"initial.x[0]" = [2.0]', "sweep.over.initial.x[0]: initial.x is swept too"),
        ('"system.parameters.inertia[2]" = [3.0, -1.0]', "system: inertia[2] is -1; every principal moment must be "
         "positive (member 1 of the sweep)"),
        ('"system.parameters.inertai" = [3.0]', "system.parameters.inertai: unknown key; did you mean 'inertia'?"),
        ('"initial.x" = { file = "no.npy" }', "sweep.over.initial.x: 'no.npy' cannot be read (No such file"),
        ('"initial.x" = { file = "run.toml" }', "sweep.over.initial.x: 'run.toml' is no state; give numbers, or the"),
        ('"initial.x[0]" = { sphere = 0 }', "sweep.over.initial.x[0].sphere: must be a positive number, not 0"),
        ('"forces[0].rate" = [0.1]', "sweep.over.forces[0].rate: the list in the file has no entry 0"),
        ('"initial.x" = [[[1.0, 2.0, 3.0], [1.0, 0.0, 0.0]]]', "initial.x: x0 has the shape (2, 3), already"),
    ],
)  # fmt: skip
def test_invalid_sweeps_are_refused(written, over, expected):
    with pytest.raises(ConfigurationError) as error:
        load(written(swept(over)))
    message = str(error.value)
    assert "\n" not in message and message.startswith(f"run.toml: {expected}"), message


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ('"initial.x[0]" = [1.0]', "sweep: samples and seed belong to random settings"),
        ('"initial.x" = { sphere = 1.0 }', "sweep.over.initial.x: 1000000000000 samples needs about"),
        ('"initial.x[0]" = { sphere = 1.0 }', "sweep.over.initial.x[0]: "),
        ('"system.parameters.inertia" = { orbit = 1.0 }', "sweep.over.system.parameters.inertia: orbit applies"),
        ('"initial.x" = { uniform = [[0, 1], [1, 2]] }', "sweep.over.initial.x: "),
    ],
)
def test_invalid_random_sweeps_are_refused(written, over, message):
    samples = 10**12 if "needs about" in message else 2
    with pytest.raises(ConfigurationError) as error:
        load(written(swept(over, f"samples = {samples}\nseed = 1")))
    assert str(error.value).startswith(f"run.toml: {message}"), str(error.value)


def test_too_many_members_are_refused_early(written):
    grid = "{ linear = [0.0, 1.0], count = 100000 }"
    text = swept(f'"initial.x[0]" = {grid}\n"initial.x[1]" = {grid}')
    with pytest.raises(ConfigurationError, match=r"sweep.over: .*10000000000 members needs about .* GB"):
        load(written(text))
    with pytest.raises(ConfigurationError, match=r"initial.x is missing"):
        load(
            written(swept('"initial.x" = { sphere = 1.0 }', "samples = 2\nseed = 1").replace("x = [1.0, 0.1, 0.5]", ""))
        )
