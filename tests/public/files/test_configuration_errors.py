"""Errors of configuration files: one line each with the key and what was given, before anything runs."""

import json
import os
import pickle
import tomllib
import warnings
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from command import command
from configuration_files import BRACKETS, OWN, READY_MADE, changed
from guards import bounded_work

CASIMIRS = '[casimirs]\n"|x|^2" = "x1^2 + x2^2 + x3^2"\n'
NAMED = OWN.replace(f"dim = 3\n{BRACKETS}", 'name = "A3,7"\nparameters = {a = 2.0}').replace(CASIMIRS, "")
M, X, STEP = "M = [1.0, 0.5, 0.25]", "x = [1.0, 0.1, 0.5]", "step = 0.1"
SCHEME = 'name = "Splitting"\norder = 4'
MANY = "x = [[1.0, 0.1, 0.5], [0.2, 1.0, 0.3]]"
MATRICES = (
    "matrices = [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], "
    "[[0, -1, 0], [1, 0, 0], [0, 0, 0]]]"
)
BY_MATRICES = OWN.replace("dim = 3", 'basis = ["a", "b", "c"]').replace(BRACKETS, MATRICES).replace(CASIMIRS, "")
FORCED = READY_MADE + '[[forces]]\nname = "LinearDamping"\nrate = [0.1, 0.2, 0.3]\n'
FORCED += '[[forces]]\nname = "Torque"\ntorque = [0.0, 0.0, 0.05]\n'
GRID = "{ linear = [0, 1], count = 100000 }"
EVENTS = READY_MADE + '[events.flip]\ng = "x2"\n[events.far]\ng = "x1"\ndirection = 1\ncount = 2\nterminal = true\n'
FLUID = (
    'system = {name = "sphere_euler", parameters = {N = 4}}\nrun = {t_span = [0, 1], step = 0.125}\n'
    "initial = INITIAL\nmethod = {name = 'IsospectralGauss'}\n"
)
RANDOM = 'kind = "random", seed = 1'


def ready(old, new=""):
    return changed(READY_MADE, (old, new))


def own(old, new=""):
    return changed(OWN, (old, new))


def hamiltonian(lines):
    return own(M, lines)


def fluid(initial, more=""):
    return FLUID.replace("INITIAL", initial) + more


TWO_SAMPLES = "samples = 2\nseed = 1"


def swept(over, beside=""):
    return f"{READY_MADE}[sweep]\n{beside}\n[sweep.over]\n{over}\n"


