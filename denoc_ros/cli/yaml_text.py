"""Safe YAML with the number formats that people write."""

from __future__ import annotations

import re
from typing import Any

import yaml


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader, which also takes 1e5 and 9.0e4 for numbers, as YAML 1.2 does."""


_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
    list('-+.0123456789'),
)


def load_yaml(text: str) -> Any:
    """Return the value of a YAML text; raises yaml.YAMLError."""
    return yaml.load(text, Loader=_Loader)
