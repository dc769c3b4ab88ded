"""Forces in configuration files, records, datasets, plots and the output of the command."""

import json
import pickle

import numpy as np
import pytest

import coadjoint as co
from coadjoint.cli import main
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.configuration.loading import load
from coadjoint.files.datasets.export import dataset_of, rebuild
from coadjoint.files.datasets.loaded_solution import solution_of_dataset
from coadjoint.files.output.output_files import write_dataset
from coadjoint.files.records.records import record_of, system_of

X = (0.6, 0.0, 0.8)
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
FORCES = (
    co.forces.LinearDamping(((0.1, 0.02, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.3)), (0.0, 0.1, 0.0)),
    co.forces.Torque((0.0, 0.0, 0.05)),
    co.forces.DoubleBracketDamping(0.1, (1.0, 2.0, 0.5)),
    co.forces.HeatBath(0.1, temperature=0.05, seed=2**62 - 1, stream=3),
)
FILE = """
system = {name = "rigid_body", parameters = {inertia = [1, 2, 3]}}
initial = {x = [0.6, 0.0, 0.8]}
run = {t_span = [0, 2], step = 0.125}

[[forces]]
name = "LinearDamping"
rate = [0.1, 0.2, 0.3]

[[forces]]
name = "Torque"
torque = [0.0, 0.0, 0.05]
"""


@pytest.mark.parametrize("attitude", [True, False])
def test_forced_run_is_rebuilt_to_the_same_bits(attitude):
    forced = BODY.with_forces(*FORCES)
    sol = co.integrate(forced, [X, X], (0, 2), 0.125, co.GaussLegendre(2), attitude=attitude)
    data = dataset_of(sol)
    again = rebuild(data)
    assert np.array_equal(again.x, sol.x) and np.array_equal(again.energy, sol.energy)
    assert not np.array_equal(sol.x[-1, 0], sol.x[-1, 1]), "members have independent noise"
    assert "drift" not in data and data["change"].shape == data["balance"].shape == (2, 2, 10)
    accounts = [f"{name}: {which}" for name in ("LinearDamping", "Torque") for which in ("energy", "|x|^2")]
    assert data["account"].values.tolist() == [*accounts, "DoubleBracketDamping: energy", "HeatBath: energy"]
    assert np.array_equal(data["work"].values[..., 3], sol.work["Torque"]["|x|^2"])
    assert np.array_equal(data["balance"].values[0, 0], sol.balance(relative=False)["energy"].tenths[0])
    assert json.loads(data.attrs["method"])["name"] == "GaussLegendre"
    assert system_of(record_of(forced)).forces == FORCES
    copy = pickle.loads(pickle.dumps({name: sol.work[name] for name in sol.work}))
    assert np.array_equal(copy["HeatBath"]["energy"], sol.work["HeatBath"]["energy"])


def test_force_functions_are_named_and_not_stored():
    forced = BODY.with_forces(FORCES[0], co.forces.Torque(lambda t: np.array([0.0, 0.0, np.sin(t)])))
    record = record_of(forced)
    assert record["not_stored"] == ["force: Torque"]
    with pytest.raises(ValueError, match=r"functions are not stored .force: Torque"):
        system_of(record)
    damaged = record_of(BODY.with_forces(FORCES[1]))
    damaged["forces"][0]["torqe"] = damaged["forces"][0].pop("torque")
    with pytest.raises(ValueError, match=r"system.forces\[0\]: .*did you mean 'torque'"):
        system_of(damaged)
    damaged["forces"] = []
    with pytest.raises(ValueError, match="no force"):
        system_of(damaged)


