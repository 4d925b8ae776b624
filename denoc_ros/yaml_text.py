"""The one reader of YAML: safe, bounded in size, depth and aliases, with the place of an error.

Text may come from anybody. PyYAML's safe loader runs no code, but aliases and merge keys of some
hundred bytes make it fill the memory, and deep brackets, dates and long integers end in errors of
every kind. Here each of them is a :class:`YamlError`.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from denoc_ros.errors import ConfigError

MOST_BYTES = 1 << 24
MOST_VALUES = 500_000  # keys and values, aliases and merge keys written out
MOST_ALIASED = 100_000  # of them those that aliases repeat
MOST_LEVELS = 60
MOST_BITS = 63  # of an integer: those of messages and parameters
MOST_DIGITS = 80  # more than an integer of 64 bits has in any notation
SHOWN = 40  # characters of a value in a message
CORE = ('null', 'bool', 'int', 'float', 'str', 'seq', 'map')


class YamlError(ValueError):
    """A text is not YAML that is taken; the message has the rule, and the place where it broke."""


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader with bounds, and the types of YAML 1.2's core schema only.

    1e5 and 9.0e4 are numbers, and a date is text. `!!binary`, `!!set` and others are refused.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._level = self._values = self._aliased = 0
        self._sizes: dict[int, int] = {}  # by the node's id: all nodes live until the end

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Compose a node, and count its values with all aliases written out."""
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        is_alias = self.check_event(yaml.AliasEvent)
        before = self._values
        self._level += 1
        if self._level > MOST_LEVELS:
            raise _broken(f'levels must be at most {MOST_LEVELS}, got more', mark)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._level -= 1
        if is_alias:
            size = self._sizes.get(id(node), 0)
            if not size:
                raise _broken('an alias must not be inside of its own anchor, got one', mark)
            self._aliased += size
            if self._aliased > MOST_ALIASED:
                raise _broken(f'aliases must repeat at most {MOST_ALIASED} values, got more', mark)
        else:
            size = 1
        self._values += size
        if self._values > MOST_VALUES:
            raise _broken(f'values must be at most {MOST_VALUES}, got more', mark)
        if not is_alias:
            self._sizes[id(node)] = self._values - before
        return node

    def construct_bounded_int(self, node: yaml.ScalarNode) -> int:
        """Return an integer of 64 bits; an error for another."""
        text = self.construct_scalar(node)
        if len(text) <= MOST_DIGITS:
            with suppress(ValueError):
                value = int(self.construct_yaml_int(node))
                if value.bit_length() <= MOST_BITS:
                    return value
        raise _broken(f'an integer must fit 64 bits, got {_short(text)}', node.start_mark)

    def construct_checked_float(self, node: yaml.ScalarNode) -> float:
        """Return a number; an error where a tag calls something else one."""
        try:
            return float(self.construct_yaml_float(node))
        except (ValueError, OverflowError):
            text = _short(self.construct_scalar(node))
            raise _broken(f'a number must be one, got {text}', node.start_mark) from None

    def construct_checked_bool(self, node: yaml.ScalarNode) -> bool:
        """Return true or false; an error where a tag calls something else so."""
        try:
            return bool(self.construct_yaml_bool(node))
        except KeyError:
            text = _short(self.construct_scalar(node))
            raise _broken(
                f'a truth value must be true or false, got {text}', node.start_mark
            ) from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; an error for a key that is neither a word nor an integer."""
        found: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        for key in found:
            if not isinstance(key, (str, int)) or isinstance(key, bool):
                raise _broken(f'a key must be text, got {key!r}', node.start_mark)
        return found


_Loader.yaml_constructors = {
    **{f'tag:yaml.org,2002:{k}': getattr(yaml.SafeLoader, f'construct_yaml_{k}') for k in CORE},
    'tag:yaml.org,2002:int': _Loader.construct_bounded_int,
    'tag:yaml.org,2002:float': _Loader.construct_checked_float,
    'tag:yaml.org,2002:bool': _Loader.construct_checked_bool,
    None: yaml.SafeLoader.construct_undefined,
}
_Loader.yaml_implicit_resolvers = {
    first: [(tag, form) for tag, form in forms if not tag.endswith(':timestamp')]
    for first, forms in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?(?:\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
    list('-+.0123456789'),
)


def load_yaml(text: str) -> Any:
    """Return the value of a YAML text.

    Raises
    ------
    YamlError
        With the rule and the place. Integers must fit 64 bits, and the values of the text with
        all aliases written out have bounds (`MOST_VALUES`, `MOST_ALIASED`, `MOST_LEVELS`).
    """
    if len(text) > MOST_BYTES:
        raise YamlError(f'the text must be at most {MOST_BYTES} bytes, got more')
    try:
        loader = _Loader(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise YamlError(f'the text must be YAML, got {" ".join(str(error).split())}') from error


def read_yaml_file(file: Path) -> Any:
    """Return the value of a YAML file; ConfigError for one that cannot be read."""
    try:
        with file.open('rb') as stream:
            content = stream.read(MOST_BYTES + 1)
        return load_yaml(content.decode('utf-8-sig'))
    except OSError as error:
        rule = f'the file must be readable, got: {error.strerror}'
    except UnicodeDecodeError as error:
        rule = f'the text must be YAML in UTF-8, got {error}'
    except YamlError as error:
        rule = str(error)
    raise ConfigError(str(file), [rule])


def _broken(rule: str, mark: yaml.Mark) -> YamlError:
    return YamlError(f'line {mark.line + 1}, column {mark.column + 1}: {rule}')


def _short(text: str) -> str:
    return repr(text) if len(text) <= SHOWN else f'{text[:SHOWN]!r}… of {len(text)} characters'
