"""Tables of Denavit-Hartenberg rows as people write them; units that cannot be meant, and axes that do not turn, are refused."""

import numpy as np
import pytest
import yaml

from mbcacq.errors import ConfigError
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.model.robot_import import import_robot

PLAIN = "theta_deg,d_mm,a_mm,alpha_deg\n0,400,25,-90\n0,0,560,0\n-90,0,25,-90\n0,515,0,90\n0,0,0,-90\n180,90,0,0\n"


@pytest.fixture
def read(tmp_path):
    def read(text, name="rows.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        found = import_robot(path, convention="standard")
        return RobotSpec.model_validate(yaml.safe_load(found.text)).model().chain.rows, found.remarks

    return read


FORMS = {
    "tabs": PLAIN.replace(",", "\t"),
    "units in brackets": PLAIN.replace("theta_deg,d_mm,a_mm,alpha_deg", "theta (deg),d [mm],a (mm),alpha (°)"),
    "Greek letters": PLAIN.replace("theta_deg", "θ (deg)").replace("alpha_deg", "α (deg)"),
    "pi": PLAIN.replace("theta_deg", "theta_rad")
    .replace("alpha_deg", "alpha_rad")
    .replace("-90", "-pi/2")
    .replace(",90\n", ",π/2\n")
    .replace("180", "pi"),
    "units in the cells alone": "theta,d,a,alpha\n0,0.4 m,25 mm,-pi/2\n0,0,0.56 m,0\n-90°,0.0,2.5 cm,-90°\n0,515 mm,0,pi/2\n0,0,0,-pi/2\npi,90 mm,0,0\n",
    "degree signs": PLAIN.replace("-90", "-90°").replace(",90\n", ",90°\n"),
    "trailing separators": PLAIN.replace("\n", ",,\n"),
    "quoted decimal commas": PLAIN.replace("400", '"400,0"').replace(",25,", ',"25,0",'),
    "semicolons and decimal commas": PLAIN.replace(",", ";").replace("400", "400,0"),
    "metres": PLAIN.replace("d_mm,a_mm", "d_m,a_m")
    .replace("400,25", "0.4,0.025")
    .replace("560", "0.56")
    .replace(",0,25,", ",0,0.025,")
    .replace("515", "0.515")
    .replace("180,90", "180,0.09"),
    "UTF-16": PLAIN.replace(",", "\t").encode("utf-16"),
    "lone carriage returns": PLAIN.replace("\n", "\r"),
    "type R": PLAIN.replace("alpha_deg\n", "alpha_deg,type\n")
    .replace("-90\n", "-90,R\n")
    .replace(",0\n", ",0,R\n")
    .replace(",90\n", ",90,R\n"),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_one_arm_in_many_forms(read, text):
    assert read(text)[0] == pytest.approx(read(PLAIN)[0], abs=1e-9)


def test_lengths_of_nearly_parallel_axes_may_be_large_and_cancel(read):
    """Factory rows of a UR: d of axes 2, 3, 4 are free to slide along almost the same line; the arm reaches as far as without."""
    tilt, slide = 1e-4, 500e3
    turned = float(np.degrees(tilt))
    rows = [[0, 89.2, 0, 90], [0, slide, -425, turned], [0, -2 * slide, -392, -2 * turned], [0, slide + 109, 0, 90]]
    text = "theta_deg,d_{u},a_{u},alpha_deg\n" + "".join(
        f"{t},{d},{a},{w!r}\n" for t, d, a, w in [*rows, [0, 94.7, 0, -90], [0, 82.3, 0, 0]]
    )
    assert len(read(text.format(u="mm"))[0]) == 6
    for unit, factor in (("m", 1.0), ("mm", 1e-3)):  # mm said to be m, and m said to be mm
        wrong = "theta_deg,d_{u},a_{u},alpha_deg\n" + "".join(f"{t},{factor * d},{factor * a},{w!r}\n" for t, d, a, w in rows)
        with pytest.raises(ConfigError, match="the flange of these rows is .* from the base, which looks like"):
            read(wrong.format(u=unit))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FORMS["metres"].replace("d_m,a_m", "d_mm,a_mm"), "looks like metres; name the columns d_m, a_m"),
        (PLAIN.replace("d_mm,a_mm", "d_m,a_m"), "looks like mm; name the columns d_mm, a_mm"),
        (PLAIN.replace("-90\n", "-1.5708\n"), "has -1.5708, which looks like radians; name the column alpha_rad"),
        (PLAIN.replace("alpha_deg", "alpha_rad"), "which looks like degrees; name the column alpha_deg"),
        (
            PLAIN.replace("theta_deg,d_mm", "theta,d_mm"),
            "rows.csv:1: column theta_deg is missing: column theta names no unit; name it so if it is in deg",
        ),
        (FORMS["units in the cells alone"].replace("-pi/2", "-1.57", 1), "column alpha names no unit"),
        (PLAIN.replace("d_mm", "d (kg)"), "rows.csv:1: column d .kg.: d_mm cannot be given in kg"),
        (PLAIN.replace("d_mm", "d_deg"), "column d_mm is missing .the header has: theta_deg, d_deg"),
        (FORMS["type R"].replace(",R", ",P", 1), "row 1 slides and has no lower_mm and upper_mm; give both"),
        (PLAIN.replace("0,400,25,-90", "0,400,25,5,-90"), "rows.csv:2: column alpha_deg: the row has 5 cells, the header 4"),
        (PLAIN.replace("400", "4_00"), "not a number"),
        (PLAIN.replace("theta_deg", "d_cm"), "columns d_cm and d_mm both give d_mm"),
    ],
)
def test_what_cannot_be_meant_is_refused(read, text, words):
    with pytest.raises(ConfigError, match=words):
        read(text)


