"""JSON texts as data and typed objects, and what is wrong with one said in words.

The types of a dataclass say how it stands in a file: ``fields_as_json`` writes it and ``from_fields`` reads it by them, and pydantic makes
the JSON Schema of them. The annotation of a field says if it stands otherwise in JSON than in Python.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import BeforeValidator, FiniteFloat, GetCoreSchemaHandler, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, core_schema

from mbcacq.errors import ConfigError
from mbcacq.model.formats import newer_format

WORDS: Mapping[str, str] = {  # kind of a fault that pydantic finds -> what a reader of JSON calls it
    "missing": "the key is missing",
    **dict.fromkeys(("model_type", "dict_type", "mapping_type", "dataclass_type"), "it is no object of keys and values"),
    **dict.fromkeys(("list_type", "tuple_type"), "it is no list"),
    "string_type": "it is no text",
    **dict.fromkeys(("float_type", "float_parsing"), "it is no number"),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "it is no whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "it is neither true nor false"),
    "finite_number": "it is not finite",
    "greater_than_equal": "it is negative",
    "too_short": "it has too few entries",
    "too_long": "it has too many entries",
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


@dataclass(frozen=True)
class InJson:
    """In the annotation of a value that stands otherwise in JSON: there it is of the type ``kind``. read: makes the value of that, and
    raises ValueError where it cannot; write: makes that of the value."""

    kind: Any
    read: Callable[[Any], Any]
    write: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        writes = core_schema.plain_serializer_function_ser_schema(self.write)
        return core_schema.no_info_after_validator_function(self.read, handler.generate_schema(self.kind), serialization=writes)


FilePath = Annotated[Path, InJson(str, Path, str)]


class EveryKey:
    """Base of a dataclass of which a file holds every field, also one that has a default in Python. No field may be missing there, with two
    exceptions: those in ``left_out`` are not written where they have their default, and older files of the format lack those in ``later``.
    """

    left_out: ClassVar[tuple[str, ...]] = ()
    later: ClassVar[tuple[str, ...]] = ()

    def unwritten(self) -> Sequence[str]:
        """The fields that a file does not hold.

        Returns
        -------
        sequence of str
            Names of the fields with their default value, out of ``left_out``.
        """
        mine: Any = self  # a base of dataclasses alone
        return [f.name for f in fields(mine) if f.name in self.left_out and getattr(self, f.name) == f.default]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        def write(value: Any, by_fields: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
            unwritten = {key[name] for name in value.unwritten()}
            return {name: content for name, content in by_fields(value).items() if name not in unwritten}

        schema = handler(source)
        found: Any = handler.resolve_ref_schema(schema)
        key = {field["name"]: field.get("serialization_alias", field["name"]) for field in found["schema"]["fields"]}
        for field in found["schema"]["fields"]:
            written = field.get("init", True) and not field.get("serialization_exclude")
            if written and field["name"] not in (*cls.left_out, *cls.later) and field["schema"]["type"] == "default":
                field["schema"] = field["schema"]["schema"]
        if cls.left_out:
            found["serialization"] = core_schema.wrap_serializer_function_ser_schema(write)
        return schema


class AsJson:
    """Base of a dataclass whose fields are the keys of its JSON content; ``from_fields`` reads it."""

    def to_dict(self) -> dict[str, Any]:
        """The content of a JSON file.

        Returns
        -------
        dict
            Every field by its name, as JSON has it.
        """
        return fields_as_json(self)


def keyed(*keys: str) -> InJson:
    """For the annotation of a tuple, which stands in JSON as an object with these keys."""

    def read(content: Mapping[str, Any]) -> tuple[Any, ...]:
        if missing := [key for key in keys if key not in content]:
            raise ValueError(f"the key '{missing[0]}' is missing")
        return tuple(content[key] for key in keys)

    return InJson(dict[str, Any], read, lambda value: dict(zip(keys, value, strict=True)))


def _as_array(values: Any) -> np.ndarray:
    try:
        return np.array(values)
    except ValueError:
        raise ValueError("its rows are not of one length") from None


def as_list(kind: Any) -> InJson:
    """For the annotation of an array, which stands in JSON as (nested) lists of this type."""
    return InJson(kind, _as_array, np.ndarray.tolist)


def _without_end(rows: list[tuple[float | None, float | None]]) -> np.ndarray:
    return np.array([(-np.inf if low is None else low, np.inf if high is None else high) for low, high in rows]).reshape(-1, 2)


End = FiniteFloat | None  # of an axis, rad; None in a file where it turns without one
Limits = Annotated[np.ndarray, InJson(list[tuple[End, End]], _without_end, np.ndarray.tolist)]
Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Vector = Annotated[np.ndarray, as_list(list[FiniteFloat])]
Transform = Annotated[np.ndarray, as_list(tuple[Row, Row, Row, Row])]
RowsOfTransform = tuple[Row, Row, Row, Row]
Matrix = Annotated[np.ndarray, as_list(list[list[FiniteFloat]])]


def as_rows(T: np.ndarray | None) -> Any:
    """A matrix as tuples of its rows, which can be compared; None of none."""
    return None if T is None else tuple(map(tuple, T.tolist()))


def plain(value: Any) -> Any:
    """Only what JSON has: dataclasses become dictionaries, of their ``to_dict`` where they have one, numpy numbers become numbers, what is
    not finite becomes None.
    """
    if hasattr(value, "to_dict"):
        value = value.to_dict()
    elif is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    elif isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def fields_as_json(value: Any) -> dict[str, Any]:
    """The fields of a dataclass as JSON content, as their types say; ``from_fields`` reads them."""
    return plain(_adapter(type(value)).dump_python(value, by_alias=True, warnings=False))


def from_fields(kind: type[T], content: Any) -> T:
    """An object of the JSON content of its fields, each of its declared type; keys that it does not have are left out.

    Raises ValueError (``pydantic.ValidationError``) where one is missing or of another type.
    """
    return _adapter(kind).validate_python(content)


def from_document(kind: type[T], content: Any, formats: str | Sequence[str], name: str, what: str, cure: str, key: str = "") -> T:
    """An object of the content of a file, whose 'format' is among ``formats``, the last of which is written today.

    name: of the file; what: it should hold; cure: what to do where it does not; key: under which the content stands in the file. Raises
    ConfigError for another format, a newer one, a missing key and a value of another kind.
    """
    known, at = (formats,) if isinstance(formats, str) else tuple(formats), f"{name}: {key}" if key else name
    found = content.get("format") if isinstance(content, Mapping) else None
    if sentence := newer_format(found, known):
        raise ConfigError(f"{at} {sentence}")
    if found not in known:
        raise ConfigError(f"{at} is no {what} of format '{known[-1]}'; {cure}")
    try:
        return from_fields(kind, content)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise damaged(name, damage(error, f"{key}." if key else ""), cure) from error


def damaged(name: str, fault: str, cure: str) -> ConfigError:
    """That a file is damaged, in one sentence."""
    return ConfigError(f"{name} is damaged ({fault}); {cure}")


@cache
def _adapter(kind: type[T]) -> TypeAdapter[T]:
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
    about = first.get("ctx", {})
    own = about.get("error")  # of a ValueError that was raised by this program
    if first["type"] == "literal_error":
        own = f"it is not {about['expected']}"
    return ".".join(str(part) for part in first["loc"]), str(own) if own else WORDS.get(first["type"], first["msg"])


def damage(error: Exception, within: str = "") -> str:
    """In words, what an error says that was raised while content of JSON was taken apart; a ValueError speaks for itself. within: what
    stands before each key of the content in its file.
    """
    if isinstance(error, ValidationError):
        key, fault = first_fault(error)
        if fault == WORDS["missing"]:
            return f"the key '{within}{key}' is missing"
        return f"{within}{key}: {fault}" if key else fault
    if isinstance(error, KeyError):
        return f"the key {error} is missing"
    return str(error) if isinstance(error, ValueError) else "a value in it is not of its kind"


SEAL = "sha256"


def sealed_text(content: Mapping[str, Any]) -> str:
    """The content as JSON, its last value the SHA-256 of the others (keys sorted, no spaces, shortest decimals)."""
    plain = json.loads(json.dumps({key: value for key, value in content.items() if key != SEAL}))
    return json.dumps({**plain, SEAL: _digest(plain)}, indent=1)


def unsealed(content: Any, file: Path, cure: str = "write it anew with mbcacq calibrate --out") -> Any:
    """The content that was read, without its checksum; one without a checksum, of an earlier version or another program, is believed.
    Raises ConfigError with the cure where the checksum does not hold."""
    if not isinstance(content, dict) or SEAL not in content:
        return content
    plain = {key: value for key, value in content.items() if key != SEAL}
    try:
        same = content[SEAL] == _digest(plain)
    except RecursionError:  # nested as no result is
        same = False
    if not same:
        raise ConfigError(
            f"{file} is not as it was written: bits changed, or it was edited; {cure}, or remove its '{SEAL}' to use it as it is"
        )
    return plain


def digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of a result's content, with its checksum or without."""
    return _digest(json.loads(json.dumps({key: value for key, value in content.items() if key != SEAL})))


def _digest(plain: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