# The text, its key, what else the line says, and True where the schema refuses it too (others no schema can tell).
REFUSED = {
    # Ready-made systems.
    "a misspelled key": (ready("step", "stpe"), "run.stpe", ("'step'",), True),
    "a misspelled table": (ready("[initial]", "[intial]"), "intial", ("'initial'",), True),
    "an unknown key": (ready(STEP, f"{STEP}\nqqq = 1"), "run.qqq", ("known here: accuracy, save_every",), True),
    "a central coordinate of 2": (
        FLUID.split("\n")[1] + "\nsystem.name = 'satellite'\ninitial.x = [0, 0, 1, 0, 1, 0, 1, 0, 0, 2]",
        "initial.x",
        ("z of satellite must be 1",),
    ),
    "no step": (ready(STEP), "run", ("step is missing", "accuracy"), True),
    "a step and an accuracy": (ready(STEP, f"{STEP}\naccuracy = 1e-8"), "run", ("step and accuracy",)),
    "an accuracy of one": (ready(STEP, "accuracy = 1.0"), "run.accuracy", ("1.0",), True),
    "an accuracy beyond rounding": (ready(STEP, "accuracy = 1e-19"), "run.accuracy", ("1e-19",)),
    "a step backward": (ready(STEP, "step = -0.1"), "run.step", ("-0.1",), True),
    "a step of zero": (ready(STEP, "step = 0"), "run.step", ("0",), True),
    "a step without end": (ready(STEP, "step = inf"), "run.step", ("inf", "finite")),
    "a step that does not divide": (ready(STEP, "step = 0.3"), "run", ("0.3", "1.0")),
    "a time beyond its rounding": (
        ready("t_span = [0, 1]\nstep = 0.1", "t_span = [0, 30.0000000003]\nstep = 0.01"),
        "run", ("0.01", "30.0000000003")),
    "a broken save_every": (ready(STEP, f"{STEP}\nsave_every = 2.0"), "run.save_every", ("2.0",)),
    "save_every of zero": (ready(STEP, f"{STEP}\nsave_every = 0"), "run.save_every", ("0",), True),
    "a number as a flag": (ready(STEP, f"{STEP}\nwatch = 1"), "run.watch", ("1",), True),
    "three times": (ready("[0, 1]", "[0, 1, 2]"), "run.t_span", ("[0, 1, 2]",), True),
    "a time that is no number": (ready("[0, 1]", "[0, nan]"), "run.t_span", ("nan",)),
    "a time of output outside": (ready(STEP, f"{STEP}\nt_eval = [11]"), "run", ("t_eval[0]", "11")),
    "times of output backward": (ready(STEP, f"{STEP}\nt_eval = [0.5, 0.25]"), "run", ("t_eval[1]", "0.25")),
    "times and a stride": (ready(STEP, f"{STEP}\nt_eval = [0.5]\nsave_every = 2"), "run", ("save_every", "t_eval")),
    "one time of output": (ready(STEP, f"{STEP}\nt_eval = 3"), "run.t_eval", ("3",), True),
    "no times of output": (ready(STEP, f"{STEP}\nt_eval = []"), "run.t_eval", ("[]",)),
    "a short state": (ready(X, "x = [1.0, 0.1]"), "initial.x", ("(2,)",)),
    "ragged states": (ready(X, "x = [[1.0, 0.1, 0.5], [1.0]]"), "initial.x", ("same length",)),
    "a flag in a state": (ready(X, "x = [1.0, true, 0.5]"), "initial.x", ("list of numbers",), True),
    "no state": (ready(X, "attitude = true"), "initial.x", ("missing",), True),
    "a state and its kind": (ready(X, f"{X}\nkind = 'random'"), "initial.kind", ("rigid_body",), True),
    "parameters of a state": (ready(X, f"{X}\nparameters = {{seed = 1}}"), "initial.parameters", ()),
    "an unknown attitude": (ready(X, f'{X}\nattitude = "rotation"'), "initial.attitude", ("'coadjoint'",), True),
    "a small attitude": (ready(X, f"{X}\nattitude = [[1.0]]"), "initial.attitude", ("(1, 1)",)),
    "an unknown system": (ready('"rigid_body"', '"rigidbody"'), "system", ("'rigidbody'", "'rigid_body'"), True),
    "a parameter of no system": (
        ready("inertia =", "inertias ="), "system.parameters.inertias", ("'inertia'",), True),
    "the type of a parameter": (ready("[1.0, 2.0, 2.5]", "'heavy'"), "system", ("heavy",), True),
    "a sign of a ready-made system": (ready("[system]", "sign = -1\n[system]"), "sign", ("'rigid_body'",), True),
    "a name of a ready-made system": (ready("[system]", 'name = "a"\n[system]'), "name", ("[algebra]",), True),
    "an unknown scheme": (ready('"Splitting"', '"Spliting"'), "method", ("'Spliting'", "'Splitting'"), True),
    "a parameter of no scheme": (ready("order", "oder"), "method.oder", ("'order'",), True),
    "an order": (ready("order = 4", "order = 3"), "method", ("1, 2, 4, 6, 8 and 10", "not 3"), True),
    "parts that do not commute": (ready("order = 4", "parts = [[0, 1], [2]]"), "method", ()),
    "a scheme without a name": (ready('name = "Splitting"'), "method", ("'order': 4",), True),
    "a scheme without its base": (ready(SCHEME, 'name = "Projected"'), "method", ("base",), True),
    "a parameter given twice": (ready("order = 4", "order = 2\nparameters = {order = 4}"), "method", ("order",)),
    "a parameter of an inner scheme": (
        ready(SCHEME, 'name = "Projected"\nbase = {name = "Splitting", s = 1}'), "method", ("'s'",), True),
    "a broken line": (ready(STEP, "step ="), "", ("line 13, column 7",)),
    "a key given twice": (ready(STEP, f"{STEP}\n{STEP}"), "", ("line 14, column 11",)),
    "the format of a file": (READY_MADE + "[output]\nfile = 'run.csv'\n", "output.file", ("run.csv", ".nc"), True),
    # Workers, archives, forces and events.
    "workers for one state": (ready(STEP, f"{STEP}\nworkers = 2"), "run.workers", ("one state",)),
    "workers and times": (
        changed(READY_MADE, (X, MANY), (STEP, f"{STEP}\nworkers = 2\nt_eval = [0.5]")), "run.workers", ("t_eval",)),
    "no workers": (changed(READY_MADE, (X, MANY), (STEP, f"{STEP}\nworkers = 0")), "run.workers", ("0",), True),
    "times in an archive": (
        READY_MADE + "t_eval = [0.5]\n[output]\narchive = 'a.zarr'\n", "output.archive", ("t_eval",)),
    "an unknown force": (FORCED.replace('"Torque"', '"Torqe"'), "forces[1]", ("'Torque'",), True),
    "a parameter of no force": (FORCED.replace("rate", "rtae"), "forces[0]", ("'rate'",), True),
    "a short rate": (FORCED.replace("0.2, 0.3]", "0.2]"), "forces", ("LinearDamping", "(2,)")),
    "a force without a name": (FORCED.replace('name = "Torque"', ""), "forces[1]", (), True),
    "a force without its rate": (READY_MADE + '[[forces]]\nname = "LinearDamping"\n', "forces[0]", ("rate",), True),
    "one force as a table": (READY_MADE + '[forces]\nname = "Torque"\n', "forces", (), True),
    "a force that is a function": (
        READY_MADE + '[[forces]]\nname = "OwnForce"\nfunction = "abs"\n', "forces[0]", (), True),
    "a coordinate of no event": (EVENTS.replace('"x2"', '"y2"'), "events.flip", ("y2",)),
    "an event of a number": (EVENTS.replace('"x2"', "3"), "events.flip", ("3",)),
    "a direction": (EVENTS.replace("direction = 1", "direction = 2"), "events.far", ("2",), True),
    "a count": (EVENTS.replace("count = 2", "count = 0"), "events.far.count", ("0",), True),
    "a key of no event": (EVENTS.replace("terminal =", "terminall ="), "events.far.terminall", ("'terminal'",), True),
    # Algebras and Hamiltonians.
    "two systems": (OWN + "[system]\nname = 'rigid_body'\n", "algebra", ("'rigid_body'",), True),
    "no Lie algebra": (own('[e3, e1] = e2"', '[e1, e3] = e1"'), "algebra.brackets", ("Jacobi", "(e1, e2, e3)")),
    "a bracket given twice": (own("[e3, e1] = e2", "[e2, e1] = e3"), "algebra.brackets", ("e2 and e1",)),
    "names and a number": (own("dim = 3", 'dim = 2\nbasis = ["a", "b", "c"]'), "algebra.basis", ("3", "2")),
    "no dimension": (own("dim = 3\n"), "algebra.dim", ("missing",), True),
    "parameters of brackets": (own("dim = 3", "dim = 3\nparameters = {a = 1}"), "algebra.parameters", (), True),
    "a name and brackets": (own("dim = 3", 'name = "so(3)"\ndim = 3'), "algebra.name", ("brackets",), True),
    "no brackets": (own(BRACKETS, "parameters = {}"), "algebra.parameters", ("brackets",), True),
    "an unknown algebra": (changed(OWN, (f"dim = 3\n{BRACKETS}", "name = 'so(x)'")), "algebra", ("so(x)",), True),
    "what an algebra needs": (changed(OWN, (f"dim = 3\n{BRACKETS}", "name = 'A3,7'")), "algebra", ("'a'",), True),
    "a sign of two": (own("sign = -1", "sign = 2"), "hamiltonian", ("sign is 2",), True),
    "a flag as a sign": (own("sign = -1", "sign = true"), "sign", ("True",), True),
    "another dimension": (own("dim = 3", "dim = 4"), "hamiltonian", ("3", "4")),
    "an empty energy": (own(M), "hamiltonian.M", ("linear", "formula")),
    "a matrix and a polynomial": (hamiltonian(f'{M}\npolynomial = "x1"'), "hamiltonian.M", ("polynomial",)),
    "a short matrix": (hamiltonian("M = [1.0, 0.5]"), "hamiltonian", ("2", "3")),
    "a flag as a matrix": (hamiltonian("M = true"), "hamiltonian.M", ("number",), True),
    "a broken polynomial": (hamiltonian('polynomial = "x1^^2"'), "hamiltonian.polynomial", ("'x1^^2'",)),
    "a coordinate beyond": (hamiltonian('polynomial = "x4"'), "hamiltonian.polynomial", ("x4",)),
    "an unknown name": (hamiltonian('formula = "x1 + d"'), "hamiltonian.formula", ("'d'",)),
    "a formula over zero": (hamiltonian('formula = "x1/0"'), "hamiltonian.formula", ("'x1/0'", "zero")),
    "code": (hamiltonian('formula = "__import__(1)*x1"'), "hamiltonian.formula", ("'__import__'",)),
    "a formula and a matrix": (hamiltonian('formula = "x1"\nM = 1.0'), "hamiltonian.M", ("formula",)),
    "parameters of a matrix": (hamiltonian("M = 1.0\nparameters = {a = 1}"), "hamiltonian.parameters", ("M",)),
    "a coordinate as a parameter": (
        hamiltonian('formula = "x1"\nparameters = {x1 = 1}'), "hamiltonian.parameters.x1", ("coordinate",)),
    "a list as a parameter": (hamiltonian('formula = "a*x1"\nparameters = {a = [1]}'), "hamiltonian.parameters.a", ()),
    "an unknown observable": (OWN + '[observe]\nspeed = "v1"\n', "observe.speed", ("'v1'",)),
    "matrices that do not close": (
        BY_MATRICES.replace("[0, 1, 0]]", "[0, 1, 1]]", 1), "algebra.matrices", ("[a, b]", "3")),
    "text in a matrix": (BY_MATRICES.replace("[0, 1, 0]]", '[0, 1, "x"]]', 1), "algebra.matrices[0][2][2]", ("'x'",)),
    "more matrices": (BY_MATRICES.replace("basis =", "dim = 4\nbasis ="), "algebra.dim", ("matrices",)),
    "fewer names": (BY_MATRICES.replace('["a", "b", "c"]', '["a", "b"]'), "algebra.matrices", ("3 names",)),
    "matrices and brackets": (
        BY_MATRICES.replace("matrices =", 'brackets = ["[a, b] = c"]\nmatrices ='), "algebra.brackets", ("matrices",)),
    "matrices and a name": (BY_MATRICES.replace("basis =", 'name = "so(3)"\nbasis ='), "algebra.name", ("matrices",)),
    # States of fluids and of files.
    "an unknown kind": (fluid('{kind = "radnom", seed = 1}'), "initial.kind", ("'radnom'", "'random'"), True),
    "a method that is no state": (fluid('{kind = "spectrum"}'), "initial.kind", ("'spectrum'",), True),
    "a parameter of no state": (fluid('{kind = "random", sed = 1}'), "initial.sed", ("'seed'",)),
    "no seed": (fluid('{kind = "random"}'), "initial", ("'seed'",)),
    "a negative seed": (fluid('{kind = "random", seed = -1}'), "initial", ("seed",)),
    "degrees beyond": (fluid(f"{{{RANDOM}, degrees = [2, 90]}}"), "initial", ("degrees[1]",)),
    "a file that is not there": (fluid('{kind = "from_file", path = "none.npy"}'), "initial", ("none.npy",)),
    "a kind of a number": (fluid("{kind = 3}"), "initial.kind", ("3",), True),
    "a parameter without a kind": (fluid("{seed = 1}"), "initial.seed", (), True),
    "a kind for a body": (ready(X, 'kind = "random"\nseed = 1'), "initial.kind", ("rigid_body",)),
    "a kind for an own algebra": (own(X, 'kind = "random"\nseed = 1'), "initial.kind", ("mine", "x")),
    "the attitude of a fluid": (fluid(f'{{{RANDOM}, attitude = "yes"}}'), "initial.attitude", ()),
    "a missing array": (fluid('{x = "none.npy"}'), "initial.x", ("none.npy",)),
    "a file of another format": (fluid('{x = "run.txt"}'), "initial.x", (), True),
    "no array": (fluid('{x = "text.npy"}'), "initial.x", ("text.npy",)),
    "an array of objects": (fluid('{x = "objects.npy"}'), "initial.x", ("objects.npy",)),
    "an array of flags": (ready(X, 'x = "flags.npy"'), "initial.x", ("flags.npy",)),
    "no matrix of the algebra": (fluid('{x = "ones.npy"}'), "initial.x", ("su(4)",)),
    "a matrix of another size": (fluid("{x = [[1.0, 0.0], [0.0, 1.0]]}"), "initial.x", ("shape",)),
    "an observable of matrices": (fluid(f"{{{RANDOM}}}", 'observe = {a = "x1"}'), "observe.a", ()),
    "a scheme for vectors": (
        fluid(f"{{{RANDOM}}}").replace("IsospectralGauss", "Splitting"), "method", ("sphere_euler",)),
    # Sweeps.
    "no sweep": (swept(""), "sweep.over", ("at least 1",)),
    "an entry beyond": (swept('"initial.x[3]" = [1.0]'), "sweep.over.initial.x[3]", ("entry 3",)),
    "no settings": (swept('"initial.x[0]" = []'), "sweep.over.initial.x[0].values", ("at least 1",)),
    "a misspelled grid": (
        swept('"initial.x[0]" = { linaer = [0, 1], count = 2 }'),
        "sweep.over.initial.x[0].linaer", ("'linear'",), True),
    "a grid without a count": (swept('"initial.x[0]" = { linear = [0, 1] }'), "sweep.over.initial.x[0]", ("count",)),
    "a grid of one": (
        swept('"initial.x[0]" = { linear = [0, 1], count = 1 }'), "sweep.over.initial.x[0].count", ("1",)),
    "two kinds": (
        swept('"initial.x[0]" = { linear = [0, 1], uniform = [0, 1] }'),
        "sweep.over.initial.x[0]", ("linear", "uniform")),
    "none of the kinds": (swept('"initial.x[0]" = {}'), "sweep.over.initial.x[0]", ("values, linear",)),
    "a logarithm of zero": (
        swept('"initial.x[0]" = { logarithmic = [0, 1], count = 3 }'), "sweep.over.initial.x[0]", ("[0, 1]",)),
    "an end that is no number": (
        swept('"initial.x[0]" = { linear = [0, nan], count = 3 }'), "sweep.over.initial.x[0]", ("nan",)),
    "a huge grid": (
        swept('"initial.x[0]" = { linear = [0, 1], count = 1000000000000 }'),
        "sweep.over.initial.x[0]", ("1000000000000",)),
    "a setting of text": (swept('"initial.x[0]" = ["a"]'), "initial.x", ("list of numbers",)),
    "ragged settings": (swept('"initial.x" = [[1.0, 2.0, 3.0], [1.0, 2.0]]'), "initial.x", ("(2,)", "member 1")),
    "ends in the wrong order": (
        swept('"initial.x[0]" = { uniform = [3, 1] }', TWO_SAMPLES), "sweep.over.initial.x[0]", ("[3, 1]", "smaller")),
    "ends too far apart": (
        swept('"initial.x[0]" = { uniform = [-1e308, 1e308] }', TWO_SAMPLES), "sweep.over.initial.x[0]", ("distance",)),
    "a number rounded to zero": (ready(STEP, "step = 1e-400"), "", ("1e-400", "too small")),
    "a number of many digits": (ready(STEP, "step = 0.1" + "0" * 400), "", ("digits", "402")),
    "an infinite setting": (
        swept('"initial.x" = [[1.0, 2.0, 3.0], [1.0, inf, 1.0]]'), "initial.x", ("inf", "member 1")),
    "members of members": (swept('"initial.x" = [[[1.0, 2.0, 3.0], [1.0, 0.0, 0.0]]]'), "initial.x", ("(2, 3)",)),
    "an unknown swept key": (swept('"initial.y" = [1.0]'), "initial.y", ("known here",)),
    "a swept attitude": (swept('"initial.attitude" = [true]'), "sweep.over.initial.attitude", ("same",)),
    "a swept kind": (swept('"initial.kind" = ["random"]'), "sweep.over.initial.kind", ("same",)),
    "a swept step": (swept('"run.step" = [0.1]'), "sweep.over.run.step", ("system.parameters",)),
    "no key": (swept('"initial.x[0" = [1]'), "sweep.over.initial.x[0", ("no key",)),
    "a state and its entry": (
        swept('"initial.x" = [[1.0, 0, 0]]\n"initial.x[0]" = [2.0]'), "sweep.over.initial.x[0]", ("initial.x",)),
    "an entry of a number": (swept('"initial.x[0][1]" = [1.0]'), "sweep.over.initial.x[0][1]", ("entry 1",)),
    "a wrong parameter of a member": (
        swept('"system.parameters.inertia[2]" = [3.0, -1.0]\n"initial.x[0]" = [1, 2, 3]'),
        "system", ("inertia[2]", "-1", "member 3")),
    "a misspelled parameter": (
        swept('"system.parameters.inertai" = [3.0]'), "system.parameters.inertai", ("'inertia'",)),
    "no force to sweep": (swept('"forces[0].rate" = [0.1]'), "sweep.over.forces[0].rate", ("entry",)),
    "a file of settings": (swept('"initial.x" = { file = "run.toml" }'), "sweep.over.initial.x", ("run.toml",)),
    "a column beyond": (
        swept('"initial.x[0]" = { file = "table.npy", column = 3 }'), "sweep.over.initial.x[0]", ("(2, 3)",)),
    "an empty file": (swept('"initial.x" = { file = "empty.npy" }'), "sweep.over.initial.x", ("(0, 3)",)),
    "a number in a file": (swept('"initial.x" = { file = "one.npy" }'), "sweep.over.initial.x", ("()",)),
    "a column without a file": (
        swept('"initial.x[0]" = { values = [1.0], column = 0 }'), "sweep.over.initial.x[0]", ("column",)),
    "random settings without samples": (
        swept('"initial.x[0]" = { uniform = [0, 1] }'), "sweep", ("initial.x[0]", "samples")),
    "samples without a seed": (swept('"initial.x" = { sphere = 1.0 }', "samples = 2"), "sweep", ("seed",)),
    "samples without random settings": (
        swept('"initial.x[0]" = [1.0]', "samples = 2\nseed = 1"), "sweep", ("samples",)),
    "no samples": (swept('"initial.x" = { sphere = 1.0 }', "samples = 0\nseed = 1"), "sweep.samples", ("0",), True),
    "a negative seed of samples": (
        swept('"initial.x" = { sphere = 1.0 }', "samples = 2\nseed = -1"), "sweep.seed", ("-1",), True),
    "a seed beyond its range": (
        swept('"initial.x" = { sphere = 1.0 }', f"samples = 2\nseed = {2**63}"), "sweep.seed", ()),
    "a sphere of size zero": (
        swept('"initial.x" = { sphere = 0 }', "samples = 2\nseed = 1"), "sweep.over.initial.x.sphere", ("0",), True),
    "a sphere of one number": (
        swept('"initial.x[0]" = { sphere = 1.0 }', "samples = 2\nseed = 1"), "sweep.over.initial.x[0]", ("sphere",)),
    "an orbit of parameters": (
        swept('"system.parameters.inertia" = { orbit = 1.0 }', "samples = 2\nseed = 1"),
        "sweep.over.system.parameters.inertia", ("orbit",)),
    "ends of another shape": (
        swept('"initial.x" = { uniform = [[0, 1], 2] }', "samples = 2\nseed = 1"), "sweep.over.initial.x", ()),
    "samples beyond memory": (
        swept('"initial.x" = { sphere = 1.0 }', "samples = 1000000000000\nseed = 1"),
        "sweep.over.initial.x", ("1000000000000",)),
    "members beyond memory": (
        swept(f'"initial.x[0]" = {GRID}\n"initial.x[1]" = {GRID}'), "sweep.over", ("10000000000 members",)),
    "random states of no shape": (
        swept('"initial.x" = { sphere = 1.0 }', "samples = 2\nseed = 1").replace(f"{X}\n", ""),
        "sweep.over.initial.x", ("initial.x is missing",)),
}  # fmt: skip