def test_forces_in_files(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(FILE)
    sol = load(path).integrate()
    other = BODY.with_forces(co.forces.LinearDamping((0.1, 0.2, 0.3)), co.forces.Torque((0.0, 0.0, 0.05)))
    assert np.array_equal(sol.x, co.integrate(other, X, (0, 2), 0.125).x)
    for old, new, message in (
        ('"Torque"', '"Torqe"', r"forces\[1\]: .*did you mean 'Torque'"),
        ("rate", "rtae", r"forces\[0\]: .*did you mean 'rate'"),
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2]", r"forces: rate of LinearDamping has the shape \(2,\)"),
        ('name = "Torque"', "", r"forces\[1\]: .*is not a force"),
        ("[[forces]]", "[forces]", "forces"),
    ):
        path.write_text(FILE.replace(old, new, 1) if "[[" not in old else FILE.split("[[forces]]")[0] + "[forces]\n")
        with pytest.raises(ConfigurationError, match=message):
            load(path)


def test_command_prints_change_and_balance(tmp_path, capsys):
    path = tmp_path / "run.toml"
    path.write_text(FILE)
    assert main(["run", str(path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "change minus the work of the forces" in lines[1] and "balance" in lines[1]
    energy = next(line.split() for line in lines if line.split()[0] == "energy")
    assert float(energy[1]) > 0.01 > 1e-3 > float(energy[2])
    assert main(["certify", str(path)]) == 2
    assert "certificate is of a system without forces" in capsys.readouterr().err


FLUID = """
system = {{name = "sphere_euler", parameters = {{N = 3}}}}
initial = {{x = {x}}}
run = {{t_span = [0.5, 1.5], step = 0.25}}

[[forces]]
name = "Viscosity"
nu = 0.1
"""


def test_forced_fluids_in_files(tmp_path, capsys):
    """Default scheme, complex states as pairs, and errors are those of the fluid."""
    sphere, path = co.systems.sphere_euler(N=3), tmp_path / "run.toml"
    W = sphere.random(seed=1)
    pairs = np.stack([W.real, W.imag], axis=-1).tolist()
    forced = sphere.with_forces(co.forces.Viscosity(0.1))
    wanted = co.integrate(forced, W, (0.5, 1.5), 0.25)
    path.write_text(FLUID.format(x=pairs))
    found = load(path)
    assert found.method == wanted.method == co.IsospectralGauss()
    assert np.array_equal(found.x0, W) and np.array_equal(found.integrate().x, wanted.x)
    assert main(["check", str(path)]) == 0 and "IsospectralGauss" in capsys.readouterr().out
    path.write_text(FLUID.format(x=[pairs, pairs]))
    assert np.array_equal(load(path).integrate().x[:, 1], wanted.x)
    path.write_text(FLUID.format(x=pairs) + f'[sweep.over]\n"initial.x" = {[pairs]}\n')
    assert np.array_equal(load(path).integrate().x[:, 0], wanted.x)
    for table, message in (('[observe]\na = "x1"\n', "observe.a: a polynomial needs coordinates"),
                        ('[events.a]\ng = "x1"\n', "events.a: an event of a file needs coordinates")):  # fmt: skip
        path.write_text(FLUID.format(x=pairs) + table)
        with pytest.raises(ConfigurationError, match=message):
            load(path)


def test_names_containing_the_account_separator(tmp_path):
    """The account of a force is one text in files; names may contain its separator."""
    square = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
    casimirs = {"b": square, "a: b": 2 * square, "": 3 * square, "b: energy": square**2}
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), casimirs=casimirs)
    forces = co.forces.LinearDamping(0.1), co.forces.DoubleBracketDamping(0.1), co.forces.LinearDamping(0.2)
    sol = co.integrate(body.with_forces(*forces), X, (0.7, 1.7), 0.125, co.GaussLegendre(2))
    write_dataset(sol.to_xarray(), tmp_path / "run.nc")
    co.integrate(body.with_forces(*forces), X, (0.7, 1.7), 0.125, co.GaussLegendre(2), archive=tmp_path / "run.zarr")
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
    renamed = sol.to_xarray()
    renamed["account"] = [str(each).replace("LinearDamping", "drag: on x") for each in renamed["account"].values]
    assert list(solution_of_dataset(tmp_path, renamed).work) == ["drag: on x", "DoubleBracketDamping", "drag: on x 2"]
