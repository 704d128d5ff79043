"""Documents that the program wrote before, kept as they were: each is still read, with every value that it has."""

import json
from pathlib import Path

import jsonschema
import pytest

from mbcacq.diagnosis.schema import diagnosis_schema
from mbcacq.workflow.diagnosis_result import DiagnosisResult

DOCUMENTS = Path(__file__).parent / "documents"


def keeps(old, new):
    """Whether all that stands in the old content stands in the new one."""
    if isinstance(old, dict):
        return all(key in new and keeps(content, new[key]) for key, content in old.items() if key != "format")
    if isinstance(old, list):
        return len(old) == len(new) and all(map(keeps, old, new))
    return old == new


@pytest.mark.parametrize("name", ["motion-1", "poses-1", "poses-2"])
def test_a_document_of_an_older_version_is_read_with_all_its_values(name):
    old = json.loads((DOCUMENTS / f"{name}.json").read_text(encoding="utf-8"))
    assert keeps(old, DiagnosisResult.from_json(json.dumps(old)).to_dict())


@pytest.mark.parametrize("name", ["motion-3", "poses-and-motion-3"])
def test_a_document_of_this_version_is_written_again_with_the_same_keys_and_values(name):
    old = json.loads((DOCUMENTS / f"{name}.json").read_text(encoding="utf-8"))
    assert DiagnosisResult.from_json(json.dumps(old)).to_dict() == old


def test_the_schema_describes_the_motion_beside_poses_and_alone():
    schema = diagnosis_schema()
    for name, described in (("poses-and-motion-3", schema), ("motion-3", schema["$defs"]["MotionDiagnosis"] | {"$defs": schema["$defs"]})):
        content = json.loads((DOCUMENTS / f"{name}.json").read_text(encoding="utf-8"))
        jsonschema.validate(content, described)
        (content.get("motion") or content)["effects"][0]["steps"][0].pop("adds")
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(content, described)


@pytest.mark.parametrize("key", ["agreement", "decided", "together"])
def test_what_poses_and_motion_say_together_is_described(key):
    content = json.loads((DOCUMENTS / "poses-and-motion-3.json").read_text(encoding="utf-8"))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content | {key: [{"unknown": 1}]}, diagnosis_schema())