def has_key(line, key):
    """Whether a line begins with a key, or with the table in which it is; lines about TOML have no key."""
    shown = line.partition(": ")[0]
    return not key or key.startswith(shown) or shown.startswith(key)


SCHEMA = Path(__file__).parents[3] / "docs" / "configuration.schema.json"


@pytest.fixture(scope="module")
def validator():
    return jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", REFUSED)
def test_an_error_is_one_line_with_its_key(files, validator, name):
    text, key, said, *by_schema = REFUSED[name]
    np.save("objects.npy", np.array([None]), allow_pickle=True)
    arrays = {"table": np.ones((2, 3)), "empty": np.ones((0, 3)), "one": np.ones(()), "ones": np.ones((4, 4))}
    for each, array in (arrays | {"flags": np.array([True, False, True])}).items():
        np.save(f"{each}.npy", array)
    Path("text.npy").write_text("no array")
    (line,) = files.refusals(text)
    assert has_key(line, key), line
    assert [part for part in said if part.casefold() not in line.casefold()] == [], line
    if by_schema:
        assert not validator.is_valid(tomllib.loads(text))


# Hostile files: bounded work, and one short line.

NINES, HEXADECIMAL = "9" * 5000, "0x" + "f" * 5000
OVER = "Composition"


def parameter(value):
    return NAMED.replace("2.0}", f"{value}}}")


