"""Certificates as measuring machines write them."""

import numpy as np
import pytest
import yaml

from mbcacq.errors import ConfigError
from mbcacq.exports.certificate import read_certificate_file
from mbcacq.model.cell_schema import ArtefactSpec
from mbcacq.recording.datasets.cell_writer import artefact_to_yaml

CSV = "label,x (mm),y (mm),z (mm),diameter,form,U (k=2),k,T\nKugel 1,-4.4902,24.8573,-10.4992,12.0003,0.0004,0.0021,2,20.1\nKugel 2,-37.3617,6.3120,-5.4404,11.9998,0.0003,0.0017,2,20.1\n"
DMO = """$$ measured 2026-03-04
UNITS/MM,ANGDEC
F(SPH1)=FEAT/SPHERE,OUTER,CART,0.0,0.0,0.0,12.0
FA(SPH1)=FEAT/SPHERE,OUTER,CART,-4.4902,24.8573,$
-10.4992,12.0003
TA(T1)=TOL/DIAM,0.001,INTOL
FA(SPH2)=FEAT/SPHERE,OUTER,CART,-37.3617,6.3120,-5.4404,11.9998
"""


def read_certificate(path, *about):
    return read_certificate_file(path, *about).artefact


@pytest.fixture
def write(tmp_path):
    def put(name, text):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return put


CENTRES = [[-4.4902, 24.8573, -10.4992], [-37.3617, 6.312, -5.4404]]


def test_a_csv_certificate_is_read(write):
    a = read_certificate(write("c.csv", CSV), "mbc", "MBC-8")
    assert (a.id, a.name, a.ball_ids) == ("mbc", "MBC-8", (1, 2))
    np.testing.assert_array_equal(a.centres, CENTRES)
    np.testing.assert_array_equal(a.diameters, [12.0003, 11.9998])
    assert a.uncertainty_mm == pytest.approx(0.00105)
    assert a.reference_temperature_C == 20.1


def test_csv_with_semicolons_and_decimal_commas_is_read(write):
    a = read_certificate(write("c.csv", "Label;X;Y;Z;D\nA7;1,5;-2,25;3;12,0\nA9;0;0;0;12\n"), "mbc")
    assert a.ball_ids == (7, 9)
    np.testing.assert_array_equal(a.centres[0], [1.5, -2.25, 3])


def test_spheres_that_name_their_place_differently_are_one_list(write):
    """The first by its centre, others by x, y, z, in the file's unit, in another, or with a label of another name."""
    text = """balls:
  - {label: K1, centre_mm: [1, 2.5, 3], diameter_mm: 12}
  - {id: K2, x: 10, y: 0.5, z: -3, diameter: 12.5}
  - {label: K3, centre_cm: [2, 3, 4.25], d: 11}
  - {label: K4, x_m: 0.04, y_um: 1500, Z (mm): 7, diameter: 12}
"""
    a = read_certificate(write("c.yaml", text), "mbc")
    assert a.ball_ids == (1, 2, 3, 4)
    assert a.centres == pytest.approx(np.array([[1, 2.5, 3], [10, 0.5, -3], [20, 30, 42.5], [40, 1.5, 7]]), abs=1e-12)
    assert a.diameters.tolist() == [12, 12.5, 11, 12]
    in_inches = "units: inch\nspheres:\n  - {label: 1, x: 1, y: 2, z: 3, d: 0.5}\n  - {label: 2, centre_mm: [25.4, 0, 0], d: 0.5}\n"
    b = read_certificate(write("d.yaml", in_inches), "mbc")
    assert b.centres == pytest.approx(np.array([[25.4, 50.8, 76.2], [25.4, 0, 0]]), abs=1e-12)
    with pytest.raises(ConfigError, match="sphere 2 has no|column z_mm|the cell is empty"):
        read_certificate(write("e.yaml", "balls:\n  - {label: 1, centre_mm: [1, 2, 3], d: 9}\n  - {label: 2, x: 1, y: 2, d: 9}\n"), "mbc")


def test_a_yaml_certificate_is_read(write):
    text = (
        "certificate: DKD-1\ndate: 2026-03-04\nT: 20.5\nalpha: 11.5\nU: 0.002\nk: 2\nspheres:\n"
        "  - {label: S1, x: -4.4902, y: 24.8573, z: -10.4992, d: 12.0003}\n  - {label: S2, x: -37.3617, y: 6.312, z: -5.4404, d: 11.9998}\n"
    )
    a = read_certificate(write("c.yaml", text), "mbc")
    np.testing.assert_array_equal(a.centres, CENTRES)
    assert (a.uncertainty_mm, a.reference_temperature_C, a.expansion_ppm_per_K) == (0.001, 20.5, 11.5)


