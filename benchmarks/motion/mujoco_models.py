"""A MuJoCo model of an arm, recorded by a second one that conceals what the first lacks."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from bench import HERE
from scipy.interpolate import CubicSpline

from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation import parameters
from mbcacq.simulation.motion import check_model, diagnose_against_model
from mbcacq.simulation.mujoco_arm import MujocoArm, load_arm
from mbcacq.simulation.refinement import RollOutFit

try:
    from mujoco import sysid
except ImportError:  # a MuJoCo that does not have it yet
    sysid = None

PAGE = HERE / "mujoco_models.md"
TIMESTEP_S, SAMPLE_S, SECONDS = 0.002, 0.004, 6.0
JOINTS = tuple(f"A{k}" for k in range(1, 7))
GAINS = ((4e4, 2e3), (6e4, 3e3), (3e4, 1.2e3), (6e3, 150), (5e3, 120), (3e3, 60))
NOISE = {"q": 2e-6, "tau": 0.4, "side": 4e-6}  # rad, N m, rad
FRICTION = ((30, 12), (45, 20), (25, 10), (8, 3), (6, 3), (4, 1.5))  # concealed: N m, N m s/rad
STIFFNESS, GEAR_DAMPING = 2.5e5, 500.0  # concealed, A2
TOOL = {"mass": 11.0, "pos": "0.11 0.02 0.03", "diaginertia": "0.05 0.07 0.06"}  # concealed: link 6 with what it carries
PASSES, ITERATIONS = 10, 500  # of the peer, so many that neither ends it: passes of reweighting, and iterations of each
SAME_WEIGHTS = 0.01  # relative change of the channels' weights at which its passes end
DELAY_S = 0.006  # concealed: of the torques
NOT_WRITTEN = ": MuJoCo has no place for it, and nothing of it is written into the model"
LINKS = (
    ("0 0 0.2", "0 0 1", "-170 170", 4, "0.05 0 0.1", 40, "1.2 1.1 0.9"),
    ("0.15 0 0.2", "0 1 0", "-150 60", 6, "0.02 0 0.3", 30, "1.4 1.5 0.3"),
    ("0 0 0.6", "0 1 0", "-120 150", 3, "0.1 0.01 0.05", 20, "0.3 0.4 0.4"),
    ("0.2 0 0.1", "1 0 0", "-180 180", 0.6, "0.2 0 0", 9, "0.05 0.15 0.15"),
    ("0.45 0 0", "0 1 0", "-120 120", 0.5, "0.03 0 0", 4, "0.01 0.012 0.012"),
    ("0.1 0 0", "1 0 0", "-350 350", 0.3, "0.06 0 0.01", 5, "0.02 0.025 0.025"),
)


def peer_is_installed() -> bool:
    """Whether mujoco.sysid can be used: without what its extra installs it is there, and empty."""
    return hasattr(sysid, "ParameterDict")


def model(concealed: bool) -> str:
    """MJCF of the arm; concealed: with friction, a tool, an elastic A2, late torques, and sensors on both sides of the gears."""
    bodies, end = "", ""
    for k, (pos, axis, span, rotor, com, mass, tensor) in enumerate(LINKS):
        friction = 'damping="2"' if not concealed else f'frictionloss="{FRICTION[k][0]}" damping="{FRICTION[k][1]}"'
        gear = f'<joint name="A2_elastic" axis="{axis}" stiffness="{STIFFNESS}" damping="{GEAR_DAMPING}"/>' if concealed and k == 1 else ""
        if concealed and k == 5:
            com, mass, tensor = TOOL["pos"], TOOL["mass"], TOOL["diaginertia"]
        bodies += (
            f'<body name="link{k + 1}" pos="{pos}"><joint name="A{k + 1}" axis="{axis}" range="{span}" armature="{rotor}" {friction}/>'
            f'{gear}<inertial pos="{com}" mass="{mass}" diaginertia="{tensor}"/>'
        )
        end += "</body>"
    servos = "".join(f'<position name="servo{j}" joint="{j}" kp="{kp}" kv="{kv}"/>' for j, (kp, kv) in zip(JOINTS, GAINS, strict=True))
    late = f'delay="{DELAY_S}" nsample="10" interp="linear"'
    sensors = "".join(f'<jointpos joint="{j}"/>' for j in JOINTS)
    sensors += "".join(f'<jointactuatorfrc joint="{j}" {late}/>' for j in JOINTS) + '<jointpos joint="A2_elastic"/>'
    return (
        f'<mujoco model="arm"><compiler angle="degree"/><option timestep="{TIMESTEP_S}" integrator="implicitfast">'
        f'<flag contact="disable"/></option><worldbody><body name="base">{bodies}{end}</body></worldbody>'
        f"<actuator>{servos}</actuator>{f'<sensor>{sensors}</sensor>' if concealed else ''}</mujoco>"
    )


def set_points(seed: int) -> np.ndarray:
    """(T, 6) rad of a motion from rest to rest."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(SECONDS / SAMPLE_S) + 1) * SAMPLE_S
    fade = np.clip(np.minimum(t, t[-1] - t), 0, 1)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    out = np.zeros((len(t), 6))
    for j, size in enumerate(np.radians([50, 25, 30, 60, 40, 90])):
        for _ in range(4):
            out[:, j] += size / 3 * rng.uniform(0.5, 1) * np.sin(2 * np.pi * rng.uniform(0.1, 0.8) * t + rng.uniform(0, 2 * np.pi))
    return np.radians([0, -40, 60, 0, 30, 0]) + fade[:, None] * out


