"""What is drawn is true: distances to the sphere, the path of the flange, spikes of a curve, the arm of a URDF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic

from mbcacq.devices import Cycles
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.cell import Artefact
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.rrd import layout, scan_colouring
from mbcacq.recording.rrd.chart import ticks, written
from mbcacq.recording.rrd.drawable import drawable
from mbcacq.recording.rrd.drawing import flange_strips
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.rrd.result_recording import round_scale
from mbcacq.recording.rrd.urdf_arm import UrdfArm
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.report.cards import SIGNS

CELL = parse_cell(synthetic.CELL)


def sphere(rng, centre, radius, count, scatter=0.0):
    towards = rng.normal(size=(count, 3))
    return centre + (radius + scatter * rng.normal(size=(count, 1))) * towards / np.linalg.norm(towards, axis=1, keepdims=True)


def test_points_are_coloured_by_their_distance_to_the_certified_sphere():
    rng = np.random.default_rng(0)
    artefact = Artefact("mbc", "", (4, 9), np.zeros((2, 3)), np.array([12.0, 20.0]))
    centres = np.array([[0.0, 0, 0], [40, 0, 0]])
    points = np.vstack([sphere(rng, centres[0], 6.030, 3000), sphere(rng, centres[1], 9.985, 3000, 0.004), rng.uniform(60, 90, (9000, 3))])
    coloured = scan_colouring.colour_scan(points.astype(np.float32), artefact, np.array([4, 9]), centres)
    np.testing.assert_allclose(coloured.radius_um, [30.0, -15.0], atol=0.5)
    np.testing.assert_allclose(coloured.form_um, [0.0, 2 * 1.96 * 4.0], atol=1.0)  # 95 % of a normal distribution
    first = coloured.colours[: scan_colouring.MOST_ON_BALL // 2].astype(int)
    assert (first == scan_colouring.OUTSIDE).all()  # 30 um outside: the end of the scale
    last = coloured.colours[-scan_colouring.MOST_ON_BALL // 2 :].astype(int)
    assert (last[:, 2] > last[:, 0]).mean() > 0.95  # inside: towards blue
    assert len(coloured.on_balls) <= 2 * scan_colouring.MOST_ON_BALL
    assert 0 < len(coloured.background) <= scan_colouring.MOST_BACKGROUND
    assert coloured.background.min() > 59


def test_a_scan_without_balls_is_all_background():
    coloured = scan_colouring.colour_scan(
        np.random.default_rng(0).uniform(0, 9, (50, 3)), CELL.artefacts[0], np.zeros(0, int), np.zeros((0, 3))
    )
    assert len(coloured.on_balls) == 0
    assert len(coloured.background) == 50


def test_each_path_ends_at_its_pose():
    rng = np.random.default_rng(1)
    route = {7: rng.normal(size=(3, 6)), 8: rng.normal(size=(1, 6))}
    strips = flange_strips(CELL, np.zeros(6), route)
    for strip, ends in zip(strips, route.values(), strict=True):
        np.testing.assert_allclose(strip[-1], CELL.robot.chain.flange(ends[-1:])[0, :3, 3], atol=1e-3)
    np.testing.assert_allclose(strips[1][0], strips[0][-1], atol=1e-3)


def test_a_spike_between_two_drawn_points_is_drawn(tmp_path):
    rng = np.random.default_rng(0)
    batch = synthetic.cycles(rng, 0.0, 100)
    batch.columns["q_command"] = batch.columns["q"].copy()
    batch.columns["q_command"][53, 2] -= np.radians(3.0)
    with Recorder(tmp_path) as recorder:
        recorder(synthetic.start())
        recorder(synthetic.events.CyclesReceived(0.5, batch))
    following = Recording(tmp_path / "run.rrd").columns(layout.FOLLOWING, "rerun.archetypes.Scalars")["scalars"]
    assert len(following) == 20
    assert following[:, 2].min() == pytest.approx(-3.0)
    assert np.abs(np.delete(following, 2, axis=1)).max() < 1e-9


def test_an_axis_that_slides_is_drawn_in_cm(tmp_path):
    """1234 mm beside angles of some radians: 123.4, not 1234 * 180 / pi."""
    slides = synthetic.CELL.replace(
        "sign: -1, theta_deg: 0, d_mm: 400", "type: prismatic, limits_mm: [0, 2000], sign: 1, theta_deg: 0, d_mm: 400", 1
    )
    batch = synthetic.cycles(np.random.default_rng(0), 0.0, 100)
    batch.columns["q"][:, 0] = 1234.0
    with Recorder(tmp_path) as recorder:
        recorder(replace(synthetic.start(), cell_yaml=slides))
        recorder(synthetic.events.CyclesReceived(0.5, batch))
    shown = Recording(tmp_path / "run.rrd").columns(layout.JOINTS, "rerun.archetypes.Scalars")["scalars"]
    np.testing.assert_allclose(shown[:, 0], 123.4)
    np.testing.assert_allclose(shown[:, 1:], np.degrees(batch.columns["q"][::5, 1:]))


def test_an_arm_that_stands_is_not_drawn_anew_and_one_that_creeps_is(tmp_path):
    """What is drawn is never farther from where the arm is than a tenth of a millimetre at 2 m."""
    rng = np.random.default_rng(0)
    batch = synthetic.cycles(rng, 0.0, 400)
    time_s = 0.04 * np.arange(400)
    creeping = np.where(time_s < 8.0, 0.0, 1e-5 * np.arange(400))[:, None] * np.array([1, 0, 0, 0, 0, 0])
    changed = {"time_s": time_s, "host_time_s": 1e4 + time_s, "q": batch.columns["q"][:1] + creeping}
    batch = Cycles({**batch.columns, **changed})
    with Recorder(tmp_path) as recorder:
        recorder(synthetic.start())
        recorder(synthetic.events.CyclesReceived(16.0, batch))
    drawn = [row["translation"] for row in Recording(tmp_path / "run.rrd").rows(layout.link(6)) if "translation" in row][1:]
    assert 30 < len(drawn) < 50  # once for eight seconds, then each sixth of 200 positions
    flange = CELL.robot.chain.flange(batch.columns["q"])[:, :3, 3]
    assert np.linalg.norm(flange[-1] - drawn[-1]) < 0.1


def test_rows_carry_pose_step_and_time_of_day(a_run):
    row = next(r for r in Recording(a_run / "run.rrd").rows(layout.BALLS_FOUND) if "scalars" in r and layout.POSE in r)
    assert row[layout.STEP_INDEX] == 0
    started = np.datetime64("2026-01-02T03:04:05", "ns").astype(np.int64)
    assert row[layout.CLOCK] == started + row[layout.TIME]


@pytest.mark.parametrize(("wanted", "scale"), [(1999.0, 1000.0), (2000.0, 2000.0), (7.3, 5.0), (0.25, 0.2), (0.0, 1.0), (np.nan, 1.0)])
def test_magnifications_are_round(wanted, scale):
    assert round_scale(wanted) == pytest.approx(scale)


@pytest.mark.parametrize("ends", [(-44.0, 72.0), (-99.0, 96.0), (0.0, 1.0), (-3e-4, 2e-4), (-0.02, 0.019)])
@pytest.mark.parametrize("most", [3, 6, 8])
def test_an_axis_has_at_least_two_values_within_its_ends(ends, most):
    values = ticks(ends, most)
    assert len(values) >= 2
    assert ends[0] <= values[0] < values[-1] <= ends[1] + 1e-9
    assert not any(text.startswith("-0") and float(text) == 0 for text in map(written, values))


def urdf(chain, turned=None):
    """A URDF of a chain: each joint's frame where its axis is at zero."""
    out, before = ['<robot name="arm"><link name="base_link"/>'], np.eye(4)
    for i, T in enumerate(chain.frames(np.zeros((1, chain.n)))[0][:-1]):
        xyz, (yaw, pitch, roll) = se3.to_abc(se3.inverse(before) @ T)
        sign = int(chain.sign[i]) * (-1 if i == turned else 1)
        shape = '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
        out.append(
            f'<link name="link{i}">{shape}</link><joint name="joint{i}" type="revolute"><parent link="{f"link{i - 1}" if i else "base_link"}"/>'
            f'<child link="link{i}"/><origin xyz="{xyz[0] / 1e3} {xyz[1] / 1e3} {xyz[2] / 1e3}" rpy="{roll} {pitch} {yaw}"/>'
            f'<axis xyz="0 0 {sign}"/><limit lower="-6" upper="6" effort="1" velocity="1"/></joint>'
        )
        before = T
    return "".join([*out, "</robot>"])


