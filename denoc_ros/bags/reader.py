"""Bags in: MCAP and db3, with or without metadata.yaml, message by message."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import numpy as np

from denoc_ros.bags.bag_files import BagFiles, chosen_connections, opened_files
from denoc_ros.bags.definitions import DefinitionError, decode, types_of
from denoc_ros.bags.file_kinds import other_kind
from denoc_ros.bags.metadata import METADATA_NAME, ChannelKey, Connection, Qos, named_files
from denoc_ros.bags.storage import MAGIC, is_mcap
from denoc_ros.errors import BagError, ConfigError
from denoc_ros.settings import parameter
from denoc_ros.types import Stamps

Stamp = Literal['header', 'log']
# A file may be compressed on its own, as rosbag2 does when a recording ends.
BAG_SUFFIXES = ('.mcap', '.db3', '.mcap.zstd', '.db3.zstd')
STAMP = parameter(
    'stamp',
    'header',
    'times of a bag: header stamps, or the times of recording (log)',
    choices=('header', 'log'),
)

BAG_FOLDER = 'bag'  # of a session's directory
DESCRIPTION_ATTACHMENT = 'robot_description.urdf'
SESSION_ATTACHMENT = 'session.json'  # what a simulated run was
DESCRIPTION_TOPIC = 'robot_description'
SESSION_DESCRIPTION_TOPIC = '/up/robot_description'  # of the nodes of a session alone
TEXT = 'std_msgs/msg/String'
RawMessage = tuple[str, str, int, bytes]  # topic, type, log time [ns], CDR

MOST_NAMED = 8  # topics of one fault in a message
LOG = logging.getLogger('denoc_ros')


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag."""

    # its topic and message type, `package/msg/Name`
    topic: str
    type: str
    stamp_ns: int  # time by the stamp that was asked for [ns]
    log_ns: int  # when it was recorded [ns]
    raw: bytes  # its CDR bytes
    message: Any  # its fields, as attributes


@dataclass(frozen=True)
class RecordedTopic:
    """A topic as a bag holds it."""

    # the topic and its message type, `package/msg/Name`
    name: str
    type: str
    messages: int  # how many
    definition: str  # ros2msg text with all dependencies, '' where the bag does not carry it
    qos: tuple[Qos, ...]  # what its publishers offered


@dataclass(frozen=True)
class BagContents:
    """Content of a bag: topics, number of messages, first and last log time [ns].

    A topic whose type changed is there once for each type.
    """

    topics: tuple[RecordedTopic, ...]
    messages: int
    start_ns: int
    end_ns: int


def read_bag(
    path: str | Path, topics: Collection[str] | None = None, stamp: Stamp = 'header'
) -> Iterator[BagMessage]:
    """Iterate over the messages of a bag in the order of their log times.

    Parameters
    ----------
    path : str or Path
        A rosbag2 folder, a bare `.mcap` or a bare `.db3` file.
    topics : collection of str, optional
        Only these; each must be in the bag.
    stamp : {'header', 'log'}
        Where `stamp_ns` comes from. A message with no header, or a zero stamp in it, has its
        log time.

    Raises
    ------
    BagError
        When the bag cannot be read; for an unfinished recording it says how to recover it.
    """
    require_stamp(path, stamp)
    return _messages(Path(path), topics, stamp)


def require_stamp(path: str | Path, stamp: Stamp) -> None:
    """Raise BagError unless stamps are asked for that a bag has."""
    if stamp not in STAMP.choices:
        raise BagError(f'{path}: stamp must be header or log, got {stamp!r}')


