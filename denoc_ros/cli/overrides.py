"""What-if on the command line: dotted paths of the model, and payloads."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from denoc_ros.errors import ConfigError


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Declare `--set` and `--payload`."""
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='PATH=VALUE',
        help='change a number of the model, such as beam.upper_arm.y.ei=9e4; repeatable',
    )
    parser.add_argument(
        '--payload',
        action='append',
        default=[],
        metavar='LINK=MASS[,X,Y,Z]',
        help='hang a mass [kg] on a link, its centre in the link frame [m]; repeatable',
    )


def overrides_of(settings: Sequence[str], payloads: Sequence[str]) -> dict[str, Any]:
    """Return overrides by dotted path.

    Parameters
    ----------
    settings : sequence of str
        `path=value` each.
    payloads : sequence of str
        `link=mass` or `link=mass,x,y,z` each.

    Raises
    ------
    ConfigError
        With every text that is neither.
    """
    from denoc_ros.cli.config import parse_setting

    findings: list[str] = []
    overrides: dict[str, Any] = {}
    for setting in settings:
        if (parsed := parse_setting(setting, findings)) is not None:
            overrides['.'.join(parsed[0])] = parsed[1]
    for payload in payloads:
        overrides.update(_payload(payload, findings))
    if findings:
        raise ConfigError('command line', findings)
    return overrides


def _payload(text: str, findings: list[str]) -> dict[str, Any]:
    link, _, numbers = text.partition('=')
    try:
        values = [float(number) for number in numbers.split(',')]
    except ValueError:
        values = []
    if not link or len(values) not in (1, 4):
        findings.append(f'--payload must be LINK=MASS or LINK=MASS,X,Y,Z, got {text!r}')
        return {}
    mass, *centre = values
    placed: dict[str, Any] = {f'payload.{link}.mass': mass}
    return {**placed, f'payload.{link}.com': centre} if centre else placed