def polynomial(text):
    return hamiltonian(f"polynomial = {text}")


def nested(coefficients, depth):
    scheme = f"name = 'Composition', coefficients = {coefficients}"
    lines = (
        scheme.replace(", c", "\nc")
        + "\nbase = "
        + f"{{{scheme}, base = " * depth
        + "{name = 'Splitting'}"
        + "}" * depth
    )
    return ready(SCHEME, lines)


HOSTILE = {
    "lists in lists": (own(X, "x = " + "[" * 2000 + "]" * 2000), "", "nested"),
    "tables in tables": (
        ready("order = 4", "order = " + "{a=" * 2000 + "1" + "}" * 2000), "", "nested"),
    "some lists": (own(X, "x = " + "[" * 200 + "]" * 200), "initial.x", "list of numbers"),
    "lists that do not end": (own("x = [1.0", "x = " + "[" * 50000 + "1.0"), "", "nested"),
    "a key of 65 parts": (OWN + ".".join("a" * 65) + " = 1", "", "64 parts"),
    "a key of 64 parts": (OWN + ".".join("a" * 64) + " = 1", "run", "unknown key"),
    "brackets in text": ('a = "' + "[" * 500 + '"\nb = ' + "[" * 2000 + "\n" + "]" * 2000, "", "nested"),
    "digits": (own(STEP, f"step = {NINES}"), "", "digits"),
    "hexadecimal dim": (own("dim = 3", f"dim = {HEXADECIMAL}"), "algebra.dim", ""),
    "hexadecimal step": (own(STEP, f"step = {HEXADECIMAL}"), "run.step", ""),
    "hexadecimal order": (ready("order = 4", f"order = {HEXADECIMAL}"), "method", ""),
    "hexadecimal parameter": (parameter(HEXADECIMAL), "algebra", ""),
    "large parameter": (parameter("1e308"), "algebra", ""),
    "date": (parameter("1979-05-27"), "algebra", ""),
    "inertia": (ready("[1.0, 2.0, 2.5]", HEXADECIMAL), "system", ""),
    "inertia that cannot be inverted": (ready("[1.0, 2.0, 2.5]", "[1.0, 1.0, 5e-324]"), "system", ""),
    "algebra beyond memory": (NAMED.replace("A3,7", "so(n)").replace("a = 2.0", "n = 100000"), "algebra", "so(100000)"),
    "long inertia": (ready("[1.0, 2.0, 2.5]", f"[{'1.0,' * 10000}]"), "system", "(10000,)"),
    "dimension": (own("dim = 3", "dim = 1000000000000"), "algebra.dim", "1000000000000"),
    "dimension of another state": (own("dim = 3", "dim = 1000"), "hamiltonian", "1000"),
    "degree": (polynomial('"x1^4000000000"'), "hamiltonian.polynomial", "degree 4000000000"),
    "digits of a degree": (polynomial(f'"x1^{NINES}"'), "hamiltonian.polynomial", "5000 digits"),
    "degree of a product": (
        polynomial('"x1^1000*x2^25"'), "hamiltonian.polynomial", "degree 1025"),
    "degree in a list": (polynomial("[[1, [1000, 25, 0]]]"), "hamiltonian.polynomial", "1025"),
    "degree of a Casimir": (own("x1^2 + x2^2", "x1^5000000 + x2^2"), "casimirs.|x|^2", "5000000"),
    "coordinate": (polynomial(f'"x{NINES}"'), "hamiltonian.polynomial", "x999"),
    "coefficient": (polynomial(f'"{NINES}*x1"'), "hamiltonian.polynomial", "5000 digits"),
    "coefficient in a list": (polynomial(f"[[{HEXADECIMAL}, [1, 0, 0]]]"), "hamiltonian.polynomial", "coefficient"),
    "product of coefficients": (polynomial(f'"{"*".join(["9" * 300] * 800)}"'), "hamiltonian.polynomial", "too large"),
    "denominators": (polynomial(f'"{"*".join(["1/" + "9" * 300] * 450)}"'), "hamiltonian.polynomial", "too large"),
    "quotient": (polynomial('"1e300/1e-300*x1"'), "hamiltonian.polynomial", "too large"),
    "many terms": (polynomial(f'"{"x1 + " * 20000}y"'), "hamiltonian.polynomial", "'y'"),
    "nested exponents": (polynomial("[[1, [[2], 0, 0]]]"), "hamiltonian.polynomial", "exponents"),
    "constant": (own("= e3", f"= {NINES} e3"), "algebra.brackets", "5000 digits"),
    "sum of constants": (own("= e3", "= 1e308 e3 + 1e308 e3"), "algebra.brackets", "1e308"),
    "long bracket": (own("= e3", "= " + "e3 " * 50000), "algebra.brackets", "e3 e3"),
    "long key": (OWN + "a" * 10**5 + " = 1", "run.aaaaa", ""),
    "long names": (OWN + f'[observe]\n"{"a" * 10**5}" = "x9"', "observe.aaaaa", ""),
    "long value": (own(X, f'x = "{"a" * 10**5}"'), "initial.x", "list of numbers"),
    "key in two lines": (OWN + '"a\\nb\\u001b[31m" = 1', "run.a b?[31m", "unknown key"),
    "name with NUL": (own('"mine"', '"a\\u0000"'), "name", "printable"),
    "Casimir with NUL": (own('"|x|^2"', '"a\\u0000"'), "casimirs.a?", "printable"),
    "a long name": (own('"mine"', f'"{"a" * 201}"'), "hamiltonian", "name of a system"),
    "schemes in schemes": (nested("[0.5, 0.25, 0.25]", 60), "method", ""),
    "coordinate of a part": (ready("order = 4", "parts = [[0, 100000000000000000000], [1], [2]]"), "method", ""),
    "saved states": (own(STEP, "step = 1e-14"), "run.save_every", "save_every="),
    "long file name": (OWN + f'[output]\nfile = "{"a" * 300}.nc"', "output.file", "aaaaa"),
    "long folder": (OWN + f'[output]\nfigure = "{"a/" * 10**5}.png"', "output.figure", "a/a"),
    "file name with NUL": (OWN + '[output]\nfile = "a\\u0000.nc"', "output.file", "cannot be written"),
    "a parameter called name": (NAMED.replace("a = 2.0", "a = 2.0, name = 1"), "algebra.parameters", "name"),
    "a parameter of no system": (ready("rigid_body", "no_body").replace("inertia", "name"), "system", "unknown"),
    "a size beyond float64": (
        swept(f'"initial.x" = {{sphere = {HEXADECIMAL}}}', "samples = 2\nseed = 1"), "sweep.over.initial.x.sphere", ""),
    "an orbit of huge exponents": (
        swept('"initial.x" = {orbit = 1e5}', "samples = 2\nseed = 1"), "initial.x", "exponents"),
    "long line": ("a" * 10**5, "", "expected '='"),
    "text that does not end": ('a = """' + "b" * 10**5, "", "unterminated string"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_bounded_time(files, name):
    text, key, said = HOSTILE[name]
    with bounded_work():
        line = files.refused(text, by="run")
    assert has_key(line, key) and said.casefold() in line.casefold() and len(line) < 420, line


def test_numbers_within_the_limits_are_read(files):
    """Degrees up to 1024, and the largest coefficients; the limits are among the hostile files."""
    largest = int(1.7976931348623157e308)
    for text in (f"1/{largest}*x1^2*1/2", f"{largest}*x1*x2^0", "1e-300*x1^1000*x2^24", "[[0, [1000, 24, 0]]]"):
        files.plan(polynomial(text if text[0] == "[" else f'"{text}"'), (X, "x = [0.0, 0.1, 0.5]"), (CASIMIRS, ""))
    files.plan(own('"mine"', f'"{"a" * 200}"'))
    files.plan(swept('"initial.x" = { sphere = 1.0 }', f"samples = 2\nseed = {2**63 - 1}"))


def test_other_bytes_and_longer_files_are_refused(files):
    Path("other.toml").write_bytes(b"x = \xff")
    for name, said in (("other.toml", "position 4"), ("none.toml", "No such file"), (".", "directory")):
        found = command(files.capsys, "check", name)
        assert (found.status, found.out) == (2, "") and said in found.err and found.err.startswith(f"{name}: ")
    Path("marked.toml").write_bytes(b"\xef\xbb\xbf" + READY_MADE.replace("\n", "\r\n").encode())
    assert command(files.capsys, "check", "marked.toml").status == 0
    with Path("long.toml").open("wb") as file:
        file.truncate(2**28 + 1)
    assert f"longer than {2**28}" in command(files.capsys, "check", "long.toml").err


# Files with several errors: one line each.

MANY_ERRORS = """
[system]
name = "heavy_top"
[system.parameters]
inertai = [1.0, 2.0, 3.0]
[initial]
x = [0.3, 0.2, 3.0, 0.6, 0.0]
[method]
name = "Splitting"
odrer = 4
[run]
t_span = [0, 10]
stepp = 0.3
save_evry = 10
[observe]
area = "x1*x9"
[events.flip]
g = "m9 + 1"
[output]
figur = "a.png"
"""
REPORTED = {
    "system": "'inertia'", "method": "'order'", "run.stepp": "'step'", "run.save_evry": "'save_every'",
    "output.figur": "'figure'",
}  # fmt: skip


@pytest.mark.parametrize("by", ["run", "check", "certify"])
def test_errors_of_all_tables_are_reported_together(files, by):
    found = dict(line.split(": ", 1) for line in files.refusals(MANY_ERRORS, by=by))
    assert found.keys() == REPORTED.keys() and all(said in found[key] for key, said in REPORTED.items())


@pytest.mark.parametrize(
    ("table", "wrong", "reported"),
    [
        ("initial", 'x = "one"', ["initial.x", "method", "run"]),
        ("run", 't_span = "late"\nstep = 0.3', ["method", "run.t_span"]),
        ("system", "name = 3", ["method", "run", "system.name"]),
        ("system", 'name = "rigid_bodi"', ["method", "run", "system"]),
        ("output", "file = 3", ["method", "output.file", "run"]),
    ],
)
def test_an_invalid_table_hides_no_error_in_others(files, table, wrong, reported):
    tables = {"system": 'name = "rigid_body"', "initial": "x = [1.0, 0.1]", "method": 'name = "Spliting"'}
    tables |= {"run": "t_span = [0, 10]\nstep = 0.3", table: wrong}
    # States, observables and events need the system, and are read if the tables are valid.
    lines = files.refusals("\n".join(f"[{key}]\n{content}" for key, content in tables.items()), by="run")
    assert sorted(line.split(": ")[0] for line in lines) == reported


def test_misspelled_keys_are_not_missing_and_errors_of_a_sweep_come_first(files):
    assert "'t_span'" in files.refused(ready("t_span", "t_spam"))
    lines = files.refusals(swept('"system.nam" = [1.0]\n"run.step" = [0.1]').replace("Splitting", "Spliting"))
    assert [line.split(": ")[0] for line in lines] == ["sweep.over.system.nam", "sweep.over.run.step"]
    lines = files.refusals(READY_MADE + "".join(f"key{k} = {k}\n" for k in range(30)))
    assert len(lines) == len(set(lines)) == 21 and lines[-1] == "10 more"


# The table or the key that the reader is sent to.
MEANT = {
    "[run] x0 = [1.0, 0.1, 0.5]": "[initial] x", "[run] y0 = [1.0, 0.1, 0.5]": "[initial] x",
    "[run] dt = 0.1": "'step'", "[run] t_end = 2.0": "'t_span'", "[run] saveat = [0.5]": "'t_eval'",
    '[run] integrator = "Splitting"': "[method]", "[run] event = 1": "[events]", '[run] file = "a.nc"': "[output] file",
    "[initial] x0 = [1.0, 0.1, 0.5]": "'x'", "[initial] t_span = [0.0, 1.0]": "[run] t_span",
    "step = 0.1": "[run] step", "dt = 0.1": "[run] step", "x0 = [1.0, 0.1, 0.5]": "[initial] x",
}  # fmt: skip


@pytest.mark.thinned(1)
@pytest.mark.parametrize("line", MEANT)
def test_keys_in_other_places_or_under_other_names_are_answered_with_their_place(files, line):
    """Beside the right key: one message."""
    table, _, key = line.rpartition("] ")
    text = ready(f"{table}]\n", f"{table}]\n{key}\n") if table else f"{line}\n{READY_MADE}"
    found = files.refused(text)
    assert found.startswith(f"{table[1:]}.{key.split(' ')[0]}: " if table else f"{key.split(' ')[0]}: ")
    assert MEANT[line] in found, found


# Paths and code.

STATES = READY_MADE.replace("x = [1.0, 0.1, 0.5]", 'x = "{}"')
SWEPT = READY_MADE + '[sweep.over]\n"initial.x" = {{ file = "{}" }}\n'


class Touching:
    """An object that creates a file when it is unpickled."""

    def __reduce__(self):
        return (open, ("executed", "w"))


@pytest.mark.parametrize("text", [STATES, SWEPT], ids=["states", "sweep"])
@pytest.mark.parametrize("kind", ["pickle", "objects"])
def test_pickles_are_not_executed(files, text, kind):
    if kind == "pickle":
        Path("states.npy").write_bytes(pickle.dumps(Touching()))
    else:
        np.save("states.npy", np.array([Touching(), 1.0, 2.0], dtype=object), allow_pickle=True)
    assert "states.npy" in files.refused(text.format("states.npy"), by="run")


@pytest.mark.parametrize("line", ["inertia =", "x =", "step =", 'name = "Splitting"', "order =", 'name = "rigid_body"'])
def test_code_in_text_is_not_executed(files, line):
    (old,) = (each for each in READY_MADE.splitlines() if each.startswith(line))
    code = f"{old.partition(' = ')[0]} = \"__import__('pathlib').Path('executed').touch()\""
    files.refused(ready(old, code), by="run")


def test_paths_are_those_beside_the_file_and_of_the_working_folder(files, monkeypatch):
    """States are read beside the configuration, and output is written in the working folder; nothing is expanded."""
    work, other = files.folder / "work", files.folder / "other"
    work.mkdir()
    other.mkdir()
    np.save(other / "states.npy", [1.0, 0.1, 0.5])
    np.save(work / "near.npy", [1.0, 0.1, 0.5])
    monkeypatch.chdir(work)
    for states, target in (("states.npy", "run.nc"), ("../work/near.npy", "../other/run.nc")):
        files.write(STATES.format(states) + f'[output]\nfile = "{target}"\n', name="other/run.toml")
        assert command(files.capsys, "run", "../other/run.toml", "--quiet").status == 0
    assert sorted(path.name for path in work.iterdir()) == ["near.npy", "run.nc"]
    assert sorted(path.name for path in other.iterdir()) == ["run.nc", "run.toml", "states.npy"]
    monkeypatch.chdir(files.folder)
    monkeypatch.setenv("HOME", str(work))
    for name in ("~/run.nc", "$HOME/run.nc", "`pwd`/run.nc", "missing/../run.nc/x.nc"):
        line = files.refused(READY_MADE + f"[output]\nfile = '{name}'\n", by="run")
        assert line.startswith("output.file: ") and "does not exist" in line


@pytest.mark.skipif(os.name == "nt", reason="links")
def test_links_are_replaced_and_circular_ones_refused(files):
    Path("precious").write_text("precious")
    os.symlink("precious", "run.nc")
    files.run(READY_MADE)
    assert Path("precious").read_text() == "precious" and not Path("run.nc").is_symlink()
    os.symlink("loop.npy", "loop.npy")
    assert "loop.npy" in files.refused(STATES.format("loop.npy"), by="run")


def test_an_array_header_beyond_the_file_is_refused(files):
    np.save("states.npy", np.ones((2, 3)))
    content = Path("states.npy").read_bytes()
    header = content.replace(b"(2, 3)", b"(9" + b"0" * 12 + b", 3)").replace(b" " * 12, b"", 1)
    Path("states.npy").write_bytes(header)
    assert "states.npy" in files.refused(STATES.format("states.npy"), by="run")


def test_unusual_names_are_preserved(files):
    """The longest exceeds the length of file names in a Zarr store."""
    names = ["é|x|²", "", "C" * 200, "C" * 199 + "D", "a.b/c"]
    casimirs = "\n".join(f'"{name}" = "x1^2 + x2^2 + x3^2"' for name in names)
    for out in ("run.nc", "run.zarr"):
        assert list(files.run(own('"|x|^2" = "x1^2 + x2^2 + x3^2"', casimirs), out=out).casimirs) == names


def test_warnings_are_one_line_each(files):
    """Of a step that is too large: printed once, beside the result."""
    files.write(ready("t_span = [0, 1]\nstep = 0.1", "t_span = [0, 200]\nstep = 2.0").replace("1.0, 0.1", "3.0, 3.0"))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        found = command(files.capsys, "run", "run.toml", "--quiet")
    assert found.status == 0 and found.out == ""
    assert found.err.startswith("coadjoint: warning: ") and found.err.count("\n") == 1
