"""Effects that were found, from wherever they are kept, as the model that a calibration takes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbcacq.calibration import CalibratedCell, Calibration
from mbcacq.calibration.joint_file import result_of_one, split_number
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.effect_model import EffectModel, combined
from mbcacq.errors import ConfigError
from mbcacq.workflow.diagnose import DiagnosisResult

One = DiagnosisResult | Diagnosis | EffectModel | Calibration | CalibratedCell | Path | str
Effects = One | Sequence[One]


def as_effects(found: Effects) -> EffectModel:
    """The model of effects of a diagnosis, a calibrated cell, their JSON files, or several of these of one arm together.

    Raises ConfigError where there is none, and says why.
    """
    if isinstance(found, Sequence) and not isinstance(found, str):
        return combined([as_effects(one) for one in found])
    if isinstance(found, EffectModel):
        return found
    if isinstance(found, Path | str):
        return _from_file(Path(found))
    diagnosis = found.poses if isinstance(found, DiagnosisResult) else found
    model = diagnosis.effects if isinstance(diagnosis, Calibration | CalibratedCell) else diagnosis.model if diagnosis else None
    if not model:
        raise ConfigError("there are no effects in this diagnosis or result that a calibration could take; calibrate without --effects")
    return model


def _from_file(path: Path) -> EffectModel:
    path, number = split_number(path)
    names = ("diagnosis.json", "result.json")
    file = next((path / name for name in names if (path / name).is_file()), path) if path.is_dir() else path
    try:
        content: Any = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read {file}: {error.strerror}; give what mbcacq diagnose --out wrote") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{file} is not JSON ({error}); give what mbcacq diagnose --out wrote") from error
    content = result_of_one(content, number, file, any_of_them=True)
    if not isinstance(content, dict):
        raise ConfigError(f"{file} is no diagnosis; give what mbcacq diagnose --out wrote")
    held = content.get("effects") if str(content.get("format")).startswith("mbcacq-result/") else content.get("model")
    if str(content.get("format")).startswith("mbcacq-effect-model/"):
        held = content
    if not held:
        raise ConfigError(
            f"{file} holds no effects that a calibration could take (format {content.get('format')!r}): "
            "diagnose the recording anew with mbcacq diagnose --out FILE"
        )
    return EffectModel.from_dict(held)
