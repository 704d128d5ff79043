"""Line profiles that are taken while the arm moves: hand-eye transform, spheres and the clock of the sensor in one adjustment.

A profile of the sensor's time t shows the cell as it is at ``t + delay + drift (t - epoch)`` of the controller's clock. The pose of the
flange there is interpolated between the cycles. A sphere that the moving laser plane cuts at s (scanner frame, ``profile_start``) moves in
the scanner by ds/dt, so that delay and drift are parameters like any other, with ds/dt as their columns. Three errors make the covariance
of a profile's circle: noise of its points; jitter of the stamps, along ds/dt; noise of the pose, alike in all directions. The latter two
are estimated by restricted maximum likelihood. Sweeps forth and back tell the delay from a shift of the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.profile_start import ProfileStart, find_start, section_rows
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.motion_in_time import FlangeMotion
from mbcacq.spheres.circles import Circle

DRIFT_SIGMA = 1e-4  # of a clock against another: quartz within 100 ppm
NEAR_S, GRID_S = 0.25, 0.05  # clocks of one network are as near; delays that are tried as starts
MOVES = 0.1  # of the largest speed of the flange
MOST_TRIED = 24  # starts
CIRCLES_TRIED = 30
GROSS = 30.0  # squared distance of a circle in standard deviations, of three coordinates: one of a million normal ones
ROUNDS, SETTLED = 60, 1e-3  # of the adjustment; change of its parameters in their standard deviations
LEAST_OF_A_WAY = 5  # profiles of one way over a sphere
POOR_MM = 5.0  # standard deviation of the scanner's place, from which it counts as undetermined
PART_S = 1e7  # more than any part of a recording lasts
JITTER_UNKNOWN_S = 1e-6  # where the estimation starts


@dataclass(frozen=True)
class SensorClock:
    """delay_s: of the controller's clock minus the sensor's at epoch_s of the sensor; drift: change of it per s.

    covariance (2, 2): of both. jitter_s: standard deviation of one stamp."""

    epoch_s: float
    delay_s: float
    drift: float
    covariance: np.ndarray
    jitter_s: float = 0.0

    def controller_time(self, t: np.ndarray) -> np.ndarray:
        """The controller's time at sensor times t (P,) s."""
        return t + self.delay_s + self.drift * self.since(t)

    def since(self, t: np.ndarray) -> np.ndarray:
        """Time (P,) s after the epoch; the parts of a recording share one clock, although ``PART_S`` sets their times apart."""
        return t - self.epoch_s - PART_S * np.rint((t - self.epoch_s) / PART_S)


@dataclass(frozen=True)
class SeenSections:
    """Circles in P profiles at sensor times (P,) s, of the sphere (P,) 0.. and of its radius (P,) mm; noise_mm: of one point."""

    time_s: np.ndarray
    sphere: np.ndarray
    radius: np.ndarray
    circles: Sequence[Circle]
    noise_mm: float

    def some(self, keep: np.ndarray) -> SeenSections:
        """The profiles that ``keep`` (P,) bool or indices choose."""
        at = np.arange(len(self.circles))[keep]
        return SeenSections(self.time_s[at], self.sphere[at], self.radius[at], [self.circles[i] for i in at], self.noise_mm)


@dataclass(frozen=True)
class ProfilesInMotion:
    """An adjusted set of profiles.

    Attributes
    ----------
    T_hand_eye : (4, 4) ndarray
        Scanner behind the moving frame.
    spheres : (K, 3) ndarray
        mm, where they rest.
    clock : SensorClock
        The sensor's.
    covariance : (8 + 3 K, 8 + 3 K) ndarray
        Translation (mm, along the axes of the moving frame), rotation behind it (rad), delay and drift (s, 1), spheres (mm).
    pose_sigma_mm : float
        Noise of a sphere's place by the pose of the flange.
    used : (P,) ndarray
        bool; the others are gross errors, or have no pose.
    sphere_in_scanner, velocity : (P, 3), (P, 6) ndarray
        Place of each sphere, mm; velocity of the moving frame in itself, mm/s and rad/s.
    passing : (P, 3) ndarray
        Velocity of the sphere in the scanner, mm/s.
    """

    T_hand_eye: np.ndarray
    spheres: np.ndarray
    clock: SensorClock
    covariance: np.ndarray
    pose_sigma_mm: float
    used: np.ndarray
    sphere_in_scanner: np.ndarray
    velocity: np.ndarray
    passing: np.ndarray

    def moved(self, step: np.ndarray) -> ProfilesInMotion:
        """With hand-eye transform, clock and spheres changed by a step (8 + 3 K,) of the parameters, in the order of ``covariance``."""
        T = se3.transform(self.T_hand_eye[:3, :3] @ se3.rotation_exp(step[3:6]), self.T_hand_eye[:3, 3] + step[:3])
        clock = replace(self.clock, delay_s=self.clock.delay_s + float(step[6]), drift=self.clock.drift + float(step[7]))
        return replace(self, T_hand_eye=T, clock=clock, spheres=self.spheres + step[8:].reshape(-1, 3))