def record(arm: MujocoArm, seed: int) -> Trajectory:
    """What the second model's controller logs, stepped one by one, with noise."""
    engine = mujoco.MjModel.from_xml_string(model(concealed=True))
    data = mujoco.MjData(engine)
    command = set_points(seed)
    per = round(SAMPLE_S / TIMESTEP_S)
    fine = CubicSpline(np.arange(len(command)), command)(np.arange((len(command) - 1) * per + 1) / per)
    data.qpos[[engine.joint(j).qposadr[0] for j in JOINTS]] = command[0]
    rows = []
    for k in range(-500, len(fine)):
        data.ctrl[:] = fine[max(k, 0)]
        mujoco.mj_step(engine, data)
        rows.append(np.array(data.sensordata))
    sensed = np.array(rows)[500::per]
    side = np.array(sensed[:, :6])
    side[:, 1] += sensed[:, 12]
    rng = np.random.default_rng(1000 + seed)
    noisy = {n: v + rng.normal(0, NOISE[n], v.shape) for n, v in (("q", sensed[:, :6]), ("tau", sensed[:, 6:12]), ("side", side))}
    time_s = SAMPLE_S * np.arange(len(command))
    return Trajectory(arm.robot, time_s, noisy["q"], q_set=command, torque=noisy["tau"], q_joint=noisy["side"], name=f"motion {seed}")


@dataclass(frozen=True)
class Cost:
    """Seconds of a clock, and of the processors in all threads and processes."""

    elapsed_s: float
    processor_s: float


@contextlib.contextmanager
def timed() -> Iterator[list[Cost]]:
    """A list that holds the cost of what ran inside once it has ended."""
    cost: list[Cost] = []
    begin, used = time.perf_counter(), sum(os.times()[:4])
    yield cost
    cost.append(Cost(time.perf_counter() - begin, sum(os.times()[:4]) - used))


@dataclass(frozen=True)
class Peer:
    """What mujoco.sysid found when it was given the right parameters. iterations: of each pass; capped: a cap ended one."""

    spec: mujoco.MjSpec
    iterations: tuple[int, ...]
    capped: bool


