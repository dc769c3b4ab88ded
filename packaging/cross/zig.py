"""The compiler of zig.cmake: zig's Clang, with options of GCC and Clang that zig spells otherwise or does not have."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

EXPORTED = "-exported_symbol"


def options(given: list[str]) -> list[str]:
    """Return the options as zig reads them."""
    kept = [option for option in given if not option.startswith("-mtune=")]
    kept = [
        f"-mcpu=x86_64{option[13:].replace('-', '_')}" if option[:13] == "-march=x86-64" else option for option in kept
    ]
    # zig links bundles of macOS, which are not linked with anything, as programs.
    kept = ["-dynamiclib" if option == "-bundle" else option for option in kept]
    if EXPORTED in kept:
        # zig's linker for macOS has no list of exports: what is not hidden is exported.
        at = kept.index(EXPORTED)
        del kept[at - 1 : at + 3]
    # In builds that are not optimized, zig would check undefined behavior.
    return ["-fno-sanitize=undefined", *kept]


if __name__ == "__main__":
    found = find_spec("ziglang")
    if found is None or found.origin is None:
        sys.exit(f"ziglang is not installed for {sys.executable}")
    zig = str(Path(found.origin).with_name("zig.exe" if os.name == "nt" else "zig"))
    sys.exit(os.spawnv(os.P_WAIT, zig, [zig, "c++", *options(sys.argv[1:])]))
