"""Documentation pages: every public name is listed, and links and file names are valid."""

import importlib.util
import re
import runpy
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint import commands

ROOT = Path(__file__).parents[3]
PAGES = sorted([*ROOT.glob("docs/*.md"), ROOT / "README.md", *ROOT.glob("src/coadjoint/**/README.md")])


@pytest.fixture(scope="module")
def api():
    specification = importlib.util.spec_from_file_location("write_api", ROOT / "docs" / "write_api.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_every_public_name_is_listed(api):
    text = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    names = {f"co.{name}" for name in dir(co)}
    spaces = "algebras analysis attitudes bodies checkcases forces jax methods orbits plotting results spectra systems"
    for space in [*spaces.split(), "torch"]:
        names |= {f"co.{space}.{name}" for name in getattr(co, space).__all__}
    names |= set(co.algebras.names())
    names |= {f"coadjoint {name}" for name in commands.commands.commands}
    assert sorted(name for name in names if f"`{name}`" not in text) == []
    assert "|  |" not in text, "a name without a text"


def test_api_page_is_up_to_date(api):
    written = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert api.page() == written, "run python docs/write_api.py"


def test_public_names_and_parameters_are_those_that_are_written(api):
    """A change of the public interface is visible in its commit, and so announced."""
    written = set((ROOT / "docs" / "public_names.txt").read_text(encoding="utf-8").splitlines())
    found = set(api.signatures().splitlines())
    assert found == written, (
        f"the public interface has lost or changed {sorted(written - found)}, and has {sorted(found - written)} now; "
        "what users call stays for two minor releases with a DeprecationWarning (docs/versions.md): if the change is "
        "meant, write it into CHANGELOG.md and run python docs/write_api.py"
    )


def test_changes_of_the_public_interface_are_seen(api, monkeypatch):
    """A removed name, a renamed parameter and another default."""

    def drift_of_series(t, leading, unit="time"):
        """Return nothing."""

    def toda(sites=5):
        """Return nothing."""

    before = set(api.signatures().splitlines())
    monkeypatch.setattr(co.analysis, "drift_of_series", drift_of_series)
    monkeypatch.setattr(co.systems, "toda", toda)
    monkeypatch.setattr(api, "MEMBERS_OF", [(title, kind, "") for title, kind, _ in api.MEMBERS_OF])
    lost = before - set(api.signatures().splitlines())
    assert "co.analysis.drift_of_series(t, lead, unit='time')" in lost and "co.systems.toda(sites=4)" in lost
    assert "PreparedRun.parameters" in lost and "co.batch" not in lost


def test_written_files_are_up_to_date(api):
    measurements = runpy.run_path(str(ROOT / "benchmarks" / "measurements.py"))
    for path, text, script in (
        ("src/coadjoint/systems/__init__.pyi", api.names_of_systems(), "docs/write_api.py"),
        ("docs/configuration.schema.json", api.written_schema(), "docs/write_api.py"),
        ("docs/measurements.md", measurements["page"](), "benchmarks/measurements.py"),
    ):
        assert text == (ROOT / path).read_text(encoding="utf-8"), f"run python {script}"
    listed = {name for sections in measurements["SUBJECTS"].values() for name in sections}
    assert {path.stem for path in measurements["REPORT"].glob("*.md")} <= listed


def test_installation_is_the_same_everywhere():
    """The library is installed from its folder, before anything else is shown."""
    paths = ROOT / "README.md", ROOT / "docs/installing.md", ROOT / "docs/site/index.md"
    readme, installing, first = (path.read_text(encoding="utf-8") for path in paths)
    [block] = re.findall(r"```sh\n(pip install .*?)```", readme, re.DOTALL)
    assert block in installing and block.splitlines()[1].split("#")[0] in first
    assert readme.index(block) < readme.index("explorer") < min(readme.index("<img"), readme.index("!["))
    for page in (*PAGES, *paths):
        assert not re.search(r"pip install coadjoint\b", page.read_text(encoding="utf-8")), page


@pytest.mark.thinned(1)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_are_valid(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        file, _, anchor = target.partition("#")
        found = (page.parent / file).resolve() if file else page
        assert found.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.+)$", found.read_text(encoding="utf-8"), re.MULTILINE)
            known = {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}
            assert anchor in known, target


@pytest.mark.thinned(1)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_named_files_exist(page):
    """File names in backticks exist, relative to the root or to a folder of the sources."""
    text = page.read_text(encoding="utf-8")
    folders = [ROOT, ROOT / "src", ROOT / "src/coadjoint", ROOT / "src/coadjoint/kernels/source", page.parent]
    folders += [folder for folder in (ROOT / "src/coadjoint").iterdir() if folder.is_dir()]
    folders += [
        ROOT / "src/coadjoint/methods/protocol",
        ROOT / "tests",
        ROOT / "tests/digests",
        *(ROOT / "src/coadjoint/kernels/source").glob("*/"),
    ]
    for name in re.findall(r"`([\w/]+\.(?:py|hpp|cpp|md|json|toml))`", text):
        shown = name in ("heun.py", "heun.cpp", "gauss.cpp", "conftest.py", "pyproject.toml") or "NAME" in name
        assert shown or any((parent / name).exists() for parent in folders), name
    for folder in re.findall(r"`((?:src|tests|docs|kernels|methods|runs|program|systems|algebra)/[\w/]*/?)`", text):
        assert any((parent / folder).exists() for parent in folders), folder