def fitted_by_peer(arm: MujocoArm, spec: mujoco.MjSpec, fit: RollOutFit) -> Peer:
    """sysid fits friction of all joints, gear of A2, inertia of link 6 and the delay of the torques. The choice of these is given to it, as
    are the weights, the samples and the settled start that this program uses. spec: with the gear's hinge and the sensors.

    Its optimiser (mujoco.minimize.least_squares) damps with at most 1e8 in the units of the residual's square. With residuals in units of
    the noise the curvature is far above that, no step is accepted and the start is returned. So each pass divides the residuals by what
    the pass before left in each channel, at least its noise, and by the root of their number; parameters are scaled by its own rule.
    Each pass ends by the optimiser's own rules, and the last one when the weights have settled.
    """
    base = spec.copy()
    late = [s.name for s in base.sensors if s.type == mujoco.mjtSensor.mjSENS_JOINTACTFRC]
    everything = sysid.ParameterDict()

    def free(name, start, low, high, change):
        everything.add(sysid.Parameter(name, nominal=start, min_value=low, max_value=high, modifier=lambda s, p: change(s, p.value)))

    for j in JOINTS:
        free(f"{j} friction", 10.0, 0.0, 100.0, lambda s, v, j=j: setattr(s.joint(j), "frictionloss", float(v[0])))
        free(f"{j} damping", 4.0, 0.0, 100.0, lambda s, v, j=j: s.joint(j).damping.__setitem__(0, float(v[0])))
    free("stiffness", 3.0, 0.5, 10.0, lambda s, v: s.joint("A2_gear").stiffness.__setitem__(0, 1e5 * float(v[0])))
    free("gear damping", 3.0, 0.0, 50.0, lambda s, v: s.joint("A2_gear").damping.__setitem__(0, 1e2 * float(v[0])))
    free("delay", 4.0, 2.0, 20.0, lambda s, v: [setattr(s.sensor(n), "delay", 1e-3 * float(v[0])) for n in late])
    body = parameters.inertia(arm, "link6")  # sysid's own pseudo-inertia is refused by MuJoCo 4.0's compiler
    free("link 6", np.zeros(10), np.full(10, -5.0), np.full(10, 5.0), body.apply)

    sequences = []
    compiled = base.compile()
    settle = round(0.4 / TIMESTEP_S)
    for number, t in enumerate(fit.trajectories):
        fine = CubicSpline(np.arange(len(t.q)), t.q_set)(np.arange((len(t.q) - 1) * 2 + 1) / 2)
        control = np.concatenate([np.repeat(fine[:1], settle, axis=0), fine, fine[-1:]])  # it leaves the last one out
        data = mujoco.MjData(compiled)
        data.qpos[[compiled.joint(j).qposadr[0] for j in JOINTS]] = t.q[:10].mean(axis=0)
        start = sysid.create_initial_state(compiled, data.qpos, data.qvel, data.act)
        times = TIMESTEP_S * np.arange(len(control))
        nothing = sysid.TimeSeries.from_names(times, np.zeros((len(times), compiled.nsensordata)), compiled)
        sequences.append(sysid.ModelSequences(f"m{number}", base, f"m{number}", start, sysid.TimeSeries(times, control), nothing))

    rounds, scale = {"next": 0}, {"unit": np.ones(len(fit.channels))}

    def weigh(params, predicted, measured, engine, everything_wanted, state):
        number = rounds["next"] % len(fit.trajectories)
        sensed = predicted.data[settle::2][: len(fit.data[number])]
        residual = fit.data[number] - channels(fit, base, engine, sensed)
        return (residual[fit.used[number]] / scale["unit"]).ravel(), measured, measured

    def residual(x, params):
        out = []
        for number, sequence in enumerate(sequences):
            rounds["next"] = number
            out += sysid.build_residual_fn(models_sequences=[sequence], modify_residual=weigh, n_threads=2)(x, params)[0]
        return out, [], []

    best, weights, settled = everything, np.zeros(len(fit.channels)), False
    iterations: list[int] = []
    while not settled and len(iterations) < PASSES:
        scale["unit"] = np.ones(len(fit.channels))
        left = np.concatenate([r.reshape(-1, len(fit.channels)) for r in residual(best.as_vector(), best.copy())[0]])
        before, weights = weights, np.maximum(fit.noise, np.sqrt(np.mean(left**2, axis=0)))
        settled = bool(np.all(np.abs(weights - before) < SAME_WEIGHTS * weights))
        if settled:
            break
        scale["unit"] = weights * np.sqrt(left.size)
        with contextlib.redirect_stdout(io.StringIO()) as said:
            best, _ = sysid.optimize(best, residual, optimizer="mujoco", verbose=False, max_iters=ITERATIONS, x_scale="jac")
        iterations.append(said.getvalue().count("iter: "))
    found = base.copy()
    for p in best.values():
        p.apply_modifier(found)
    return Peer(found, tuple(iterations), not settled or max(iterations) >= ITERATIONS)


