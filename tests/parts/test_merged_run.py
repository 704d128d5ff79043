"""A part scanned by the fake cell over the wires, merged by the cell that the same run calibrates, against its true surface."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dry_runs import PLANS, plan_file, recorded

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.sufficiency import options_for
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.effects.functions import DescribedPart, linear
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.files.mesh_file import Mesh, read_mesh
from mbcacq.geometry import se3
from mbcacq.parts.agreement import agreement
from mbcacq.parts.cad import compare_with_cad
from mbcacq.parts.merge import merge, merged_points
from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import cells_of
from mbcacq.parts.placement import CommonMotion, placements
from mbcacq.parts.scans import PartScan, surface_of, thinned
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.observation_writer import write_observation_set
from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq.recording.rrd.reader import Recording
from mbcacq.report.page import render
from mbcacq.report.sources.from_result import content_of
from mbcacq.spheres.cloud_file import read_cloud_file
from mbcacq.spheres.ply import read_cloud
from mbcacq.workflow.export import export
from mbcacq.workflow.merge_scans import merge_scans
from mbcacq.workflow.part_scenes import scenes_as_observations, trials_on_parts

DESIGN = PLANS / "parts" / "freeform.stl"


def few_poses(plan):
    """36 poses of the balls and eight scans of the part."""
    plan["exposures"] = 1
    plan["scanner"]["resolution_mm"] = 0.8
    plan["steps"][2]["stations"] = ["p1", "p2", "p4"]
    plan["steps"][3]["views"] = plan["steps"][3]["views"][6:18:2] + plan["steps"][3]["views"][27:29]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("part")
    observations = recorded(plan_file(folder, few_poses, "part.yaml"), folder / "run")
    return folder / "run", observations, calibrate(observations)


@pytest.fixture(scope="module")
def merged(run):
    folder, _, cell = run
    return merge_scans(folder, folder / "merged.ply", result=cell, cad=DESIGN)


def test_poses_of_the_part_hold_no_balls_and_take_no_part_in_the_calibration(run):
    _, observations, cell = run
    of_part = observations.phase == "part"
    assert of_part.sum() == 8
    assert not of_part[observations.pose].any()
    assert cell.fit.used_poses == 36


def test_calibration_brings_the_scans_together_as_far_as_it_says(merged):
    found = merged.agreement
    assert found.rms_mm("before") > 0.15
    assert found.rms_mm("geometry") < found.rms_mm("before") / 5
    assert 0.4 < found.ratio < 1.8  # of few overlaps, which share the error of one calibration
    assert f"expected {found.expected_mm:.3f}" in found.sentence
    assert "more than the calibration explains" not in found.sentence


def test_the_merged_cloud_lies_on_the_true_surface(merged):
    found = merged.deviations
    assert abs(found.mean_mm) < found.U_mm
    assert found.rms_mm < 1.3 * found.expected_mm
    assert found.beyond_U < 0.15
    assert found.apart == 0


def test_the_cloud_has_one_point_a_voxel_with_its_scan_and_uncertainty(merged):
    cloud = read_cloud_file(merged.cloud)
    assert len(np.unique(cells_of(cloud.points.astype(float), merged.voxel_mm))) == len(cloud.points) == merged.merged.kept
    assert len(np.unique(cloud.properties["scan"])) == merged.merged.scans == 8
    normals = np.stack([cloud.properties[n] for n in ("nx", "ny", "nz")], axis=1)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)), abs=1e-5)
    # The place of the part as a whole is uncertain in the base frame, and does not matter within the part.
    assert np.median(cloud.properties["sigma_base_mm"]) > np.median(cloud.properties["sigma_mm"]) > 0.005


def test_the_report_has_a_section_of_the_part(run, merged):
    content = content_of(run[2].to_dict(), run_info={"merged": json.loads(json.dumps(merged.to_dict()))})
    assert content.part is not None
    assert content.part.sentences[0].startswith("The scans of this part agree within")
    assert len(content.part.poses) == len(merged.agreement.pairs)
    there = np.isfinite(content.part.deviation_mm)
    assert there.mean() > 0.5
    assert abs(np.mean(content.part.deviation_mm[there])) < merged.deviations.U_mm
    page = render(content)
    assert 'href="#part"' in page
    assert "Deviation from the design along its normal" in page


def test_what_is_kept_can_be_viewed(merged, tmp_path):
    figures, recording = merged.write(tmp_path / "kept.ply")
    assert json.loads(figures.read_text())["agreement"]["pairs"][0]["cells"] >= 30
    drawn = {
        entity: len(list(Recording(recording).rows(f"part/{entity}"))) for entity in ("text", "before", "after", "steps/arrows", "cad")
    }
    assert set(drawn.values()) == {1}


def test_blocks_change_nothing(run, merged, tmp_path):
    folder, observations, cell = run
    scans = list(_scans(folder, observations))
    way = placements(cell)[-1]
    common = CommonMotion.of(way, [(scan.q, scan.points[::200]) for scan in scans])
    options = PartOptions()
    for name, size in (("one", options.block_points), ("many", 4000)):
        merge(lambda: iter(scans), way, common, (0.01, 0.009), 0.8, tmp_path / f"{name}.ply", replace(options, block_points=size))
    one, many = (np.sort(np.array(merged_points(tmp_path / f"{name}.ply")), order=["x", "y", "z"]) for name in ("one", "many"))
    assert np.array_equal(one, many)
    assert not list(tmp_path.glob(".merge-*"))


def test_a_part_that_moved_is_no_matter_of_the_calibration(run):
    folder, observations, cell = run
    scans = []
    for k, scan in enumerate(_scans(folder, observations)):
        moved = PartScan(scan.number, scan.q, scan.points + [0.0, 0.0, 0.15 * (k >= 4)])
        scans.append(thinned(surface_of(moved), 20_000))
    found = agreement(scans, placements(cell), PartOptions())
    assert found.ratio > 2
    assert "the part, the mount or the arm moved" in found.sentence


def test_the_part_judges_what_was_learnt_from_balls(run):
    """A cell as the balls give it, and one whose mount was learnt wrongly."""
    folder, observations, cell = run
    ((name, tried),) = trials_on_parts(folder, observations)
    assert name == "the scans of the part at station 'part'"
    plain = tried(cell, cell)
    assert plain.geometry_alone == plain.with_effects
    assert 0.3 < plain.with_effects.chi2_dof < 3
    assert plain.warnings[0].startswith("they agree as well as expected")
    turned = cell.state.T_flange_scanner @ se3.exp(np.array([0, 0, 0, 0, 2e-3, 0]))
    wrong = replace(cell, state=replace(cell.state, T_flange_scanner=turned))
    assert tried(wrong, wrong).warnings[0].startswith("they show that an effect is missing")


def test_the_part_confirms_and_contradicts_effects(run):
    """Elastic joints that this arm has not, and an effect of no size beside a mount that was learnt wrongly or rightly."""
    folder, observations, cell = run
    ((_, tried),) = trials_on_parts(folder, observations)
    turned = cell.state.T_flange_scanner @ se3.exp(np.array([0, 0, 0, 0, 2e-3, 0]))
    wrong = replace(cell, state=replace(cell.state, T_flange_scanner=turned))
    elastic, none = (replace(cell, effects=EffectModel(observations.cell.robot, (_compliance(c),))) for c in (2e-5, 1e-12))
    assert tried(elastic, cell).warnings[0].startswith("they contradict what was found")
    assert tried(none, wrong).warnings[0].startswith("they confirm what was found;")
    assert tried(none, cell).warnings[0].startswith("they cannot tell")


def _compliance(rad_per_Nm):
    cause, size = "gravity_torque_2", np.array([rad_per_Nm])
    parts = (DescribedPart("joint", 1, 0, (linear(cause),)),)
    known = {"names": ("c",), "units": ("",), "coefficients": size, "std": 0.01 * size, "sigma": np.array([np.inf]), "typical": size}
    return EffectTerm(name="joint_compliance", where=("A2",), depends_on=cause, parts=parts, **known)


def test_a_recording_without_a_part_says_how_to_name_one(run, tmp_path):
    folder, observations, cell = run
    with pytest.raises(ConfigError, match="there is no station 'p9' .there: p1"):
        merge_scans(folder, tmp_path / "a.ply", result=cell, station="p9")


def _scans(folder: Path, observations):
    from mbcacq.recording.rrd.reader import open_recordings

    q = dict(zip(observations.pose_id.tolist(), observations.q, strict=True))
    parts = set(observations.pose_id[observations.phase == "part"].tolist())
    for taken in open_recordings(folder)[0].scans():
        if taken.pose in parts:
            yield PartScan(taken.pose, q[taken.pose], taken.scan.points)


def test_a_design_in_metres_or_cut_off_is_refused(tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(DESIGN.read_bytes()[:-10])
    with pytest.raises(ConfigError, match="is cut off: its head announces"):
        read_mesh(path)


@pytest.mark.parametrize("other", ["mirrored", "in metres", "a plane"])
def test_a_design_of_another_part_is_refused(merged, other):
    mesh, T = read_mesh(DESIGN), merged.deviations.T_base_cad
    plane = Mesh(np.array([[-90, -60, 40], [90, -60, 40], [90, 60, 40.0]]), np.array([[0, 1, 2]]))
    mirrored, small = Mesh(mesh.vertices * [1, -1, 1], mesh.triangles[:, ::-1]), Mesh(mesh.vertices / 1000, mesh.triangles)
    with pytest.raises(ConfigError, match="in mm instead of m," if other == "in metres" else "has another shape than the merged cloud"):
        compare_with_cad(merged.cloud, {"mirrored": mirrored, "in metres": small, "a plane": plane}[other], T, PartOptions())


def test_a_bent_part_is_still_the_part(merged):
    mesh = read_mesh(DESIGN)
    bent = Mesh(mesh.vertices + [0, 0, 1] * (5e-5 * mesh.vertices[:, :1] ** 2), mesh.triangles)  # by 0.4 mm at its ends
    found = compare_with_cad(merged.cloud, bent, merged.deviations.T_base_cad, PartOptions())
    assert 0.05 < found.rms_mm < 0.3
    assert found.beyond_U > 0.5


@pytest.mark.parametrize(("corners", "says"), [([], "is empty"), ([[0, 0, 0], [1, 1, 0], [2, 2, 0]], "holds no triangles with an area")])
def test_a_mesh_without_a_surface_is_refused(tmp_path, corners, says):
    path = tmp_path / "a.obj"
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\n" * bool(corners))
    with pytest.raises(ConfigError, match=says):
        read_mesh(path)


@pytest.fixture(scope="module")
def part_alone(run, tmp_path_factory):
    """Observation set of the scans of the part, without balls."""
    folder = tmp_path_factory.mktemp("alone") / "set"
    export(run[0], observations=folder, scans=True)
    seen = load_observations(folder)
    write_observation_set(seen.select(seen.phase == "part"), folder)
    return folder


def test_a_folder_of_scans_of_a_part_alone_is_merged(run, part_alone, tmp_path):
    assert merge_scans(part_alone, tmp_path / "a.ply", result=run[2]).merged.scans == 8


def _one_alone(part, clouds):
    return part.select(np.arange(len(part.q)) == 0), clouds


def _each_elsewhere(part, clouds):
    return replace(part, q=part.q + np.outer(np.arange(len(part.q)), [0.4, 0, 0, 0, 0, 0])), clouds


def _one_view(part, clouds):
    return replace(part, q=np.tile(part.q[0], (len(part.q), 1))), {k: clouds[int(part.pose_id[0])] for k in clouds}


def _in_units_of(mm):
    return lambda part, clouds: (part, {k: points / mm for k, points in clouds.items()})


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (_one_alone, "no two scans of this part overlap"),
        (_each_elsewhere, "no two scans of this part overlap"),
        (_one_view, "all scans were taken at the same joint angles"),
        (_in_units_of(1000), "looks like metres; convert the clouds to mm"),
        (_in_units_of(25.4), "looks like inches; convert the clouds to mm"),
    ],
)
def test_scans_that_say_nothing_of_the_cell_are_refused_in_a_sentence(run, part_alone, tmp_path, wrong, says):
    part = load_observations(part_alone)
    part, clouds = wrong(part, {int(k): read_cloud(part_alone / "scans" / f"{k}.ply") for k in part.pose_id})
    write_observation_set(part, tmp_path / "wrong")
    (tmp_path / "wrong" / "scans").mkdir()
    for number, points in clouds.items():
        write_ply(tmp_path / "wrong" / "scans" / f"{number}.ply", points.astype(np.float32))
    with pytest.raises(ConfigError, match=says):
        merge_scans(tmp_path / "wrong", tmp_path / "a.ply", result=run[2])


def test_the_part_alone_gives_the_hand_eye_that_the_balls_give(run):
    """Fake scanner, eight views; the arm is taken as nominal, and balls at three stations see its errors: both state their uncertainty."""
    folder, observations, cell = run
    alone = scenes_as_observations(folder, observations.select(observations.phase == "part"))
    found = calibrate(alone, CalibrationOptions(kinematics=False))
    assert alone.n_centres == 8
    assert "that of the scanner" in found.to_dict()["scale_from"]
    before = np.linalg.norm(observations.cell.T_flange_scanner[:3, 3] - cell.state.T_flange_scanner[:3, 3])
    after = found.state.T_flange_scanner[:3, 3] - cell.state.T_flange_scanner[:3, 3]
    assert np.linalg.norm(after) < before / 10
    at = [found.names.index(f"hand_eye.{axis}") for axis in "xyz"]
    assert np.all(np.abs(cell.state.T_flange_scanner[:3, :3].T @ after) < 4 * np.sqrt(np.diag(found.covariance)[at]))


def test_scans_fit_once_the_part_alone_calibrated_hand_eye_and_arm(run):
    folder, observations, _ = run
    alone = scenes_as_observations(folder, observations.select(observations.phase == "part"))
    options = options_for(alone, CalibrationOptions())
    assert options.kinematics
    found = calibrate(alone, options)
    scans = [thinned(surface_of(scan), 8_000) for scan in _scans(folder, observations)]
    fitted = agreement(scans, placements(found), PartOptions())
    assert fitted.rms_mm("geometry") < fitted.rms_mm("before") / 5
    assert fitted.ratio < 1.8
    assert found.expected_accuracy(postures=50) > 0.1  # elsewhere the arm is hardly better known than before
