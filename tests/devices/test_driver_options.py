"""Every driver that is delivered refuses options that are no numbers, whoever gives them."""

from importlib.metadata import entry_points

import pytest
from pydantic import ValidationError

from mbcacq.devices import DriverOptions

OURS = sorted(
    {
        model
        for kind in ("robots", "scanners", "positioners", "sensors")
        for point in entry_points(group=f"mbcacq.{kind}")
        if point.value.startswith("mbcacq_") and (model := getattr(point.load(), "options_model", None)) is not None
    },
    key=lambda model: model.__name__,
)
NUMBERS = [(model, name) for model in OURS for name, field in model.model_fields.items() if field.annotation in (float, float | None)]


@pytest.mark.parametrize(("model", "name"), NUMBERS, ids=lambda value: getattr(value, "__name__", value))
@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_infinity_and_nan_are_refused(model, name, value):
    with pytest.raises(ValidationError) as caught:
        model.model_validate({name: value})
    assert name in {error["loc"][0] for error in caught.value.errors()}


def test_every_driver_has_the_one_base():
    assert len(OURS) >= 9
    assert all(issubclass(model, DriverOptions) for model in OURS)
