"""Effects that were found, from wherever they are kept, as the model that a calibration takes."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_io import result_of_one, split_number
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects import catalogue
from mbcacq.effects.effect_model import EffectModel, combined
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.errors import ConfigError
from mbcacq.model.formats import newer_format
from mbcacq.model.json_text import read_json
from mbcacq.recording.datasets.open_format import RESEMBLES
from mbcacq.workflow.diagnosis_result import DiagnosisResult

One = DiagnosisResult | Diagnosis | EffectModel | CalibratedCell | Path | str
Effects = One | Sequence[One]
READABLE = ("mbcacq-diagnosis/3", "mbcacq-result/1", "mbcacq-effect-model/1")
DIAGNOSIS, RESULT, EFFECT_MODEL = KINDS = ("mbcacq-diagnosis/", "mbcacq-result/", "mbcacq-effect-model/")


def as_effects(found: Effects) -> EffectModel:
    """The model of effects of a diagnosis, a calibrated cell, their JSON files, or several of these of one arm together.

    Raises ConfigError if there is none, and says why.
    """
    if isinstance(found, Sequence) and not isinstance(found, str):
        return combined([as_effects(one) for one in found])
    if isinstance(found, EffectModel):
        return found
    if isinstance(found, Path | str):
        return _from_file(Path(found))
    diagnosis = found.poses if isinstance(found, DiagnosisResult) else found
    model = diagnosis.effects if isinstance(diagnosis, CalibratedCell) else diagnosis.model if diagnosis else None
    if not model:
        raise ConfigError("there are no effects in this diagnosis or result that a calibration could take; calibrate without --effects")
    return model


def _from_file(path: Path) -> EffectModel:
    path, number = split_number(path)
    names = ("diagnosis.json", "result.json")
    file = next((path / name for name in names if (path / name).is_file()), path) if path.is_dir() else path
    try:
        text = file.read_bytes()
    except OSError as error:
        raise ConfigError(f"cannot read {file}: {error.strerror}; give what mbcacq diagnose --out wrote") from error
    content: Any = result_of_one(read_json(text, str(file), "give what mbcacq diagnose --out wrote"), number, file, any_of_them=True)
    if not isinstance(content, dict):
        raise ConfigError(f"{file} is no diagnosis; give what mbcacq diagnose --out wrote")
    kind = content.get("format")
    if not isinstance(kind, str):
        raise ConfigError(f"{file} does not say its format, as a diagnosis does; give what mbcacq diagnose --out wrote")
    if sentence := newer_format(kind, READABLE):
        raise ConfigError(f"{file} {sentence}")
    if not kind.startswith(KINDS):
        raise ConfigError(
            f"{file} is of format '{kind}', and no diagnosis, result or model of effects; give what mbcacq diagnose --out wrote"
        )
    fit = content.get("fit")
    if isinstance(fit, dict) and "channels" in fit:
        raise ConfigError(
            f"{file} is the diagnosis of a motion: its effects are of torques and paths, and none is a displacement at standstill that a "
            "calibration could take; give the diagnosis of a recording of poses, or leave out --effects"
        )
    key = "" if kind.startswith(EFFECT_MODEL) else "effects" if kind.startswith(RESULT) else "model"
    held = content.get(key) if key else content
    if not held:
        raise ConfigError(
            f"{file} holds no effects that a calibration could take: its '{key}' is empty or missing; diagnose anew, or leave out --effects"
        )
    model = EffectModel.from_dict(held, str(file), key)
    if not model:
        terms = f"{key}.terms" if key else "terms"
        raise ConfigError(f"{file} holds no effects that a calibration could take: {terms} is empty; diagnose anew, or leave out --effects")
    return model


def remarks_on_names(names: Iterable[str]) -> list[str]:
    """A sentence for each name of an effect that neither the catalogue nor an installed package has.

    Such an effect is used: its file says what it displaces, and another machine may lack the package or the file that found it. But it
    may be a slip, which the reader must see.
    """
    try:
        known = sorted(catalogue.effects())
    except ConfigError:
        return []  # a broken package is named where effects are searched for
    out = []
    for name in dict.fromkeys(names):
        if name in known or name == UNKNOWN:
            continue
        near = difflib.get_close_matches(name, known, 1, cutoff=RESEMBLES)
        meant = f" (is '{near[0]}' meant?)" if near else ""
        out.append(f"the effect '{name}' is not in the catalogue here{meant}: it is taken as its file describes it")
    return out