def test_columns_that_are_not_known_are_said(read):
    rows, remarks = read(
        PLAIN.replace("alpha_deg\n", "alpha_deg,motor\n").replace("-90\n", "-90,a\n").replace(",0\n", ",0,a\n").replace(",90\n", ",90,a\n")
    )
    assert rows == pytest.approx(read(PLAIN)[0])
    assert "columns not used: motor" in remarks


def test_a_mass_without_its_centre_is_said(read):
    _, remarks = read(
        PLAIN.replace("alpha_deg\n", "alpha_deg,mass_kg\n")
        .replace("-90\n", "-90,9\n")
        .replace(",0\n", ",0,0\n")
        .replace(",90\n", ",90,0\n")
    )
    assert any(remark.startswith("the mass of rows ") and "1" in remark for remark in remarks)


def test_a_calibrated_table_is_not_taken_for_radians(read):
    """Its angles differ from whole quarters of a turn by thousandths of a degree, small ones are small."""
    rows, _ = read(PLAIN.replace("-90\n", "-90.0131\n").replace("0,0,560,0", "0.0312,0,560.21,0.0093"))
    assert np.degrees(rows[0][3]) == pytest.approx(-90.0131)


def test_a_row_of_sigma_one_slides_along_its_z(tmp_path):
    """Behind the first row's -90 deg about x the next z is y of the base."""
    text = "sigma,theta_deg,d_mm,a_mm,alpha_deg,lower_mm,upper_mm\n0,0,400,25,-90,,\n{},0,0,560,0,-100,900\n0,-90,0,25,-90,,\n"
    (tmp_path / "a.csv").write_text(text.format(1))
    arm = RobotSpec.model_validate(yaml.safe_load(import_robot(tmp_path / "a.csv", convention="standard").text)).model()
    at = arm.chain.flange(np.array([[0, 0, 0], [0, 321.0, 0]]))
    np.testing.assert_allclose(at[1, :3, 3] - at[0, :3, 3], [0, 321, 0], atol=1e-9)
    assert arm.limits[1].tolist() == [-100, 900]
    (tmp_path / "a.csv").write_text(text.format(0))
    assert len(import_robot(tmp_path / "a.csv", convention="standard").joints) == 3