def test_dmis_takes_the_measured_spheres(write):
    a = read_certificate(write("c.dmo", DMO), "mbc")
    assert a.ball_ids == (1, 2)
    np.testing.assert_array_equal(a.centres, CENTRES)
    np.testing.assert_array_equal(a.diameters, [12.0003, 11.9998])


def test_dmis_in_inches_is_read_in_millimetres(write):
    a = read_certificate(write("c.dmo", "UNITS/INCH,ANGDEC\nFA(A)=FEAT/SPHERE,OUTER,CART,1,2,-3,0.5\n"), "mbc")
    np.testing.assert_allclose(a.centres, [[25.4, 50.8, -76.2]])
    np.testing.assert_allclose(a.diameters, [12.7])


def test_the_artefact_file_reads_back_exactly(write):
    a = read_certificate(write("c.csv", CSV), "mbc")
    for text in (artefact_to_yaml(a),):
        b = ArtefactSpec.model_validate(yaml.safe_load(text)).model()
        np.testing.assert_array_equal(a.centres, b.centres)
        np.testing.assert_array_equal(a.diameters, b.diameters)
        assert (a.ball_ids, a.uncertainty_mm, a.reference_temperature_C) == (b.ball_ids, b.uncertainty_mm, b.reference_temperature_C)
    again = read_certificate(write("ours.yaml", artefact_to_yaml(a)), "mbc")
    np.testing.assert_array_equal(a.centres, again.centres)
    assert again.uncertainty_mm == a.uncertainty_mm


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("c.csv", "", r"c\.csv:1: the file is empty"),
        ("c.csv", "label,x,y,z\n1,2,3,4\n", r"c\.csv:1: column d_mm is missing"),
        ("c.csv", "label,x,y,z,d\n1,2,3,4\n", r"c\.csv:2: column d: the row has 4 cells, the header 5"),
        ("c.csv", "label,x,y,z,d\n1,2,up,4,12\n", r"c\.csv:2: column y: 'up' is not a number"),
        ("c.csv", "label,x,y,z,d\n1,2,nan,4,12\n", "not a finite number"),
        ("c.csv", "label,x,y,z,d\n1,2,3,4,12\n1,2,3,9,12\n", "listed twice"),
        ("c.csv", "label,x,y,z,d\n1,2,3,4,-12\n", "not positive"),
        ("c.yaml", "a: [", "is not YAML"),
        ("c.yaml", "a: 1", "no list"),
        ("c.yaml", "balls:\n - {label: 1, x: 1, y: 2, z: 3}\n", r"c\.yaml: column d_mm is missing"),
        ("c.dmo", "FA(A)=FEAT/SPHERE,OUTER,POL,1,2,3,4\n", r"c\.dmo:1"),
        ("c.dmo", "\nFA(A)=FEAT/SPHERE,OUTER,CART,1,2,x,4\n", r"c\.dmo:2"),
        ("c.pdf", "x", "must be .csv"),
    ],
)
def test_faults_name_file_and_line(write, name, text, message):
    with pytest.raises(ConfigError, match=message):
        read_certificate(write(name, text), "mbc")


def test_a_missing_certificate_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.csv"):
        read_certificate(tmp_path / "none.csv", "mbc")


POINTS = "B1{s}0{s}0{s}0{s}1.2\nB2{s}6.2{s}0.01{s}-0.005{s}1.2\nB3{s}1.2{s}4.8{s}0.4{s}1.2\n"


@pytest.mark.parametrize(
    ("name", "text", "factor"),
    [
        ("c.csv", "label,x (cm),y (cm),z (cm),d (cm)\n" + POINTS.format(s=","), 10),
        ("c.csv", "label,x_inch,y_inch,z_inch,d_inch\n" + POINTS.format(s=","), 25.4),
        ("c.csv", "label\tx [cm]\ty [cm]\tz [cm]\tdiameter [cm]\n" + POINTS.format(s="\t"), 10),
        ("c.csv", "# all units: cm\nlabel,x,y,z,d\n" + POINTS.format(s=","), 10),
        ("c.csv", "label;x in cm;y in cm;z in cm;d in cm\n" + POINTS.format(s=";").replace(".", ","), 10),
        (
            "c.yaml",
            "unit: cm\nballs:\n"
            + "".join(
                f"- {{label: {r.split()[0]}, x: {r.split()[1]}, y: {r.split()[2]}, z: {r.split()[3]}, d: {r.split()[4]}}}\n"
                for r in POINTS.format(s=" ").splitlines()
            ),
            10,
        ),
        (
            "c.dmo",
            "UNITS/CM,ANGDEC\n"
            + "".join("FA({})=FEAT/SPHERE,OUTER,CART,{},{},{},{}\n".format(*r.split()) for r in POINTS.format(s=" ").splitlines()),
            10,
        ),
        (
            "c.dmo",
            "UNITS/METER,ANGDEC\n"
            + "".join("FA({})=FEAT/SPHERE,OUTER,CART,{},{},{},{}\n".format(*r.split()) for r in POINTS.format(s=" ").splitlines()),
            1000,
        ),
    ],
)
def test_units_are_honoured(write, name, text, factor):
    a = read_certificate(write(name, text), "mbc")
    assert a.centres[1] == pytest.approx(np.array([6.2, 0.01, -0.005]) * factor)
    assert a.diameters[0] == pytest.approx(1.2 * factor)


