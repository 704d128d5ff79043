"""Driver options as pydantic models, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class BusOptions(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
