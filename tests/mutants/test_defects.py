"""The list of planted defects fits the sources: each can be planted, and the tests that should notice it exist."""

from collections import Counter
from pathlib import Path

import pytest

from mutants.defects import ROOT, Defect, defects, missing_test

FOLDERS = {"algebra", "systems", "program", "methods", "kernels", "runs", "choosing", "files", "analysis", "pictures"}
SOURCE = """
def slopes(system, states):
    if system.sign != 0:
        return system.sign * combined(system.field, states, 2)
    return 0
"""
SPLIT_OVER_LINES = """
class Field:
        def slopes(system, states):
                if system.sign != 0:
                        return system.sign * combined(
                                system.field,
                                states,
                                2,
                        )
                return 0
"""


def test_defects_cover_every_folder():
    """The defects of a folder stand in its file, those of modules outside of the folders in command.toml."""
    assert {defect.folder for defect in defects()} == {*FOLDERS, "command"}
    for defect in defects():
        part = defect.file.removeprefix("src/coadjoint/").partition("/")[0]
        assert defect.folder == (part if part in FOLDERS else "command"), defect.name
    assert len(defects()) >= 320
    assert sum(defect.file.endswith((".cpp", ".hpp")) for defect in defects()) >= 60
    assert not [name for name, count in Counter((d.folder, d.name) for d in defects()).items() if count > 1]


@pytest.mark.thinned(1)
@pytest.mark.parametrize("folder", sorted({*FOLDERS, "command"}))
def test_each_defect_can_be_planted(folder):
    for defect in defects():
        if defect.folder == folder:
            text = (ROOT / defect.file).read_text(encoding="utf-8")
            assert defect.planted(text) != text


@pytest.mark.thinned(1)
@pytest.mark.parametrize("folder", sorted({*FOLDERS, "command"}))
def test_tests_of_each_defect_exist(folder):
    sources = {path.name for path in (ROOT / "src/coadjoint").rglob("*.cpp")}
    for defect in defects():
        if defect.folder == folder:
            assert defect.tests, defect.name
            assert not [wrong for test in defect.tests if (wrong := missing_test(test))]
            assert bool(defect.compile) == defect.file.endswith((".cpp", ".hpp")), defect.name
            assert sources.issuperset(defect.compile), defect.name


def defect(old, new):
    return Defect(folder="algebra", name="x", file="y.py", old=old, new=new, tests=("tests/nowhere.py",))


@pytest.mark.parametrize("source", [SOURCE, SPLIT_OVER_LINES])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("system.sign * combined(system.field, states, 2)", "combined(system.field, states, 2)"),
        ("system . sign\n  * combined", "combined"),
        ("combined(system.field, states, 2,)", "combined(system.field, states, 3)"),
        ("states, 2)", "states, 3)"),
        (
            "if system.sign != 0: return system.sign",
            "if system.sign == 0:\n    return 1\nif system.sign != 0:\n    return 2",
        ),
        ("return 0", ""),
    ],
)
def test_old_text_is_found_in_reformatted_sources(source, old, new):
    planted = defect(old, new).planted(source)
    assert planted.count("def slopes") == 1
    if new:
        compile(planted, "y.py", "exec")
        assert "".join(new.split()).rstrip(")") in "".join(planted.split())


def test_lines_of_new_text_are_indented_like_the_source():
    planted = defect("return 0", "if states:\n    return 1\nreturn 2").planted(SPLIT_OVER_LINES)
    assert planted.endswith("\n" + " " * 16 + "if states:\n" + " " * 20 + "return 1\n" + " " * 16 + "return 2\n")


@pytest.mark.parametrize(
    ("old", "text", "message"),
    [
        ("b", "a b b", "occurs 2 times"),
        ("f(x, y)", "f(x, y) + f(\n    x,\n    y,\n)", "occurs 2 times"),
        ("b", "abd", "occurs 0 times"),
        ("x = y", "x == y", "occurs 0 times"),
        ("c", "c", "changes nothing"),
        ("c", "c + d", "changes nothing"),
    ],
)
def test_old_text_must_occur_once_and_change(old, text, message):
    with pytest.raises(ValueError, match=message):
        defect(old, "c").planted(text)


def test_missing_tests_are_reported():
    assert missing_test("tests/nowhere.py::test_x") == "there is no file tests/nowhere.py"
    here = Path(__file__).relative_to(ROOT).as_posix()
    assert missing_test(f"{here}::test_x[1]") == f"{here} has no test_x"
    assert not missing_test(f"{here}::test_defects_cover_every_folder[a-b]")
