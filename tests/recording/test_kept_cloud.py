"""A recording keeps what the balls were found in, and a choice of the rest."""

import dataclasses

import numpy as np
import synthetic

from mbcacq.acquisition import events
from mbcacq.devices import Scan
from mbcacq.model.cell import Artefact
from mbcacq.recording.rrd.kept_cloud import FURTHER_PER_BALL, FURTHER_REST, REST, kept_cloud
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.rrd.writer import Recorder
from mbcacq.spheres.extract import find_spheres

CENTRES = np.array([[0.0, 0, 0], [30, 0, 5], [0, 40, -5]])
ARTEFACT = Artefact("mbc", "three balls", (1, 2, 7), CENTRES, np.full(3, 12.0))
AT = np.array([5.0, -10, -3])


def scan(rest=20_000):
    """The upper half of each ball, a plate below them with a hole under each, and noise of 5 um; a pixel is the number of its point."""
    rng = np.random.default_rng(4)
    up = rng.normal(size=(3, 900, 3))
    up[..., 2] = np.abs(up[..., 2])
    balls = (CENTRES[:, None] + 6.0 * up / np.linalg.norm(up, axis=2, keepdims=True)).reshape(-1, 3)
    plate = np.column_stack([rng.uniform(-40, 60, (2, rest)).T, np.full(rest, -25.0)])
    points = np.concatenate([plate, balls]) + AT + rng.normal(0, 0.005, (rest + 2700, 3))
    return Scan(
        points.astype(np.float32), np.arange(len(points)).astype(np.uint8), (1, len(points)), np.arange(len(points), dtype=np.int32)
    )


def test_the_first_exposure_has_every_point_of_the_balls_and_a_thinned_rest():
    whole = scan()
    kept = kept_cloud(whole, ARTEFACT, np.array([1, 2, 7]), CENTRES + AT, 0)
    assert set(range(20_000, 22_700)) <= set(kept.pixel.tolist())
    assert 0.9 * REST < len(kept.points) - 2700 <= REST
    np.testing.assert_array_equal(kept.points, whole.points[kept.pixel])
    np.testing.assert_array_equal(kept.intensity, kept.pixel.astype(np.uint8))


def test_the_same_centres_are_found_in_what_is_kept():
    whole = scan()
    found = find_spheres(whole.points, ARTEFACT)
    again = find_spheres(kept_cloud(whole, ARTEFACT, found.ball, found.xyz, 0).points, ARTEFACT)
    assert again.ball.tolist() == found.ball.tolist() == [1, 2, 7]
    np.testing.assert_allclose(again.xyz, found.xyz, atol=1e-4)


def test_of_further_exposures_little_is_kept_and_of_one_without_balls_everything():
    whole = scan()
    assert len(kept_cloud(whole, ARTEFACT, np.array([1, 2, 7]), CENTRES + AT, 1).points) <= 3 * FURTHER_PER_BALL + FURTHER_REST
    assert kept_cloud(whole, ARTEFACT, np.zeros(0, int), np.zeros((0, 3)), 0) is whole


def test_a_recording_of_the_balls_alone_holds_every_exposure_and_whole_clouds_where_no_ball_was_found(tmp_path):
    sent, whole, lost = [], scan(), None
    for event in synthetic.run():
        if isinstance(event, events.ScanTaken):
            event = dataclasses.replace(event, scan=whole)
        if isinstance(event, events.CentresFound):
            if lost is None:  # the first exposure of all: nothing was looked for
                lost = event.pose, event.exposure
                continue
            event = dataclasses.replace(event, ball=np.array([1, 2, 7]), xyz=CENTRES + AT)
        sent.append(event)
    with Recorder(tmp_path, all_points=False) as recorder:
        for event in sent:
            recorder(event)
    stored = list(Recording(tmp_path / "run.rrd").scans())
    assert [(s.pose, s.exposure) for s in stored] == [(e.pose, e.exposure) for e in sent if isinstance(e, events.ScanTaken)]
    sizes = {(s.pose, s.exposure): len(s.scan.points) for s in stored}
    assert sizes.pop(lost) == len(whole.points)
    assert all(2700 < size < 4000 if exposure == 0 else size < 400 for (_, exposure), size in sizes.items())
