"""Initial states of fluids by name and parameters in configuration files."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint import cli
from coadjoint.files.configuration.initial_states import state_by_name
from coadjoint.files.configuration.loading import ConfigurationError, load
from coadjoint.files.configuration.models import InitialTable

FLUID = """
[system]
name = "{system}"
parameters = {{N = {N}}}
[initial]
{initial}
[method]
name = "IsospectralGauss"
[run]
t_span = [0.0, 0.5]
step = 0.25
"""
BALL = co.systems.sphere_euler(N=8)
TORUS = co.systems.torus_euler(N=9)


@pytest.fixture
def read(tmp_path):
    def write(initial, system="sphere_euler", N=8, more=""):
        file = tmp_path / "fluid.toml"
        file.write_text(FLUID.format(system=system, N=N, initial=initial) + more)
        return load(file)

    return write


@pytest.mark.parametrize(
    ("initial", "system", "state"),
    [
        ('kind = "random"\nseed = 3\ndegrees = [2, 4]', BALL, BALL.random(3, degrees=(2, 4))),
        ('kind = "random"\nseed = 3\nspectrum = [0, 0, 1.5, 2.0]', TORUS, TORUS.random(3, spectrum=[0, 0, 1.5, 2.0])),
        ('kind = "zonal_jet"\nband = [-0.5, 1.0]', BALL, BALL.zonal_jet(band=(-0.5, 1.0))),
        ('kind = "zonal_jet"\nwidth = 0.5', TORUS, TORUS.zonal_jet(width=0.5)),
        ('kind = "rossby_haurwitz"\ndegree = 3\norder = 2', BALL, BALL.rossby_haurwitz(3, 2)),
        (
            'kind = "blobs"\nplaces = [[0.1, 0.2], [-0.3, 2.0]]\nstrengths = [1.0, -1.0]\nwidths = 0.5',
            BALL,
            BALL.blobs([(0.1, 0.2), (-0.3, 2.0)], [1.0, -1.0], 0.5),
        ),
    ],
    ids=["random", "random-torus", "jet", "jet-torus", "rossby-haurwitz", "blobs"],
)
def test_named_state_equals_the_method(read, initial, system, state):
    configuration = read(initial, system.name, system.algebra.N)
    np.testing.assert_array_equal(configuration.x0, state)
    np.testing.assert_array_equal(configuration.integrate().x[0], state)


def test_named_states_are_documented_methods():
    for system in (BALL, TORUS):
        assert len(set(system.states_by_name)) == len(system.states_by_name) >= 5
        for name in system.states_by_name:
            assert callable(getattr(system, name)) and getattr(system, name).__doc__


def test_path_is_relative_to_the_file(read, tmp_path, monkeypatch):
    W = BALL.random(5, degrees=(2, 3))
    np.save(tmp_path / "state.npy", W)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    np.testing.assert_array_equal(read('kind = "from_file"\npath = "state.npy"').x0, W)


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ('kind = "radnom"\nseed = 1', "initial.kind: unknown initial state 'radnom'; did you mean 'random'?"),
        ('kind = "spectrum"', "initial.kind: unknown initial state 'spectrum'"),
        ('kind = "random"\nsed = 1', "initial.sed: unknown key; did you mean 'seed'?"),
        ('kind = "random"\nseed = 1\nx = [1.0]', "initial.x: unknown key"),
        ('kind = "random"\nseed = 1\nsystem = 2', "initial.system: unknown key"),
        ('kind = "random"', "initial: random needs the parameter 'seed'"),
        ('kind = "random"\nseed = -1', "initial: seed"),
        ('kind = "random"\nseed = 1\ndegrees = [2, 90]', "initial: degrees[1]"),
        ('kind = "from_file"\npath = "none.npy"', "none.npy: No such file or directory"),
        ("kind = 3", "initial.kind: must be text in quotes, not 3"),
        ("attitude = false", "initial: x is missing; give it, or the kind of an initial state"),
        ("x = [1.0]\nparameters = {seed = 1}", "initial: parameters belong to a kind of initial state"),
        ("seed = 1", "initial.seed: unknown key"),
    ],
)
def test_invalid_named_state_has_the_key(read, initial, message):
    with pytest.raises(ConfigurationError) as refused:
        read(initial)
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_other_systems_have_no_named_states(read, tmp_path):
    body = '[system]\nname = "rigid_body"\n[initial]\nkind = "random"\nseed = 1\n[run]\nt_span = [0, 1]\nstep = 0.1\n'
    (tmp_path / "body.toml").write_text(body)
    with pytest.raises(ConfigurationError, match="rigid_body has no named initial states; give x"):
        load(tmp_path / "body.toml")
    own = body.replace('[system]\nname = "rigid_body"', "[algebra]\ndim = 3\nbrackets = []\n[hamiltonian]\nM = 1")
    (tmp_path / "body.toml").write_text(own)
    with pytest.raises(ConfigurationError, match="only ready-made systems have named states"):
        load(tmp_path / "body.toml")


def test_forced_fluids_have_named_states():
    """A system with forces has the named states of the unforced one."""
    arguments, forced = InitialTable(kind="random", seed=1), BALL.with_forces(co.forces.Friction(0.1))
    np.testing.assert_array_equal(state_by_name("fluid.toml", arguments, forced), BALL.random(1))


@pytest.mark.long
def test_command_plots_a_named_state(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fluid.toml").write_text(FLUID.format(system="torus_euler", N=9, initial='kind = "random"\nseed = 1'))
    assert cli.main(["run", "fluid.toml", "--figure", "fluid.png"]) == 0
    assert capsys.readouterr().out.startswith("torus_euler, IsospectralGauss")
    assert (tmp_path / "fluid.png").read_bytes().startswith(b"\x89PNG")
