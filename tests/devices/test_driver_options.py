"""Every driver that is delivered refuses options that are no numbers, whoever gives them."""

from importlib.metadata import entry_points

import pytest
from pydantic import ValidationError

from mbcacq.devices import DriverOptions, same_model

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


@pytest.mark.parametrize(
    ("wanted", "reported", "same"),
    [
        ("kr210_r2700_2", "#KR210R2700_2 C4 FLR", True),
        ("KUKA KR 16 R2010-2", "#KR16R2010_2 C4 FLR", True),
        ("KR 16-2", "#KR16_2 C2", True),
        ("KR 210 R2700-2", "#KR210R3100_2 C4 FLR", False),
        ("KR 6 R900-2", "#KR6R700_2 C5", False),
        ("KR 10", "KR 1000 titan", False),
        ("KR 10", "#KR10R1100_2 C5", True),
    ],
)
def test_model_names(wanted, reported, same):
    assert same_model(wanted, reported) is same
