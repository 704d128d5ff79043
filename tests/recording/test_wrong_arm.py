"""A table of joint angles that is read with another arm than the one that moved."""

import numpy as np
import pytest

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model import shipped
from mbcacq.recording.datasets.loose_table import TableOptions, read_loose_table


@pytest.fixture
def table(tmp_path):
    """Thirty postures of a KR 10 R1100, whose target on the flange a tracker measured in the base."""
    rng = np.random.default_rng(4)
    q = np.radians([0, -90, 90, 0, 40, 0]) + rng.uniform(-0.9, 0.9, (30, 6))
    xyz = se3.apply(shipped.robot("kr10_r1100_2").chain.flange(q), np.array([20.0, -35.0, 120.0]))
    rows = np.column_stack([np.degrees(q), xyz])
    heads = [*(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm"]
    (tmp_path / "table.csv").write_text("\n".join([",".join(heads), *(",".join(f"{v:.6f}" for v in row) for row in rows)]))
    return tmp_path / "table.csv"


def test_the_wrong_arm_is_refused_and_the_shipped_one_that_fits_is_named(table):
    with pytest.raises(ConfigError, match="with the links of KUKA KR 10 R1100-2 in place of Universal Robots UR10e"):
        read_loose_table(table, TableOptions(robot=shipped.robot("ur10e")))


def test_an_arm_that_is_not_shipped_is_doubted(table, tmp_path):
    lines = table.read_text().splitlines()
    rng = np.random.default_rng(5)
    moved = [f"{line.rpartition(',')[0]},{float(line.rpartition(',')[2]) + 60 * rng.standard_normal():.3f}" for line in lines[1:]]
    (tmp_path / "other.csv").write_text("\n".join([lines[0], *moved]))
    with pytest.raises(ConfigError, match=r"check that it is this arm \(--robot\)"):
        read_loose_table(tmp_path / "other.csv", TableOptions(robot=shipped.robot("kr10_r1100_2")))


def test_the_right_arm_is_read(table):
    read = read_loose_table(table, TableOptions(robot=shipped.robot("kr10_r1100_2"), by_instrument=True))
    assert read.observations.n_poses == 30
