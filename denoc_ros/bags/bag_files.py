"""The files of a bag, opened together: MCAP or SQLite, plain or compressed by zstd."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from operator import attrgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from rosbags.rosbag2.reader import zstd

from denoc_ros.bags.mcap_source import McapSource
from denoc_ros.bags.metadata import Connection, connection
from denoc_ros.decompression import WINDOW_BITS, BudgetedFile, ByteBudget, decompressed_message

_ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'
_SQLITE_MAGIC = b'SQLite format 3\0'
# Contents that the file computes when it is read: views, virtual tables, generated columns.
_COMPUTED = """
SELECT name FROM sqlite_master WHERE type = 'view' OR sql LIKE 'CREATE VIRTUAL%'
UNION SELECT m.name FROM sqlite_master m, pragma_table_xinfo(m.name) x
WHERE m.type = 'table' AND x.hidden > 1
"""
_DEFINITIONS = """
SELECT topic_type, encoding, encoded_message_definition FROM message_definitions ORDER BY id DESC
"""
_COUNTS = 'SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1'
_MESSAGES = 'SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({}) ORDER BY 2'
Found = tuple[Connection, int, Any]  # log time [ns] and bytes of a message


class BagSource(Protocol):
    """One file of a bag."""

    connections: list[Connection]
    span: tuple[int, int] | None  # first and last time of a message [ns]

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, Any]]:
        """Iterate over (number of the connection, log time [ns], bytes), by log time."""

    def close(self) -> None:
        """Close the file."""


class DatabaseSource:
    """Reads one SQLite file of rosbag2.

    Raises
    ------
    ValueError
        For a database that computes its contents, of any size, when they are read.
    sqlite3.Error
        For a file that is no database of rosbag2.
    """

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(f'{path.resolve().as_uri()}?immutable=1', uri=True)
        try:
            computed = self._database.execute(_COMPUTED).fetchone()
            if computed:
                raise ValueError(f'database must hold plain tables, got {computed[0]!r}')
            counts = {number: rest for number, *rest in self._database.execute(_COUNTS)}
            times = [each for row in counts.values() for each in row[1:]]
            if wrong := [each for each in times if not isinstance(each, int)]:
                rule = 'time of a message must be a whole number of ns'
                raise ValueError(f'{rule}, got {wrong[0]!r}')
            self.connections = list(self._connections(counts))
        except BaseException:
            self.close()
            raise
        self.span = (min(times), max(times)) if times else None

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def messages(self, wanted: Collection[int]) -> Iterator[tuple[int, int, Any]]:
        """Iterate over (number of the topic, log time [ns], bytes), by log time."""
        query = _MESSAGES.format(', '.join('?' * len(wanted)))
        with closing(self._database.execute(query, list(wanted))) as rows:
            yield from rows

    def _connections(self, counts: dict[int, list[int]]) -> Iterator[Connection]:
        columns = {row[1] for row in self._database.execute('PRAGMA table_info(topics)')}
        qos = 'offered_qos_profiles' if 'offered_qos_profiles' in columns else "''"
        definitions = {}
        if self._database.execute('PRAGMA table_info(message_definitions)').fetchone():
            definitions = {kind: rest for kind, *rest in self._database.execute(_DEFINITIONS)}
        rows = self._database.execute(
            f'SELECT id, name, type, serialization_format, {qos} FROM topics ORDER BY id'
        )
        for number, topic, kind, encoding, offered in rows:
            if not (isinstance(topic, str) and isinstance(kind, str)):
                raise ValueError(f'name and type of a topic must be text, got {topic!r}, {kind!r}')
            known, text = definitions.get(kind, ('', ''))
            count = counts.get(number, (0,))[0]
            yield connection(number, topic, kind, count, encoding, (known, text), offered)


class BagFiles:
    """The files of a bag that are open.

    Attributes
    ----------
    connections : list of Connection
        Those that can be read.
    left_out : list of Connection
        Those that cannot: their `fault` says why.
    """

    def __init__(self, sources: Sequence[BagSource], has_packed_messages: bool) -> None:
        self.sources = sources
        self._unpacked: Callable[[bytes], bytes] = (
            decompressed_message if has_packed_messages else bytes
        )
        every = [each for source in sources for each in source.connections]
        self.connections = [each for each in every if not each.fault]
        self.left_out = [each for each in every if each.fault]

    @property
    def span(self) -> tuple[int, int]:
        """First and last time of a message [ns], 0 without any."""
        spans = [source.span for source in self.sources if source.span is not None]
        return min((s[0] for s in spans), default=0), max((s[1] for s in spans), default=0)

    def messages(self, topics: Collection[str]) -> Iterator[Found]:
        """Iterate over the messages of topics: those of each file by their log times."""
        for source in self.sources:
            chosen = chosen_connections(source, topics)
            if not chosen:
                continue
            for number, log_ns, raw in source.messages(chosen):
                yield chosen[number], log_ns, self._message(raw)

    def mcap_sources(self) -> list[McapSource]:
        """Return the files of MCAP, by their first messages."""
        found = [source for source in self.sources if isinstance(source, McapSource)]
        return sorted(found, key=lambda source: source.span or (0, 0))

    def _message(self, raw: Any) -> Any:
        return self._unpacked(raw) if isinstance(raw, bytes) else raw


def chosen_connections(source: BagSource, topics: Collection[str]) -> dict[int, Connection]:
    """Return the connections of topics that can be read, by their numbers."""
    found = filter(lambda each: each.topic in topics and not each.fault, source.connections)
    return {each.number: each for each in sorted(found, key=attrgetter('number'))}


@contextmanager
def opened_files(parts: Sequence[Path], has_packed_messages: bool = False) -> Iterator[BagFiles]:
    """Open the files of a bag; what each is, its first bytes say."""
    with ExitStack() as stack:
        for part in parts:
            if not part.is_file():
                raise ValueError(f'{part.name} must be a regular file, got another kind')
        plain = [part for part in parts if not _starts_with(part, _ZSTD_MAGIC)]
        unpacked = {part: part for part in plain}
        if len(plain) < len(parts):
            folder = Path(stack.enter_context(TemporaryDirectory(prefix='denoc_bag_')))
            budget = ByteBudget(sum(part.stat().st_size for part in parts))
            unpacked |= {p: _unpacked(p, folder, budget) for p in parts if p not in unpacked}
        sources: list[BagSource] = []
        for part in (unpacked[part] for part in parts):
            is_database = _starts_with(part, _SQLITE_MAGIC)
            source: BagSource = DatabaseSource(part) if is_database else McapSource(part)
            stack.callback(source.close)
            sources.append(source)
        yield BagFiles(sources, has_packed_messages)


def _starts_with(path: Path, magic: bytes) -> bool:
    with path.open('rb') as stream:
        return stream.read(len(magic)) == magic


def _unpacked(part: Path, folder: Path, budget: ByteBudget) -> Path:
    """Write the content of a compressed file into a folder, within a budget."""
    target = folder / part.name.removesuffix('.zstd')
    options = {zstd.DecompressionParameter.window_log_max: WINDOW_BITS}
    with part.open('rb') as packed, target.open('wb') as stream:
        content = zstd.open(packed, 'rb', options=options)
        shutil.copyfileobj(BudgetedFile(content, budget), stream)
    return target
