"""Forces in configuration files, records, datasets, pictures, and in the table of the command."""

import json
import pickle

import numpy as np
import pytest

import coadjoint as co
from coadjoint.cli import main
from coadjoint.files.configuration.configuration import load
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.datasets.export import dataset_of, rebuild
from coadjoint.files.datasets.loaded_solution import LoadedSolution
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


@pytest.mark.parametrize("kept", [True, False])
def test_a_run_is_repeated_from_its_dataset_bit_for_bit(kept):
    forced = BODY.with_forces(*FORCES)
    sol = co.integrate(forced, [X, X], (0, 2), 0.125, co.GaussLegendre(2), attitude=kept)
    data = dataset_of(sol)
    again = rebuild(data)
    assert np.array_equal(again.x, sol.x) and np.array_equal(again.energy, sol.energy)
    assert not np.array_equal(sol.x[-1, 0], sol.x[-1, 1]), "members have noises of their own"
    assert "drift" not in data and data["change"].shape == data["balance"].shape == (2, 2, 10)
    accounts = [f"{name}: {which}" for name in ("LinearDamping", "Torque") for which in ("energy", "|x|^2")]
    assert data["account"].values.tolist() == [*accounts, "DoubleBracketDamping: energy", "HeatBath: energy"]
    assert np.array_equal(data["work"].values[..., 3], sol.work["Torque"]["|x|^2"])
    assert np.array_equal(data["balance"].values[0, 0], sol.balance()["energy"].tenths[0])
    assert json.loads(data.attrs["method"])["name"] == "GaussLegendre"
    assert system_of(record_of(forced)).forces == FORCES
    copy = pickle.loads(pickle.dumps({name: sol.work[name] for name in sol.work}))
    assert np.array_equal(copy["HeatBath"]["energy"], sol.work["HeatBath"]["energy"])


def test_a_batch_is_repeated():
    systems = co.batch([BODY.with_forces(FORCES[0], force) for force in (FORCES[1], co.forces.Torque((0.1, 0.0, 0.0)))])
    sol = co.integrate(systems, X, (0, 2), 0.125)
    assert np.array_equal(rebuild(dataset_of(sol)).x, sol.x) and not np.array_equal(sol.x[-1, 0], sol.x[-1, 1])


def test_functions_are_not_kept_and_said_so():
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


def test_files_have_forces(tmp_path):
    place = tmp_path / "run.toml"
    place.write_text(FILE)
    sol = load(place).integrate()
    other = BODY.with_forces(co.forces.LinearDamping((0.1, 0.2, 0.3)), co.forces.Torque((0.0, 0.0, 0.05)))
    assert np.array_equal(sol.x, co.integrate(other, X, (0, 2), 0.125).x)
    for old, new, said in (
        ('"Torque"', '"Torqe"', r"forces\[1\]: .*did you mean 'Torque'"),
        ("rate", "rtae", r"forces\[0\]: .*did you mean 'rate'"),
        ("[0.1, 0.2, 0.3]", "[0.1, 0.2]", r"forces: rate of LinearDamping has the shape \(2,\)"),
        ('name = "Torque"', "", r"forces\[1\]: .*is not a force"),
        ("[[forces]]", "[forces]", "forces"),
    ):
        place.write_text(FILE.replace(old, new, 1) if "[[" not in old else FILE.split("[[forces]]")[0] + "[forces]\n")
        with pytest.raises(ConfigurationError, match=said):
            load(place)


def test_the_command_shows_change_and_balance(tmp_path, capsys):
    place = tmp_path / "run.toml"
    place.write_text(FILE)
    assert main(["run", str(place)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert "change minus the work of the forces" in said[1] and "balance" in said[1]
    energy = next(line.split() for line in said if line.split()[0] == "energy")
    assert float(energy[1]) > 0.01 > 1e-3 > float(energy[2])
    assert main(["certify", str(place)]) == 2
    assert "has forces" in capsys.readouterr().err


def test_pictures_say_change():
    figure = co.integrate(BODY.with_forces(FORCES[0]), X, (0, 2), 0.125).plot()
    assert figure.axes[0].get_title().startswith("change of the energy")


FLUID = """
system = {{name = "sphere_euler", parameters = {{N = 3}}}}
initial = {{x = {x}}}
run = {{t_span = [0.5, 1.5], step = 0.25}}

[[forces]]
name = "Viscosity"
nu = 0.1
"""


def test_fluids_with_forces_are_read_as_fluids(tmp_path, capsys):
    """The default scheme, complex states as pairs, and what a polynomial cannot be of are those of the fluid."""
    sphere, place = co.systems.sphere_euler(N=3), tmp_path / "run.toml"
    W = sphere.random(seed=1)
    pairs = np.stack([W.real, W.imag], axis=-1).tolist()
    forced = sphere.with_forces(co.forces.Viscosity(0.1))
    wanted = co.integrate(forced, W, (0.5, 1.5), 0.25)
    place.write_text(FLUID.format(x=pairs))
    found = load(place)
    assert found.method == wanted.method == co.IsospectralGauss()
    assert np.array_equal(found.x0, W) and np.array_equal(found.integrate().x, wanted.x)
    assert main(["check", str(place)]) == 0 and "IsospectralGauss" in capsys.readouterr().out
    place.write_text(FLUID.format(x=[pairs, pairs]))
    assert np.array_equal(load(place).integrate().x[:, 1], wanted.x)
    place.write_text(FLUID.format(x=pairs) + f'[sweep.over]\n"initial.x" = {[pairs]}\n')
    assert np.array_equal(load(place).integrate().x[:, 0], wanted.x)
    for table, said in (('[observe]\na = "x1"\n', "observe.a: a polynomial needs coordinates"),
                        ('[events.a]\ng = "x1"\n', "events.a: an event of a file needs coordinates")):  # fmt: skip
        place.write_text(FLUID.format(x=pairs) + table)
        with pytest.raises(ConfigurationError, match=said):
            load(place)


def test_names_with_the_separator_of_accounts(tmp_path):
    """In files the account of a force is one text; a name may have what separates it from the other, or end in one."""
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
    assert list(LoadedSolution(tmp_path, renamed).work) == ["drag: on x", "DoubleBracketDamping", "drag: on x 2"]
