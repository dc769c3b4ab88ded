"""Random configuration files run by the command, which must write a result or print one line per error."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import shutil
import tempfile
import tomllib
import warnings
from pathlib import Path

import numpy as np

import coadjoint as co
from coadjoint import commands
from coadjoint.files.configuration.configuration import Configuration
from coadjoint.files.configuration.construction import ConfigurationError
from coadjoint.files.output.output_files import OutputError
from coadjoint.methods.reversible_steps import speed_of
from coadjoint.systems.protocol import member_of, unforced

from .configurations import draw
from .folder import make, snapshot
from .judging import wrong_error

MAX_STEPS = 40  # longer runs are cut
MAX_OWN_STEPS = 10**5  # of `ReversibleSteps` in a run; each step of a run may contain 2^24, which take half a minute
LONGEST_LINE, MOST_LINES = 420, 21
KINDS = "Value Type Arithmetic Overflow ZeroDivision FloatingPoint Recursion Memory LinAlg"
UNFORESEEN = tuple(f"coadjoint: {kind}Error: " for kind in KINDS.split())

_integrate = Configuration.integrate


def shortened(configuration, *args, **kwargs):
    """Run a configuration for at most `MAX_STEPS` steps, and `MAX_OWN_STEPS` at the speed of the start."""
    configuration.check_memory()
    start, end = configuration.t_span
    steps = abs(end - start) / configuration.step
    if steps > MAX_STEPS:
        end = start + (MAX_STEPS if end > start else -MAX_STEPS) * configuration.step
        configuration = dataclasses.replace(configuration, t_span=(start, end), t_eval=None)
    share = MAX_OWN_STEPS / own_steps(configuration)
    if share < 1.0 and start + share * configuration.step != start:
        span, step = (start, start + share * (end - start)), share * configuration.step
        configuration = dataclasses.replace(configuration, t_span=span, step=step, t_eval=None)
    return _integrate(configuration, *args, **kwargs)


def own_steps(configuration):
    """Estimate the number of steps of `ReversibleSteps` in a run from the speed at the start; 1 for other schemes."""
    method, (start, end) = configuration.method, configuration.t_span
    if not isinstance(method, co.ReversibleSteps):
        return 1.0
    system, fastest = unforced(member_of(configuration.system)), 0.0
    with contextlib.suppress(ValueError, TypeError, ArithmeticError), np.errstate(all="ignore"):
        method.properties(system)
        speed = speed_of(system, method.speed)
        fastest = max(float(speed.at(x)[0]) for x in np.atleast_2d(configuration.x0))
    return max(1.0, abs(end - start) * fastest / method.stride)


class Runs:
    """The command in a temporary folder."""

    def __init__(self):
        self._place, self._home = tempfile.TemporaryDirectory(), tempfile.TemporaryDirectory()
        self._outside = Path(self._place.name).resolve()
        self._folder = make(self._outside)
        os.chdir(self._folder)
        os.environ["HOME"] = self._home.name  # caches of other packages
        Configuration.integrate = shortened
        self._raised = None
        self._invoke = type(commands.commands).invoke
        commands.commands.invoke = self._recording
        self._before = snapshot(self._outside)

    def _recording(self, context):
        try:
            return self._invoke(commands.commands, context)
        except Exception as error:
            self._raised = error
            raise

    def tried(self, seed):
        """Return descriptions of what is wrong with the outcome of a run."""
        (self._folder / "run.toml").write_bytes(draw(seed))
        self._raised = None
        message, printed = io.StringIO(), io.StringIO()
        self._before = snapshot(self._outside)
        with warnings.catch_warnings(), contextlib.redirect_stdout(printed), contextlib.redirect_stderr(message):
            warnings.simplefilter("default")
            try:
                status, line = commands.perform(["run", "run.toml", "--quiet"])
            except Exception as error:
                return [f"raised: {wrong_error(error, '') or type(error).__name__}"]
        return [*self._of_the_line(status, line, printed.getvalue() + message.getvalue()), *self._of_the_folder()]

    def _of_the_line(self, status, line, printed):
        if status not in (0, 1, 2):
            yield f"exit status {status}"
        if printed:
            yield f"printed: {printed[:200]!r}"
        if status == 0:
            if " encountered in " in line:
                yield f"a warning: {line[:200]!r}"
            return
        # All errors of a file are reported, one per line.
        lines = line.split("\n")
        if not all(lines) or not all(each.isprintable() and len(each) <= LONGEST_LINE for each in lines):
            yield f"not one line for each mistake: {line[:500]!r}"
        if len(lines) > MOST_LINES:
            yield f"{len(lines)} lines: {line[:500]!r}"
        if line.startswith(UNFORESEEN):
            yield f"unforeseen: {line[:300]!r} {wrong_error(self._raised, '')}"
        error = self._raised
        if isinstance(error, ConfigurationError | OutputError):
            cause = error.__cause__
            if cause is not None and type(cause) is not ConfigurationError and (wrong := wrong_error(cause, "")):
                yield wrong

    def _of_the_folder(self):
        now, targets = snapshot(self._outside), [*self._targets()]
        for name, state in now.items():
            path = self._outside / name
            if name == "work/run.toml" or state == self._before.get(name, "new"):
                continue
            if not any(path == target or target in path.parents for target in targets):
                yield f"written beside what was named: {name}"
                break
        lost = [name for name in self._before if name not in now]
        if lost:
            yield f"removed: {lost[0]}"
        self._tidied(now)

    def _targets(self):
        """Yield the output paths of the file."""
        with contextlib.suppress(ValueError, RecursionError, OSError, AttributeError):
            table = tomllib.loads((self._folder / "run.toml").read_bytes().decode())
            for named in filter(lambda arguments: isinstance(arguments, str), table.get("output", {}).values()):
                yield (self._folder / named).resolve()
                yield Path(os.path.normpath(self._folder / named))

    def _tidied(self, now):
        """Remove written files, so that each seed finds the same folder."""
        for name in sorted(now, reverse=True):
            path = self._outside / name
            if name not in self._before and name != "work/run.toml" and os.path.lexists(path):
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
