"""The documentation site, without Sphinx: its order of pages, and the reference of every public name."""

import csv
import itertools
import json
import re
import runpy
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import write_api
from matplotlib.figure import Figure
from paper_page import FIGURES, paper_page
from picture_pages import picture_code, picture_pages
from reference_pages import reference_pages
from scheme_pages import scheme_pages, text_of
from system_pages import GROUPS, code, system_pages, thumbnails, write_notebooks
from write_sources import (
    SYSTEMS,
    URLS,
    first_sentence,
    linked,
    published,
    with_explorer,
    with_schemes,
    with_sentences,
)

import coadjoint as co
from coadjoint.methods import registry
from coadjoint.methods.registry import suggested_scheme
from coadjoint.pictures import register
from coadjoint.pictures.gallery import run_example
from coadjoint.pictures.register import kinds
from coadjoint.summaries import summarize_system
from coadjoint.systems.registry import gallery_entry_of
from long import long_where

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
SITE = DOCS / "site"
GENERATED = {"systems/index", "schemes/index", "pictures/index", "reference/index", "paper"}


def entries(page):
    """Return the pages that the toctrees of a page list, in order."""
    text = (SITE / f"{page}.md").read_text(encoding="utf-8")
    return [
        line
        for block in re.findall(r"```\{toctree\}\n(.*?)```", text, re.DOTALL)
        for line in block.split("\n")
        if line and not line.startswith(":")
    ]


SECTIONS = entries("index")
PAGES = [page for section in SECTIONS for page in entries(section)]


def test_every_page_is_in_one_toctree():
    assert sorted(SECTIONS) == sorted({page.stem for page in SITE.glob("*.md")} - {"index"})
    assert len(PAGES) == len(set(PAGES))
    assert set(PAGES) - GENERATED == {page.stem for page in DOCS.glob("*.md")}


def test_every_page_links_the_next_one():
    pages = [page for page in PAGES if page not in GENERATED]
    for page, following in itertools.pairwise(pages):
        last = (DOCS / f"{page}.md").read_text(encoding="utf-8").rstrip().rpartition("\n")[2]
        title = (DOCS / f"{following}.md").read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        assert last == f"Next: [{title}]({following}.md).", page


def test_pages_link_no_files_without_a_page():
    """Files outside of the pages are named without a link, or linked where pyproject.toml names a repository."""
    linked_files = [page.name for page in DOCS.glob("*.md") if re.search(r"\]\(\.\./", published(page))]
    assert linked_files == []
    api = published(DOCS / "api.md")
    assert "`choosing/accuracy.py`" in api and ("choosing/accuracy.py)" in api) == ("Source" in URLS)


def test_links_of_copied_pages():
    text = (SITE / "index.md").read_text(encoding="utf-8")
    assert '<a href="explorer/index.html">Open it.' in with_explorer(text, "index.md") and "<!-- explorer" in text
    top = system_pages()["systems/heavy_top.md"]
    assert '<a href="../explorer/index.html#system=heavy_top">' in with_explorer(top, "systems/heavy_top.md")
    tables = with_schemes(published(DOCS / "schemes.md"), set(scheme_pages()))
    assert "[`IsospectralGauss()`](schemes/IsospectralGauss.md)" in tables
    assert {f"schemes/{name}.md" for name in re.findall(r"\]\(schemes/(\w+)\.md\)", tables)} <= set(scheme_pages())


