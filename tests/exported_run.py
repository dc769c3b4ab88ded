"""Prepared runs that are exported as C: compiled as shared libraries and called by ctypes."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co
from c_compilers import compilers, library


class Build(NamedTuple):
    """A compiler, a level of optimization, a language, and the processor: any, or this one.

    With fused products of this one, GNU C would fuse all.
    """

    compiler: str
    level: str
    native: bool
    language: str = "c"

    @property
    def flags(self) -> tuple[str, ...]:
        own = ("-march=native", *(("-std=gnu99",) if self.language == "c" else ())) if self.native else ()
        return (f"-O{self.level}", *own)

    def __str__(self) -> str:
        return "-".join((self.compiler, self.language, f"O{self.level}", *(("native",) if self.native else ())))


def builds(language: str = "c") -> list[Build]:
    """Return every compiler and level, with the instructions of this processor and without."""
    return [
        Build(name, level, native, language) for level in "1032" for native in (True, False) for name in compilers()
    ]


class RunInC:
    """The functions of an exported run; arrays that are given are not changed."""

    def __init__(self, prepared: co.PreparedRun, folder: Path, build: Build, *, tangent: bool = True) -> None:
        folder.mkdir(exist_ok=True)
        self.header, self.tangent = co.export_c(prepared, folder / "own.h", tangent=tangent), tangent
        text = self.header.read_text()
        self.resumable, self.inputs = "void own_first(double x[" in text, "const double u[" in text
        self.compensated, self.attitude = "double error[" in text.partition("*/")[0], "own_run_with_attitude(" in text
        source = folder / "functions.c"
        source.write_text('#include "own.h"\n#ifdef __cplusplus\nextern "C" {\n#endif\n')
        with source.open("a") as file:
            for name in self._names():
                arguments = [kind for kind, _ in self._arguments(name)]
                called = ", ".join(one.split()[-1].strip("*") for one in arguments)
                head = f"void exported_{name}({', '.join(arguments)})"
                file.write(f"{head};\n{head} {{ own_{name}({called}); }}\n")
            file.write("#ifdef __cplusplus\n}\n#endif\n")
        target = folder / "functions.so"
        self.library = library(build.compiler, source, target, *build.flags, language=build.language)

    def _names(self) -> list[str]:
        names = ["step", "run", *(("first", "next", "finish") if self.resumable else ())]
        names += ["run_with_attitude"] if self.attitude else []
        return [*names, *(("step_with_tangents",) if self.tangent else ())]

    def _arguments(self, name: str) -> list[tuple[str, str]]:
        found = [("double *x", "x")]
        found += [("double *e", "e")] if self.compensated and name in ("first", "next", "finish") else []
        found += [("double *v", "v"), ("unsigned long count", "count")] if "tangents" in name else []
        found += [("double *A", "A")] if "attitude" in name else []
        found += [("const double *u", "u")] if self.inputs else []
        found += [("double h", "h")]
        return found + ([("unsigned long steps", "steps")] if name.startswith("run") else [])

    def call(self, name: str, x: Any, h: float, **given: Any) -> Any:
        """Return the state after a function; with `v` (k, n) also the vectors. Errors `e` and `A` are replaced."""
        x, v = np.array(x, dtype=np.float64), np.array(given.get("v", ()), dtype=np.float64)
        u = np.array(given.get("u", ()), dtype=np.float64)
        values = {
            "e": _address(given.get("e", u)),
            "A": _address(given.get("A", u)),
            "x": _address(x),
            "v": _address(v),
            "u": _address(u),
            "count": ctypes.c_ulong(len(v)),
            "h": ctypes.c_double(h),
            "steps": ctypes.c_ulong(given.get("steps", 0)),
        }
        getattr(self.library, f"exported_{name}")(*(values[key] for _, key in self._arguments(name)))
        return (x, v) if "v" in given else x


def _address(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def check_run(
    prepared: co.PreparedRun,
    x0: Any,
    steps: int,
    folder: Path,
    build: Build,
    *,
    u: Any = (),
    h: float | None = None,
    tangent: bool = True,
    **inputs: Any,
) -> RunInC:
    """Compare the bits of a run, of a step and of every state between two steps, and the derivative of a step.

    The derivative has the rounding of some hundred operations, relative to the largest number.
    """
    exported, h = RunInC(prepared, folder, build, tangent=tangent), prepared.step if h is None else h
    end = h * steps
    sol = prepared.run(x0, (0.0, end), **inputs)
    one = prepared.run(x0, (0.0, h), **inputs).x[-1]
    assert_same(exported.call("run", x0, h, steps=steps, u=u), sol.x[-1])
    assert_same(exported.call("step", x0, h, u=u), one)
    if exported.resumable:
        state, e = np.array(x0, dtype=np.float64), np.zeros(len(x0))
        for k in range(steps):
            state = exported.call("next" if k else "first", state, h, u=u, e=e)
            assert_same(exported.call("finish", state, h, u=u, e=e.copy()), sol.x[k + 1])
    if tangent:
        n = len(sol.x[0])
        v = np.random.default_rng(n).standard_normal((min(n, 4), n))
        _, tangents = prepared.jvp(x0, (0.0, h), {"x0": v.T}, **inputs)
        moved, found = exported.call("step_with_tangents", x0, h, v=v, u=u)
        expected = tangents.x[-1].T
        assert_same(moved, one)
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()
    return exported


def assert_same(found: Any, expected: Any) -> None:
    assert np.array_equal(np.asarray(found).view(np.int64), np.ascontiguousarray(expected).view(np.int64)), (
        found,
        expected,
    )
