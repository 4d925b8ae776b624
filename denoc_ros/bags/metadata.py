"""metadata.yaml, as rosbag2 of Humble to Jazzy and rosbags read it."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from denoc_ros.errors import ConfigError
from denoc_ros.yaml_text import read_yaml_file

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


def named_files(folder: Path) -> set[str]:
    """Return the names of the files that metadata.yaml names; ConfigError where it is damaged."""
    file = folder / METADATA_NAME
    content = read_yaml_file(file)
    try:
        paths = content['rosbag2_bagfile_information']['relative_file_paths']
        return {Path(path).name for path in paths}
    except (KeyError, TypeError) as error:
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
