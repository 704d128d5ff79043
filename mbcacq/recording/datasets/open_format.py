"""YAML files of an open format, checked by a pydantic model: keys that it does not know stand for other programs, unless they are slips."""

from __future__ import annotations

import difflib
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from mbcacq.model.formats import newer_format
from mbcacq.model.yaml_source import YamlFile, name_of

Spec = TypeVar("Spec", bound=BaseModel)
RESEMBLES = 0.8  # similarity of two words from which one is taken for a slip of the other


def validate(model: type[Spec], file: YamlFile) -> Spec:
    """The data checked against a pydantic model; the first fault becomes a ConfigError with its line.

    Keys that the model does not know are left out, at every level: these are open formats, and other programs add what they need. One
    that resembles a known key which is not there is taken for a slip and refused.
    """
    data = file.data
    known = get_args(model.model_fields["format"].annotation) if "format" in model.model_fields else ()
    if sentence := newer_format(data.get("format"), known):
        raise file.error(("format",), f"it {sentence}")
    slips: list[tuple[tuple[int | str, ...], str]] = []
    known_data = known_only(model, data, slips)
    for path, meant in slips:
        raise file.error(path, f"the key '{path[-1]}' is not known; '{meant}' is meant? correct it")
    try:
        return model.model_validate(known_data)
    except ValidationError as error:
        first = error.errors()[0]
        place, more = name_of(first["loc"]), f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        if first["type"] == "missing":
            raise file.error(first["loc"], f"'{place}' is missing{more}; add it") from None
        raise file.error(first["loc"], f"{place}: {first['msg']}{more}; correct it") from None


def known_only(kind: Any, data: Any, slips: list[tuple[tuple[int | str, ...], str]], path: tuple[int | str, ...] = ()) -> Any:
    """Data (mappings, lists) without the keys that a pydantic model or an annotation made of such models does not know.

    slips: gets the path of each such key that resembles one which the data at ``path`` lack, and that one.
    """
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if not isinstance(data, dict):
            return data
        fields = kind.model_fields
        missing = [field for field in fields if field not in data]
        slips += [((*path, key), meant) for key in data if key not in fields and (meant := _resembled(str(key), missing))]
        return {key: known_only(fields[key].annotation, value, slips, (*path, key)) for key, value in data.items() if key in fields}
    parts = [part for part in get_args(kind) if part is not type(None)]
    if isinstance(data, list) and parts:
        return [known_only(parts[0], entry, slips, (*path, i)) for i, entry in enumerate(data)]
    return known_only(parts[0], data, slips, path) if len(parts) == 1 and isinstance(data, dict) else data


def _resembled(key: str, known: list[str]) -> str | None:
    """The known key that a misspelt one means: it differs in letters, capitals or the unit."""
    plain = {name.lower().replace("-", "_"): name for name in known}
    lower = key.lower().replace("-", "_").replace(" ", "_")
    if lower in plain:
        return plain[lower]
    by_stem = {name.rsplit("_", 1)[0]: name for name in known if "_" in name}
    if lower in by_stem:
        return by_stem[lower]
    close = difflib.get_close_matches(lower, list(plain), 1, cutoff=RESEMBLES)
    return plain[close[0]] if close else None
