"""A disk that runs full in the middle of a run: named, nothing lost, resumed when there is room again."""

import shutil
import subprocess
import sys
import textwrap

import pytest
from dry_runs import plan_file
from typed_command import MBCACQ, ROOT, mbcacq

CAN_MOUNT = (
    sys.platform == "linux"
    and subprocess.run(["unshare", "-Urm", "sh", "-c", "mount -t tmpfs none /mnt"], capture_output=True).returncode == 0
    if sys.platform == "linux"
    else False
)


@pytest.mark.skipif(not CAN_MOUNT, reason="needs a file system of its own (user namespaces)")
def test_a_full_disk_is_named_and_the_run_goes_on_when_there_is_room(tmp_path):
    """A disk of 320 MiB, of which hardly anything is left after the first pose; copied to where there is room, the run is resumed."""
    plan = plan_file(tmp_path, lambda plan: plan.update(exposures=1))
    script = textwrap.dedent(f"""
        mkdir {tmp_path}/disk && mount -t tmpfs -o size=320m none {tmp_path}/disk && cd {ROOT}
        ({MBCACQ} run {plan} --dry-run --out {tmp_path}/disk/run 2> {tmp_path}/first; echo $? > {tmp_path}/code) &
        until grep -q pose_done {tmp_path}/disk/run/journal.jsonl 2>/dev/null || test -e {tmp_path}/code; do sleep 0.02; done
        mount -o remount,size=$(( $(df -k --output=used {tmp_path}/disk | tail -1) + 512 ))k {tmp_path}/disk
        wait
        cp -r {tmp_path}/disk/run {tmp_path}/full
    """)
    subprocess.run(["unshare", "-Urm", "sh", "-c", script], timeout=900, capture_output=True)
    first = (tmp_path / "first").read_text()
    assert (tmp_path / "code").read_text().strip() == "6", first
    assert "Traceback" not in first
    assert "disk" in first
    assert "resume the run" in first or "mbcacq recover" in first
    from mbcacq.recording import load_observations
    from mbcacq.recording.run_folder.gaps import find_gaps

    run = shutil.copytree(tmp_path / "full", tmp_path / "run")
    assert mbcacq("recover", tmp_path / "full").returncode == 0
    kept = load_observations(tmp_path / "full").pose_id.tolist()
    assert 1 <= len(kept) < 10
    assert any("planned poses were not measured" in gap for gap in find_gaps(tmp_path / "full"))
    again = mbcacq("run", plan, "--dry-run", "--resume", run)
    assert again.returncode == 0, again.stderr
    assert sorted(load_observations(run).pose_id.tolist()) == list(range(10))
