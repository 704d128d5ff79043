"""Every driver that is delivered refuses numbers that no device has, whoever gives them."""

from importlib.metadata import entry_points

import pytest
from mbcacq_bus.stations import StationOptions
from mbcacq_ur.options import UrOptions
from pydantic import ValidationError

from mbcacq.devices import ConfigError, DriverOptions, parse_options, same_model

OURS = sorted(
    {
        model
        for kind in ("robots", "scanners", "positioners", "sensors")
        for point in entry_points(group=f"mbcacq.{kind}")
        if point.value.startswith("mbcacq_") and (model := getattr(point.load(), "options_model", None)) is not None
    },
    key=lambda model: model.__name__,
)
NUMBERS = [
    (model, name)
    for model in OURS
    for name, field in model.model_fields.items()
    if field.annotation in (int, int | None, float, float | None)
]


@pytest.mark.parametrize(("model", "name"), NUMBERS, ids=lambda value: getattr(value, "__name__", value))
@pytest.mark.parametrize("value", [float("inf"), float("nan"), 1e20, -1e20, "8", True])
def test_what_is_no_number_of_a_device_is_refused(model, name, value):
    with pytest.raises(ValidationError) as caught:
        model.model_validate({name: value})
    assert name in {error["loc"][0] for error in caught.value.errors()}


@pytest.mark.parametrize("stations", [{"1": 1e20}, {"1": 0.0, "2": float("nan")}])
def test_numbers_within_an_option_are_looked_at(stations):
    with pytest.raises(ConfigError, match=r"stations(: 1e\+20 is beyond 1e\+10|\.2: )"):
        parse_options(StationOptions, "the lift", {"stations": stations})


def test_a_text_in_place_of_a_number_is_told_what_is_wanted():
    with pytest.raises(ConfigError, match="payload_kg must be a number of at least 0, not '08'"):
        parse_options(UrOptions, "the arm", {"address": "192.168.0.10", "limits_deg": [[-1, 1]] * 6, "payload_kg": "08"})
    with pytest.raises(ConfigError, match=r"payload_kg: 1e\+06 is beyond 5000, the most that any device has"):
        parse_options(UrOptions, "the arm", {"address": "192.168.0.10", "limits_deg": [[-1, 1]] * 6, "payload_kg": 1e6})


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
