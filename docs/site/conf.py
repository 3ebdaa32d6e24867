# SPDX-License-Identifier: Apache-2.0
"""Configuration of Sphinx; `tools/documentation/site/build_site.py` copies the pages beside it and builds them."""

import os
import sys
from pathlib import Path

ROOT = Path(os.environ["STRIPE_NEWTON_ROOT"])
sys.path[:0] = [str(ROOT), str(ROOT / "kernels"), str(ROOT / "tasks")]

project = "stripe-newton"
author = "The stripe-newton authors"
copyright = "the stripe-newton authors, Apache-2.0"
version = release = os.environ["STRIPE_NEWTON_VERSION"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
root_doc = "contents"
templates_path = ["_templates"]
html_static_path = ["_static"]
highlight_language = "text"
nitpicky = False

myst_heading_anchors = 4
myst_enable_extensions = ["attrs_inline"]

html_theme = "furo"
html_title = f"stripe-newton {version}"
html_favicon = "_static/icon.svg"
html_css_files = ["site.css"]
html_js_files = ["versions.js"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/search.html",
        "versions.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "undoc-members": False, "show-inheritance": True}
toc_object_entries_show_parents = "hide"
napoleon_use_rtype = False
napoleon_use_ivar = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
copybutton_prompt_text = r"\$ |>>> "
copybutton_prompt_is_regexp = True

OF_ALL_CONFIGS = ("copy", "from_dict", "replace", "to_dict", "validate", "problems", "OPEN", "MAY_BE_NONE")


def skip_member(app, what, name, obj, skip, options):
    """Leave out what every config class has; the protocol ``Config`` explains it once."""
    explains = getattr(obj, "__qualname__", "").startswith("Config.")
    return True if name in OF_ALL_CONFIGS and not explains else None


def hide_constructor(app, what, name, obj, options, signature, returns):
    """Config classes and dataclasses list their fields below, so their constructors have no signature."""
    return ("", None) if what == "class" and hasattr(obj, "__dataclass_fields__") else None


def setup(app):
    app.connect("autodoc-skip-member", skip_member)
    app.connect("autodoc-process-signature", hide_constructor)
