"""The documentation site, without Sphinx: its order of pages, and the reference of every public name."""

import csv
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from page_notebooks import PLACE, page_cells, write_page_notebooks
from paper_page import FIGURES, paper_page
from picture_pages import picture_code, picture_pages
from system_pages import code

import coadjoint as co
from coadjoint.methods.registry import suggested_scheme
from coadjoint.pictures import register
from coadjoint.pictures.register import kinds
from coadjoint.systems.registry import gallery_entry_of
from long import long_where


def test_every_kind_of_picture_is_shown_with_its_options():
    [page] = picture_pages().values()
    sections = dict(section.split("\n", 1) for section in page.split("\n## ")[1:])
    assert list(sections) == list(kinds())
    for name, kind in kinds().items():
        rows = dict(re.findall(r"^\| `(\w+)` \| (needed|`.*?`) \| [^|]+ \| .+\. \|$", sections[name], re.MULTILINE))
        assert list(rows) == list(kind.options)
        for option, default in rows.items():
            needed = kind.options[option].default is kind.options[option].empty
            assert default == ("needed" if needed else f"`{kind.options[option].default!r}`")
        assert kind.__doc__.startswith(f"{kind.usage}\n\n") and picture_code(name) in sections[name]


@pytest.mark.parametrize("name", kinds())
def test_code_of_a_kind_of_picture_draws_it(name, monkeypatch):
    drawn = []
    kind = kinds()[name]
    recorded = replace(kind, prepare=lambda *given, **options: drawn.append(name) or kind.prepare(*given, **options))
    monkeypatch.setattr(recorded.__class__, "check", lambda *_: None)
    monkeypatch.setitem(register._KINDS, name, recorded)
    names = {}
    exec(picture_code(name), names)
    assert isinstance(names["figure"], Figure) and set(drawn) == {name}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", co.systems.names())
def test_code_of_a_page_is_public_and_declares_the_run_of_the_gallery(name, monkeypatch):
    calls = []

    def recorded(*given, **options):
        calls.append((given, options))
        return SimpleNamespace(plot=lambda: None)

    monkeypatch.setattr(co, "integrate", recorded)
    shown, entry = code(name), gallery_entry_of(name)
    exec(shown, {})
    [((system, x0, t_span, step, scheme), options)] = calls
    declared = co.systems.get(name, **entry.parameters)
    assert system.name == declared.name and repr(system.parameters) == repr(declared.parameters)
    assert np.array_equal(x0, entry.start())
    assert (t_span, step, scheme) == (entry.t_span, entry.step, suggested_scheme(declared))
    assert {"save_every": 1, "attitude": False} | options == {
        "save_every": entry.save_every,
        "attitude": entry.attitude,
    }
    assert set(re.findall(r"^(?:import|from) .*", shown, re.MULTILINE)) <= {
        "import numpy as np",
        "import coadjoint as co",
    }
    for space, public in re.findall(r"\bco\.(?:(systems|methods)\.)?(\w+)", shown):
        assert public in dir(getattr(co, space) if space else co), public


# Of minutes together: the compilation of functions, fluids, and large lattices.
SLOW = {"double_spherical_pendulum", "reduced_mhd", "satellite", "separable_cosh", "sklyanin", "sphere_euler"}


@pytest.mark.thinned(12)
@pytest.mark.parametrize("name", long_where(SLOW, co.systems.names()))
def test_code_of_a_page_runs(name):
    names = {}
    exec(code(name), names)
    assert isinstance(names["figure"], Figure) and names["sol"].t[-1] == gallery_entry_of(name).t_span[1]


def test_statements_of_the_paper_are_under_their_verdicts_and_figures(tmp_path):
    verdicts = {"a": "holds", "b": "holds with a limit", "c": "does not hold", "d": "holds"}
    places = {"a": "section 2", "b": "figures 4, 5", "c": "example 5.2", "d": "figure 3"}
    with (tmp_path / "table.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(("place", "statement", "paper", "criterion", "measured", "verdict"))
        for key, verdict in verdicts.items():
            texts = (f"{column} {key}" for column in ("statement", "paper", "criterion"))
            table.writerow((places[key], *texts, f"|{key}| = 1", verdict))
    page = paper_page(tmp_path, library=0.0)
    assert "Of 4 statements: 1 do not hold, 1 hold with a limit, 2 hold.\n" in page
    sections = dict(section.split("\n", 1) for section in re.split(r"^#{2,3} ", page, flags=re.MULTILINE)[1:])
    for verdict in set(verdicts.values()):
        row = re.compile(r"^\| [^|]* \| statement (\w): paper \1 \| criterion \1 \|", re.MULTILINE)
        rows = row.findall(sections[f"What {verdict}"])
        assert rows == [key for key in verdicts if verdicts[key] == verdict]
    shown = {title: re.findall(r"Statement (\w); in the paper", sections[title]) for title, _ in FIGURES.values()}
    expected = {"Figure 3": ["d"], "Figure 4": ["b"], "Figure 5": ["b"]}
    assert {title: keys for title, keys in shown.items() if keys} == expected
    assert "**Holds with a limit**: \\|b\\| = 1." in sections["Figure 4"]


def test_a_page_that_asks_for_it_is_a_notebook_of_its_text_and_code(tmp_path):
    page = (Path(__file__).parents[3] / "docs" / "learn.md").read_text(encoding="utf-8")
    cells = page_cells(page)
    sources = [source for kind, source in cells if kind == "code"]
    assert page.count("```python") == len(sources) and cells[0][1].startswith("# Learn")
    assert sum(source.count("\n") + 1 for source in sources) == len(re.findall(r"^(?:>>>|\.\.\.) ", page, re.MULTILINE))
    for source in sources:
        compile(source, "learn", "exec")
    assert not any(">>>" in source or "```python" in source or PLACE in source for _, source in cells)
    pages = {"learn.md": page, "other.md": "# Other\n"}
    write_page_notebooks(tmp_path, pages)
    assert [path.name for path in tmp_path.iterdir()] == ["learn.ipynb"]
    assert "<learn.ipynb>" in pages["learn.md"] and PLACE not in pages["learn.md"]
