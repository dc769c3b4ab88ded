"""What a release states in several places: version, dependencies, license and links."""

import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

import coadjoint as co

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="not a checkout")
# Extras of users; the others are tools of developers.
DEVELOPING = {"all", "dev", "docs", "bench", "bench-fortran", "torch"}


def text_of(name):
    return (ROOT / name).read_text(encoding="utf-8")


def project():
    return tomllib.loads(text_of("pyproject.toml"))


def triggers_and_jobs(workflow):
    """Return the text of the triggers of a workflow, and that of each job."""
    triggers, _, rest = text_of(f".github/workflows/{workflow}").partition("\non:\n")[2].partition("\n\n")
    jobs = re.findall(r"^  ([\w-]+):\n((?:    .*\n|\n)+)", rest.partition("\njobs:\n")[2], re.MULTILINE)
    return triggers, dict(jobs)


def test_version_is_that_of_the_source_everywhere():
    metadata = project()
    assert "version" not in metadata["project"] and metadata["project"]["dynamic"] == ["version"]
    assert metadata["tool"]["dynamic-metadata"][0]["input"] == "src/coadjoint/__init__.py"
    assert re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+|\.dev\d+)?", co.__version__)
    assert re.search(r"^version: (.*)$", text_of("CITATION.cff"), re.MULTILINE)[1] == co.__version__
    assert re.search(r'^  version: "(.*)"$', text_of("packaging/conda/recipe.yaml"), re.MULTILINE)[1] == co.__version__


def test_changelog_begins_with_this_version_and_its_date():
    headings = re.findall(r"^## (.*)$", text_of("CHANGELOG.md"), re.MULTILINE)
    releases = [heading for heading in headings if heading != "Unreleased"]
    date = re.search(r"^date-released: (.*)$", text_of("CITATION.cff"), re.MULTILINE)[1]
    assert releases[0] == f"{co.__version__} ({date})"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)", heading) for heading in releases)


def test_minimum_versions_are_those_of_the_project():
    """The versions that `make minimum` installs are the lower bounds, for the core and all extras of users."""
    found = project()["project"]
    requirements = set(found["dependencies"])
    for extra, needed in found["optional-dependencies"].items():
        requirements |= set(needed) if extra not in DEVELOPING else set()
    assert all(re.fullmatch(r"[\w-]+>=[\d.]+", requirement) for requirement in requirements), "a lower bound, no other"
    direct, _, indirect = text_of("tests/minimum_versions.txt").partition("# Not a dependency")
    lines = {line for line in direct.splitlines() if line and not line.startswith("#")}
    assert lines == {requirement.replace(">=", "==") for requirement in requirements}
    names = {re.split("[>=]=", requirement)[0] for requirement in requirements}
    assert not names & {line.partition("==")[0] for line in indirect.splitlines()}


def test_recipe_needs_what_the_core_needs():
    """And permits no older version of an optional package than the extras do."""
    recipe, found = text_of("packaging/conda/recipe.yaml"), project()["project"]
    required, _, constrained = recipe.partition("  run:\n")[2].partition("  run_constraints:\n")
    listed = {line[6:].replace(" ", "") for line in required.splitlines() if line.startswith("    - ")}
    assert listed - {"python>=${{python_min}}"} == set(found["dependencies"])
    assert f'python_min: "{found["requires-python"][2:]}"' in recipe
    bounds = set().union(*found["optional-dependencies"].values())
    names = {"matplotlib-base": "matplotlib", "pytorch": "torch"}
    optional = re.findall(r"^    - ([\w-]+) (>=.*)$", constrained, re.MULTILINE)
    assert len(optional) > 3 and {f"{names.get(name, name)}{bound}" for name, bound in optional} <= bounds


def test_wheels_of_every_platform_have_all_levels():
    """The environment of a platform replaces the common one."""
    table = project()["tool"]["cibuildwheel"]
    platforms = {name: part for name, part in table.items() if name in ("linux", "macos", "windows")}
    environments = {name: part.get("environment", table["environment"]) for name, part in platforms.items()}
    environments["all"] = table["environment"]
    assert {name for name, variables in environments.items() if variables.get("COADJOINT_LEVELS") != "all"} == set()
    assert "CIBW_ENVIRONMENT" not in text_of(".github/workflows/wheels.yml"), "it would replace all of these"
    assert re.search(r"^      COADJOINT_LEVELS: all$", text_of("packaging/conda/recipe.yaml"), re.MULTILINE)