def adjust_in_motion(
    motion: FlangeMotion, seen: SeenSections, start: ProfilesInMotion, delay_prior: tuple[float, float] | None = None
) -> ProfilesInMotion:
    """Gauss-Newton from ``start`` with all parameters at once.

    delay_prior: delay and its standard deviation in s, as a wire between both devices gives them. Raises ConfigError where the sweeps leave
    a parameter undetermined.
    """
    at, K = start, len(start.spheres)
    prior = np.zeros(8 + 3 * K)
    prior[7] = DRIFT_SIGMA**-2
    aim = start.clock.delay_s
    if delay_prior is not None:
        aim, prior[6] = delay_prior[0], delay_prior[1] ** -2
    sizes, robust = np.array([JITTER_UNKNOWN_S**2, 0.02**2]), True
    N = A = np.eye(len(prior))
    used = np.ones(len(seen.circles), dtype=bool)
    for round_ in range(ROUNDS):
        r, J, passing, _, _, known, by_place = _linearised(motion, seen, at)
        V, parts = _covariances(seen, passing, by_place, sizes)
        W = np.linalg.inv(V)
        distance = np.einsum("pi,pij,pj->p", r, W, r)
        limit = max(GROSS, GROSS * float(np.median(distance[known])) / 2.4 if robust else 0.0)
        used = known & (distance < limit)
        if 3 * used.sum() < 2 * len(prior):
            raise ConfigError("fewer profiles than needed show one sphere while the cycles of the arm are there; sweep over it more often")
        N, A = _normal(J, W, used, prior)
        off = np.zeros(len(prior))
        off[6], off[7] = prior[6] * (at.clock.delay_s - aim), prior[7] * at.clock.drift
        step = -A @ (np.einsum("pia,pij,pj->a", J[used], W[used], r[used]) + off)
        if not np.isfinite(step).all():
            raise ConfigError("profiles and cycles contradict each other so much that no clock fits them; are both of one recording?")
        at = at.moved(step)
        sizes, changed = _scored(r + J @ step, J, W, parts, used, A, sizes)
        robust = robust and round_ < ROUNDS // 4
        if not robust and changed < 1e-3 and np.abs(step / np.sqrt(np.diag(A))).max() < SETTLED:
            break
    size = np.sqrt(np.diag(N))
    if np.linalg.cond(N / np.outer(size, size)) > 1e11 or np.sqrt(np.diag(A)[:3].max()) > POOR_MM:
        raise ConfigError(
            "the sweeps leave hand-eye transform and delay undetermined; sweep over the sphere forth and back, at four orientations and "
            "more, turned by 20° about two axes"
        )
    _, _, passing, s, velocity, known, _ = _linearised(motion, seen, at)
    clock = replace(at.clock, covariance=A[6:8, 6:8], jitter_s=float(np.sqrt(sizes[0])))
    found = replace(at, clock=clock, covariance=A, pose_sigma_mm=float(np.sqrt(sizes[1])), used=used & known)
    return replace(found, sphere_in_scanner=s, velocity=velocity, passing=passing)


def misfit_mm(motion: FlangeMotion, seen: SeenSections, at: ProfilesInMotion) -> float:
    """Median distance by which circles miss their sphere; infinite where the arm is known at less than half of the profiles."""
    rows, _, _, _, _, known, _ = _linearised(motion, seen, at)
    return float(np.median(np.linalg.norm(rows[known], axis=1))) if known.mean() >= 0.5 else np.inf