def read_raw(path: str | Path, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
    """Iterate over (topic, type, log time [ns], CDR bytes) of the messages, by log time.

    For those who take all of a long bag, or all of some topics, in one go: nothing is decoded.
    Arguments and errors as `read_bag`.
    """
    with _open(Path(path)) as bag:
        for one, log_ns, raw in _raw_messages(path, bag, _present(path, bag, topics)):
            yield one.topic, one.type, log_ns, raw


def bag_contents(path: str | Path) -> BagContents:
    """Return the contents of a bag without reading its messages; errors as `read_bag`."""
    with _open(Path(path)) as bag:
        topics: dict[ChannelKey, RecordedTopic] = {}
        for one in bag.connections:
            key = one.topic, one.type
            before = topics[key].messages if key in topics else 0
            text = one.definition.text if one.definition.encoding == 'ros2msg' else ''
            topics[key] = RecordedTopic(*key, before + one.messages, text, one.qos)
        messages = sum(topic.messages for topic in topics.values())
        return BagContents(tuple(topics.values()), messages, *bag.span)


def bag_topics(path: str | Path) -> dict[str, str]:
    """Return the message type of each topic of a bag, the last one of a topic that has several.

    Errors as `read_bag`.
    """
    return {topic.name: topic.type for topic in bag_contents(path).topics}


def read_attachment(path: str | Path, name: str) -> bytes:
    """Return a file attached to a bag of MCAP, e.g. `robot_description.urdf`.

    Raises
    ------
    BagError
        When the bag cannot be read or has no such attachment.
    """
    found: set[str] = set()
    with _open(Path(path)) as bag:
        for attachment in chain.from_iterable(each.attachments() for each in bag.mcap_sources()):
            if attachment.name == name:
                return bytes(attachment.data)
            found.add(attachment.name)
    raise BagError(
        f'{path}: attachment must be one of {", ".join(sorted(found)) or "(none)"}, got {name!r}'
    )


def read_description(path: str | Path) -> str:
    """Return the robot's URDF as attached or as published last, '' if the bag has none.

    Errors as `read_bag`.
    """
    try:
        return read_attachment(path, DESCRIPTION_ATTACHMENT).decode()
    except BagError:
        topics = [topic for topic in bag_topics(path) if topic.endswith(DESCRIPTION_TOPIC)]
        if SESSION_DESCRIPTION_TOPIC in topics:
            topics = [SESSION_DESCRIPTION_TOPIC]
        items = read_bag(path, topics) if topics else iter(())
        published = [str(item.message.data) for item in items if item.type == TEXT]
        return published[-1] if published else ''


def _messages(path: Path, topics: Collection[str] | None, stamp: Stamp) -> Iterator[BagMessage]:
    with _open(path) as bag:
        chosen = _present(path, bag, topics)
        types = {}
        for one in bag.connections:
            if one.topic not in chosen:
                continue
            try:
                types[one.type, one.definition] = types_of(one.type, *one.definition)
            except DefinitionError as error:
                rule = f'{path}: {one.topic}: {error}'
                if topics is not None:
                    raise DefinitionError(rule) from error
                warn_left_out(rule)
        for one, log_ns, raw in _raw_messages(path, bag, chosen):
            store = types.get((one.type, one.definition))
            if store is None:
                continue
            message, _ = decode(store, one.type, raw)
            stamp_ns = (header_stamp_ns(message) if stamp == 'header' else 0) or log_ns
            yield BagMessage(one.topic, one.type, stamp_ns, log_ns, raw, message)


def _raw_messages(
    path: str | Path, bag: BagFiles, topics: Collection[str]
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield (connection, log time [ns], CDR bytes); a database may hold anything else."""
    for one, log_ns, raw in bag.messages(topics):
        if not isinstance(raw, bytes):
            raise BagError(f'{path}: {one.topic}: message must be bytes, got {type(raw).__name__}')
        if not isinstance(log_ns, int):
            raise BagError(
                f'{path}: {one.topic}: time of a message must be a whole number of ns, '
                f'got {log_ns!r}'
            )
        yield one, log_ns, raw


def header_stamp_ns(message: Any) -> int:
    """Return the time in a message's header [ns], 0 when it has none."""
    stamp = getattr(getattr(message, 'header', None), 'stamp', None)
    return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _present(path: str | Path, bag: BagFiles, topics: Collection[str] | None) -> set[str]:
    """Return the topics that are wanted, default all; BagError for those that are not there."""
    present = {one.topic for one in bag.connections}
    if topics is None:
        return present
    if missing := sorted(set(topics) - present):
        faults = {one.topic: f': {one.fault}' for one in bag.left_out}
        raise BagError(
            f'{path}: topics must be among {", ".join(sorted(present)) or "(none)"}, '
            f'got {", ".join(topic + faults.get(topic, "") for topic in missing)}'
        )
    return set(topics)


@contextmanager
def _open(path: Path) -> Iterator[BagFiles]:
    """Open a bag; topics that cannot be read are named once, and not there."""
    source = require_readable(path)
    with only_bag_errors(path):
        parts, has_packed_messages = [source], False
        if source.is_dir():
            about = named_files(source)
            parts, has_packed_messages = (
                [source / name for name in about.names],
                about.has_packed_messages,
            )
            if missing := [part.name for part in parts if not part.exists()]:
                raise BagError(
                    f'{path}: bag must have the files that {METADATA_NAME} names, '
                    f'got none of {", ".join(missing)}'
                )
        with opened_files(parts, has_packed_messages) as bag:
            if bag.left_out and not bag.connections:
                raise BagError(
                    f'{path}: bag must have a topic that can be read, got: {_faults(bag)}'
                )
            if bag.left_out:
                warn_left_out(f'{path}: {_faults(bag)}')
            yield bag


def _faults(bag: BagFiles) -> str:
    """Return why topics are left out, with their messages."""
    found: dict[str, dict[str, int]] = {}
    for one in bag.left_out:
        topics = found.setdefault(one.fault, {})
        topics[one.topic] = topics.get(one.topic, 0) + one.messages
    return '; '.join(f'{_named(topics)}: {fault}' for fault, topics in found.items())


def _named(topics: dict[str, int]) -> str:
    named = [f'{topic} ({count} messages)' for topic, count in topics.items()]
    more = len(named) - MOST_NAMED
    return ', '.join(named[:MOST_NAMED]) + (f' and {more} more' if more > 0 else '')


@lru_cache(maxsize=1000)
def warn_left_out(reason: str) -> None:
    """Log, once for each reason, that topics are left out."""
    LOG.warning('topics are left out: %s', reason)


@contextmanager
def only_bag_errors(path: Path) -> Iterator[None]:
    """Convert every exception during the reading of a bag into a BagError that names it."""
    # damaged files lead the readers below to errors of nearly every kind
    try:
        yield
    except (BagError, GeneratorExit):
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise BagError(f'{path}: bag must be readable, got: {reason}') from error


def require_readable(path: Path) -> Path:
    """Return the path to open for a bag: a finished folder or a file.

    Raises
    ------
    BagError
        When there is none; for an unfinished recording it says how to recover it.
    """
    if not path.exists():
        raise BagError(f'{path}: bag must exist, got nothing there')
    if path.is_dir():
        return _require_finished_folder(bag_folder(path))
    if not path.is_file():
        raise BagError(f'{path}: bag must be a folder or a regular file, got another kind')
    if not path.name.endswith(BAG_SUFFIXES):
        rule = f'{path}: bag must be a rosbag2 folder, a .mcap or a .db3 file'
        kind = other_kind(path)
        raise BagError(f'{rule}, got {kind}' if kind else rule)
    # What does not even begin as MCAP is not unfinished but something else.
    if path.suffix == '.mcap' and is_mcap(path) and not _is_finished(path):
        raise BagError(_unfinished(path))
    return path


def bag_folder(folder: Path) -> Path:
    """Return the bag of a folder: that of a session's directory, else the folder itself."""
    inside = folder / BAG_FOLDER
    if (folder / SESSION_ATTACHMENT).is_file() and not inside.is_dir():
        raise BagError(f'{folder}: run must have its bag in the folder {BAG_FOLDER}, got none')
    return inside if inside.is_dir() and not (folder / METADATA_NAME).is_file() else folder


def _mcap_files(source: Path) -> list[Path]:
    """Return the MCAP files of a bag: those that metadata.yaml names, or all in the folder."""
    if not source.is_dir():
        return [source]
    # Opening a pipe would wait for ever.
    found = sorted(part for part in source.glob('*.mcap') if part.is_file())
    try:
        named = named_files(source).names
    except ConfigError:
        return found
    # the recorder leaves out what somebody spoiled
    return [part for part in found if part.name in named] or found


def _require_finished_folder(folder: Path) -> Path:
    parts = _mcap_files(folder)
    unfinished = [part for part in parts if not _is_finished(part)]
    if (folder / METADATA_NAME).is_file() and not unfinished:
        try:
            named_files(folder)
        except ConfigError as error:
            raise BagError(
                f'{error}; run: denoc recover {folder}' if parts else str(error)
            ) from error
        return folder
    if len(parts) == 1 and not unfinished and not (folder / METADATA_NAME).exists():
        return parts[0]
    if parts:
        raise BagError(_unfinished(folder))
    databases = sorted(file for file in folder.glob('*.db3') if file.is_file())
    if len(databases) == 1:
        return databases[0]
    raise BagError(
        f'{folder}: bag folder must hold {METADATA_NAME} or one .db3 file, '
        f'got {len(databases)} of those'
    )


def _unfinished(path: Path) -> str:
    return (
        f'{path}: bag must be finished, got one that was cut off or damaged; '
        f'run: denoc recover {path}'
    )


def _is_finished(path: Path) -> bool:
    try:
        with path.open('rb') as stream:
            start = stream.read(len(MAGIC))
            stream.seek(max(path.stat().st_size - len(MAGIC), 0))
            return start == stream.read() == MAGIC
    except OSError as error:
        raise BagError(f'{path}: bag must be readable, got: {error.strerror}') from error


def read_thinned(
    path: str | Path,
    topics: Collection[str],
    step_ns: int,
    early_ns: float = -math.inf,
    late_ns: float = math.inf,
) -> Iterator[RawMessage]:
    """Iterate over (topic, type, log time [ns], CDR bytes) of about one message per step.

    Parameters
    ----------
    path : str or Path
        A bag that `read_raw` reads. The index of an MCAP file leads from one message to the next
        that is wanted; bags without one are read whole.
    step_ns : int
        Mean time between the messages kept of a topic, where it has more [ns]. The first message
        of each topic is always kept.
    early_ns, late_ns : float
        What is kept lies between them, since the first message of these topics [ns].
    """
    picker = _Picker(step_ns, early_ns, late_ns)
    with _open(Path(path)) as bag:
        sources = bag.mcap_sources()
        wanted = _present(path, bag, topics)
        if not all(each.contents.is_indexed for each in sources) or sources != [*bag.sources]:
            sources = []
        for source in sources:
            chosen = chosen_connections(source, wanted)
            named = {number: one.topic for number, one in chosen.items()}
            for number, log_ns, raw in source.picked(named, picker.pick):
                yield chosen[number].topic, chosen[number].type, log_ns, raw
        if not sources:
            for one, log_ns, raw in _raw_messages(path, bag, wanted):
                if len(picker.pick(one.topic, np.array([log_ns]))):
                    yield one.topic, one.type, log_ns, raw


class _Picker:
    """Decides which messages are kept."""

    def __init__(self, step_ns: int, early_ns: float, late_ns: float) -> None:
        self._step = max(step_ns, 1)
        self._early, self._late = early_ns, late_ns
        self._due: dict[str, int] = {}
        self._first = -1

    def pick(self, topic: str, times: Stamps) -> list[int]:
        """Return which of a topic's next messages are kept, by their log times (k,) [ns]."""
        kept: list[int] = []
        if self._first < 0:
            self._first = int(times[0])
        if topic not in self._due:
            self._keep(topic, int(times[0]))
            kept.append(0)
        row = max(len(kept), int(np.searchsorted(times, self._first + self._early)))
        while row < len(times):
            row = max(row, int(np.searchsorted(times, self._due[topic])))
            if row == len(times) or times[row] - self._first > self._late:
                break
            self._keep(topic, int(times[row]))
            kept.append(row)
            row += 1
        return kept

    def _keep(self, topic: str, log_ns: int) -> None:
        due = self._due.get(topic, log_ns)
        # a message that comes a little late does not put off those after it
        self._due[topic] = (due if log_ns - due <= self._step // 2 else log_ns) + self._step
