"""The list of defects fits the sources: each can be planted, and the tests that should notice it exist."""

from collections import Counter
from pathlib import Path

import pytest

from mutants.defects import ROOT, Defect, defects, missing_test

ROOMS = {
    "algebra",
    "systems",
    "program",
    "methods",
    "kernels",
    "runs",
    "choosing",
    "files",
    "analysis",
    "pictures",
    "command",
}


def test_the_list_covers_every_room():
    assert {defect.room for defect in defects()} == ROOMS
    assert len(defects()) >= 60
    assert sum(defect.file.endswith((".cpp", ".hpp")) for defect in defects()) >= 20
    twice = [name for name, count in Counter((d.room, d.name) for d in defects()).items() if count > 1]
    assert not twice


@pytest.mark.parametrize("room", sorted(ROOMS))
def test_each_defect_can_be_planted(room):
    for defect in defects():
        if defect.room == room:
            text = (ROOT / defect.file).read_text(encoding="utf-8")
            assert defect.planted(text) != text


@pytest.mark.thinned(4)
@pytest.mark.parametrize("room", sorted(ROOMS))
def test_what_should_notice_each_exists(room):
    for defect in defects():
        if defect.room == room:
            assert defect.tests, defect.name
            assert not [wrong for test in defect.tests if (wrong := missing_test(test))]
            compiled = defect.file.endswith((".cpp", ".hpp"))
            assert bool(defect.compile) == compiled, defect.name
            names = {path.name for path in (ROOT / "src/coadjoint").rglob("*.cpp")}
            assert names.issuperset(defect.compile), defect.name


def test_what_does_not_fit_is_an_error():
    given = {"room": "algebra", "name": "x", "file": "y.py", "tests": ("tests/nowhere.py",)}
    assert Defect(old="b", new="c", **given).planted("abd") == "acd"
    for old, text, said in (
        ("b", "abb", "occurs 2 times"),
        ("b", "a", "occurs 0 times"),
        ("c", "c", "changes nothing"),
    ):
        with pytest.raises(ValueError, match=said):
            Defect(old=old, new="c", **given).planted(text)
    assert missing_test("tests/nowhere.py::test_x") == "there is no file tests/nowhere.py"
    here = Path(__file__).relative_to(ROOT).as_posix()
    assert missing_test(f"{here}::test_x[1]") == f"{here} has no test_x"
    assert not missing_test(f"{here}::test_the_list_covers_every_room[a-b]")
