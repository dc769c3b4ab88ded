"""The tables that the explorer reads: every entry that depends on a slider is known by its terms."""

import ctypes
import json
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from explorer_formulas import Formula, energy_formulas, evaluate
from explorer_systems import SHOWN
from write_explorer import OF_MATRICES, SCHEMES, code_of, entry, first_values, rows_of_parts, shared

import coadjoint as co

VECTORS = [shown for shown in SHOWN if not shown.start]
(PLANET,) = (shown for shown in SHOWN if shown.start)


@pytest.fixture
def random():
    return np.random.default_rng(3)


@pytest.mark.parametrize("shown", VECTORS, ids=lambda shown: shown.name)
def test_tables_at_other_values_are_those_of_the_library(shown, random):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        written = entry(shown, random)
    assert set(written["schemes"]) == {name for name, _, _ in SCHEMES}
    assert len(shown.x0) == len(shown.coordinates) == shown.build(first_values(shown)).dim
    assert (written["step"], written["x0"]) == (shown.step, shown.x0)
    dependent = {path for scheme in written["schemes"].values() for path in scheme["moves"]}
    assert bool(dependent) == bool(shown.sliders)
    json.dumps(shared({shown.name: written}))


@pytest.mark.parametrize("shown", VECTORS, ids=lambda shown: shown.name)
def test_first_views_are_smooth_and_show_the_drift(shown):
    """In 20 s at a step a frame the errors of Runge-Kutta become visible, and curves have no visible corners."""
    system, x0 = shown.build(first_values(shown)), np.array(shown.x0)
    found = {}
    for name, scheme, _ in SCHEMES[1:3]:
        method = eval(code_of(scheme, shown), {"co": co})
        sol = co.integrate(system, x0, (0.0, 1200 * shown.step), shown.step, method)
        errors = [np.abs(values - values[0]).max() / np.abs(x0).max() for values in sol.casimirs.values()]
        found[name] = max(errors)
        moves = np.linalg.norm(np.diff(sol.x, axis=0), axis=1) / np.linalg.norm(x0)
        assert np.median(moves) < 0.3
    assert found["splitting4"] < 1e-12 < 1e-4 < found["rk4"] < 0.2


def test_formulas_of_sources():
    assert evaluate("0.5 I1 /", {"I1": 4.0}) == 0.125
    assert evaluate("2 a - 3 *", {"a": 5.0}) == -9.0


def test_formulas_are_evaluated_in_the_order_of_their_operations(random):
    def function(a, b):
        return [3 - a, a - 3, (a + b) * a / 7, 1 / (b * b) - 0.1, -(a + 0 * b) / 1.5, 0 - b * 1, (0 + a) * 0.3]

    values = dict(zip("ab", random.uniform(0.5, 2.0, 2).tolist(), strict=True))
    found = function(Formula("a"), Formula("b"))
    assert [evaluate(one.text, values) for one in found] == function(**values)
    assert (0 * Formula("a"), Formula("a") * 0, 0 / Formula("a")) == (0, 0, 0)


@pytest.mark.parametrize("shown", VECTORS, ids=lambda shown: shown.name)
def test_formulas_of_energies_are_those_of_the_systems(shown, random):
    """By numbers with many digits, at which squares are rounded: to rounding, since the library may use fractions."""
    values = {slider.name: random.uniform(slider.low, slider.high) for slider in shown.sliders}
    x = random.normal(size=(4, len(shown.x0)))
    energies, formulas = [shown.build(one).energy(x) for one in (first_values(shown), values)], energy_formulas(shown)
    change = sum(
        (evaluate(text, values) - evaluate(text, first_values(shown))) * np.prod(x[:, list(key)], axis=1)
        for key, text in formulas.items()
    )
    assert np.allclose(energies[1] - energies[0], change, rtol=0, atol=2.0**-46)
    assert bool(formulas) == bool(shown.sliders)