def test_a_urdf_of_the_same_arm_is_drawn_and_moves(tmp_path):
    from dataclasses import replace

    file = tmp_path / "arm.urdf"
    file.write_text(urdf(CELL.robot.chain))
    with Recorder(tmp_path / "run") as recorder:
        recorder(replace(synthetic.start(), urdf=str(file)))
        for event in synthetic.pose(np.random.default_rng(0), 0, 1.0):
            recorder(event)
    recording = Recording(tmp_path / "run" / "run.rrd")
    joints = [r for r in recording.rows(f"{layout.URDF}/joints/joint2") if "quaternion" in r]
    assert len(joints) > 2
    assert not np.allclose(joints[0]["quaternion"], joints[-1]["quaternion"])
    assert not list(recording.rows(f"{layout.link(2)}/body"))  # its links are not drawn twice


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (urdf(CELL.robot.chain, turned=2), "do not move as those of six axes"),
        ("<robot name='a'><link name='base'/></robot>", "has 0 moving joints"),
        ("no xml", "cannot be read as a URDF"),
    ],
)
def test_another_urdf_is_refused_with_a_warning_and_the_links_are_drawn(tmp_path, text, what):
    from dataclasses import replace

    file = tmp_path / "arm.urdf"
    file.write_text(text)
    with pytest.raises(ConfigError, match=what):
        UrdfArm(file, CELL)
    with Recorder(tmp_path / "run") as recorder:
        recorder(replace(synthetic.start(), urdf=str(file)))
    recording = Recording(tmp_path / "run" / "run.rrd")
    assert any(what in r["text"][0] for r in recording.rows(layout.LOG) if "text" in r)
    assert list(recording.rows(f"{layout.link(2)}/body"))


def test_what_the_viewer_has_no_shape_for_is_shown_as_a_question_mark_and_kept_in_the_data(tmp_path):
    assert drawable("Überprüfung 5 µm ± 0,1 → ✓ Калибровка") == "Überprüfung 5 µm ± 0,1 → ✓ Калибровка"
    assert drawable("測定 ✘ 😀") == "?? ? ?"
    assert drawable("p < 10⁻⁶, 10⁻¹², 10⁶ and m²") == "p < 10^-6, 10^-12, 10⁶ and m²"
    start = synthetic.start()
    with Recorder(tmp_path) as recorder:
        recorder(replace(start, name="測定", plan_yaml=start.plan_yaml + "# 測定\n"))
    recording = Recording(tmp_path / "run.rrd")
    assert recording.text(layout.PLAN).endswith("# 測定\n")
    assert recording.text(layout.PLAN_SHOWN).endswith("# ??\n")


def test_every_sign_of_a_verdict_can_be_drawn():
    assert {drawable(sign) for sign in SIGNS.values()} == set(SIGNS.values())
