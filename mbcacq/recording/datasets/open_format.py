"""YAML texts as checked data: every fault becomes one sentence with file and line."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from mbcacq.errors import ConfigError
from mbcacq.model.formats import newer_format
from mbcacq.model.yaml12 import Yaml12Loader

MAX_BYTES = 16 << 20
Spec = TypeVar("Spec", bound=BaseModel)


RESEMBLES = 0.8  # similarity of two words from which one is taken for a slip of the other


def read_yaml_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; this is no cell description")
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}; check the path") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not UTF-8 text; save the file as UTF-8") from None


def load_yaml(text: str, name: str) -> tuple[dict[str, Any], yaml.Node]:
    """The mapping in a YAML text, and its node tree for line numbers. Raises ConfigError."""
    loader = Yaml12Loader(text)
    try:
        node = loader.get_single_node()
        data = loader.construct_document(node) if node is not None else None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise ConfigError(f"{name}:{line}: not valid YAML ({getattr(error, 'problem', None) or 'unreadable'}); correct the line") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name}:1: not valid YAML ({error}); correct it") from None
    finally:
        loader.dispose()
    _refuse_repeated_keys(node, name)
    if data is None:
        raise ConfigError(f"{name}:1: it is empty, where keys are expected (format, robot, ...); fill it in")
    if node is None or not isinstance(data, dict):
        found = "a list" if isinstance(data, list) else "a single value"
        raise ConfigError(f"{name}:1: keys are expected (format, robot, ...), found {found}; correct the file")
    return data, node


def _refuse_repeated_keys(root: yaml.Node | None, name: str) -> None:
    """YAML itself would silently take the last of two equal keys."""
    waiting, seen = [root], set()
    while waiting:
        node = waiting.pop()
        if node is None or id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            waiting += node.value
        elif isinstance(node, yaml.MappingNode):
            keys = set()
            for key, value in node.value:
                if isinstance(key, yaml.ScalarNode) and key.value in keys and key.value != "<<":
                    raise ConfigError(f"{name}:{key.start_mark.line + 1}: the key '{key.value}' stands here twice; remove one")
                keys.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
                waiting.append(value)


def validate(model: type[Spec], data: dict[str, Any], node: yaml.Node, name: str) -> Spec:
    """The data checked against a pydantic model; the first fault becomes a ConfigError with its line.

    Keys that the model does not know are left out, at every level: these are open formats, and other programs add what they need. One
    that resembles a known key which is not there is taken for a slip and refused.
    """
    known = get_args(model.model_fields["format"].annotation) if "format" in model.model_fields else ()
    if sentence := newer_format(data.get("format"), known):
        raise ConfigError(f"{name}:{line_of(node, ('format',))}: it {sentence}")
    for path, key, meant in misspelt(model, data):
        raise ConfigError(f"{name}:{line_of(node, (*path, key))}: the key '{key}' is not known; '{meant}' is meant? correct it")
    try:
        return model.model_validate(known_only(model, data))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        line = line_of(node, first["loc"])
        if first["type"] == "missing":
            raise ConfigError(f"{name}:{line}: '{place}' is missing{more}; add it") from None
        raise ConfigError(f"{name}:{line}: {place}: {first['msg']}{more}; correct it") from None


def known_only(kind: Any, data: Any) -> Any:
    """Data (mappings, lists) without the keys that a pydantic model or an annotation made of such models does not know."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if not isinstance(data, dict):
            return data
        fields = kind.model_fields
        return {key: known_only(fields[key].annotation, value) for key, value in data.items() if key in fields}
    parts = [part for part in get_args(kind) if part is not type(None)]
    if isinstance(data, list) and parts:
        return [known_only(parts[0], entry) for entry in data]
    return known_only(parts[0], data) if len(parts) == 1 and isinstance(data, dict) else data


def misspelt(kind: Any, data: Any, path: tuple[int | str, ...] = ()) -> Iterator[tuple[tuple[int | str, ...], str, str]]:
    """(path, key, known key that it resembles) of the keys that a pydantic model does not know and that look like one it lacks here."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if not isinstance(data, dict):
            return
        fields = kind.model_fields
        missing = [field for field in fields if field not in data]
        for key, value in data.items():
            if key in fields:
                yield from misspelt(fields[key].annotation, value, (*path, key))
            elif meant := _resembled(str(key), missing):
                yield path, str(key), meant
        return
    parts = [part for part in get_args(kind) if part is not type(None)]
    if isinstance(data, list) and parts:
        for i, entry in enumerate(data):
            yield from misspelt(parts[0], entry, (*path, i))
    elif len(parts) == 1 and isinstance(data, dict):
        yield from misspelt(parts[0], data, path)


def _resembled(key: str, known: list[str]) -> str | None:
    """The known key of which this one is a slip: letters, capitals, or the unit are different."""
    plain = {name.lower().replace("-", "_"): name for name in known}
    lower = key.lower().replace("-", "_").replace(" ", "_")
    if lower in plain:
        return plain[lower]
    by_stem = {name.rsplit("_", 1)[0]: name for name in known if "_" in name}
    if lower in by_stem:
        return by_stem[lower]
    close = difflib.get_close_matches(lower, list(plain), 1, cutoff=RESEMBLES)
    return plain[close[0]] if close else None


def line_of(node: yaml.Node, path: tuple[int | str, ...]) -> int:
    """Line (from 1) of the node at a path of keys and indices, or of its nearest parent that exists."""
    line = node.start_mark.line + 1
    for part in path:
        child = None
        if isinstance(node, yaml.MappingNode):
            child = next(((key, value) for key, value in node.value if key.value == str(part)), None)
            if child is not None:
                line, node = child[0].start_mark.line + 1, child[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            child = node = node.value[part]
            line = node.start_mark.line + 1
        if child is None:
            break
    return line
