"""Options that actions of `denoc identify` share, and the files of their results."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from functools import partial, wraps
from importlib import import_module
from inspect import getdoc, signature
from pathlib import Path
from typing import Any, get_type_hints

from denoc_ros.cli.arguments import (
    WINDOW,
    add_gravity,
    add_json,
    add_number,
    add_option,
    add_output,
    add_pairs,
    add_settings,
    option_of,
    require,
    settings_of,
    window_findings,
)
from denoc_ros.cli.verb_result import VerbResult
from denoc_ros.cli.verbs import exit_status
from denoc_ros.errors import BagError, ConfigError
from denoc_ros.identification.decay.channel import Channel
from denoc_ros.identification.identification_result import RESULT_FILE, write_result
from denoc_ros.identification.verbs.actions import ACTIONS
from denoc_ros.output_files import Document, write_text
from denoc_ros.pages.html_page import ReportPage
from denoc_ros.pages.provenance import versions
from denoc_ros.settings import declared
from denoc_ros.simulation.recorded.run_files import SESSION_FILE

Asked = tuple[tuple[float, float], int | None]  # band [Hz], number of modes


@dataclass(frozen=True)
class Fit:
    """Result of an action with a verdict, for a text and for a page and a file in a folder."""

    document: Document
    drawn: tuple[Any, ...] = ()  # further arguments of the page
    notes: Sequence[str] = ()  # lines on stderr
    head: Sequence[str] = ()  # lines before the text


@dataclass(frozen=True)
class Action:
    """One action of `denoc identify`.

    Its computation takes options by their names; nothing behind it sees the parsed arguments.
    """

    name: str
    description: str
    add_options: Callable[[argparse.ArgumentParser], None]  # declares its arguments
    fit: Callable[..., Fit | VerbResult]
    # of a Fit's document, the lines for a terminal; None where there is no Fit
    text: Callable[[Document], str] | None = None
    # of a Fit's document, what is drawn and the command line; None: its folder has none
    page: Callable[..., ReportPage] | None = None
    # how an argument of `fit` that is no option follows from all of them
    settings: Mapping[str, Callable[[argparse.Namespace], Any]] = field(default_factory=dict)

    def run(self, args: argparse.Namespace) -> VerbResult:
        """Fit; write the result and its page to a folder if one is named."""
        if getattr(args, 'output', None):
            _require_own_folder(args.output)
        settings = {**SHARED, **self.settings}
        found = self.fit(
            **{
                name: settings[name](args) if name in settings else getattr(args, name)
                for name in signature(self.fit).parameters
            }
        )
        if isinstance(found, VerbResult):
            return found
        assert self.text is not None
        document, notes = {**found.document, 'versions': versions()}, found.notes
        if output := args.output:
            if (output / RESULT_FILE).exists():
                notes = [*notes, f'denoc identify: {output}: the earlier result is replaced']
            write_result(output, document)
            if self.page is not None:
                page = self.page(document, *found.drawn, args.command)
                write_text(output / 'report.html', page.html())
        lines = [*found.head, self.text(document)]
        return VerbResult(document, lines, exit_status(document['verdict']), notes)


def _require_own_folder(output: Path) -> None:
    """Refuse the folder of a run, whose report a result would replace."""
    if (output / SESSION_FILE).exists():
        raise BagError(f'{output}: --output must be a folder of its own, got that of a run')


def add_recording_options(parser: argparse.ArgumentParser, several: bool = False) -> None:
    """Declare which recording is identified, or which several, and where the result goes."""
    if several:
        add_option(parser, 'path BAG', 'bags or tables', type=Path, nargs='+')
    else:
        add_option(parser, 'path BAG', 'a bag or a table', type=Path)
    add_output(parser, 'FOLDER', 'folder for result.yaml and report.html')
    add_json(parser)


def add_channel_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select a signal of a file."""
    group = parser.add_argument_group('the signal')
    own = ('--topic', '--field', '--quantity', '--gain', '--offset', '--unit')
    add_settings(group, Channel, *own, *WINDOW)


def add_verdict_options(parser: argparse.ArgumentParser) -> None:
    """Declare the options that select the modes of the verdict."""
    group = parser.add_argument_group('the verdict (default: that of the strongest mode)')
    add_option(group, '--band LO:HI', 'exit status by all modes between two frequencies [Hz]', '')
    text = 'exit status by the K strongest modes, in the band if one is given'
    add_number(group, '--modes K', int, text, '', 1)


