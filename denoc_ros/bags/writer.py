"""Bags out: MCAP that rosbag2, rosbags, mcap-ros2-support and Foxglove read."""

from __future__ import annotations

from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

from denoc_ros.bags.definitions import encode, message_definition
from denoc_ros.bags.metadata import (
    ChannelKey,
    FileContents,
    Qos,
    Topic,
    metadata_text,
    qos_text,
    write_metadata,
)
from denoc_ros.bags.storage import COMPRESSIONS, Identity, Loss, McapFile, displacement, free_paths
from denoc_ros.errors import BagError


class BagWriter:
    """Writes a bag that does not exist yet.

    Not thread-safe; `denoc_ros.bags.background.BackgroundWriter` serves a real-time producer.

    Parameters
    ----------
    path : str or Path
        A path that ends in `.mcap`: one bare file. Any other: a rosbag2 folder with
        `NAME_0.mcap`, `NAME_1.mcap`, … and, from `close` on, metadata.yaml.
    max_bag_size : int
        A file that has reached this size [bytes] is followed by the next one; 0: no bound.
    max_bag_duration : float
        Longest stretch of log time in one file [s]; 0: no bound.

    Raises
    ------
    BagError
        When the path exists, an argument is out of range, or the disk refuses.

    Notes
    -----
    What was written before the last `flush` survives a kill of the process (`denoc recover`); a
    file that is followed by another, or that is closed, survives a loss of power.
    When the disk refuses a write, BagError says so and the file is closed, whole up to the last
    flush. `check` notices a file that is deleted, moved, replaced or cut while it is written, and
    goes on in another; and finished files that are gone or cut.
    """

    def __init__(
        self,
        path: str | Path,
        compression: str = 'zstd',
        max_bag_size: int = 0,
        max_bag_duration: float = 0.0,
    ) -> None:
        self.path = self._wanted = Path(path)
        self._check_arguments(compression, max_bag_size, max_bag_duration)
        self._compression = compression
        self._max_size = max_bag_size
        self._max_duration_ns = round(max_bag_duration * 1e9)
        self._topics: dict[ChannelKey, tuple[Topic, str]] = {}
        self._types: dict[str, str] = {}  # of each topic the one that was added last
        self._attachments: dict[str, tuple[str, bytes, int]] = {}
        self._finished: list[FileContents] = []
        self._losses: list[Loss] = []
        self._file: McapFile | None = None
        try:
            self._file = self._first_file()
        except FileExistsError as error:
            raise BagError(
                f'{self.path}: output must not exist yet, got an existing one'
            ) from error
        except OSError as error:
            raise BagError(
                f'{self.path}: output must be writable, got: {error.strerror}'
            ) from error

    def _check_arguments(self, compression: str, size: int, duration: float) -> None:
        if compression not in COMPRESSIONS:
            raise BagError(
                f'{self.path}: compression must be one of {", ".join(COMPRESSIONS)}, '
                f'got {compression!r}'
            )
        if not (size >= 0 and 0 <= duration < float('inf')):
            raise BagError(
                f'{self.path}: max_bag_size and max_bag_duration must be >= 0 and finite, '
                f'got {size} and {duration}'
            )
        if self._bare and (size or duration):
            raise BagError(
                f'{self.path}: a bag that splits must be a folder, got a path ending in .mcap'
            )

    @property
    def _bare(self) -> bool:
        return self.path.suffix == '.mcap'

    @property
    def files(self) -> tuple[FileContents, ...]:
        """Contents of the files, in order."""
        return (*self._finished, *([self._file.contents] if self._file else []))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """The files that are no longer there as they were written, in the order of notice."""
        return tuple(self._losses)

    @property
    def messages(self) -> int:
        """Number of messages in all files."""
        return sum(part.messages for part in self.files)

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics, in the order they were added."""
        return tuple(topic for topic, _ in self._topics.values())

    def add_topic(
        self, name: str, type_name: str, qos: tuple[Qos, ...] = (Qos(),), definition: str = ''
    ) -> None:
        """Add a topic; adding it again with the same type changes nothing.

        A topic has a channel for each of its types, and messages that follow are of the last one.

        Parameters
        ----------
        qos : tuple of Qos
            What its publishers offer.
        definition : str
            ros2msg text with all dependencies; looked up by type when empty.
        """
        topic = Topic(name, type_name, qos_text(qos))
        if topic.key not in self._topics:
            entry = topic, definition or message_definition(type_name)
            try:
                self._open_file().add_topic(*entry)
            except OSError as error:
                self._give_up(error)
            self._topics[topic.key] = entry
        self._types[name] = type_name

    def write(
        self,
        topic: str,
        stamp_ns: int,
        raw: bytes,
        publish_ns: int | None = None,
        type_name: str = '',
    ) -> None:
        """Append a message, its CDR bytes unparsed.

        Parameters
        ----------
        stamp_ns : int
            Log time: when it was received [ns].
        raw : bytes
            CDR with its 4 bytes of encapsulation.
        publish_ns : int, optional
            When it was sent [ns]; default: the log time.
        type_name : str, optional
            Its type; default: the one with which the topic was added last.
        """
        channel = topic, type_name or self._type(topic)
        if channel not in self._topics:
            raise BagError(
                f'{self.path}: topic {topic} must be added as {channel[1]} before, got none'
            )
        if stamp_ns < 0:
            raise BagError(f'{self.path}: stamp on {topic} must be >= 0 ns, got {stamp_ns}')
        if self._due(stamp_ns):
            self.split()
        sent = stamp_ns if publish_ns is None else publish_ns
        try:
            self._open_file().write(channel, stamp_ns, raw, sent)
        except OSError as error:
            self._give_up(error)

    def write_message(self, topic: str, stamp_ns: int, **fields: Any) -> None:
        """Append a message given by its fields, without ROS.

        A type with a header gets `stamp_ns` as its stamp unless `header` is given; fields left out
        are zero or empty. Otherwise as `write`.
        """
        self.write(topic, stamp_ns, encode(self._type(topic), stamp_ns, fields))

    def _type(self, topic: str) -> str:
        if topic not in self._types:
            raise BagError(f'{self.path}: topic {topic} must be added before messages are written')
        return self._types[topic]

    def attach(
        self,
        name: str,
        content: str | bytes,
        media_type: str = 'application/xml',
        stamp_ns: int = 0,
    ) -> None:
        """Attach a file, e.g. the URDF; every file of a split bag carries it."""
        data = content.encode() if isinstance(content, str) else content
        self._attachments[name] = (media_type, data, stamp_ns)
        try:
            self._open_file().attach(name, *self._attachments[name])
        except OSError as error:
            self._give_up(error)

    def flush(self) -> None:
        """Hand everything to the system: a kill after this loses nothing written before it."""
        try:
            self._open_file().flush()
        except OSError as error:
            self._give_up(error)

    def split(self) -> None:
        """Finish the current file and go on in the next one."""
        if self._bare:
            raise BagError(f'{self.path}: a bag that splits must be a folder, got a bare file')
        try:
            if not self.check():
                file = self._open_file()
                self._finish_file()
                file.close()
                self._begin_file(self._next_file())
        except OSError as error:
            self._give_up(error)

    def check(self) -> bool:
        """Check that all files are as written; if the last one is not, go on in a new file.

        The new file lies beside the old one, or in a new folder with a name by time when the
        folder is gone. Nothing is overwritten. `losses` tells what is no longer in the bag.
        """
        file = self._open_file()
        try:
            cause = file.displacement()
            if cause:
                self._lose(file, cause)
                self._begin_file(self._file_beside())
                self._losses[-1] = replace(self._losses[-1], next_path=self._open_file().path)
            else:
                self._lose_finished()
        except OSError as error:
            self._give_up(error)
        return bool(cause)

    def close(self) -> None:
        """Finish the last file and write metadata.yaml; closing again does nothing.

        Metadata.yaml names the files that are still there; `losses` has the others.
        """
        file = self._file
        if file is None:
            return
        try:
            if cause := file.displacement():
                self._lose(file, cause)
            else:
                self._finish_file()
            # The disk may take long to have the file: a kill meanwhile leaves a whole bag.
            with closing(file):
                self._lose_finished()
                self._write_metadata()
        except OSError as error:
            self._give_up(error)

    def __enter__(self) -> BagWriter:
        """Return itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Close: messages written before an error are worth keeping."""
        self.close()

    def _open_file(self) -> McapFile:
        if self._file is None:
            raise BagError(f'{self.path}: bag must be open for writing, got a closed one')
        return self._file

    def _make_place(self) -> Identity:
        """Make the folder; return which it is."""
        folder = self.path.parent if self._bare else self.path
        folder.mkdir(parents=True, exist_ok=self._bare)
        return Identity.of(folder.stat())

    def _first_file(self) -> McapFile:
        """Make the folder, and return its first file; neither stays where the disk refuses."""
        self._place = self._make_place()
        self._begun = 0
        try:
            return self._next_file()
        except OSError:
            if not self._bare:
                with suppress(OSError):
                    self.path.rmdir()
            raise

    def _next_file(self) -> McapFile:
        if self._bare:
            return McapFile(self.path, self._compression)
        name = f'{self.path.name}_{self._begun}.mcap'
        self._begun += 1
        # small chunks for small files, as only whole chunks count towards the size
        chunk = min(1 << 20, max(self._max_size // 8, 1 << 12)) if self._max_size else 1 << 20
        return McapFile(self.path / name, self._compression, chunk)

    def _begin_file(self, file: McapFile) -> None:
        """Go on in a file, with all topics and attachments."""
        self._file = file
        for entry in self._topics.values():
            file.add_topic(*entry)
        for name, attachment in self._attachments.items():
            file.attach(name, *attachment)

    def _file_beside(self) -> McapFile:
        """Return a new file beside one that is gone, in a new folder when that is gone too."""
        if not self._bare and self._place.is_at(self.path):
            while True:
                try:
                    return self._next_file()
                except FileExistsError:
                    continue  # somebody else's: the next number
        for path in free_paths(self._wanted, '.mcap' if self._bare else ''):
            self.path = path
            try:
                return self._first_file()
            except FileExistsError:
                continue
        raise AssertionError('names by time do not end')

    def _lose(self, file: McapFile, cause: str) -> None:
        """Leave out the current file, and all before it that went with the folder."""
        self._file = None
        file.abandon(cause)
        self._lose_finished()
        self._losses.append(Loss(file.path, cause, file.contents))

    def _lose_finished(self) -> None:
        """Leave out the finished files that are gone or cut."""
        folder = self.path.parent if self._bare else self.path
        for part in tuple(self._finished):
            if cause := displacement(folder / part.name, part.size):
                self._finished.remove(part)
                self._losses.append(Loss(folder / part.name, cause, part))

    def _due(self, stamp_ns: int) -> bool:
        file = self._open_file()
        if not file.contents.messages:
            return False
        long = 0 < self._max_duration_ns <= stamp_ns - file.contents.start_ns
        return long or 0 < self._max_size <= file.size

    def _finish_file(self) -> None:
        file = self._open_file()
        file.finish()
        self._finished.append(file.contents)
        self._file = None

    def _write_metadata(self) -> None:
        if not self._bare and self._place.is_at(self.path):
            write_metadata(self.path, metadata_text(self.topics, self._finished))

    def _give_up(self, cause: OSError) -> NoReturn:
        offered = self.messages
        file, self._file = self._file, None
        problem = ''
        try:
            if file is not None:
                file.salvage()
                self._finished.append(file.contents)
            self._write_metadata()
        except OSError as error:
            problem = f', not whole ({error.strerror}): run denoc recover'
        raise BagError(
            f'{self.path}: disk must take what is recorded, got: {cause.strerror}; closed with '
            f'{self.messages} messages{problem}, the last {offered - self.messages} are lost'
        ) from cause
