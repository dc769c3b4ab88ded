"""Random configuration files run by the command, which must write a result or print one line per error."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import tempfile
import tomllib
import warnings
from importlib.metadata import entry_points
from pathlib import Path

from .configurations import draw
from .folder import make, snapshot
from .judging import TooLong

LONGEST_LINE, MOST_LINES = 420, 21
UNFORESEEN = "coadjoint: "  # errors of files begin with their names


class Runs:
    """The command in a temporary folder."""

    def __init__(self):
        self.place, self.home = tempfile.TemporaryDirectory(), tempfile.TemporaryDirectory()
        self.outside = Path(self.place.name).resolve()
        self.folder = make(self.outside)
        os.chdir(self.folder)
        os.environ["HOME"] = self.home.name  # caches of other packages
        (script,) = entry_points(group="console_scripts", name="coadjoint")
        self.command = script.load()
        sys.argv = ["coadjoint", "run", "run.toml", "--quiet"]

    def tried(self, seed):
        """Return descriptions of what is wrong with the outcome of a run."""
        (self.folder / "run.toml").write_bytes(draw(seed))
        message, printed = io.StringIO(), io.StringIO()
        before = snapshot(self.outside)
        with warnings.catch_warnings(), contextlib.redirect_stdout(printed), contextlib.redirect_stderr(message):
            warnings.simplefilter("default")
            try:
                status = self.command()
            except SystemExit as ended:
                status = ended.code
            except TooLong:  # steps that a scheme chooses, or large matrices: they can be interrupted
                status = None
            except Exception as error:
                return [f"raised {type(error).__name__}: {error}"[:300]]
        wrong = [] if status is None else [*self.of_the_line(int(status or 0), message.getvalue(), printed.getvalue())]
        return [*wrong, *self.of_the_folder(before)]

    @staticmethod
    def of_the_line(status, line, printed):
        if status not in (0, 1, 2):
            yield f"exit status {status}"
        if printed:
            yield f"printed: {printed[:200]!r}"
        if " encountered in " in line:
            yield f"a warning: {line[:200]!r}"
        if status == 0:
            return
        # All errors of a file are reported, one per line.
        lines = line.removesuffix("\n").split("\n")
        if not all(lines) or not all(each.isprintable() and len(each) <= LONGEST_LINE for each in lines):
            yield f"not one line for each mistake: {line[:500]!r}"
        if len(lines) > MOST_LINES:
            yield f"{len(lines)} lines: {line[:500]!r}"
        if line.startswith(UNFORESEEN):
            yield f"unforeseen: {line[:300]!r}"

    def of_the_folder(self, before):
        now, targets = snapshot(self.outside), [*self.targets()]
        changed = [name for name, state in now.items() if name != "work/run.toml" and state != before.get(name, "new")]
        for name in changed:
            path = self.outside / name
            if not any(path == target or target in path.parents for target in targets):
                yield f"written beside what was named: {name}"
                break
        yield from [f"removed: {name}" for name in before if name not in now][:1]
        # Each seed finds the same folder.
        for name in sorted(now, reverse=True):
            path = self.outside / name
            if name not in before and name != "work/run.toml" and os.path.lexists(path):
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()

    def targets(self):
        """Yield the output paths of the file."""
        with contextlib.suppress(ValueError, RecursionError, OSError, AttributeError):
            table = tomllib.loads((self.folder / "run.toml").read_bytes().decode())
            for named in filter(lambda arguments: isinstance(arguments, str), table.get("output", {}).values()):
                yield (self.folder / named).resolve()
                yield Path(os.path.normpath(self.folder / named))
