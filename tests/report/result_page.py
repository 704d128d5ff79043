"""A synthetic result with its recording, and the page made of it as a browser reads it."""

import re
from html.parser import HTMLParser

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations
from mbcacq.report.write import report_from_result

BEFORE, AFTER = [0.721, 0.837, 1.041, 0.712, 0.734], [0.457, 0.347, 0.428, 0.375, 0.364]
CHAIN = Chain(
    np.array([-1.0, 1, 1, -1, 1, -1]),
    np.radians([0, 0, -90, 0, 0, 180]),
    np.array([400, 0, 0, 420, 0, 80.0]),
    np.array([25, 455, 35, 0, 0, 0.0]),
    np.radians([-90, 0, -90, 90, -90, 180]),
    np.zeros(6),
)


def rows(chain):
    return {name: getattr(chain, name).tolist() for name in ("theta", "d", "a", "alpha", "beta")}


def make_result(limit=0.5):
    names = ["a_1", "theta_2", "hand_eye.x", "ball_1.x"]
    return {
        "format": "mbcacq-result/1",
        "method": "ml",
        "measurement": "artefact_in_scanner",
        "robot": {
            "name": "KUKA KR 6 R900",
            "sign": CHAIN.sign.tolist(),
            "nominal": rows(CHAIN),
            "calibrated": rows(CHAIN),
            "errors": rows(CHAIN),
        },
        "T_flange_scanner": se3.transform(np.diag([1.0, -1, -1]), np.array([1.2621, -0.561, 264.7998])).tolist(),
        "stations": [{"id": "s1", "artefact": "mbc", "T_base_station": np.eye(4).tolist(), "std": [0.01] * 6}],
        "balls": [{"id": 1, "centre_mm": [0.0, 0, 0]}, {"id": 2, "centre_mm": [30.0, 0, 0]}],
        "preliminary": {"T_flange_scanner": np.eye(4).tolist()},
        "parameters": [
            {
                "name": "theta_1",
                "value": 0.0,
                "error": 0.0,
                "unit": "rad",
                "std": None,
                "status": "held",
                "reason": "turns base and stations together",
            },
            {"name": "a_1", "value": 25.143, "error": 0.143, "unit": "mm", "std": 0.0057, "status": "free"},
            {
                "name": "theta_2",
                "value": float(np.radians(-0.017)),
                "error": float(np.radians(-0.017)),
                "unit": "rad",
                "std": float(np.radians(0.0009)),
                "status": "free",
            },
            {"name": "hand_eye.x", "value": 1.2621, "error": 0.5, "unit": "mm", "std": 0.0031, "status": "free"},
            {"name": "ball_1.x", "value": 0.0004, "error": 0.0004, "unit": "mm", "std": 0.0007, "status": "prior"},
        ],
        "names": names,
        "covariance": (np.diag([0.0057, 1.6e-5, 0.0031, 0.0007]) ** 2).tolist(),
        "noise": {"scanner_mm": [0.005, 0.005, 0.009], "joint_rad": [5e-6] * 6},
        "fit": {
            "poses": 76,
            "centres": 608,
            "rms_mm": 0.0089,
            "chi2": 1733.0,
            "dof": 1752,
            "chi2_dof": 0.989,
            "rank": 96,
            "iterations": 5,
            "expected_accuracy_mm": 0.0123,
        },
        "held": {"theta_1": "turns base and stations together"},
        "correlated": [{"parameters": ["a_1", "hand_eye.x"], "correlation": -0.987}],
        "rejected": [{"pose": 41, "ball": 2, "distance_mm": 0.8}],
        "verification": {
            "before": {},
            "after": {"max_mm": max(AFTER)},
            "limit_mm": limit,
            "budget": {
                "station": "b1",
                "length_mm": 735.2364,
                "certificate_mm": 0.0014,
                "temperature_mm": 0.0011,
                "probing_mm": 0.0025,
                "repeatability_mm": 0.0025,
                "combined_mm": 0.004,
                "temperature": {
                    "low_C": 15.0,
                    "high_C": 25.0,
                    "sensor_C": 0.0,
                    "reference_C": 20.0,
                    "source": "assumed",
                    "what": "",
                    "expansion_ppm_per_K": 0.5,
                    "expansion_stated": True,
                },
            },
            "places": [
                {"station": f"b{i}", "balls": [9, 10], "certified_mm": 735.2364, "before_mm": b, "after_mm": a, "expected_mm": 0.01}
                | {"judging_mm": 0.004}
                for i, (b, a) in enumerate(zip(BEFORE, AFTER, strict=True), 1)
            ],
        },
    }


def make_observations(seed=0):
    rng = np.random.default_rng(seed)
    P = 12
    robot = RobotModel("KUKA KR 6 R900", CHAIN, np.radians([[-170, 170]] * 6), np.zeros(6), np.zeros((6, 3)))
    cell = Cell(
        robot,
        np.eye(4),
        (Artefact("mbc", "MBC", (1, 2), np.array([[0.0, 0, 0], [30, 0, 0]]), np.array([12.0, 12])),),
        (Station("s1", "mbc"),),
    )
    q = rng.uniform(-1, 1, (P, 6))
    T = CHAIN.flange(q) @ np.array(make_result()["T_flange_scanner"])
    points = se3.apply(se3.inverse(T)[:, None], cell.ball_centres[None])
    noise = rng.normal(0, [0.005, 0.005, 0.009], points.shape)
    return Observations(
        cell,
        np.arange(P),
        np.zeros(P, int),
        q,
        np.repeat(np.arange(P), 2),
        np.tile([0, 1], P),
        (points + noise).reshape(-1, 3),
        phase=np.array(["position"] * 10 + ["verification"] * 2),
    )


class Page(HTMLParser):
    """Visible text and every address that a browser would load."""

    def __init__(self, html):
        super().__init__()
        self.text, self.loads, self.tags, self.skip = [], [], [], 0
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.skip += tag in ("script", "style")
        self.loads += [v for k, v in attrs if k in ("src", "href", "data", "action", "srcset", "poster") and not v.startswith("#")]

    def handle_endtag(self, tag):
        self.skip -= tag in ("script", "style")

    def handle_data(self, data):
        if not self.skip:
            self.text.append(data)

    @property
    def words(self):
        return re.sub(r"\s+", " ", " ".join(self.text))


def page(tmp_path, result, **more):
    return Page(report_from_result(result, path=tmp_path / "report.html", **more).read_text(encoding="utf-8"))
