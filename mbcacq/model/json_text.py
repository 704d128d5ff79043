"""JSON texts as data and typed objects, and what is wrong with one said in words."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BeforeValidator, TypeAdapter, ValidationError

from mbcacq.errors import ConfigError

WORDS: Mapping[str, str] = {  # kind of a fault that pydantic finds -> what a reader of JSON calls it
    "missing": "the key is missing",
    "model_type": "it is no object of keys and values",
    "dict_type": "it is no object of keys and values",
    "list_type": "it is no list",
    "tuple_type": "it is no list",
    "string_type": "it is no text",
    "float_type": "it is no number",
    "float_parsing": "it is no number",
    "int_type": "it is no whole number",
    "int_parsing": "it is no whole number",
    "int_from_float": "it is no whole number",
    "finite_number": "it is not finite",
}


def with_nan(value: Any) -> Any:
    """Content of JSON with not-a-number for each null, which stands for a number that is not finite."""
    if isinstance(value, Mapping):
        return {key: with_nan(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [with_nan(v) for v in value]
    return np.nan if value is None else value


Number = Annotated[float, BeforeValidator(with_nan, json_schema_input_type=float | None)]
T = TypeVar("T")


def plain(value: Any) -> Any:
    """Only what JSON has: dataclasses become dictionaries, of their ``to_dict`` where they have one, numpy numbers become numbers, what is
    not finite becomes None.
    """
    if hasattr(value, "to_dict"):
        value = value.to_dict()
    elif is_dataclass(value) and not isinstance(value, type):
        return fields_as_json(value)
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def fields_as_json(value: Any) -> dict[str, Any]:
    """The fields of a dataclass as JSON content; ``from_fields`` reads them."""
    return {f.name: plain(getattr(value, f.name)) for f in fields(value)}


def from_fields(kind: type[T], content: Any) -> T:
    """An object of the JSON content of its fields, each of its declared type; keys that it does not have are left out.

    Raises ValueError (``pydantic.ValidationError``) where one is missing or of another type.
    """
    return _reader(kind).validate_python(content)


@cache
def _reader(kind: type[T]) -> TypeAdapter[T]:
    return TypeAdapter(kind)


def read_json(data: bytes | str, name: str, cure: str) -> Any:
    """The data in a JSON text. name: of the file; cure: what to do where it is none. Raises ConfigError."""
    try:
        return json.loads(data.decode("utf-8-sig") if isinstance(data, bytes) else data)
    except UnicodeDecodeError:
        fault = "it is not UTF-8 text"
    except json.JSONDecodeError as error:
        fault = f"it breaks off or is malformed in line {error.lineno}, column {error.colno}" if data.strip() else "it is empty"
    except RecursionError:
        fault = "its brackets are nested deeper than in any such file"
    except ValueError:  # Python refuses integers of several thousand digits
        fault = "a number in it has too many digits"
    raise ConfigError(f"{name} is not JSON ({fault}); {cure}")


def first_fault(error: ValidationError) -> tuple[str, str]:
    """(key, fault in words) of the first fault of content that does not fit a pydantic model."""
    first = error.errors()[0]
    return ".".join(str(part) for part in first["loc"]), WORDS.get(first["type"], first["msg"])


def damage(error: Exception) -> str:
    """In words, what an error says that was raised while content of JSON was taken apart; a ValueError speaks for itself."""
    if isinstance(error, ValidationError):
        key, fault = first_fault(error)
        return f"the key '{key}' is missing" if fault == WORDS["missing"] else f"{key}: {fault}"
    if isinstance(error, KeyError):
        return f"the key {error} is missing"
    return str(error) if isinstance(error, ValueError) else "a value in it is not of its kind"