def passes_of(
    motion: FlangeMotion, seen: SeenSections, found: ProfilesInMotion, group: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The profiles of each group (P,), a stretch of one way, together: they share what the arm is off by, as the balls of one scan do.

    Each is the centre of the sphere at one moment: time (G,) s of the sensor, place (G, 3) mm in the scanner, its covariance (G, 3, 3), and
    the index (G,) of the profile of that moment.

    The sphere moves in the scanner as the arm does, so all circles of a stretch say one place at its middle. What the hand-eye transform
    may still be off by cancels in it.
    """
    rows, _, passing, s, _, known, by_place = _linearised(motion, seen, found)
    V, _ = _covariances(seen, passing, by_place, np.array([found.clock.jitter_s**2, found.pose_sigma_mm**2]))
    W = np.linalg.inv(V)
    used, time, xyz, covariance, first = found.used & known, [], [], [], []
    for g in np.unique(group[used]):
        of = np.flatnonzero(used & (group == g))
        if len(of) < LEAST_OF_A_WAY:
            continue
        C = np.linalg.inv(np.einsum("pij,pik,pkl->jl", by_place[of], W[of], by_place[of]))
        off = -C @ np.einsum("pij,pik,pk->j", by_place[of], W[of], rows[of])
        middle = of[np.argmin(np.abs(s[of, 1] - s[of, 1].mean()))]
        time.append(seen.time_s[middle])
        xyz.append(s[middle] + off)
        covariance.append(C)
        first.append(middle)
    return np.array(time), np.array(xyz).reshape(-1, 3), np.array(covariance).reshape(-1, 3, 3), np.array(first, dtype=int)


def start_in_motion(motion: FlangeMotion, seen: SeenSections) -> ProfilesInMotion:
    """Start values from the profiles of one sphere, with the delay at which they fit best, near zero where clocks agree so far.

    Raises ConfigError where no delay lets profiles fall into the recorded motion.
    """
    few = seen.some(np.unique(np.linspace(0, len(seen.circles) - 1, CIRCLES_TRIED).round().astype(int)))
    best: tuple[float, float, ProfileStart] | None = None
    for delay in _delays(motion, seen.time_s):
        known = motion.known(few.time_s + delay)
        if known.sum() < CIRCLES_TRIED // 2:
            continue
        part = few.some(known)
        found = find_start(motion.at(part.time_s + delay)[0], part.circles, float(seen.radius[0]))
        if best is None or found.misfit_mm < best[0]:
            best = found.misfit_mm, delay, found
    if best is None:
        raise ConfigError(
            "no delay between both clocks lets the profiles of the sphere fall into the recorded motion of the arm; give cycles and "
            "profiles of one recording, with their times in s"
        )
    _, delay, found = best
    clock = SensorClock(float(seen.time_s.mean()), delay, 0.0, np.zeros((2, 2)))
    nothing = np.zeros((len(seen.circles), 6))
    used, place = np.ones(len(nothing), dtype=bool), found.sphere[None]
    return ProfilesInMotion(found.T_hand_eye, place, clock, np.eye(11), 0.0, used, nothing[:, :3], velocity=nothing, passing=nothing[:, :3])


def _delays(motion: FlangeMotion, t: np.ndarray) -> np.ndarray:
    """Delays at which most of the profiles (P,) s of a sphere fall into times at which the flange moves."""
    low, high = motion.time_s[0] - t[-1], motion.time_s[-1] - t[0]
    grid = np.r_[0.0, np.arange(np.ceil(low / GRID_S), high / GRID_S + 1) * GRID_S]
    grid = np.unique(grid[(grid >= low) & (grid <= high)])
    speed = np.linalg.norm(np.diff(motion.chain.flange(motion.q)[:, :3, 3], axis=0), axis=1) / np.diff(motion.time_s)
    moves = speed > MOVES * np.quantile(speed, 0.95)
    some = t[:: max(len(t) // 200, 1)]
    share = []
    for delay in grid:
        i = np.searchsorted(motion.time_s, some + delay) - 1
        inside = (i >= 0) & (i < len(moves))
        share.append(float((inside & moves[np.clip(i, 0, len(moves) - 1)]).mean()))
    near = grid[np.array(share) >= max(share, default=0.0) - 0.02]
    if (np.abs(near) <= NEAR_S).any():
        near = near[np.abs(near) <= NEAR_S]
    return near[np.unique(np.linspace(0, len(near) - 1, min(len(near), MOST_TRIED)).round().astype(int))]


def _linearised(motion: FlangeMotion, seen: SeenSections, at: ProfilesInMotion) -> tuple[np.ndarray, ...]:
    """Rows (P, 3) that circles miss their sphere by, their derivatives (P, 3, 8 + 3 K), velocity (P, 3) and place (P, 3) of the sphere in
    the scanner, velocity of the flange (P, 6), whether its pose is known (P,), and the rows by the place of the sphere (P, 3, 3)."""
    t = at.clock.controller_time(seen.time_s)
    hand, velocity = motion.at(t)
    own = at.spheres[seen.sphere]
    rows, by_place, s, J9 = section_rows(hand, seen.circles, seen.radius, at.T_hand_eye, own)
    in_hand = se3.apply(se3.inverse(hand), own)
    passing = -(velocity[:, :3] + se3.cross(velocity[:, 3:], in_hand)) @ at.T_hand_eye[:3, :3]
    J = np.zeros((len(t), 3, 8 + 3 * len(at.spheres)))
    J[:, :, :6] = J9[:, :, :6]
    by_time = np.einsum("pij,pj->pi", by_place, passing)
    J[:, :, 6], J[:, :, 7] = by_time, by_time * at.clock.since(seen.time_s)[:, None]
    place = 8 + 3 * seen.sphere[:, None] + np.arange(3)
    J[np.arange(len(t))[:, None], :, place] = np.swapaxes(J9[:, :, 6:], 1, 2)
    return rows, J, passing, s, velocity, motion.known(t), by_place


def _covariances(seen: SeenSections, passing: np.ndarray, by_place: np.ndarray, sizes: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """(P, 3, 3) of the rows, and its derivatives by the squares of jitter and pose noise."""
    along = np.einsum("pij,pj->pi", by_place, passing)
    parts = [along[:, :, None] * along[:, None, :], by_place @ np.swapaxes(by_place, 1, 2)]
    circle = seen.noise_mm**2 * np.array([c.cofactor for c in seen.circles])
    return circle + sizes[0] * parts[0] + sizes[1] * parts[1], parts


def _normal(J: np.ndarray, W: np.ndarray, used: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations with the prior, and their inverse, scaled before."""
    N = np.einsum("pia,pij,pjb->ab", J[used], W[used], J[used], optimize=True) + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(N), 1e-300))
    return N, np.linalg.pinv(N / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size)


