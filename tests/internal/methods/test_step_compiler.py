"""When a step in C++ is compiled again: time stamps, preprocessed text, other processes, slow compilers."""

import os
import pickle
import shutil
import time
from pathlib import Path

import pytest

import coadjoint as co
from coadjoint.methods import step_compiler
from refusals import refused

SOURCE = Path(__file__).parents[2] / "public" / "runs" / "own_step.cpp"

pytestmark = pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler is installed")


@pytest.fixture(scope="module")
def step(tmp_path_factory):
    patch = pytest.MonkeyPatch()
    patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    path = tmp_path_factory.mktemp("source") / "own_step.cpp"
    path.write_text(SOURCE.read_text() + "\nextern int of_these_tests;\n")  # unlike that of other tests in the process
    yield co.methods.compile_step(path)
    patch.undo()


@pytest.mark.long
def test_another_process_finds_what_was_compiled(step, monkeypatch):
    def refused(*given):
        raise AssertionError("compiled again")

    for known in ("_LOADED", "_LIBRARIES", "_LAST_COMPILATIONS"):
        monkeypatch.setattr(step_compiler, known, {})
    monkeypatch.setattr(step_compiler, "_build", refused)
    assert co.methods.compile_step(step.path) == step and step.address != 0


class Project:
    """A source with headers of its own, of which only the preprocessing is tested."""

    def __init__(self, folder, step, patch):
        self.folder, self.patch, self.names = folder, patch, []
        for name in ("own", "first", "second"):
            (folder / name).mkdir()
        self.write("own/own.cpp", '#include "one.hpp"\n#include "steps/step_scheme.hpp"\nSTEP_SCHEME(own_step, Own)\n')
        self.write("own/one.hpp", '#include "deep/two.hpp"\n#include <three.hpp>\n#ifdef MACRO\nint MACRO;\n#endif\n')
        self.write("own/deep/two.hpp", 'int two;\n#include "three.hpp"\n')
        self.write("second/three.hpp", "int three;\n")
        self.write("compiler", '#!/bin/sh\nexec c++ "$@"\n')
        (folder / "compiler").chmod(0o755)
        self.options()
        patch.setattr(step_compiler, "_LAST_COMPILATIONS", {})
        patch.setattr(step_compiler, "_LOADED", {})
        self.library = step_compiler._LIBRARIES[step.path, step.digest]
        patch.setattr(step_compiler, "cached_library", self.loaded)

    def loaded(self, name, build):
        self.names.append(name)
        return self.library

    def write(self, name, text):
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)

    def options(self, more=""):
        search = f"-I{self.folder}/absent -I{self.folder}/first -I{self.folder}/second"
        self.patch.setenv("CXX", f"{self.folder}/compiler {search} {more}")

    def compile(self):
        """Return what identifies the step, and how many libraries were loaded."""
        return co.methods.compile_step(self.folder / "own" / "own.cpp"), len(self.names)


