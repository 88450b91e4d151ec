"""Texts from jinja2 templates, whose loops and choices are in them."""

import re
from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined


@cache
def environment(package: str) -> Environment:
    """The templates of a package's folder `templates/`."""
    return Environment(
        loader=PackageLoader(package),
        extensions=["jinja2.ext.do"],
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def render(package: str, template: str, **values: object) -> str:
    """Render a template; omitted parts leave no empty lines."""
    return re.sub(r"\n{3,}", "\n\n", environment(package).get_template(template).render(values))


def one_line(words: str) -> str:
    """Return words that fit a comment of C or Verilog: one line of ASCII."""
    known = "".join(c if c.isalnum() or c in " ._:=,+-()/" else "?" for c in words)
    return known.encode("ascii", "replace").decode()