def _scored(
    r: np.ndarray, J: np.ndarray, W: np.ndarray, parts: list[np.ndarray], used: np.ndarray, A: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, float]:
    """Variances after a step of Fisher scoring of the restricted likelihood, and by how much of their uncertainties they changed."""
    r, J, W = r[used], J[used], W[used]
    WJ, Wr = W @ J, np.einsum("pij,pj->pi", W, r)
    D = [part[used] for part in parts]
    known = [np.einsum("ab,pia,pij,pjb->", A, WJ, d, WJ, optimize=True) - np.einsum("pij,pji->", W, d) for d in D]
    gradient = np.array([np.einsum("pi,pij,pj->", Wr, d, Wr) + of_fit for d, of_fit in zip(D, known, strict=True)])
    information = np.array([[np.einsum("pij,pjk,pkl,pli->", W, a, W, b, optimize=True) for b in D] for a in D])
    free = (sizes > 0) | (gradient > 0)
    step = np.zeros(len(sizes))
    block = information[np.ix_(free, free)] + 1e-12 * np.diag(np.diag(information)[free])
    step[free] = np.linalg.solve(block, gradient[free]) if free.any() else 0.0
    after = np.maximum(sizes + step, 0.0)
    return after, float(np.abs((after - sizes) * np.sqrt(np.diag(information) / 2)).max())
