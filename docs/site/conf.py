"""Sphinx configuration of the documentation site, which `make site` builds from what `write_sources.py` writes."""

import inspect
import os
import sys
import tomllib
from pathlib import Path
from typing import Any

import coadjoint

root = Path(coadjoint.__file__).parents[2]
sys.path.append(str(root / "docs" / "site"))
from formulas import in_restructured_text  # noqa: E402

urls = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"].get("urls", {})

project = "coadjoint"
author = "The coadjoint developers"
copyright = "The coadjoint developers"
release = coadjoint.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx_design",
    "sphinx_copybutton",
]
root_doc = "index"
exclude_patterns = ["extra"]
mathjax_path = "mathjax/tex-chtml.js"  # copied by write_sources.py: no other server is asked
suppress_warnings = ["config.cache"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
# Only the code of examples is copied, without prompts and results.
copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True
copybutton_exclude = ".linenos, .gp"

mathjax3_config = {"options": {"enableMenu": False}}

default_role = "py:obj"
add_module_names = False
autodoc_typehints = "none"
numpydoc_show_class_members = False
toc_object_entries = False

html_theme = "pydata_sphinx_theme"
html_title = "coadjoint"
html_context = {"default_mode": "auto"}
html_favicon = "_static/favicon.svg"
html_static_path = ["_static"]
html_extra_path = ["extra"]
html_css_files = ["coadjoint.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    **({"github_url": urls["Source"]} if "Source" in urls else {}),
    "header_links_before_dropdown": 6,
    "navbar_align": "left",
    "navigation_with_keys": False,
    "show_toc_level": 2,
    # Pictures of systems are wide.
    "secondary_sidebar_items": {"**": ["page-toc"]} | {f"systems/{name}": [] for name in coadjoint.systems.names()},
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}

# Where this build is published; only there are the others that the switcher leads to.
if published := os.environ.get("COADJOINT_SITE"):
    html_theme_options |= {
        "switcher": {"json_url": "_static/switcher.json", "version_match": published},
        "navbar_end": ["version-switcher", "theme-switcher", "navbar-icon-links"],
    }
    html_js_files = ["versions.js"]


def set_formulas(app: Any, what: str, name: str, subject: Any, options: Any, lines: list[str]) -> None:
    """Replace the formulas of a docstring by mathematics."""
    lines[:] = in_restructured_text(lines)


def set_signature(
    app: Any, what: str, name: str, subject: Any, options: Any, signature: str, returned: Any
) -> tuple[str, Any] | None:
    """Return the signature of a scheme, in place of that of the `__new__` of all schemes."""
    if what != "class" or signature != "(*arguments, **parameters)":
        return None
    found = inspect.signature(subject)
    bare = [parameter.replace(annotation=inspect.Parameter.empty) for parameter in found.parameters.values()]
    return str(found.replace(parameters=bare, return_annotation=inspect.Signature.empty)), returned


def setup(app: Any) -> None:
    """Set formulas before numpydoc divides a docstring into sections, and signatures before it reads them."""
    app.connect("autodoc-process-docstring", set_formulas, priority=100)
    app.connect("autodoc-process-signature", set_signature, priority=100)
