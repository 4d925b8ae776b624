"""The HTML pages' templates."""

from __future__ import annotations

from typing import Any


def render_page(template: str, **values: Any) -> str:
    """Return one of the package's Jinja templates filled in, with HTML escaped."""
    from jinja2 import Environment, PackageLoader

    environment = Environment(
        loader=PackageLoader('denoc_ros.cli', '.'),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return str(environment.get_template(template).render(**values))
