"""Guarded callbacks: a failure is logged, counted and answered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters

LONGEST_REASON = 1000  # characters of what a message may have put into an error
# how service types say that they failed, and why
FAILED = {'success': False, 'successful': False}
REASONS = ('message', 'reason', 'failure_reason')

Service = Callable[[Any, Any], Any]


class Guard:
    """Keeps exceptions from ending the process whose executor calls back.

    Parameters
    ----------
    log : callable
        Takes the first failure of each kind.

    Attributes
    ----------
    failures : Counter
        Failed calls, by what was called.
    last : str
        The last failure.
    reported : int
        How many of them /diagnostics has warned of.
    """

    def __init__(self, log: Callable[[str], None]) -> None:
        self.failures: Counter[str] = Counter()
        self.last = ''
        self.reported = 0
        self._log = log
        self._logged: set[tuple[str, str]] = set()

    def note(self, what: str, error: Exception) -> str:
        """Count a failure, log the first of its kind; return it in words."""
        kind = type(error).__name__
        text = f'{kind}: {error}'.encode(errors='replace').decode()[:LONGEST_REASON]
        self.failures[what] += 1
        self.last = f'{what} failed, got {text}'
        if (what, kind) not in self._logged:
            self._logged.add((what, kind))
            self._log(f'{self.last}{_place(error)}')
        return text

    def calling(self, what: str, callback: Callable[..., Any]) -> Callable[..., Any]:
        """Return a callback that fails for nobody; it then returns None."""

        def guarded(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.note(what, error)
                return None

        return guarded

    def handling(self, what: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a guarded callback of a subscription: rclpy counts its arguments."""
        call = self.calling(what, callback)

        def guarded(message: Any) -> None:
            call(message)

        return guarded

    def ticking(self, what: str, callback: Callable[[], None]) -> Callable[[], None]:
        """Return a guarded callback of a timer: rclpy counts its arguments."""
        call = self.calling(what, callback)

        def guarded() -> None:
            call()

        return guarded

    def serving(self, what: str, kind: Any, callback: Service) -> Service:
        """Return a callback of a service that answers a failure with a failure.

        Parameters
        ----------
        what : str
            For the log.
        kind : type
            Of the service.
        callback : callable
            Takes request and response.
        """

        def guarded(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except Exception as error:
                return _refusal(kind.Response(), self.note(what, error))

        served = _one_by_one(guarded) if kind is SetParameters else guarded
        served.guards = callback  # type: ignore[attr-defined]
        return served


def _place(error: Exception) -> str:
    """Return where an error was raised, for the log."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return ''
    return f' ({trace.tb_frame.f_code.co_filename}:{trace.tb_lineno})'


def _refusal(response: Any, reason: str) -> Any:
    """Say in a response of any type that the request failed, and why where it can be said."""
    parts = [response, *(getattr(response, name, None) for name in ('result', 'results'))]
    for part in parts:
        for name, value in {**FAILED, **dict.fromkeys(REASONS, reason)}.items():
            if hasattr(part, name):
                setattr(part, name, value)
    if isinstance(response, SetParameters.Response):
        response.results = [SetParametersResult(successful=False, reason=reason)]
    return response


def _one_by_one(callback: Service) -> Service:
    """Return a service that sets each parameter by a call of its own: each has its result."""

    def guarded(request: Any, response: Any) -> Any:
        for parameter in request.parameters:
            one = callback(SetParameters.Request(parameters=[parameter]), SetParameters.Response())
            response.results.extend(one.results)
        return response

    return guarded