def asked_of(args: argparse.Namespace) -> Asked:
    """Return band [Hz] and number of the requested modes; ConfigError with findings."""
    findings, band = [], (0.0, math.inf)
    if args.band:
        try:
            low, high = (float(end) if end else None for end in args.band.split(':'))
            band = (low or 0.0, math.inf if high is None else high)
        except ValueError:
            findings.append(f'--band must be LO:HI in Hz, got {args.band!r}')
        if not 0.0 <= band[0] < band[1]:
            findings.append(f'--band must have 0 <= LO < HI, got {args.band}')
    ConfigError.raise_any('identify', findings)
    return band, args.modes


def channel_of(args: argparse.Namespace) -> Channel:
    """Return the channel that the options give; ConfigError where they make no sense."""
    findings = ['--gain must not be 0, got 0'] if args.gain == 0.0 else []
    require([*findings, *window_findings(args)])
    return settings_of(Channel, args)


# settings that several actions take
SHARED: Mapping[str, Callable[[argparse.Namespace], Any]] = {
    'channel': channel_of,
    'asked': asked_of,
    'gravity': lambda args: tuple(args.gravity),
    'held': lambda args: args.joints == 'held',
}


def add_robot_options(parser: argparse.ArgumentParser, robot: bool = True) -> None:
    """Declare the options that say of which robot, where its joints stood, and whether held."""
    group = parser.add_argument_group('the robot')
    if robot:
        add_option(
            group,
            '--robot URDF',
            'robot for the damping coefficients; default: the one in the bag',
            '',
        )
    text = "position of a joint [rad, m]; default: the bag's /joint_states, else 0"
    add_pairs(group, '--at JOINT=VALUE', text, float)
    add_option(
        group,
        '--joints',
        'whether the joints were held during the decay; default: held',
        'held',
        choices=('held', 'free'),
    )
    add_gravity(group)


# options that follow from an argument of a computation
BY_ARGUMENT: Mapping[str, Callable[[argparse.ArgumentParser], None]] = {
    'channel': add_channel_options,
    'asked': add_verdict_options,
    'robot': add_robot_options,
}


def action_of(name: str) -> Action:
    """Return an action: the one that its module declares, or that follows from a computation."""
    _, path, pages = ACTIONS[name]
    module = import_module(f'denoc_ros.identification.{path}')
    if hasattr(module, 'DECLARED'):
        found: Action = next(action for action in module.DECLARED if action.name == name)
        return found
    reports = import_module(f'denoc_ros.identification.pages.{pages or "identify_result"}')
    shown = name if pages else 'values'
    text, page = (getattr(reports, f'{shown}_{what}') for what in ('text', 'page'))
    return computed_action(name, getattr(module, f'identify_{name}'), text, page)


def computed_action(
    name: str,
    compute: Callable[..., tuple[Any, ...]],
    text: Callable[[Document], str],
    page: Callable[..., ReportPage],
) -> Action:
    """Return the action of a computation: description and options are its own.

    Parameters
    ----------
    compute : callable
        Of a `path`, and of arguments that are called as in `SHARED` or `BY_ARGUMENT`, or are
        classes of settings, of which each field is an option. Returns the document of a result,
        and what its page draws. Its docstring, up to what it returns, describes the action.
    text, page : callable
        As of `Action`.
    """
    kinds: dict[str, type] = {
        argument: kind
        for argument, kind in get_type_hints(compute).items()
        if argument not in SHARED and isinstance(kind, type) and is_dataclass(kind)
    }

    def add_options(parser: argparse.ArgumentParser) -> None:
        add_recording_options(parser)
        for argument in signature(compute).parameters:
            if argument in BY_ARGUMENT:
                BY_ARGUMENT[argument](parser)
        for kind in kinds.values():
            group = parser.add_argument_group(f'the {name}')
            add_settings(group, kind, *(option_of(*each) for each in declared(kind).items()))

    @wraps(compute)
    def fit(**given: Any) -> Fit:
        document, *drawn = compute(**given)
        return Fit(document, tuple(drawn))

    described = ' '.join((getdoc(compute) or '').partition('\n\nReturns\n')[0].split())
    settings = {argument: partial(settings_of, kind) for argument, kind in kinds.items()}
    return Action(name, described.replace('%', '%%'), add_options, fit, text, page, settings)