def structure(arm: MujocoArm, fit: RollOutFit) -> mujoco.MjSpec:
    """The given model with the gear's hinge and the sensors."""
    return fit.template([parameters.gear(arm, "A2", 1 / 3e5, 500.0), parameters.sensor_delay(arm, "tau")])


def channels(fit: RollOutFit, spec: mujoco.MjSpec, engine: mujoco.MjModel, sensed: np.ndarray) -> np.ndarray:
    from mbcacq.simulation.mujoco_arm import sensors_of

    out = np.zeros((len(sensed), len(fit.channels)))
    for k, c in enumerate(fit.channels):
        for s in sensors_of(spec, c.signal, fit.arm.joints[c.axis]):
            out[:, k] += sensed[:, engine.sensor_adr[engine.sensor(s.name).id]]
    return out


def mujoco_models(given: argparse.Namespace) -> None:
    """A MuJoCo model of a six-axis arm, recorded by a second one that conceals what the first lacks: found, written back, run again.

    The peer needs its extra: pip install 'mujoco[sysid]'; without it its rows are left out.
    """
    with_peer = not given.no_peer and peer_is_installed()
    if not given.no_peer and not with_peer:
        print("mujoco.sysid is not installed, and its rows are left out: pip install 'mujoco[sysid]' adds it", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.xml"
        file.write_text(model(concealed=False))
        arm = load_arm(file)
        learnt, held = [record(arm, s) for s in (0, 1)], [record(arm, s) for s in (2,)]
        with timed() as ours:
            found, match = diagnose_against_model(learnt, arm, lambda text: print(text, flush=True))
        match = check_model(match, arm, held, "a third motion")
        print(match.text)
        fit = RollOutFit(arm, learnt)
        peer, others, theirs = None, None, []
        if with_peer:
            with timed() as theirs:
                peer = fitted_by_peer(arm, structure(arm, fit), fit)
            print("passes of mujoco.sysid:", *peer.iterations, "iterations", file=sys.stderr)
            others = RollOutFit(arm, held).errors_of(peer.spec)
        text = page(found, match, *ours, peer, others, *theirs)
    print(text)
    if given.write:
        PAGE.write_text(text)


def page(found, match, cost, peer, others, cost_of_peer=None) -> str:
    true = {("friction", j, "frictionloss_Nm"): f[0] for j, f in zip(JOINTS, FRICTION, strict=True)}
    true |= {("friction", j, "damping_Nms_per_rad"): f[1] for j, f in zip(JOINTS, FRICTION, strict=True)}
    true |= {("gear", "A2", "stiffness_Nm_per_rad"): STIFFNESS, ("gear", "A2", "damping_Nms_per_rad"): GEAR_DAMPING}
    true |= {("inertia", "link6", "mass_kg"): TOOL["mass"], ("sensor_delay", "tau", "delay_s"): DELAY_S}
    true |= {("inertia", "link6", f"centre_{a}_mm"): 1e3 * float(v) for a, v in zip("xyz", TOOL["pos"].split(), strict=True)}
    true |= {("inertia", "link6", f"inertia_{a}{a}_kg_m2"): float(v) for a, v in zip("xyz", TOOL["diaginertia"].split(), strict=True)}
    concealed = {("friction", j) for j in JOINTS} | {("joint_compliance", "A2"), ("payload", "mount"), ("channel_latency", "tau")}
    effects = sorted({(e.name, "+".join(e.where)) for e in found.named_effects})
    wrong = [f"{name} at {where}" for name, where in effects if (name, where) not in concealed]
    off = {k: abs(p.after - true[k]) / p.std for p in match.parameters if (k := (p.name, p.where, p.parameter)) in true}
    friction = [v for key, v in off.items() if key[0] == "friction"]
    lines = [
        "# A MuJoCo model against a recording by another",
        "",
        "**Question.** Does a diagnosis find what a model lacks, and write it back as well as a peer that is told what to fit?",
        "",
        "    pip install 'mujoco[sysid]'",
        "    python benchmarks/motion.py mujoco --write",
        "",
        "A six-axis arm with position servos, as MJCF. A second model records it, with friction in all joints, a tool, an elastic A2 and",
        f"torques that are {1e3 * DELAY_S:g} ms late; it is stepped by code of its own. Two motions of {SECONDS:g} s are diagnosed",
        f"(`--simulation`), a third is held out. Noise: {NOISE['q']:g} rad, {NOISE['side']:g} rad behind the gears, {NOISE['tau']:g} N m.",
        "",
        f"Not named: {', '.join(' at '.join(c) for c in sorted(concealed - set(effects))) or 'nothing'}.",
        f"Named and not concealed: {', '.join(wrong) or 'nothing'}{NOT_WRITTEN if wrong else ''}.",
        "",
        "## Written into the model",
        "",
        f"{len(friction)} parameters of friction, at most {max(friction, default=0.0):.1f} sigmas off, and",
        "",
        "| | given | found | concealed | sigmas |",
        "|---|--:|--:|--:|--:|",
    ]
    for p in match.parameters:
        key = (p.name, p.where, p.parameter)
        if key not in off or p.name != "friction":
            goal, sigmas = (f"{true[key]:g}", f"{off[key]:.1f}") if key in off else ("nothing", "")
            lines.append(f"| {p.name} {p.where} `{p.parameter}` | {p.given} | {p.found} ± {p.std:.2g} | {goal} | {sigmas} |")
    lines += ["", "## New runs by the recorded set points, on the held-out motion (rms of the axes)", ""]
    head, rule = "| channel | noise | given model | model found |", "|---|--:|--:|--:|"
    lines += [head + (" `mujoco.sysid` |" if peer else ""), rule + ("--:|" if peer else "")]
    checks = match.checks[0].errors
    for name in dict.fromkeys((kind(e.channel), e.unit) for e in checks):
        of = [k for k, e in enumerate(checks) if (kind(e.channel), e.unit) == name]
        columns = [[getattr(checks[k], which) for k in of] for which in ("noise", "before", "after")]
        columns += [[others[k].after for k in of]] if peer else []
        lines.append(f"| {', '.join(name)} | " + " | ".join(f"{np.sqrt(np.mean(np.square(c))):.4g}" for c in columns) + " |")
    lines += [
        "",
        "## Accuracy and time",
        "",
        f"| | mean square over that of the added noise | processor time, s | elapsed, s, at a load of {os.getloadavg()[0]:.0f} |",
        "|---|--:|--:|--:|",
    ]
    ours = excess(checks)
    lines.append(f"| this program, diagnosis included | {ours:.4f} | {cost.processor_s:.0f} | {cost.elapsed_s:.0f} |")
    if peer:
        theirs = excess(others)
        lines.append(f"| `mujoco.sysid` | {theirs:.4f} | {cost_of_peer.processor_s:.0f} | {cost_of_peer.elapsed_s:.0f} |")
        iterations = ", ".join(map(str, peer.iterations))
        end = "The cap ended it, so its figure is not of a converged fit" if peer.capped else "No cap ended it"
        lines += [
            "",
            conclusion(ours / theirs, cost.processor_s / cost_of_peer.processor_s),
            "",
            "`mujoco.sysid` was given the parameters to fit with bounds and starts, the hinge of the gear, the sensors, the weights, the",
            f"samples and the settled start. Its optimiser ran {len(peer.iterations)} passes of {iterations} iterations, until the weights",
            f"of the channels changed by less than {SAME_WEIGHTS:.0%}. {end}. With other starts",
            "it may take more or less. Both used two threads.",
        ]
    return "\n".join(lines) + "\n"


def conclusion(errors: float, times: float) -> str:
    """In words; errors, times: of this program over those of the peer."""
    accuracy = "Both are equally accurate" if abs(errors - 1) < 0.01 else f"This program leaves {errors:.2g} times the mean square"
    return f"{accuracy}. This program finds the parameters itself and takes {times:.2g} times the processor time."


def excess(errors) -> float:
    """Mean square of all channels, each over that of the noise that was added."""
    return float(np.mean([(e.after / NOISE[kind(e.channel)]) ** 2 for e in errors]))


def kind(channel: str) -> str:
    return {"q": "q", "tau": "tau", "q_joint": "side"}[channel.split()[1]]
