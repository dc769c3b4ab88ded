"""Planted defects: what is drawn, where it is, and that the listed ones exist."""

import itertools
from pathlib import Path

import pytest

from mutants import cpp_defects, python_defects
from mutants.plant import ROOT, defects_in, drawn, listed

STANDING = Path(ROOT / "tests" / "mutants" / "standing.txt")


def planted(reader, text):
    """Return (function, kind, the text with the defect) of all defects of a text."""
    return [(d.function, d.kind, d.planted(text.encode()).decode()) for d in reader.defects_of("file", text)]


@pytest.mark.parametrize(
    ("old", "kind", "new"),
    [
        ("return a + b", "sign", "return (a - b)"),
        ("return -a", "sign", "return (a)"),
        ("return a < b", "comparison", "return (a <= b)"),
        ("return a in b", "comparison", "return (a not in b)"),
        ("return a and b", "condition", "return (a or b)"),
        ("return a and b", "lost condition", "return (a)"),
        ("if a:\n        pass", "condition inverted", "if (not (a)):\n        pass"),
        ("return a if b else c", "lost branch", "return (c)"),
        ("return a * b", "dropped factor", "return (b)"),
        ("return a / b", "dropped factor", "return (a)"),
        ("return a[i]", "index 0", "return a[0]"),
        ("return a[b:]", "off by one", "return a[(b) + 1:]"),
        ("return range(a)", "off by one", "return range((a) - 1)"),
        ("return f(a, b)", "swapped arguments", "return f(b, a)"),
        ("return f(a, c=b)", "lost argument", "return f(a)"),
        ("return max(a, b)", "lost call", "return (a)"),
        ("return 2", "constant", "return 3"),
        ("return 0.5", "constant", "return 1.0"),
        ("return True", "constant", "return False"),
        ("raise a", "lost statement", "pass"),
        ("a += b", "lost sum", "a = b"),
    ],
)
def test_each_kind_of_python(old, kind, new):
    text = "def f(a, b):\n    {}\n"
    assert ("f", kind, text.format(new)) in planted(python_defects, text.format(old))


def test_defaults_and_properties_of_python():
    text = "class A(B):\n    x = y\n\n    @property\n    def p(self, k=1):\n        return self.base\n"
    found = planted(python_defects, text)
    assert ("A.p", "default", text.replace("k=1", "k=2")) in found
    assert ("A", "lost property", "class A(B):\n    x = y\n\n    pass\n") in found


def test_texts_annotations_and_messages_are_left_alone():
    text = 'def f(a: X[0] = None) -> Y[1]:\n    """Return 2."""\n    raise E(f"{a + 1}")\n'
    assert [kind for _, kind, _ in planted(python_defects, text)] == ["lost statement"]


@pytest.mark.parametrize(
    ("old", "kind", "new"),
    [
        ("return a + b;", "sign", "return a - b;"),
        ("return a < b;", "comparison", "return a <= b;"),
        ("return a && b;", "lost condition", "return a ;"),
        ("return a * b(c);", "dropped factor", "return a ;"),
        ("return a[i];", "index 0", "return a[0];"),
        ("return 2;", "constant", "return 3;"),
        ("return 0.5;", "constant", "return 2.0 * 0.5;"),
        ("if (a) b();", "condition inverted", "if (!(a)) b();"),
        ("return g(a, b);", "swapped arguments", "return g(b, a);"),
        ("return larger(a, b);", "lost call", "return a;"),
    ],
)
def test_each_kind_of_cpp(old, kind, new):
    text = "template <class A>\nvoid f(const A& a, A* b) {{\n    {}  // a + b\n}}\n"
    assert ("f", kind, text.format(new)) in planted(cpp_defects, text.format(old))


def test_templates_pointers_and_comments_are_no_expressions():
    text = '#define X 1\nvoid f(A<B>* a) { const A<B>& c = *a; g("1 + 2"); /* 3 */ }\n'
    assert planted(cpp_defects, text) == []


@pytest.mark.thinned(1)
@pytest.mark.parametrize("pattern", ["algebra/*.py", "runs/*.py", "kernels/tables/*.py"])
@pytest.mark.long
def test_drawn_defects_compile(pattern):
    found = defects_in(ROOT, [pattern])
    wrong = []
    for defect in itertools.islice(drawn(found, 7), 150):
        text = (ROOT / "src/coadjoint" / defect.file).read_bytes()
        try:
            compile(defect.planted(text), defect.file, "exec")
        except SyntaxError:
            wrong.append(defect.address)
    assert len(wrong) <= 2, wrong


def test_draws_are_repeated_by_their_seed():
    found = defects_in(ROOT, ["analysis/powers.py", "analysis/predicted_drift.py"])
    first, again, other = ([d.address for d in drawn(found, seed)] for seed in (1, 1, 2))
    assert first == again != other and sorted(first) == sorted(other) == sorted(d.address for d in found)


def test_listed_defects_exist(tmp_path):
    """A line whose function has changed names another place or none: write it again."""
    lines = STANDING.read_text("utf-8").splitlines()[1:]
    files = {line.partition("::")[0] for line in lines}
    found = defects_in(ROOT, sorted(files))
    assert len(listed(found, STANDING)) == len(lines) >= 100
    (tmp_path / "list.txt").write_text(f"{lines[0]}\nalgebra/constants.py::nothing: sign 1\n")
    with pytest.raises(ValueError, match=r"nothing: sign 1"):
        listed(found, tmp_path / "list.txt")
