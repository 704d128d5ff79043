"""The base of what a plan may say under ``fake:``."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class StrictOptions(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