def test_wheels_have_all_but_the_sources_that_are_compiled():
    """Steps of users are compiled with the headers, and lazy names are read from the stubs."""
    patterns = project()["tool"]["scikit-build"]["wheel"]["exclude"]
    source = ROOT / "src"
    files = [path for path in source.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    excluded = {
        path for path in files if any(fnmatch(path.relative_to(source).as_posix(), pattern) for pattern in patterns)
    }
    assert excluded == {path for path in files if path.suffix == ".cpp"}


def test_a_release_is_published_after_every_other_job():
    """And only for a tag: a workflow that is started by hand builds and tests alone."""
    triggers, jobs = triggers_and_jobs("wheels.yml")
    assert triggers == '  push:\n    tags: ["v*"]\n  workflow_dispatch:'
    publishing = {name for name, job in jobs.items() if re.search(r"id-token: write|pypi-publish", job)}
    assert publishing == {"publish"} and {"version", "tests", "wheels", "source"} <= set(jobs)
    needed = re.search(r"^    needs: \[(.*)\]$", jobs["publish"], re.MULTILINE)[1]
    assert set(needed.split(", ")) == set(jobs) - publishing
    assert "\n    if: github.event_name == 'push'\n" in jobs["publish"]
    assert "\n    uses: ./.github/workflows/tests.yml" in jobs["tests"]
    assert "  workflow_call:" in triggers_and_jobs("tests.yml")[0].splitlines()


def test_license_is_the_same_everywhere():
    found = project()["project"]
    assert found["license"] == "MIT" and text_of("LICENSE").startswith("MIT License\n")
    assert re.search(r"^license: (.*)$", text_of("CITATION.cff"), re.MULTILINE)[1] == "MIT"
    holder = re.search(r"^Copyright \(c\) \d{4} (.*)$", text_of("LICENSE"), re.MULTILINE)[1]
    assert holder == found["authors"][0]["name"] == re.search(r"^  - name: (.*)$", text_of("CITATION.cff"), re.M)[1]
    assert f"license: {found['license']}\n" in text_of("packaging/conda/recipe.yaml")


def test_no_link_to_a_repository_that_does_not_exist():
    """Until pyproject.toml names one, under [project.urls], where the documentation site takes it from."""
    assert "urls" not in project()["project"], "name the repository in CITATION.cff too, and drop this test"
    files = [
        path for name in ("docs", "src", "tests", ".github", "packaging", "paper") for path in (ROOT / name).rglob("*")
    ]
    files += [path for path in ROOT.iterdir() if path.is_file()]
    texts = (".py", ".md", ".cff", ".toml", ".yml", ".yaml", ".bib", ".pyi", ".json")
    linked = [path for path in files if path.suffix in texts and path.is_file() and path != Path(__file__)]
    repository = re.compile(r"github(usercontent)?\.(com|io)/coadjoint|coadjoint\.(github|readthedocs)\.io")
    assert [path for path in linked if repository.search(path.read_text(encoding="utf-8"))] == []


def test_paper_is_short_and_its_references_exist():
    """At most 1000 words, in the sections of the journal; all entries are cited, and all but two have a DOI."""
    header, text = re.match(r"---\n(.*?)\n---\n(.*)", text_of("paper/paper.md"), re.DOTALL).groups()
    entries = dict(re.findall(r"^@(?:\w+)\{(\w+),\n(.*?)^\}", text_of("paper/paper.bib"), re.DOTALL | re.MULTILINE))
    assert "bibliography: paper.bib" in header and len(text.split()) <= 1000
    assert set(re.findall(r"@(\w+)", text)) == set(entries)
    dois = {name for name, entry in entries.items() if re.search(r"doi = \{10\.\d{4,}/[\w./-]+\}", entry)}
    assert set(entries) - dois == {"reich1993", "poissonbrackets"}
    # The section on the use of AI is written by the authors; the header says so.
    sections = ["Summary", "Statement of need", "State of the field", "Software design", "Research impact statement"]
    assert re.findall(r"^# (.*)$", text, re.MULTILINE) == [*sections, "Acknowledgements", "References"]
    assert 'authors, before submission: their names, ORCIDs and affiliations here, and the section "AI usage' in header
    for figure in re.findall(r"\]\((\w+\.png)\)", text):
        assert (ROOT / "paper" / figure).is_file()


def test_figures_of_the_paper_are_drawn(tmp_path, monkeypatch):
    """By the same script, from runs over a small part of the spans; those of the paper are named as they are."""
    monkeypatch.syspath_prepend(str(ROOT / "paper"))
    import figures

    written = figures.draw(tmp_path, 1 / 50)
    assert [file.name for file in written] == re.findall(r"\]\((\w+\.png)\)", text_of("paper/paper.md"))
    assert all(file.read_bytes().startswith(b"\x89PNG") and file.stat().st_size > 10_000 for file in written)
