"""The list of thresholds is complete: each is probed, tested elsewhere, or said to need no probe.

The files in TOML, one for each layer, list what is not probed here, by file:

- `number`: no threshold, but a code, a version, a seed, or a number in a formula;
- `effort`: bounds and estimates of memory, time and search, and choices between ways to the same result;
- `display`: what is shown, and how much of it;
- `choice`: which scheme, step or trial run is taken; the run that is taken is measured against what was asked for;
- `tested`: by a test, which is named;
- `open`: not probed, for a reason.
"""

import tomllib
from functools import cache
from pathlib import Path

import pytest

from mutants.defects import missing_test
from thresholds.scan import SOURCES, in_cpp, in_python, thresholds
from thresholds.test_probes import PROBES

LISTS, REASONED = ("number", "effort", "display", "choice"), ("tested", "open")


@cache
def listed():
    """The keys of each file with the kind of each entry."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("*.toml")):
        for file, entries in tomllib.loads(path.read_text("utf-8")).items():
            assert not set(entries) - {*LISTS, *REASONED}, (path.name, file)
            own = found.setdefault(file, [])
            own += [(key, kind) for kind in LISTS for key in entries.get(kind, ())]
            own += [(key, kind) for kind in REASONED for keys in entries.get(kind, {}).values() for key in keys]
    for probe in PROBES.values():
        for file, key in set(probe.keys):
            if (key, "probed") not in found.setdefault(file, []):
                found[file].append((key, "probed"))
    return found


FOLDERS = sorted(path.name for path in SOURCES.iterdir() if path.is_dir() and path.name != "__pycache__")


@pytest.mark.parametrize("folder", ["", "C++", *FOLDERS])
def test_every_threshold_is_probed_or_listed(folder):
    """The sources of one folder; files beside the folders have none."""
    wrong = []
    for file in sorted({*thresholds(), *listed()}):
        if folder == ("C++" if file.endswith((".cpp", ".hpp")) else file.rpartition("/")[0].partition("/")[0]):
            found, known = thresholds().get(file, frozenset()), [key for key, _ in listed().get(file, ())]
            if new := sorted(found - set(known)):
                wrong.append(
                    f"{file} has the thresholds {new}, which no probe tests on both sides: add a probe to "
                    "tests/thresholds/probes_of_*.py, or list them in tests/thresholds/*.toml with their kind"
                )
            if gone := sorted(set(known) - found):
                wrong.append(f"{file} has no thresholds {gone} any more: take them out of tests/thresholds")
            if len(set(known)) < len(known):
                wrong.append(f"{file} has thresholds that are listed twice: {sorted(known)}")
    assert not wrong, "\n".join(wrong)


def test_tests_that_are_named_exist_and_reasons_are_given():
    for path in Path(__file__).parent.glob("*.toml"):
        for entries in tomllib.loads(path.read_text("utf-8")).values():
            assert not [wrong for test in entries.get("tested", ()) if (wrong := missing_test(test))]
            assert all(len(reason.split()) > 3 for reason in entries.get("open", ()))


def test_few_are_open():
    kinds = [kind for entries in listed().values() for _, kind in entries]
    decided = sum(kind in ("probed", "tested", "open") for kind in kinds)
    assert kinds.count("open") < decided / 3


def test_thresholds_are_found():
    """Of every form in which the sources write them."""
    python = in_python(
        """
FEW, MANY = 3, 2**20
NAME, SWITCH, WIDE = "x", True, 4 * FEW
class A:
    LARGEST: int = 64
    def f(self, x, small=1e-9):
        if abs(x) > 64 * UNIT_ROUNDOFF or len(x) > 12 or x > 0.3 or x < 2:
            floor = 8 * UNIT_ROUNDOFF * x
        n = read_integer(x, "x", 1, 24)
        return max(x, 1e-12), np.allclose(x, 0, atol=1e-13)
"""
    )
    assert python == {
        "FEW",
        "MANY",
        "WIDE",
        "LARGEST",
        "default of f: 1e-09",
        "abs(x) > 64 * UNIT_ROUNDOFF",
        "len(x) > 12",
        "x > 0.3",
        "8 * UNIT_ROUNDOFF * x",
        "read_integer(x, 'x', 1, 24)",
        "max(x, 1e-12)",
        "np.allclose(x, 0, atol=1e-13)",
    }
    cpp = in_cpp(
        """
constexpr double SMALL = 0x1p-40, LARGE = 2.0 * SMALL;  // x < 0.7
constexpr int64_t MOST = 192;
#define LIMITS(_) _(WIDEST, 1024) _(KIND, 2)
if (a > 0.25 * b || n >= 16 || c < 1.0 || k == 3) return 4.0 * UNIT_ROUNDOFF;
"""
    )
    assert cpp == {"SMALL", "LARGE", "MOST", "WIDEST", "a > 0.25 * b", "n >= 16", "4.0 * UNIT_ROUNDOFF"}
