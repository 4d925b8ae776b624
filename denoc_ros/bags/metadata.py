"""metadata.yaml, as rosbag2 of Humble to Jazzy and rosbags read it."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import yaml
from rosbags.rosbag2.metadata import parse_qos

from denoc_ros.errors import ConfigError
from denoc_ros.yaml_text import load_yaml, read_yaml_file

METADATA_NAME = 'metadata.yaml'
# the newest version that Humble writes: later ones only add keys that nothing here needs
_VERSION = 5
ChannelKey = tuple[str, str]  # name and message type of a topic, whose type may change


@dataclass(frozen=True)
class Qos:
    """The quality of service a publisher offers, in rmw's integers, which all versions read."""

    history: int = 1
    depth: int = 10
    reliability: int = 1
    durability: int = 2
    liveliness: int = 1

    def as_dict(self) -> dict[str, object]:
        """Return the profile with the keys of `offered_qos_profiles`."""
        return {
            'history': self.history,
            'depth': self.depth,
            'reliability': self.reliability,
            'durability': self.durability,
            'deadline': {'sec': 0, 'nsec': 0},
            'lifespan': {'sec': 0, 'nsec': 0},
            'liveliness': self.liveliness,
            'liveliness_lease_duration': {'sec': 0, 'nsec': 0},
            'avoid_ros_namespace_conventions': False,
        }


def qos_text(profiles: Iterable[Qos]) -> str:
    """Return `offered_qos_profiles`: yaml within a string, empty for no profile."""
    rows = [profile.as_dict() for profile in profiles]
    return yaml.safe_dump(rows, sort_keys=False).strip() if rows else ''


@lru_cache(maxsize=32)
def qos_profiles(text: str) -> tuple[Qos, ...]:
    """Return the profiles of `offered_qos_profiles`; ValueError for a text that has none."""
    try:
        return tuple(
            Qos(
                profile.history.value,
                profile.depth,
                profile.reliability.value,
                profile.durability.value,
                profile.liveliness.value,
            )
            for profile in parse_qos(load_yaml(text) if text else [])
        )
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f'got {text!r:.60}') from error


class Definition(NamedTuple):
    """The definition of a message type in a file: `ros2msg` or `ros2idl`, and its text."""

    encoding: str
    text: str


@dataclass(frozen=True)
class Connection:
    """A topic in one file of a bag."""

    number: int  # in its file
    topic: str
    type: str  # `package/msg/Name`
    messages: int
    definition: Definition
    qos: tuple[Qos, ...] = ()  # what its publishers offered
    fault: str = ''  # why its messages cannot be read, '' where they can


def connection(
    number: int,
    topic: str,
    kind: str,
    messages: int,
    encoding: str,
    definition: tuple[str, str],
    qos: str,
    fault: str = '',
) -> Connection:
    """Return a topic as a file describes it, with the fault for which it cannot be read."""
    profiles: tuple[Qos, ...] = ()
    if fault:
        pass
    elif encoding != 'cdr':
        fault = f'its messages must be encoded as cdr, got {encoding!r}'
    elif not kind:
        fault = 'it must have a schema, which names its message type, got none'
    else:
        try:
            profiles = qos_profiles(qos)
        except ValueError as error:
            fault = f'its quality of service must be readable, {error}'
    package, _, name = kind.partition('/')
    if name and '/' not in name:  # as ROS 1 and several writers have it
        kind = f'{package}/msg/{name}'
    return Connection(number, topic, kind, messages, Definition(*definition), profiles, fault)


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: name, message type and the offered QoS as yaml text."""

    name: str
    type: str
    qos: str = ''
    encoding: str = 'cdr'

    @property
    def key(self) -> ChannelKey:
        """Name and type, which no other topic of a bag has."""
        return self.name, self.type


@dataclass
class FileContents:
    """Content of one file of a bag: times in ns, messages by channel; its bytes once finished."""

    name: str
    start_ns: int = 0
    end_ns: int = 0
    messages: int = 0
    counts: Counter[ChannelKey] = field(default_factory=Counter)
    size: int = 0

    def add(self, channel: ChannelKey, stamp_ns: int) -> None:
        """Count one message."""
        if not self.messages:
            self.start_ns = self.end_ns = stamp_ns
        elif stamp_ns < self.start_ns:
            self.start_ns = stamp_ns
        elif stamp_ns > self.end_ns:
            self.end_ns = stamp_ns
        self.counts[channel] += 1
        self.messages += 1


def topic_counts(files: Iterable[FileContents]) -> Counter[str]:
    """Return the messages of files by topic."""
    found: Counter[str] = Counter()
    for part in files:
        for (name, _), count in part.counts.items():
            found[name] += count
    return found


def metadata_text(topics: Sequence[Topic], files: Sequence[FileContents]) -> str:
    """Return the text of metadata.yaml for topics and the files they were written to."""
    filled = [part for part in files if part.messages]
    start = min((part.start_ns for part in filled), default=0)
    end = max((part.end_ns for part in filled), default=0)
    counts = sum((part.counts for part in files), Counter[ChannelKey]())
    information = {
        'version': _VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(counts.values()),
        'topics_with_message_count': [
            {'topic_metadata': _topic_row(topic), 'message_count': counts[topic.key]}
            for topic in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [part.name for part in files],
        'files': [_file_row(part) for part in files],
    }
    return yaml.safe_dump({'rosbag2_bagfile_information': information}, sort_keys=False)


def write_metadata(folder: Path, text: str) -> None:
    """Put metadata.yaml into a folder, whole or not at all."""
    unfinished = folder / f'.{METADATA_NAME}.tmp'
    try:
        with unfinished.open('w', encoding='utf-8') as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        unfinished.replace(folder / METADATA_NAME)
    finally:
        unfinished.unlink(missing_ok=True)
    # The names of the bag's files are in the folder, which the disk has apart from the files.
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@dataclass(frozen=True)
class NamedFiles:
    """The files of a bag by its metadata.yaml."""

    names: tuple[str, ...]  # in the order of their times
    has_packed_messages: bool = False  # whether each message is compressed by zstd


def named_files(folder: Path) -> NamedFiles:
    """Return the files that metadata.yaml names; ConfigError where it is damaged."""
    file = folder / METADATA_NAME
    content = read_yaml_file(file)
    try:
        about = content['rosbag2_bagfile_information']
        names = tuple(Path(path).name for path in about['relative_file_paths'])
        mode = str(about.get('compression_mode') or 'none').lower()
        form = about.get('compression_format')
        if mode != 'none' and form != 'zstd':
            raise ConfigError(str(file), [f'compression_format must be zstd, got {form!r}'])
        return NamedFiles(names, mode == 'message')
    except (KeyError, TypeError, AttributeError) as error:
        rule = f'the file must name the files of the bag, got {content!r:.60}'
        raise ConfigError(str(file), [rule]) from error


def _topic_row(topic: Topic) -> dict[str, str]:
    return {
        'name': topic.name,
        'type': topic.type,
        'serialization_format': topic.encoding,
        'offered_qos_profiles': topic.qos,
    }


def _file_row(part: FileContents) -> dict[str, object]:
    return {
        'path': part.name,
        'starting_time': {'nanoseconds_since_epoch': part.start_ns},
        'duration': {'nanoseconds': part.end_ns - part.start_ns},
        'message_count': part.messages,
    }
