"""Recovery of a truncated recording as a complete bag."""

from __future__ import annotations

import filecmp
import re
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import Writer

from denoc_ros.bags.metadata import (
    ChannelKey,
    FileContents,
    Topic,
    metadata_text,
    topic_counts,
    write_metadata,
)
from denoc_ros.bags.storage import CompleteRecords, DiskFile, is_mcap, library_name
from denoc_ros.errors import BagError

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Recovered:
    """The result of a recovery."""

    path: Path  # the new bag
    files: tuple[FileContents, ...]  # what each of its files holds
    torn: tuple[str, ...]  # names of the files that lack their beginning or their end
    damaged_chunks: int  # chunks left out because their content is not what was written
    left_out: tuple[str, ...] = ()  # names of the files that are none of MCAP
    # messages left out because the file does not say what they are: it lacks their channel, or
    # the channel's schema
    unknown_messages: int = 0

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        return dict(topic_counts(self.files))

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(part.messages for part in self.files)


def recover(
    path: str | Path, out: str | Path | None = None, progress: Progress | None = None
) -> Recovered:
    """Rebuild a bag of MCAP, finished or not, from its complete records.

    The original is only read. Files in its folder that are none of MCAP are left out. The new bag
    appears whole or not at all; doing it again gives the same bytes and is no error.

    Parameters
    ----------
    out : str or Path, optional
        A new rosbag2 folder, or for a single file a new `.mcap`; default: the path's name with
        `_recovered`, a folder beside it.
    progress : callable, optional
        Is told the size [bytes] of each file as it is done.

    Raises
    ------
    BagError
        When no file is one of MCAP, or `out` exists and is something else.
    """
    source = Path(path)
    found = _parts(source)
    parts = [part for part in found if is_mcap(part)]
    if not any(part.stat().st_size for part in parts):
        raise BagError(f'{source}: must be an MCAP file, got an empty one or another kind')
    stem = source.name if source.is_dir() else source.stem
    target = source.with_name(f'{stem}_recovered') if out is None else Path(out)
    if target.suffix == '.mcap' and len(parts) > 1:
        raise BagError(f'{target}: output of {len(parts)} files must be a folder, got a file name')
    unfinished = target.with_name(f'.{target.name}.unfinished')
    try:
        _remove(unfinished)
        unfinished.parent.mkdir(parents=True, exist_ok=True)
        result = replace(
            _rebuild(parts, unfinished, target, progress),
            left_out=tuple(part.name for part in found if part not in parts),
        )
        _publish(unfinished, target)
    except OSError as error:
        raise BagError(
            f'{source}: recovery must be able to write {target}, got: {error}'
        ) from error
    finally:
        with suppress(OSError):
            _remove(unfinished)
    return result


def _parts(source: Path) -> list[Path]:
    if source.is_dir():
        parts = sorted((p for p in source.glob('*.mcap') if p.is_file()), key=_natural)
    else:
        parts = [source] if source.is_file() else []
    packed = [*source.glob('*.mcap.zstd')] if source.is_dir() else [source]
    if packed and packed[0].name.endswith('.zstd'):
        raise BagError(
            f'{source}: must be a .mcap file or a folder that holds some, got {packed[0].name}: '
            f'unpack it with zstd -d'
        )
    if not parts:
        raise BagError(f'{source}: must be a .mcap file or a folder that holds some, got none')
    return parts


def _natural(path: Path) -> list[tuple[int, str]]:
    pieces = re.split(r'(\d+)', path.name)
    return [(int(piece) if piece.isdigit() else -1, piece) for piece in pieces]


def _rebuild(
    parts: list[Path], folder: Path, target: Path, progress: Progress | None
) -> Recovered:
    bare = target.suffix == '.mcap'
    if not bare:
        folder.mkdir()
    copies = []
    for part in parts:
        name = target.name if bare else part.name
        copies.append(_Copy(part, folder if bare else folder / name, name))
        if progress is not None:
            progress(part.stat().st_size)
    if not bare:
        topics = list(dict.fromkeys(topic for copy in copies for topic in copy.topics))
        write_metadata(folder, metadata_text(topics, [copy.contents for copy in copies]))
    return Recovered(
        target,
        tuple(copy.contents for copy in copies),
        tuple(part.name for part, copy in zip(parts, copies, strict=True) if not copy.finished),
        sum(copy.damaged_chunks for copy in copies),
        unknown_messages=sum(copy.unknown_messages for copy in copies),
    )


def _publish(unfinished: Path, target: Path) -> None:
    if not target.exists():
        unfinished.rename(target)
    elif not _same(unfinished, target):
        raise BagError(f'{target}: output must not exist yet, got an existing one that differs')


def _same(one: Path, other: Path) -> bool:
    if not one.is_dir():
        return other.is_file() and filecmp.cmp(one, other, shallow=False)
    names = sorted(path.name for path in one.iterdir())
    if not other.is_dir() or names != sorted(path.name for path in other.iterdir()):
        return False
    return not any(filecmp.cmpfiles(one, other, names, shallow=False)[1:])


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


class _Copy:
    """Copies the complete records of one file into a new one, with times and sequence kept."""

    def __init__(self, source: Path, target: Path, name: str) -> None:
        self.contents = FileContents(name)
        self.topics: list[Topic] = []
        self.unknown_messages = 0
        self._schemas: dict[int, int] = {0: 0}
        self._types: dict[int, str] = {0: ''}
        self._channels: dict[int, tuple[int, ChannelKey]] = {}
        with source.open('rb') as stream:
            disk = DiskFile(target)
            try:
                self._writer = Writer(disk)
                self._copy(CompleteRecords(stream))
            finally:
                disk.close()

    def _copy(self, records: CompleteRecords) -> None:
        started = False
        for record in records:
            if not started:
                # the one that readers of rosbag2 ask for, whatever a damaged header says
                self._writer.start('ros2', library_name())
                started = True
            self._take(record)
        if not started:
            self._writer.start('ros2', library_name())
        self._writer.finish()
        self.finished = records.finished
        self.damaged_chunks = records.damaged_chunks

    def _take(self, record: object) -> None:
        if isinstance(record, Message):
            self._take_message(record)
        elif isinstance(record, Channel):
            self._take_channel(record)
        elif isinstance(record, Schema) and record.id not in self._schemas:
            self._types[record.id] = record.name
            self._schemas[record.id] = self._writer.register_schema(
                record.name, record.encoding, record.data
            )
        elif isinstance(record, Attachment):
            self._writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)

    def _take_channel(self, record: Channel) -> None:
        if record.id in self._channels or record.schema_id not in self._schemas:
            return
        number = self._writer.register_channel(
            record.topic, record.message_encoding, self._schemas[record.schema_id], record.metadata
        )
        qos = record.metadata.get('offered_qos_profiles', '')
        topic = Topic(record.topic, self._types[record.schema_id], qos, record.message_encoding)
        self._channels[record.id] = (number, topic.key)
        self.topics.append(topic)

    def _take_message(self, record: Message) -> None:
        if record.channel_id not in self._channels:
            self.unknown_messages += 1
            return
        number, channel = self._channels[record.channel_id]
        self._writer.add_message(
            number, record.log_time, record.data, record.publish_time, record.sequence
        )
        self.contents.add(channel, record.log_time)