def same_size_and_time(project):
    path = project.folder / "own" / "deep" / "two.hpp"
    before = path.stat()
    path.write_text(path.read_text().replace("two", "owt"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def link_turned(project):
    (project.folder / "own" / "one.hpp").unlink()
    (project.folder / "own" / "one.hpp").symlink_to(project.folder / "other.hpp")


EDITS = {
    "source": lambda project: project.write("own/own.cpp", "int more;\nSTEP_SCHEME(own_step, Own)\n"),
    "header": lambda project: project.write("own/one.hpp", "int one;\n"),
    "header of a header": lambda project: project.write("own/deep/two.hpp", "int other;\n"),
    "same size and time": same_size_and_time,
    "header in a folder of an option": lambda project: project.write("second/three.hpp", "int other;\n"),
    "header found before another": lambda project: project.write("first/three.hpp", "int other;\n"),
    "folder found before another": lambda project: project.write("absent/three.hpp", "int other;\n"),
    "header beside the header": lambda project: project.write("own/deep/three.hpp", "int other;\n"),
    "header of the library shadowed": lambda project: project.write("own/steps/step_scheme.hpp", "int other;\n"),
    "macro": lambda project: project.options("-DMACRO=four"),
    "option that leaves the text alone": lambda project: project.options("-fwrapv"),
    "searched folders": lambda project: project.options(f"-isystem {project.folder}/first -DMACRO=five"),
    "compiler": lambda project: project.write("compiler", '#!/bin/sh\nexec c++ -DMACRO=six "$@"\n'),
    "link": link_turned,
}


@pytest.mark.thinned(10)
@pytest.mark.parametrize(
    ("edit", "trusting"), [*((edit, True) for edit in EDITS), ("header", False), ("header found before another", False)]
)
def test_an_edit_is_noticed_in_the_same_process(step, tmp_path, monkeypatch, edit, trusting):
    """From the stamps of files and folders alone, where all are old enough, and from the preprocessed text."""
    monkeypatch.setattr(step_compiler, "TIMESTAMP_GRANULARITY", -(10**18) if trusting else 10**18)
    project = Project(tmp_path, step, monkeypatch)
    project.write("other.hpp", "int other;\n")
    first, count = project.compile()
    assert count == 1
    with monkeypatch.context() as patch:
        if trusting:
            patch.setattr(step_compiler, "_run", None)
        assert project.compile() == (first, 1)
    EDITS[edit](project)
    second, count = project.compile()
    assert count == 2 and project.names[0] != project.names[1]
    assert (second.digest != first.digest) == (edit != "compiler"), "another machine may have another compiler"
    assert project.compile() == (second, 2)


def test_time_stamps_of_files_that_have_just_changed_are_not_trusted(tmp_path, monkeypatch):
    """A second edit within the resolution of the clock would leave the same ones."""
    (tmp_path / "file").touch()
    stamps = step_compiler.stamps_of([os.fsencode(tmp_path / name) for name in ("file", "none")])
    newest = max((tmp_path / "file").stat().st_mtime_ns, (tmp_path / "file").stat().st_ctime_ns)
    for later, trusted in ((0, False), (1, True), (-1, False), (-(10**18), False)):
        monkeypatch.setattr(time, "time_ns", lambda later=later: newest + step_compiler.TIMESTAMP_GRANULARITY + later)
        assert step_compiler.stamps_are_final(stamps) == trusted
    assert not step_compiler.stamps_are_final({})


def test_a_compiler_that_does_not_list_its_folders(step, tmp_path, monkeypatch):
    """Then a header may appear anywhere, and each call preprocesses."""
    monkeypatch.setattr(step_compiler, "TIMESTAMP_GRANULARITY", -(10**18))
    project = Project(tmp_path, step, monkeypatch)
    project.write("compiler", '#!/bin/sh\nexec c++ "$@" 2>/dev/null\n')
    first, _ = project.compile()
    project.write("first/three.hpp", "int other;\n")
    assert project.compile()[1] == 2 and project.compile()[0] != first


def test_a_step_in_another_process(step, tmp_path, monkeypatch):
    """It is compiled there from the same file, by any compiler, and an edited file is refused."""
    project = Project(tmp_path, step, monkeypatch)
    sent, address = pickle.loads(pickle.dumps(project.compile()[0])), step.address
    monkeypatch.setattr(step_compiler, "_LIBRARIES", {})
    project.write("compiler", '#!/bin/sh\nexec c++ -DMACRO=other "$@"\n')
    assert sent.address == address
    monkeypatch.setattr(step_compiler, "_LIBRARIES", {})
    project.write("own/deep/two.hpp", "int other;\n")
    with refused(ValueError, "own.cpp", "own_step"):
        sent.address  # noqa: B018


def test_a_compiler_that_does_not_end(tmp_path, monkeypatch):
    (tmp_path / "compiler").write_text("#!/bin/sh\ncat >/dev/null; sleep 60\n")
    (tmp_path / "compiler").chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("CXX", str(tmp_path / "compiler"))
    monkeypatch.setattr(step_compiler, "COMPILER_TIMEOUT", 0.1)
    with refused(RuntimeError, "did not end"):
        co.methods.compile_step(SOURCE)
