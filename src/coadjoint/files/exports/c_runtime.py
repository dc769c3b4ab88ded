"""Headers of C in the package, and the functions of them that exported runs call: those of kernels, for one number."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path

SECTION = re.compile(r"^/\* \[(\w+)\] \*/\n", re.MULTILINE)
NAME = re.compile(r"\bcoadjoint_\w+")
INCLUDES = """#ifndef COADJOINT_H
#define COADJOINT_H
#include <float.h>
#include <stdint.h>
#if !defined(__STDC_HOSTED__) || __STDC_HOSTED__
#include <math.h>
#else /* freestanding: whoever links gives sqrt, and fma if the processor has it */
#ifdef __cplusplus
extern "C" {
#endif
double sqrt(double x);
double fma(double a, double b, double c);
#ifdef __cplusplus
}
#endif
#endif
#if DBL_MANT_DIG != 53 || (defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD < 0 || FLT_EVAL_METHOD == 2))
#error "double must have 53 bits, without excess precision: for 32-bit x86 give -msse2 -mfpmath=sse"
#endif
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "-ffast-math changes the meaning of sums; compile without it"
#endif
#if defined(__clang__) /* a product and a sum are fused only where this is written */
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
"""

FREE_BODY = Path(__file__).with_name("coadjoint.h")


def includes(defined: Sequence[str]) -> str:
    """Return the beginning of the code, with definitions."""
    return "\n".join([INCLUDES, *defined, ""])


@cache
def _sections() -> dict[str, str]:
    """Return the text of each section, in an order in which none calls a later one."""
    text = Path(__file__).with_name("step.h").read_text(encoding="utf-8")
    pieces = SECTION.split(text)
    found = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    inside = FREE_BODY.read_text(encoding="utf-8").partition("#elif defined(COADJOINT_BITS)")[2]
    body = inside.partition("\n")[2].rpartition("#endif")[0].replace("coadjoint_##", "coadjoint_free_##")
    body = body.replace("NAN", "coadjoint_nan()")
    found["free_body"] = f"#define COADJOINT_BITS 64\n{body}#define coadjoint_free_body\n"
    found["body_changes"] = found.pop("body_changes")
    return found


@cache
def _defined() -> dict[str, str]:
    """Return the section of each function and structure."""
    found = {}
    for section, text in _sections().items():
        for name in re.findall(
            r"^(?:static (?:inline )?[^(]*?|struct )\b(coadjoint_\w+)(?:\(| \{)", text, re.MULTILINE
        ):
            found[name] = section
    found["coadjoint_free_body_jacobian"] = "free_body"
    return found


def runtime(body: str) -> str:
    """Return the sections whose functions a text calls, and those that these call."""
    sections, needed, pending = _sections(), set(), [body]
    while pending:
        for name in set(NAME.findall(pending.pop())):
            section = _defined().get(name)
            if section is not None and section not in needed:
                needed.add(section)
                pending.append(sections[section])
    return "\n".join(sections[name].strip() + "\n" for name in sections if name in needed)


def free_body_header(name: str = FREE_BODY.name) -> str:
    """Return the header of free bodies for a file of this name, which includes itself by its name."""
    if not name.isprintable() or any(sign in name for sign in '"\\'):
        raise ValueError(f"{name!r} cannot be included; give a name without quotes, backslashes and control characters")
    return FREE_BODY.read_text(encoding="utf-8").replace(f'#include "{FREE_BODY.name}"', f'#include "{name}"')
