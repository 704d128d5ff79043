"""A small plan in a folder of its own, with room for one fault."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
PLANS = ROOT / "plans"

PLAN = """\
format: mbcacq-plan/1
name: small
robot:
  driver: kuka_rsi
  model: robot.yaml
  home_deg: [0, -90, 90, 0, 90, 0]
scanner:
  driver: gocator
  noise_mm: [0.005, 0.005, 0.009]
  field_of_view: {near_z_mm: 55, far_z_mm: -55, near_half_mm: [35.5, 49], far_half_mm: [50, 77], body_mm: [[-73, -95, 219], [73, 95, 268]]}
hand_eye:
  rotation: [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]
  translation_mm: [1, -0.5, 265]
artefacts: [mbc.yaml, bar.yaml]
stations:
  - {id: 1, artefact: mbc, pose_in_base: {translation_mm: [600, 0, 150], abc_deg: [20, -10, 5]}}
  - {id: 2, artefact: bar, pose_in_base: {translation_mm: [600, 0, 100], abc_deg: [90, 0, 0]}}
steps:
  - name: views
    phase: position
    do: look
    stations: [1]
    views:
      - {tilt_deg: 20, azimuth_deg: 30}
      - {tilt_deg: 30, azimuth_deg: 200, roll_deg: 40}
  - name: ends
    phase: verification
    do: look
    stations: [2]
    balls: each
    views: [{tilt_deg: 10}]
"""


class Folder:
    """A plan with its files; ``plan(old, new)`` writes it with one thing changed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        for name, source in {
            "robot.yaml": "robots/kr10_r1100_2.yaml",
            "mbc.yaml": "artefacts/mbc-8.yaml",
            "bar.yaml": "artefacts/bar-735.yaml",
        }.items():
            (path / name).write_text((PLANS / source).read_text())

    def plan(self, *changes: tuple[str, str]) -> Path:
        return self.write("plan.yaml", PLAN, *changes)

    def change(self, name: str, *changes: tuple[str, str]) -> None:
        self.write(name, (self.path / name).read_text(), *changes)

    def write(self, name: str, text: str, *changes: tuple[str, str]) -> Path:
        for old, new in changes:
            assert old in text, f"{old!r} is not in {name}"
            text = text.replace(old, new, 1)
        (self.path / name).write_text(text)
        return self.path / name
