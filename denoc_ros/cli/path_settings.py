"""Values put into a configuration by dotted paths, as `--set path=value` gives them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from denoc_ros.model.numbers import FAMILIES
from denoc_ros.yaml_text import YamlError, load_yaml


def parse_setting(setting: str, findings: list[str]) -> tuple[list[str], Any] | None:
    """Return the names and the value of `path=value`; None, with a finding, for another text."""
    path, equals, text = setting.partition('=')
    names = path.split('.')
    if not equals or not all(names):
        findings.append(f'--set must be path=value with a dotted path, got {setting!r}')
        return None
    try:
        return names, load_yaml(text)
    except YamlError as error:
        findings.append(f'--set {path}: {error}')
        return None


def apply_setting(raw: dict[str, Any], setting: str, findings: list[str]) -> None:
    """Put one `path=value` into the mapping; model paths go to the plant and to `model`."""
    parsed = parse_setting(setting, findings)
    if parsed is None:
        return
    names, value = parsed
    path = '.'.join(names)
    targets = [['model', path], ['plant', path]] if names[0] in FAMILIES else [names]
    for target in targets:
        _set(raw, target, value, findings, setting)


def _set(
    raw: dict[str, Any], names: Sequence[str], value: Any, findings: list[str], setting: str
) -> None:
    here = raw
    for name in names[:-1]:
        step = here.get(name)
        if step is None:
            step = here[name] = {}
        if not isinstance(step, dict):
            findings.append(f'--set must name a value below a mapping, got {setting!r}')
            return
        here = step
    here[names[-1]] = value