def test_every_public_name_has_a_page():
    written = {f"systems/{name}" for name in co.systems.names()} | {f"schemes/{name}" for name in co.methods.names()}
    pages, targets = reference_pages(written)
    text = linked((DOCS / "api.md").read_text(encoding="utf-8"), targets)
    left = re.findall(r"^\| `(\w[\w.]*)` \|", text, re.MULTILINE)
    modules = {"co.__version__", *(f"co.{name}" for name in dir(co) if isinstance(getattr(co, name), ModuleType))}
    assert [name for name in left if name not in modules] == []
    assert {path for path in targets.values()} <= set(pages) | {f"{path}.md" for path in written}
    for _, kind, names in write_api.MEMBERS_OF:
        shown = re.search(r":members: (.*)", pages.get(targets[kind.__name__], ""))
        assert shown is None or shown[1].split(", ") == names.split(), kind
    assert "   :members: " in pages["reference/classes/coadjoint.Solution.rst"]
    assert r"| Return the free rigid body, $x' = x \times (I^{-1} x)$, with its exact solution. |" in text


def test_every_system_and_scheme_has_a_page():
    systems, schemes = system_pages(), scheme_pages()
    assert set(systems) == {f"systems/{name}.md" for name in (*co.systems.names(), "index")}
    assert set(schemes) == {f"schemes/{name}.md" for name in (*co.methods.names(), "index")}
    for name in co.systems.names():
        assert f"autofunction:: coadjoint.systems.{name}\n" in systems[f"systems/{name}.md"]


def test_formulas_of_the_first_sentences_of_systems_are_set():
    pages = system_pages()
    sentences = {name: pages[f"systems/{name}.md"].split("\n")[2] for name in co.systems.names()}
    assert sentences["matrix_body"].startswith(r"The free rigid body of n dimensions, $X' = [X, \Omega]$, its momentum")
    for name, sentence in sentences.items():
        assert not re.search(r"\w' =|[`^]| cross |\bOmega\b| _", re.sub(r"\$[^$]*\$", "", sentence)), name


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


def test_schemes_are_written_as_code():
    for name in co.methods.names():
        for example in registry.scheme(name).examples():
            text = text_of(example)
            if text.startswith("co."):
                assert eval(text) == example, text


def test_code_of_a_picture_is_the_run_of_the_gallery():
    names = {}
    exec(code("rigid_body").rpartition("\n")[0], names)
    declared = run_example("rigid_body")
    assert np.array_equal(names["sol"].x, declared.x) and np.array_equal(names["sol"].attitude, declared.attitude)


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


def test_coefficients_of_schemes_are_those_of_their_steps():
    pages = scheme_pages()
    assert (
        "\n| 0.0 | 0.0 | 0.0 | 0.0 | 0.0 |\n| 0.5 | 0.5 | 0.0 | 0.0 | 0.0 |\n" in pages["schemes/ExplicitRungeKutta.md"]
    )
    row = re.search(r"\| (0\.211\S+) \| 0\.25 \| (-\S+) \|\n", pages["schemes/GaussLegendre.md"])
    assert np.allclose([float(k) for k in row.groups()], [0.5 - 3**0.5 / 6, 0.25 - 3**0.5 / 6], rtol=0, atol=2**-52)
    assert "| backward | 0.20724538589718786 |" in pages["schemes/Splitting.md"]
    assert "| 3 | -0.657963087177503 |" in pages["schemes/LineSplitting.md"]
    radau = re.search(r"\| 0\.33\S+ \| (\S+) \| (\S+) \|\n", pages["schemes/RadauEnergy.md"])
    assert np.allclose([float(k) for k in radau.groups()], [5 / 12, -1 / 12], rtol=0, atol=2**-52)
    assert f"\n{row[0]}" in pages["schemes/IsospectralGauss.md"]
    commutator_free = pages["schemes/CommutatorFree.md"]
    assert "| stage 4 | stage 2 | - 1/2 g1 + g3 |\n" in commutator_free
    assert "| exponential 1 | - 1/12 g1 + 1/6 g2 + 1/6 g3 + 1/4 g4 |\n" in commutator_free
    assert "## Coefficients" not in pages["schemes/Kahan.md"]


