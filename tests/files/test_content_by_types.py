"""The types of a dataclass write it and read it: what a file lacks, or a newer program wrote, is one sentence."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field

from mbcacq.errors import ConfigError
from mbcacq.model.json_text import EveryKey, Matrix, fields_as_json, from_document, from_fields, keyed


@dataclass(frozen=True, kw_only=True)
class Kept(EveryKey):
    left_out = ("held",)
    later = ("kind", "size")

    q: Annotated[Matrix, Field(alias="q_rad")]
    variant: str = ""
    held: bool = False
    kind: Literal["small", "large"] = "small"
    size: Annotated[tuple[float, str], keyed("value", "unit")] | None = None


def read(content):
    return from_document(Kept, content, ("mbcacq-kept/1", "mbcacq-kept/2"), "kept.json", "kept thing", "keep it anew")


def test_what_is_written_reads_back_and_says_nothing_of_what_is_not_so():
    content = fields_as_json(Kept(q=np.array([[0.5, 1.0]])))
    assert content == {"q_rad": [[0.5, 1.0]], "variant": "", "kind": "small", "size": None}
    assert from_fields(Kept, content).q.tolist() == [[0.5, 1.0]]
    assert fields_as_json(Kept(q=np.zeros((1, 1)), held=True)) == {
        "q_rad": [[0.0]],
        "variant": "",
        "held": True,
        "kind": "small",
        "size": None,
    }
    assert fields_as_json(Kept(q=np.zeros((1, 1)), size=(2.0, "mm")))["size"] == {"value": 2.0, "unit": "mm"}
    assert from_fields(Kept, content | {"size": {"value": 2.0, "unit": "mm"}}).size == (2.0, "mm")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"format": "mbcacq-kept/3"}, "kept.json was written by a newer mbcacq: its format is 'mbcacq-kept/3'"),
        ({"format": "mbcacq-plan/1"}, "kept.json is no kept thing of format 'mbcacq-kept/2'; keep it anew"),
        ({"q_rad": [[1.0], [1.0, 2.0]]}, "kept.json is damaged (q_rad: its rows are not of one length); keep it anew"),
        ({"q_rad": [["x"]]}, "kept.json is damaged (q_rad.0.0: it is no number); keep it anew"),
        ({"variant": None}, "kept.json is damaged (variant: it is no text); keep it anew"),
        ({"kind": "huge"}, "kept.json is damaged (kind: it is not 'small' or 'large'); keep it anew"),
        ({"size": {"value": 2.0}}, "kept.json is damaged (size: the key 'unit' is missing); keep it anew"),
        ({"held": "perhaps"}, "kept.json is damaged (held: it is neither true nor false); keep it anew"),
    ],
)
def test_what_is_wrong_is_named_by_file_key_and_cure(change, sentence):
    with pytest.raises(ConfigError) as error:
        read({"format": "mbcacq-kept/1", "q_rad": [[1.0]], "variant": ""} | change)
    assert str(error.value).startswith(sentence)


def test_a_key_that_has_a_default_in_python_may_not_be_missing_in_a_file():
    with pytest.raises(ConfigError, match="the key 'variant' is missing"):
        read({"format": "mbcacq-kept/1", "q_rad": [[1.0]]})
