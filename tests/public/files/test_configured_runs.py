"""Runs of configuration files are those of the same calls in Python, bit for bit."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from command import command
from configuration_files import BRACKETS, OWN, READY_MADE
from same_runs import check_same, same_bits

X = (1.0, 0.1, 0.5)
BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
SCHEME = co.Splitting(order=4)
FULL = """
[system]
name = "rigid_body"
[system.parameters]
inertia = [1.0, 2.0, 2.5]
[initial]
x = [[1.0, 0.1, 0.5], [0.2, 1.0, 0.3], [0.1, -0.2, 1.0], [0.3, 0.4, -1.0]]
attitude = true
[method]
name = "Splitting"
order = 4
[run]
t_span = [2, -1]
step = 0.125
save_every = 3
watch = false
threads = 2
[observe]
"x1 x2" = "x1*x2"
"""
MANY = [(1.0, 0.1, 0.5), (0.2, 1.0, 0.3), (0.1, -0.2, 1.0), (0.3, 0.4, -1.0)]
QUARTER = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
EVENTS = """
[events.flip]
g = "x2"
[events.far]
g = "x1^2 - 0.125"
direction = 1
terminal = true
count = 2
"""
FAR = co.Polynomial({(2, 0, 0): 1, (0, 0, 0): -0.125})
DAMPED = BODY.with_forces(co.forces.LinearDamping((0.1, 0.2, 0.3)), co.forces.Torque((0.0, 0.0, 0.05)))
FORCES = """
[[forces]]
name = "LinearDamping"
rate = [0.1, 0.2, 0.3]
[[forces]]
name = "Torque"
torque = [0.0, 0.0, 0.05]
"""
SUMS = [0.0, *np.cumsum(np.full(3000, 0.01)).tolist()]
"""Times that are sums of steps, and with them rounded."""
SPAN = "t_span = [0, 1]\nstep = 0.1"


def run(system=BODY, x0=X, span=(0.0, 1.0), step=0.1, method=SCHEME, **options):
    return lambda: co.integrate(system, x0, span, step, method, **options)


CONFIGURED = {
    "a ready-made system": (READY_MADE, run()),
    "every key": (
        FULL,
        run(x0=MANY, span=(2, -1), step=0.125, attitude=True, save_every=3, watch=False,
            observe={"x1 x2": co.Polynomial({(1, 1, 0): 1})}),
    ),
    "the default scheme": (READY_MADE.replace('[method]\nname = "Splitting"\norder = 4\n', ""), run(method=None)),
    "a parameter called name": (
        READY_MADE.replace('"Splitting"\norder = 4', '"ExplicitRungeKutta"\nparameters = {name = "runge2"}'),
        run(method=co.ExplicitRungeKutta("runge2")),
    ),
    "a wrapped scheme": (
        READY_MADE.replace('"Splitting"\norder = 4', '"Composition"\ncoefficients = [0.5, 0.5]\n'
                           "base = {name = 'GaussLegendre', stages = 3}"),
        run(method=co.Composition(co.GaussLegendre(3), (0.5, 0.5))),
    ),
    "a coadjoint matrix": (READY_MADE.replace("0.5]", '0.5]\nattitude = "coadjoint"'), run(attitude="coadjoint")),
    "a matrix of attitude": (READY_MADE.replace("0.5]", f"0.5]\nattitude = {QUARTER}"), run(attitude=QUARTER)),
    "no attitude": (READY_MADE.replace("0.5]", "0.5]\nattitude = false"), run()),
    "times": (
        READY_MADE.replace("0.5]", "0.5]\nattitude = true").replace("[0, 1]", "[0, 10]") + "t_eval = [0.25, 3, 9.99]\n",
        run(span=(0, 10), attitude=True, t_eval=[0.25, 3, 9.99]),
    ),
    "an end that is a sum of steps": (READY_MADE.replace(SPAN, f"t_span = [0, {SUMS[-1]!r}]\nstep = 0.01"),
                                      run(span=(0, SUMS[-1]), step=0.01)),
    "events": (
        READY_MADE.replace(SPAN, "t_span = [0, 40]\nstep = 0.125") + EVENTS,
        run(span=(0, 40), step=0.125, events=[co.Event("x2", name="flip"), co.Event(FAR, 1, 2, True, "far")]),
    ),
    "forces": (READY_MADE + FORCES, run(DAMPED)),
}  # fmt: skip


@pytest.mark.parametrize("name", CONFIGURED)
def test_a_file_is_the_run_in_python(files, name):
    text, wanted = CONFIGURED[name]
    check_same(files.run(text), wanted())


def test_an_archive_of_a_file_is_its_run(files):
    files.write(FULL + '[output]\narchive = "run.zarr"\n')
    found = command(files.capsys, "run", "run.toml", "--progress", "--quiet")
    assert found.status == 0 and "steps (100 %)" in found.err
    wanted, archived = CONFIGURED["every key"][1](), co.open_archive("run.zarr")
    for name in ("t", "x", "energy", "attitude"):
        assert same_bits(getattr(archived, name), getattr(wanted, name)), name
    assert same_bits(archived.observed["x1 x2"], wanted.observed["x1 x2"]) and not archived.watched
    assert archived.to_xarray().attrs["configuration"] == (files.folder / "run.toml").read_text()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "mixed"])
def test_line_ends_are_normalized(files, end):
    """In the stored text, and in the lines that errors name."""
    ends = ["\n", "\r\n", "\r"] if end == "mixed" else [end]
    for text in (READY_MADE, READY_MADE.replace("step = 0.1", "step =")):
        lines = text.split("\n")
        joined = "".join(line + ends[k % len(ends)] for k, line in enumerate(lines[:-1])) + lines[-1]
        if text == READY_MADE:
            assert files.run(joined).dataset.attrs["configuration"] == READY_MADE
            (files.folder / "run.nc").unlink()
        else:
            assert "line 13, column 7" in files.refused(joined)


# Accuracy.

ACCURATE = READY_MADE.replace("step = 0.1", "accuracy = 1e-8")


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", [None, SCHEME])
@pytest.mark.parametrize("span", [(0, 1), (1, -2)])
def test_an_accuracy_chooses_as_python_does(files, method, span):
    without = () if method else (('[method]\nname = "Splitting"\norder = 4\n', ""),)
    found = files.run(ACCURATE, ("[0, 1]", str(list(span))), *without)
    expected = co.integrate(BODY, X, span, accuracy=1e-8, method=method)
    assert (found.step, found.method) == (expected.step, expected.method) and same_bits(found.x, expected.x)
    assert np.linalg.norm(found.x[-1] - BODY.exact(X, float(span[1] - span[0]))) < 1e-8
    chosen = files.plan(ACCURATE, ("[0, 1]", str(list(span))), *without)
    assert f"chosen, expected error {expected.choice.error:.1e}" in chosen["scheme"]


def test_an_accuracy_with_attitude_is_chosen_for_both(files):
    attitude = ("0.5]", "0.5]\nattitude = true"), ("1e-8", "1e-6")
    choice = co.choose(BODY, X, (0.0, 1.0), 1e-6, methods=SCHEME, attitude=True)
    assert files.run(ACCURATE, *attitude).step == choice.step
    assert f"expected error {choice.error:.1e}" in files.plan(ACCURATE, *attitude)["scheme"]


# Algebras and Hamiltonians.


def test_own_brackets_give_the_same_motion(files):
    own = files.run(OWN, ("0.25]", "0.4]"))
    assert own.system.algebra == co.algebras.so(3)
    assert (own.system.name, own.system.sign, list(own.casimirs)) == ("mine", -1, ["|x|^2"])
    assert same_bits(own.x, co.integrate(BODY, X, (0.0, 1.0), 0.1).x)


def test_catalogue_attitude_ensemble_and_observed(files):
    text = """
    casimirs = {}
    algebra = {name = "A3,7", parameters = {a = 2.0}}
    hamiltonian = {M = 1.0, linear = [0.0, 0.0, 1.0]}
    initial = {x = [[1.0, 1.0, 1.0], [0.5, 0.0, 1.0]], attitude = "coadjoint"}
    run = {t_span = [0.0, 0.5], step = 0.1, watch = false, threads = 1, save_every = 2}
    observe = {height = "x3"}
    """
    sol = files.run(text)
    spiral = co.LiePoissonSystem(co.algebras.A3_7(2.0), co.Quadratic(1.0, linear=[0.0, 0.0, 1.0]), casimirs={})
    wanted = co.integrate(spiral, sol.x0, (0, 0.5), 0.1, attitude="coadjoint", save_every=2, watch=False)
    assert same_bits(sol.x, wanted.x) and same_bits(sol.attitude, wanted.attitude)
    assert sol.casimirs == {} and not sol.watched and same_bits(sol.observed["height"], sol.x[..., 2])


M = "M = [1.0, 0.5, 0.25]"


@pytest.mark.parametrize(
    ("lines", "hamiltonian"),
    [
        ("M = 2.0", co.Quadratic(2.0)),
        ("M = [1, 0.5, 0.25]\nconstant = -2.5", co.Quadratic([1, 0.5, 0.25], constant=-2.5)),
        ("linear = [1, 2, 3]\nconstant = 1", co.Quadratic(0.0, linear=[1, 2, 3], constant=1)),
        (
            "M = [[0, 1, 0], [1, 0, 0], [0, 0, 2]]\nlinear = [0, 0, 1]",
            co.Quadratic([[0, 1, 0], [1, 0, 0], [0, 0, 2]], linear=[0, 0, 1]),
        ),
        ('polynomial = "0.5*x1^2 + 1/4*x2^2 + x3^4"',
         co.Polynomial({(2, 0, 0): 0.5, (0, 2, 0): Fraction(1, 4), (0, 0, 4): 1})),
        ("polynomial = [[0.5, [2, 0, 0]], [0.1, [0, 0, 4]]]", co.Polynomial({(2, 0, 0): 0.5, (0, 0, 4): 0.1})),
        ('formula = "a*x1^2/2 + cos(x2)/b"\nparameters = {a = 1.5, b = 4}',
         co.formula("a*x1^2/2 + cos(x2)/b", 3, parameters={"a": 1.5, "b": 4})),
    ],
)  # fmt: skip
def test_hamiltonians_of_a_file(files, lines, hamiltonian):
    sol = files.run(OWN, (M, lines))
    own = co.LiePoissonSystem(co.algebras.so(3), hamiltonian, sign=-1)
    wanted = co.integrate(own, X, (0.0, 1.0), 0.1)
    assert same_bits(sol.x, wanted.x) and same_bits(sol.energy, wanted.energy) and sol.method == wanted.method


def test_formulas_have_the_names_of_the_basis_and_parameters_that_are_swept(files):
    """And their values are those of the function in Python, up to the rounding of a few steps."""
    basis = (f"dim = 3\n{BRACKETS}", 'basis = ["a", "b", "c"]\nbrackets = ["[a, b] = c", "[b, c] = a", "[c, a] = b"]')
    casimir = '"x1^2 + x2^2 + x3^2"', '"a^2 + b^2 + c^2"'
    formula = M, 'formula = "(a + k*b)^2/2 + 1/(2 + c^2)"\nparameters = {k = 1}'
    sweep = '[sweep.over]\n"hamiltonian.parameters.k" = [1.0, 1.5, 2.0]\n'
    sol = files.run(OWN + sweep, basis, casimir, formula)
    for member, k in enumerate((1.0, 1.5, 2.0)):
        H = lambda x, k=k: (x[0] + k * x[1]) ** 2 / 2 + 1 / (2 + x[2] ** 2)  # noqa: E731
        alone = co.integrate(co.LiePoissonSystem(co.algebras.so(3), H, sign=-1), X, (0, 1), 0.1)
        assert np.abs(sol.x[:, member] - alone.x).max() < 2.0**-46
    assert sol.system[0].algebra.basis == ("a", "b", "c")


BY_MATRICES = (
    ("dim = 3\n", 'basis = ["a", "b", "c"]\n'),
    (
        BRACKETS,
        "matrices = [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], "
        "[[0, -1, 0], [1, 0, 0], [0, 0, 0]]]",
    ),
    ('"x1^2 + x2^2 + x3^2"', '"a^2 + b^2 + c^2"'),
)


def test_an_algebra_by_its_matrices(files):
    found = files.run(OWN, *BY_MATRICES, ("x = [1.0, 0.1, 0.5]", "x = [1.0, 0.1, 0.5]\nattitude = true"))
    assert found.system.algebra == co.algebras.so(3) and found.system.algebra.basis == ("a", "b", "c")
    assert np.array_equal(found.system.algebra.representation, co.algebras.so(3).representation)
    own = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1)
    assert same_bits(found.attitude, co.integrate(own, X, (0, 1), 0.1, attitude=True).attitude)


@pytest.mark.parametrize("casimirs", [None, "", '"|x|^2" = "x1^2 + x2^2 + x3^2"'])
def test_casimirs_are_computed_only_by_default(files, casimirs):
    table = '[casimirs]\n"|x|^2" = "x1^2 + x2^2 + x3^2"\n'
    found = files.run(OWN, (table, "" if casimirs is None else f"[casimirs]\n{casimirs}\n"))
    wanted = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25])).casimirs
    assert len(found.casimirs) == (len(wanted) if casimirs is None else bool(casimirs))


# States by name, in files, and of matrices.

FLUID = """
[system]
name = "{system}"
parameters = {{N = {N}}}
[initial]
{initial}
[run]
t_span = [0.5, 1.0]
step = 0.25
"""
BALL, TORUS = co.systems.sphere_euler(N=4), co.systems.torus_euler(N=5)
GRID = np.cos(np.arange(35.0)).reshape(5, 7)


def test_modes_and_grids_in_files(files, tmp_path, monkeypatch):
    """Of a file `.npy` beside the configuration; rows that are no modes are refused."""
    monkeypatch.chdir(tmp_path)
    state = BALL.from_modes({(3, 2): 0.5 - 1j})
    for kind, key, array in (
        ("from_grid", "values", BALL.to_grid(state)),
        ("from_modes", "modes", BALL.mode_array(state)),
    ):
        np.save(tmp_path / "given.npy", array)
        text = FLUID.format(system="sphere_euler", N=4, initial=f'kind = "{kind}"\n{key} = "given.npy"')
        np.testing.assert_allclose(files.run(text).x0, state, rtol=0, atol=1e-14)
    for modes, word in (("[[3, 2]]", "imaginary"), ("[[3, 2, 1.0], [3, 2, 2.0]]", "twice"), ("3", "imaginary")):
        text = FLUID.format(system="sphere_euler", N=4, initial=f'kind = "from_modes"\nmodes = {modes}')
        assert word in str(files.refused(text, by="run"))


@pytest.mark.parametrize(
    ("initial", "system", "state"),
    [
        ('kind = "random"\nseed = 3\ndegrees = [2, 3]', BALL, BALL.random(3, degrees=(2, 3))),
        ('kind = "random"\nseed = 3\nspectrum = [0, 0, 1.5]', TORUS, TORUS.random(3, spectrum=[0, 0, 1.5])),
        ('kind = "zonal_jet"\nband = [-0.5, 1.0]', BALL, BALL.zonal_jet(band=(-0.5, 1.0))),
        ('kind = "zonal_jet"\nwidth = 0.5', TORUS, TORUS.zonal_jet(width=0.5)),
        ('kind = "rossby_haurwitz"\ndegree = 3\norder = 2', BALL, BALL.rossby_haurwitz(3, 2)),
        (
            'kind = "blobs"\nplaces = [[0.1, 0.2], [-0.3, 2.0]]\nstrengths = [1.0, -1.0]\nwidths = 0.5',
            BALL,
            BALL.blobs([(0.1, 0.2), (-0.3, 2.0)], [1.0, -1.0], 0.5),
        ),
        (
            'kind = "from_modes"\nmodes = [[3, 2, 0.5, -1.0], [2, 0, 1.0]]',
            BALL,
            BALL.from_modes({(3, 2): 0.5 - 1j, (2, 0): 1.0}),
        ),
        (f'kind = "from_grid"\nvalues = {GRID.tolist()}', TORUS, TORUS.from_grid(GRID)),
    ],
    ids=["random", "random-torus", "jet", "jet-torus", "rossby-haurwitz", "blobs", "modes", "grid-torus"],
)
def test_named_states_are_those_of_the_methods(files, initial, system, state):
    """With and without forces."""
    text = FLUID.format(system=system.name, N=system.algebra.N, initial=initial)
    sol, wanted = files.run(text), co.integrate(system, state, (0.5, 1.0), 0.25)
    assert same_bits(sol.x0, wanted.x0) and same_bits(sol.x, wanted.x) and sol.method == wanted.method
    viscous = files.run(text + '[[forces]]\nname = "Viscosity"\nnu = 0.1\n')
    wanted = co.integrate(system.with_forces(co.forces.Viscosity(0.1)), state, (0.5, 1.0), 0.25)
    assert same_bits(viscous.x, wanted.x) and viscous.method == wanted.method


def test_states_of_complex_matrices(files, monkeypatch):
    """As pairs of numbers, from files beside the configuration, alone and several, swept, and of forced fluids."""
    W = BALL.random(5, degrees=(2, 3))
    other = BALL.random(6, degrees=(1, 2))
    pairs, more = (np.stack([one.real, one.imag], axis=-1).tolist() for one in (W, other))
    np.save("w.npy", W)
    np.save("both.npy", [W, other])
    wanted, both = (co.integrate(BALL, x0, (0.5, 1.0), 0.25) for x0 in (W, np.array([W, other])))
    (files.folder / "elsewhere").mkdir()
    for given in ("w.npy", f"{files.folder}/w.npy", pairs, "both.npy", [pairs, more], None):
        text = FLUID.format(system="sphere_euler", N=4, initial=f"x = {given!r}" if given else f"x = {more}")
        if given is None:
            text += f'[sweep.over]\n"initial.x" = {[pairs, more]}\n'
        files.write(text)
        monkeypatch.chdir(files.folder / "elsewhere")
        assert command(files.capsys, "run", "../run.toml", "--out", "run.nc", "--quiet").status == 0
        assert same_bits(
            co.load("run.nc").x, (wanted if given in ("w.npy", f"{files.folder}/w.npy", pairs) else both).x
        )
        monkeypatch.chdir(files.folder)


def test_states_of_real_matrices_and_of_vectors_in_a_file(files):
    body = co.systems.matrix_body((1.0, 2.0, 4.0))
    X3 = body.algebra.projected(np.arange(9.0).reshape(3, 3))
    text = (
        'system = {name = "matrix_body", parameters = {inertia = [1, 2, 4]}}\nrun = {t_span = [0, 1], step = 0.125}\n'
    )
    method = 'method = {name = "IsospectralGauss", stages = 2}\n'
    sol = files.run(f"{text}{method}initial = {{x = {X3.tolist()}}}\n")
    assert same_bits(sol.x, co.integrate(body, X3, (0, 1), 0.125, co.IsospectralGauss(2)).x)
    np.save("x.npy", X)
    assert same_bits(files.run(READY_MADE, ("[1.0, 0.1, 0.5]", '"x.npy"')).x, run()().x)


# Dry runs.


def test_a_plan_describes_the_run(files):
    wanted = CONFIGURED["every key"][1]()
    lines = files.plan(FULL + '[output]\nfile = "a.nc"\nfigure = "a.png"\n')
    assert list(lines) == ["system", "members", "scheme", "keeps", "steps", "saved", "memory", "output", "time"]
    assert lines["system"] == "rigid_body, dimension 3" and lines["members"] == "4"
    assert lines["steps"] == "24 of 0.125, from t = 2 to -1" and lines["saved"] == "9 points of 4 members"
    number, unit = lines["memory"].split(",")[0].split()
    scale = {"bytes": 1, "kB": 1e3, "MB": 1e6, "GB": 1e9}[unit]
    assert float(number) * scale >= 0.9 * (wanted.x.nbytes + wanted.attitude.nbytes + wanted.energy.nbytes)
    assert lines["memory"].endswith(" are free") and lines["output"].endswith("; to a.nc, a.png")
    assert "estimated from a trial of" in lines["time"]
    assert files.plan(FULL + '[output]\narchive = "a.zarr"\n')["output"].endswith("; to a.zarr")
    assert files.plan(FULL)["output"].endswith("the file names no output")
    assert sorted(path.name for path in files.folder.iterdir()) == ["run.toml"]


def test_plans_of_sweeps_forces_events_and_rounded_times(files):
    more = '[sweep.over]\n"system.parameters.inertia[2]" = [2.5, 2.25]\n"initial.x[0]" = [1.0, 0.5, 0.25]\n'
    lines = files.plan(READY_MADE + more)
    assert lines["system"] == "rigid_body, dimension 3; 6 systems, one for each member" and lines["members"] == "6"
    assert lines["swept"] == "system.parameters.inertia[2], initial.x[0]"
    found = files.plan(READY_MADE + FORCES + EVENTS)
    assert "broken by forces (Poisson map: LinearDamping" in found["keeps"]
    evaluated = READY_MADE.replace(SPAN, f"t_span = [0, 30]\nstep = 0.01\nt_eval = {SUMS}")
    assert files.plan(evaluated)["steps"] == "3000 of 0.01, from t = 0 to 30"
