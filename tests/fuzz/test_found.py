"""Regression tests of findings of the fuzzer, independent of what seeds draw."""

import decimal

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.configuration.loading import load
from coadjoint.files.output.output_files import check_target

BODY, X = co.systems.rigid_body(), (0.1, 1.0, 0.2)
HUGE = 10**400
MODIFIED = co.modified_hamiltonian(BODY, co.Splitting())
MATRICES = co.MatrixAlgebra("so", 3)
TURNING = co.MatrixSystem(MATRICES, lambda W: W)
TORUS = co.systems.torus_euler(N=5)
LONG_NAME = "x" * 3000
BRACKETS = ["[e1, e2] = e3"]


@pytest.mark.parametrize(
    ("call", "expected"),
    {
        "a gradient of other shape": (
            lambda: co.predicted_drift(BODY, X, gradient=lambda x: [1.0, 2.0]),
            "gradient returns has the shape (2,)",
        ),
        "a gradient that is no number": (
            lambda: co.predicted_drift(BODY, X, gradient=iter),
            "what gradient returns is",
        ),
        "a field of other shape": (
            lambda: co.predicted_drift(BODY, X, field=lambda x: 1.0),
            "field returns has the shape ()",
        ),
        "a dimension that is an array": (
            lambda: co.Quadratic([1.0, 2.0]).check_dimension(np.array([])),
            "dimension must be",
        ),
        "a basis that is a number": (lambda: co.LieAlgebra.from_brackets(BRACKETS, basis=0.5), "basis is 0.5"),
        "matrices that are not finite": (lambda: TURNING.spectrum(np.full((3, 3), np.inf)), "a state[0, 0] is inf"),
        "combinations without end": (
            lambda: co.frequencies(np.arange(64.0), np.cos(np.arange(64.0)), 1).combinations(largest=HUGE),
            "largest must be",
        ),
        "a coordinate of an event": (lambda: co.Event(HUGE), "coordinate of an event must be"),
        "another kind of number": (lambda: MODIFIED(X, decimal.Decimal("0.1")), "h is Decimal('0.1')"),
        "whole numbers without a float": (
            lambda: co.Quadratic(X, linear=X)([HUGE, 1.0, 1.0]),
            "number is too large for float64",
        ),
        "functions that take no objects": (
            lambda: co.Separable({0: (np.sin, np.cos)}).value([HUGE, 1, 1]),
            "function of coordinate 0",
        ),
        "a name that is a number": (lambda: MATRICES.read(np.eye(3), 10**5000), "nonempty string"),
        "a derivative that is too large": (lambda: co.Polynomial({(2,): 1.7e308}).gradient([1.0]), "range of float64"),
        "a spectrum that takes no array": (lambda: TORUS.random(1, spectrum=int), "it must take an array of degrees"),
        "a graph without end": (
            lambda: co.systems.spin_lattice(lattice=[], shape=10**30),
            "shape, the number of sites",
        ),
        "pieces that are no list": (
            lambda: co.SplitHamiltonian([(7, co.Quadratic(1.0))]),
            "coordinates of piece 0 is 7",
        ),
        "names that are a number": (lambda: co.Polynomial({(1,): 2}).named(7), "names is 7; give one name"),
        "a name that is no text": (lambda: co.Polynomial({(1, 1): 2}).named(["a", 1j]), "must be a nonempty string"),
        "a long name of a file": (lambda: load(LONG_NAME), "cannot be read (File name too long)"),
        "a long name of a result": (lambda: check_target(LONG_NAME), "it must be .nc or .zarr"),
    }.values(),
)
def test_refusal_is_one_sentence(call, expected):
    with pytest.raises((ValueError, TypeError, OverflowError)) as raised:
        call()
    message = str(raised.value)
    assert expected in message and len(message) < 1000 and "\n" not in message


def test_torque_may_be_a_builtin_function():
    assert co.forces.Torque(np.negative).torque is np.negative
    with pytest.raises(TypeError):
        BODY.with_forces(co.forces.Torque(iter))


def test_huge_masses_do_not_warn(recwarn):
    with pytest.raises(ValueError, match="change units"):
        co.systems.so_n_body((1e308, 1e308, 1e308))
    assert not [noticed for noticed in recwarn if issubclass(noticed.category, RuntimeWarning)]


def test_arrays_without_end_are_refused_before_they_are_copied():
    wide = np.broadcast_to(1j, 10**13)
    with pytest.raises(ValueError, match="a copy of modes, of shape"):
        TORUS.from_modes(wide)


def test_statistics_beyond_float64_are_infinite(recwarn):
    walk = co.analysis.random_walk(np.full((3, 3), 1e308), 1)
    assert walk.worst == 1e308 and walk.late == np.inf
    assert not [noticed for noticed in recwarn if issubclass(noticed.category, RuntimeWarning)]


BODY_FILE = """
system = {name = "rigid_body"}
initial = {x = [1.0, 0.1, 0.5]}
"""


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('run = {t_span = [0, 1], step = 0.1, t_eval = [0.25]}\noutput.archive = "a.zarr"', "run.t_eval: an archive"),
        ('run = {t_span = [0, 1], step = 0.1}\noutput.archive = "a.zarr"\n[events.e]\ng = "x1"', "events: an archive"),
        (
            'run = {t_span = [1, 0], step = 0.1}\n[[forces]]\nname = "HeatBath"\nalpha = 1\ntemperature = 1\nseed = 3',
            "run: HeatBath does not run",
        ),
    ],
)
def test_contradictory_files_are_refused(tmp_path, more, message):
    file = tmp_path / "run.toml"
    file.write_text(BODY_FILE + more, encoding="utf-8")
    with pytest.raises(ValueError, match="toml: ") as raised:
        load(file)
    assert message in str(raised.value)
