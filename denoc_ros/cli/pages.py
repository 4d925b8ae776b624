"""Templates of the HTML pages."""

from __future__ import annotations

from typing import Any


def page_template(name: str) -> Any:
    """Return one of the package's Jinja templates, with HTML escaped."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader('denoc_ros.cli', '.'),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)