def test_flows_of_a_typed_algebra_are_those_of_its_splitting():
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 0.0, 0.5]))
    for order in (2, 4):
        program = co.Splitting(order=order, parts="coordinates").flow_table(system).to_mapping()
        rows = rows_of_parts()[f"splitting{order}"][1]
        assert np.array_equal(rows["part"], program["part"]) and np.array_equal(rows["section"], program["section"])
        assert np.array_equal(rows["tau"], program["coefficient"])


def test_a_planet_has_the_modes_of_its_first_state_for_every_size(random):
    written = entry(PLANET, random)
    assert {name: scheme["code"] for name, scheme in written["schemes"].items()} == {
        name: code for name, code, _ in OF_MATRICES
    }
    modes = {(l, m): complex(re, im) for l, m, re, im in written["modes"]}
    for N in (16.0, 32.0, 48.0):
        system = PLANET.build({**first_values(PLANET), "N": N, "lamb": 150.0})
        state = system.from_modes(modes, absolute=False)
        assert np.allclose(state, PLANET.initial(system), rtol=0, atol=1e-8 * np.abs(state).max())


def test_the_numbers_of_a_planet_are_those_of_the_schemes(random):
    """The page appends what depends on the sliders, and the processes of the export leave no addresses."""
    fields = {name: scheme["fields"] for name, scheme in entry(PLANET, random)["schemes"].items()}
    assert fields["isospectral2"]["tables.tables.coefficients"] == [0.5, 1, 0.5]
    a, c = np.array([[3, 3 - 2 * 3**0.5], [3 + 2 * 3**0.5, 3]]) / 12, (0.5 - 3**0.5 / 6, 0.5 + 3**0.5 / 6)
    found = fields["isospectral4"]["tables.tables.coefficients"]
    assert np.allclose(found, [*a.ravel(), 0.5, 0.5, *c], rtol=0, atol=1e-15)
    for stages, one in enumerate(fields.values(), 1):
        assert one["tables.tables.whole"][6:] == [0, 0, 0, stages, 1, 0] and one["tables.step"] == [1]


NATIVE_COMPILER = """#!/bin/sh
# Takes the place of emcc, without the options of WebAssembly.
for option in "$@"; do
    case $option in
    -c) compiles=yes ;;
    *EXPORTED_FUNCTIONS=*) exported=${option#*=} ;;
    esac
done
if [ "$MORE" ]; then
    case "$*" in *" -c "*/src/coadjoint/*) exit ;; esac  # sources of the library, which is built anyway
fi
if [ "$compiles" ]; then
    exec c++ $(echo "$*" | sed "s/-msimd128//") -O0 -fPIC -fvisibility=hidden -w $MORE
fi
echo "$exported" > "$EXPORTED"
if [ "$MORE" ]; then
    exec touch "$FOLDER/public/kernels.wasm"
fi
exec c++ -shared -Wl,-z,defs "$FOLDER"/objects/*.o -o "$FOLDER/public/kernels.wasm"
"""


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("c++"), reason="links with the options of GNU ld")
@pytest.mark.parametrize("links", [False, pytest.param(True, marks=pytest.mark.long)])
def test_the_kernels_of_the_explorer_compile_and_link(tmp_path, links):
    """By the script that builds them, with the compiler of this machine: all that is exported is defined."""
    command = tmp_path / "emcc"
    command.write_text(NATIVE_COMPILER)
    command.chmod(0o755)
    script = Path(__file__).parents[3] / "explorer" / "wasm" / "build.sh"
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "MORE": "" if links else "-fsyntax-only"}
    environment |= {"FOLDER": str(tmp_path), "EXPORTED": str(tmp_path / "exported")}
    done = subprocess.run(["sh", str(script), str(tmp_path)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    names = [name.removeprefix("_") for name in (tmp_path / "exported").read_text().strip().split(",")]
    assert len(names) > 8
    if links:
        library = ctypes.CDLL(str(tmp_path / "public" / "kernels.wasm"))
        assert [name for name in names if not hasattr(library, name)] == []
