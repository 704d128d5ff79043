"""The row of a recording in the table of a fleet; its types are those of the columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Self

import numpy as np
import pyarrow as pa
from pydantic import Field

from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.json_text import from_fields

LARGEST = 1e100  # of a figure of a table: its square is a number too
EVALUATED, REFUSED, FAILED = "evaluated", "refused", "failed"
ERROR, STD = "error.", "std."  # before the name of a parameter: its columns
Figure = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]


@dataclass(kw_only=True)
class FleetRow:
    """The row of a recording in the table. It is filled step by step, and missing results are None.

    Attributes
    ----------
    status : str
        'evaluated', 'refused' or 'failed'.
    reason : str or None
        The reason of the status, or the warnings of the calibration.
    estimates : dict[str, tuple[Figure, Figure]]
        Error and standard deviation, in mm or rad, of each free parameter; each stands in a column of its own, 'error.NAME' and 'std.NAME'.
        Ball centres, which belong to the artefact, are left out of them.
    names : tuple[str, ...]
        Names of all free parameters, in the order of the covariance (rows one after the other).
    nominal : tuple[Figure, ...]
        MD-H rows of the nominal arm one after the other.
    axes : tuple[str, ...]
        Names of its axes; empty: A1 ..
    effects : tuple[str, ...] or None
        Effects that were found, as 'NAME at WHERE'.
    out_of_control : tuple[str, ...] or None
        Figures outside their control limits.
    """

    recording: str
    arm: str
    time: str | None = None
    robot: str | None = None
    status: str = ""
    reason: str | None = None
    verdict: str | None = None
    poses: int | None = None
    centres: int | None = None
    rejected: int | None = None
    simulated: bool | None = None
    wall_s: float | None = None
    processor_s: float | None = None
    rms_mm: float | None = None
    chi2_dof: float | None = None
    expected_accuracy_mm: float | None = None
    spacing_max_mm: float | None = None
    spacing_mean_mm: float | None = None
    scanner_noise_mm: float | None = None
    joint_noise_rad: float | None = None
    transfer_rms_mm: float | None = None
    transfer_own_rms_mm: float | None = None
    transfer_normalised_error: float | None = None
    estimates: dict[str, tuple[Figure, Figure]] = field(default_factory=dict)
    effects: tuple[str, ...] | None = None
    out_of_control: tuple[str, ...] | None = None
    names: tuple[str, ...] = ()
    nominal: tuple[Figure, ...] = ()
    axes: tuple[str, ...] = ()
    covariance: tuple[Figure, ...] = ()

    @classmethod
    def of_columns(cls, columns: Mapping[str, Any]) -> Self:
        """The row of its columns. Raises ValueError if a value is not of its kind, or a calibrated arm lacks figures."""
        estimates = {
            name.removeprefix(ERROR): (error, columns.get(name.replace(ERROR, STD, 1)))
            for name, error in columns.items()
            if name.startswith(ERROR) and error is not None
        }
        given = {name: value for name, value in columns.items() if value is not None}
        row = from_fields(cls, {**given, "estimates": estimates})
        if row.status == EVALUATED and not row._is_whole():
            raise ValueError("figures of the calibrated arm are missing")
        return row

    def _is_whole(self) -> bool:
        """Whether the row has the figures of a calibrated arm: errors of its parameters, their covariance, the nominal arm."""
        of_the_arm = [name for name in self.names if name.rpartition("_")[0] in PARAMETERS]
        whole = len(self.covariance) == len(self.names) ** 2 and len(self.nominal) % len(PARAMETERS) == 0
        return whole and self.robot is not None and all(name in self.estimates for name in of_the_arm)

    def columns(self) -> dict[str, Any]:
        """Its columns by name; None in each of what did not come about."""
        out: dict[str, Any] = {}
        for one in fields(self):
            if one.name == "estimates":
                for name, (error, std) in self.estimates.items():
                    out |= {ERROR + name: error, STD + name: std}
            else:
                value = getattr(self, one.name)
                out[one.name] = None if value == one.default else value
        return out

    def covariance_of(self, names: Sequence[str]) -> np.ndarray:
        """(p, p) covariance of parameters, whatever the others are."""
        chosen = [self.names.index(name) for name in names]
        return np.reshape(self.covariance, (len(self.names), len(self.names)))[np.ix_(chosen, chosen)]


def estimates_of(rows: Sequence[FleetRow], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Error and standard deviation of a parameter, (N,) each, NaN where a row has none."""
    error, std = np.array([row.estimates.get(name, (np.nan, np.nan)) for row in rows], dtype=float).reshape(-1, 2).T
    return error, std


def arrow_schema(rows: Sequence[FleetRow]) -> Any:
    """The columns of rows with their types. Only those of parameters depend on the recordings."""
    kinds = {"str": pa.string(), "int": pa.int64(), "bool": pa.bool_(), "float": pa.float64()}
    kinds |= {"tuple[str, ...]": pa.list_(pa.string()), "tuple[Figure, ...]": pa.list_(pa.float64())}
    columns: list[tuple[str, Any]] = []
    for one in fields(FleetRow):
        if one.name == "estimates":
            names = dict.fromkeys(name for row in rows for name in row.estimates)
            columns += [(before + name, pa.float64()) for name in names for before in (ERROR, STD)]
        else:
            columns.append((one.name, kinds[str(one.type).removesuffix(" | None")]))
    return pa.schema(columns)
