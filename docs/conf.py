"""Sphinx settings."""

import re

project = "motionmend"
author = "The motionmend authors"
copyright = "2026, the motionmend authors, Apache-2.0"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "motionmend"
exclude_patterns = ["_build"]
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"


def _spans(line):
    """A line's parts, and whether each stands between backticks."""
    return [(part, part.startswith("`")) for part in re.split("(`[^`]*`)", line)]


def as_lists(app, what, name, obj, options, lines):  # noqa: ARG001 (Sphinx's signature)
    """Our docstrings' `name : what it is` lines as lists, and their underlined words as bold ones."""
    found, in_list = [], False
    for at, line in enumerate(lines):
        below = lines[at + 1] if at + 1 < len(lines) else ""
        line = "".join(part if odd else part.replace("|", r"\|") for part, odd in _spans(line))
        if line and re.fullmatch("-{4,}", below):
            found += ["", f"**{line}**", ""]
        elif re.fullmatch("-{4,}", line):
            in_list = False
        elif item := re.match(r"(\w+(?:,? (?:`?\w+`? )?\w+)*) : (.+)", line):
            found += ([] if in_list else [""]) + [f"- **{item[1].replace('`', '')}**: {item[2]}"]
            in_list = True
        else:
            in_list = in_list and bool(line)
            found += ["  " + line.strip() if in_list else line]
    lines[:] = found


def setup(app):
    app.connect("autodoc-process-docstring", as_lists)