@pytest.mark.parametrize(
    "said", ["Units: inch", "Unit = in", "All dimensions in inch", "Messung in Zoll", "Einheit: Zoll", "Dimensions: inches"]
)
def test_inches_named_above_the_headings_are_read(write, said):
    text = f"{said}\nlabel,x,y,z,d\n" + "".join(f"B{i},{2 * i},{0.1 * i * i},0,1.5\n" for i in range(3))
    found = read_certificate_file(write("c.csv", text), "mbc")
    assert found.artefact.diameters == pytest.approx([38.1] * 3)
    assert found.artefact.centres[1] == pytest.approx([50.8, 2.54, 0])
    assert "read in inches" in found.notes[0]


def test_two_units_above_the_headings_are_refused(write):
    text = "Units: mm. All dimensions in inch\nlabel,x,y,z,d\nB1,0,0,0,12\n"
    with pytest.raises(ConfigError, match="speak of mm and of inches; write one"):
        read_certificate(write("c.csv", text), "mbc")
    same = "Units: mm. All dimensions in millimetres\nlabel,x,y,z,d\nB1,0,0,0,12\n"
    assert read_certificate(write("c.csv", same), "mbc").diameters[0] == 12


@pytest.mark.parametrize(
    ("heading", "value", "uncertainty"),
    [
        ("U (µm)", "12", 0.006),
        ("U_um", "12", 0.006),
        ("U (k=3, µm)", "12", 0.004),
        ("sigma", "0.004", 0.004),
        ("u (um)", "4", 0.004),
        ("standard uncertainty [nm]", "4000", 0.004),
    ],
)
def test_uncertainties_in_their_units(write, heading, value, uncertainty):
    text = f'label,x,y,z,d,"{heading}"\n' + "".join(f"B{i},{50 * i},{3 * i * i},0,12,{value}\n" for i in range(3))
    assert read_certificate(write("c.csv", text), "mbc").uncertainty_mm == pytest.approx(uncertainty)


def test_temperatures_and_expansions_in_their_units(write):
    text = "label,x,y,z,d,T (°F),alpha (1/K)\n" + "".join(f"B{i},{50 * i},{3 * i * i},0,12,68,1.15e-5\n" for i in range(3))
    a = read_certificate(write("c.csv", text), "mbc")
    assert a.reference_temperature_C == pytest.approx(20)
    assert a.expansion_ppm_per_K == pytest.approx(11.5)


def test_what_is_not_used_is_listed(write):
    text = "label,x,y,z,d,form error,inspector\n" + "".join(f"B{i},{50 * i},{3 * i * i},0,12,0.001,me\n" for i in range(3))
    found = read_certificate_file(write("c.csv", text), "mbc")
    assert found.unused == ("form error", "inspector")
    assert found.notes[0] == "not used: form error, inspector"
    assert "no uncertainty was read" in found.notes[1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("label,x (kg),y,z,d\nB1,1,2,3,12\n", "column x .kg.: x_mm cannot be given in kg"),
        ("label,x (deg),y,z,d\nB1,1,2,3,12\n", "column x .deg.: x_mm cannot be given in deg"),
        ("# units: furlongsx\nlabel,x,y,z,d\nB1,1,2,3,12\n", "the unit 'furlongsx' is no length"),
        ("label,x,y,z,d,x (mm)\nB1,1,2,3,12,4\n", "columns x and x .mm. both give x_mm"),
        ("label,x,y,z,d,U\nB1,1,2,3,12,1.2\n", "c.csv:2: column U: 1.2 looks like µm; name its unit"),
        ("label,x,y,z,d,T\nB1,1,2,3,12,68\n", "68 is no temperature of a measuring room in °C"),
        ("label,x,y,z,d,T\nB1,1,2,3,12,293.15\n", "293.15 is no temperature of a measuring room in °C"),
        ("label,x,y,z,d,alpha\nB1,1,2,3,12,1.15e-5\n", "1.15e-5 in ppm/K looks like 1/K"),
    ],
)
def test_units_that_cannot_be_honoured_are_refused(write, text, words):
    with pytest.raises(ConfigError, match=words):
        read_certificate(write("c.csv", text), "mbc")


def test_an_unknown_unit_of_dmis_is_refused(write):
    with pytest.raises(ConfigError, match="the unit 'PARSEC' is not known"):
        read_certificate(write("c.dmo", "UNITS/PARSEC,ANGDEC\n"), "mbc")
