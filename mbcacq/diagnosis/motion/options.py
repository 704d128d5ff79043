"""All numbers that tune the diagnosis of motion, in one place, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class MotionNumbers:
    """Numbers of ``diagnose_trajectories``, for which the figures in benchmarks/trajectories.md hold."""

    # signals
    rate_window_s: float = 0.09  # of the local quintic that gives rates: short against any motion, long against the sampling interval
    presliding_rad: float = 2e-5  # travel after which friction has changed its direction
    standstill: float = 0.02  # share of a joint's fastest speed below which friction may be anything up to the stiction
    highest_rate_hz: float = 500.0  # faster recordings are resampled: no mechanical effect of the catalogue is faster
    fewest_samples: int = 200  # fewer do not fill two segments of a recording
    edge_s: float = 0.05  # left out at both ends: the samples of a late channel lie outside the recording there
    load_window_s: float = 0.1  # of the quadratic that smooths a load: noise of a covariate would shrink its coefficient

    # segments and folds
    segment_s: float = 0.5  # segments count as independent: longer than the correlation of residuals seen in measured data
    held_out_parts: int = 3  # a single recording, or many of them, are held out in so many parts
    interleaved_blocks: int = 15  # of a single recording, among which effects are selected: a fold has all postures

    torque_offset: float = 0.03  # prior sigma of a torque's offset, as a share of its largest: drives measure currents to 1 to 3 %

    rotor_share: float = 0.05  # prior sigma of a rotor's inertia behind its gear, as a share of the arm's mass times its reach squared

    explained_chi2_dof: float = 4.0  # below it a joint's torque counts as explained: residuals are at most twice the noise
    weight_rounds: int = 3  # alternations of weights and coefficients: the mean squares have settled to a per cent

    # periodic components
    spectrum_oversampling: int = 8  # steps of angle per shortest period, and steps of order per distinguishable one
    background_orders: int = 61  # orders about a spectral line that give the background there
    motor_order_trials: float = 4.0  # orders compared near one and two per motor turn

    # hyper-parameters and delays
    hyper_rounds: int = 4  # Gauss-Newton converges in three
    hyper_step: float = 1e-3  # relative step of a numerical derivative: between curvature and rounding
    delay_rounds: int = 6  # Gauss-Newton converges in four
    longest_delay_s: float = 0.05  # a longer delay of a channel is not credible
    delay_tolerance_s: float = 1e-8  # a tenth of the resolution of a channel's latency

    # uncertainty
    correlation_s: float = 1.0  # residuals further apart than that count as independent
    unexplained_load_uncertainty: float = 0.05  # relative, of a load that is the drive's torque: the rotor's part of it is not separated

    # description of the data
    description_samples: int = 300  # in all, on which other readings are tried: conventions show in few
    description_correlated: float = 10.0  # samples that count as one there
    suspicious_ratio: float = 0.75  # product over the joints of the unexplained rms torque with another reading and without, at most

    wide_range: float = 0.5  # share of an axis' limits from which a motion counts as wide

    # motor currents
    current_sigmas: float = 20.0  # a joint whose current does not show the arm's torque as clearly has no torque
    current_segment: int = 125  # samples that count as one independent observation

    # verdict
    unexplained_chi2_dof: float = 2.0  # held-out chi2 per degree of freedom above which something is unexplained
    residual_chi2_dof: float = 2.0  # of a joint's residual, below which it is noise
    residual_bins: int = 24  # of the table over a covariate
    residual_segments: int = 24  # of a channel's residual, which count as independent
    least_residual_share: float = 0.15  # share of the residual that one covariate must predict on held-out data to be reported
    agreement_sigmas: float = 3.0  # between a parameter from poses and from motion

    workers: int = 2  # threads of the cross-validation: matrices, so they share the work


NUMBERS = MotionNumbers()
RIDGE = 1e-12  # of a scaled normal matrix: numerical rank in double precision