def test_notebooks_have_the_code_of_the_pages(tmp_path):
    pytest.importorskip("nbformat")
    write_notebooks(tmp_path)
    assert {path.stem for path in tmp_path.glob("*.ipynb")} == set(co.systems.names())
    for path in tmp_path.glob("*.ipynb"):
        read = json.loads(path.read_text(encoding="utf-8"))
        text, cell = ("".join(one["source"]) for one in read["cells"])
        assert text.startswith(f"# {path.stem}\n") and cell == f"%matplotlib inline\n{code(path.stem)}\nfigure"


@pytest.mark.parametrize("published", ["", "dev", "stable"])
def test_versions_are_those_that_are_published(published, monkeypatch):
    monkeypatch.setenv("COADJOINT_SITE", published)
    options = runpy.run_path(str(SITE / "conf.py"))["html_theme_options"]
    assert ("switcher" in options) == bool(published)
    if published:
        versions = json.loads((SITE / options["switcher"]["json_url"]).read_text(encoding="utf-8"))
        assert options["switcher"]["version_match"] in {one["version"] for one in versions}
        workflow = (ROOT / ".github" / "workflows" / "site.yml").read_text(encoding="utf-8")
        folders = set(re.findall(r"build/public/(\w+)\n", workflow))
        assert {one["url"] for one in versions} == {f"../{folder}/" for folder in folders}


def test_sweeps_of_splittings_are_shown():
    rows = re.findall(r"^\| (forward|backward) \| (\S+) \|$", scheme_pages()["schemes/Splitting.md"], re.MULTILINE)
    expected = [
        ("forward" if sweep.forward else "backward", repr(sweep.coefficient))
        for scheme in registry.scheme("Splitting").examples()
        for sweep in scheme.sweeps()
    ]
    assert set(rows) <= set(expected) and rows[1:3] == [("forward", "0.5"), ("backward", "0.5")]


def test_what_schemes_preserve_is_shown():
    pages = scheme_pages()
    for scheme, expected in (("Splitting", "yes | no | all |"), ("RadauEnergy", "no | yes |")):
        row = re.search(r"^\| \[rigid_body\]\([^)]*\) \| (.*)$", pages[f"schemes/{scheme}.md"], re.MULTILINE)
        assert row is not None and row[1].startswith(expected), scheme


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


def test_sections_show_first_sentences_and_systems():
    pages = {page.name: published(page) for page in [*SITE.glob("*.md"), *DOCS.glob("*.md")]}
    text = with_sentences(pages["rigid_bodies.md"], pages)
    assert "- [](gallery.md): Plot the ready-made systems, " in text
    assert re.search(r"```\{toctree\}\n:hidden:\n\ngallery\nfree_body\n.*```\n", text, re.DOTALL)
    assert first_sentence("# T\n\nOf `a.b`, 1.5 and\n[c](d.md). Next.\n") == "Of `a.b`, 1.5 and [c](d.md)."
    groups = {page: SYSTEMS.findall(text) for page, text in pages.items() if SYSTEMS.search(text)}
    assert groups.pop("gallery.md") == list(GROUPS)
    assert groups == {"rigid_bodies.md": ["bodies"], "spin_systems.md": ["lattices"], "ideal_fluids.md": ["fluids"]}
    lattices = re.findall(r":link: systems/(\w+)\n", "\n".join(thumbnails("lattices", "systems/")))
    assert lattices == ["spin_lattice", "toda", "toda_ring"]


def test_equations_of_systems_are_shown():
    pages = system_pages()
    signs = {name: re.search(r"x' = (-?)J\(x\)", pages[f"systems/{name}.md"]) for name in co.systems.names()}
    for name, sign in signs.items():
        if sign is not None:
            assert sign[1] == ("-" if summarize_system(name)["sign"] < 0 else ""), name
    assert sum(sign is not None for sign in signs.values()) > 20
    assert re.findall(r"^\$\$ (H|C_\{\d\}) =", pages["systems/heavy_top.md"], re.MULTILINE) == ["H", "C_{1}", "C_{2}"]
