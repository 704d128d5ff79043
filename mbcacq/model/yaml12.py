"""YAML with the numbers of YAML 1.2: '1e9' and '5.' are numbers, '010' is ten, and '12:30' is a text.

PyYAML reads numbers by the rules of YAML 1.1, where these are a text, a text, eight and 750. An underscore between digits, which 1.1 has
and people write, stays permitted. Only plain data are constructed, as by ``yaml.safe_load``.
"""

from __future__ import annotations

import re
from typing import Any

import yaml

_BASE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml takes a tenth of the time
_INT, _FLOAT = "tag:yaml.org,2002:int", "tag:yaml.org,2002:float"
_DIGITS = r"[0-9](?:_?[0-9])*"
_INT_PATTERN = re.compile(rf"[-+]?{_DIGITS}$|0o[0-7]+$|0x[0-9a-fA-F]+$")
_FLOAT_PATTERN = re.compile(
    rf"[-+]?(?:\.{_DIGITS}|{_DIGITS}\.(?:{_DIGITS})?)(?:[eE][-+]?[0-9]+)?$|[-+]?{_DIGITS}[eE][-+]?[0-9]+$"
    r"|[-+]?\.(?:inf|Inf|INF)$|\.(?:nan|NaN|NAN)$"
)


class Yaml12Loader(_BASE):
    """A safe loader whose numbers are those of YAML 1.2."""

    yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in known if tag not in (_INT, _FLOAT)]
        for first, known in _BASE.yaml_implicit_resolvers.items()
    }


def _int(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node).replace("_", "")
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    return int(text, base)


def _float(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> float:
    text = loader.construct_scalar(node).replace("_", "").lower()
    return float(text.replace(".inf", "inf").replace(".nan", "nan"))


Yaml12Loader.add_implicit_resolver(_INT, _INT_PATTERN, list("-+0123456789"))
Yaml12Loader.add_implicit_resolver(_FLOAT, _FLOAT_PATTERN, list("-+.0123456789"))
Yaml12Loader.add_constructor(_INT, _int)
Yaml12Loader.add_constructor(_FLOAT, _float)


def load(text: str | bytes) -> Any:
    """The plain data of one YAML document. Raises yaml.YAMLError."""
    return yaml.load(text, Loader=Yaml12Loader)


class Yaml12Dumper(yaml.SafeDumper):
    """A safe dumper that puts every text in quotes that this loader would read as a number."""


Yaml12Dumper.add_implicit_resolver(_INT, _INT_PATTERN, list("-+0123456789"))
Yaml12Dumper.add_implicit_resolver(_FLOAT, _FLOAT_PATTERN, list("-+.0123456789"))


class Flow(dict):
    """A mapping that is written on one line."""


class FlowList(list):
    """A list that is written on one line."""


Yaml12Dumper.add_representer(Flow, lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style=True))
Yaml12Dumper.add_representer(FlowList, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True))


def dump(data: Any, **how: Any) -> str:
    """YAML text of plain data, in the order of their keys; ``how`` as ``yaml.dump`` takes it. Readers of YAML 1.1 take the same from it."""
    return yaml.dump(data, Dumper=Yaml12Dumper, sort_keys=False, **how)
