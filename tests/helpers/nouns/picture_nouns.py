"""Synthetic nouns for the pictures: 24 third-order plants, one controller, a recording, equilibria."""

from collections.abc import Sequence

import numpy as np
from bench_nouns import Block, Estimate, Loop, LoopSetup, RecordingInfo, RequirementResult, TransferFunction
from conversions import TWO_PI, rad

import loopshape as ls

POINTS = (
    *((theta, p) for p in (0.8, 1.0, 1.2, 1.4) for theta in (-30.0, -15.0, 0.0, 15.0, 30.0)),
    *((theta, 1.6) for theta in (-15.0, 0.0, 15.0)),
    (0.0, 1.8),
)


def plant_numbers(theta2_deg: float, p_ab_bar: float) -> tuple[float, float, float]:
    """Kappa, f in Hz, zeta."""
    kappa = 1200.0 + 1400.0 * (p_ab_bar - 0.8) * (1.0 - (theta2_deg / 60.0) ** 2) - 4.0 * theta2_deg
    return kappa, 4.0 + 2.4 * (p_ab_bar - 0.8) + 0.3 * (theta2_deg / 30.0) ** 2 + 0.004 * theta2_deg, 0.065


def model(theta2_deg: float, p_ab_bar: float) -> TransferFunction:
    kappa, f_hz, zeta = plant_numbers(theta2_deg, p_ab_bar)
    w = TWO_PI * f_hz
    return TransferFunction(np.array([kappa]), np.array([1.0, 2.0 * zeta * w, w * w, 0.0]))


def frf(
    theta2_deg: float = 0.0, p_ab_bar: float = 1.0, seed: int = 0, noise: float = 0.02, **changes: object
) -> ls.FRF:
    rng = np.random.default_rng(seed + round(100 * p_ab_bar + theta2_deg))
    f = np.arange(0.05, 60.0, 0.05)
    truth = model(theta2_deg, p_ab_bar).response(f)
    relative = noise * np.sqrt(1.0 + (0.15 / f) ** 4 + (f / 6.0) ** 5)
    error = relative * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
    response = truth * (1.0 + error)
    coherence = 1.0 / (1.0 + 12.0 * relative**2)
    input_power = 1e-2 / (1.0 + (f / 5.0) ** 2)
    given: dict[str, object] = {
        "frequency_hz": f,
        "response": response[:, None, None],
        "covariance": (np.abs(truth) ** 2 * relative**2)[:, None, None].astype(complex),
        "valid": coherence > 0.8,
        "inputs": ("z_theta2_v",),
        "outputs": ("theta2_rad",),
        "method": "local polynomial from n to z and y, 20 s multisine, 6 periods",
        "recording": f"r{POINTS.index((theta2_deg, p_ab_bar)) + 1:02d}",
        "loop": "theta2",
        "rate_hz": 1000.0,
        "operating_point": {"theta2_deg": theta2_deg, "p_ab_bar": p_ab_bar},
        "coherence": coherence,
        "input_power": input_power,
        "output_power": np.abs(response) ** 2 * input_power / coherence,
        "cross_power": response * input_power,
    }
    return ls.FRF(**(given | changes))  # type: ignore[arg-type]


def fit(theta2_deg: float = 0.0, p_ab_bar: float = 1.0, outcome: str = "converged") -> ls.Fit:
    kappa, f_hz, zeta = plant_numbers(theta2_deg, p_ab_bar)
    values = (("kappa", kappa, "rad/(V s3)", 18.0), ("f_hz", f_hz, "Hz", 0.02), ("zeta", zeta, "1", 0.004))
    return ls.Fit(
        structure="third_order",
        model=model(theta2_deg, p_ab_bar),
        parameters=tuple(Estimate(*v) for v in values),
        covariance=np.diag([18.0**2, 0.02**2, 0.004**2]),
        outcome=outcome,
        chi2_per_dof=1.1,
        p_value=0.2,
        runs_p_value=0.4,
        misfit_db=0.3,
        band_hz=(0.2, 10.0),
        lines=200,
        recording=f"r{POINTS.index((theta2_deg, p_ab_bar)) + 1:02d}",
        loop="theta2",
        operating_point={"theta2_deg": theta2_deg, "p_ab_bar": p_ab_bar},
    )


def controller(gain: float = 11.0) -> ls.Controller:
    blocks = (
        Block("gain", {"gain": gain}),
        Block("lead_lag", {"f1_hz": 2.2, "f2_hz": 18.0}),
        Block("notch", {"f1_hz": 4.5, "f2_hz": 4.5, "damping1": 0.05, "damping2": 5.0}),
        Block("low_pass_2", {"f_hz": 19.0, "damping": 0.55}),
    )
    return ls.Controller("theta2", blocks, 1000.0)


def requirements(**changes: object) -> ls.Requirements:
    given: dict[str, object] = {
        "loop": "theta2",
        "gain_margin_db": 6.0,
        "phase_margin_deg": 35.0,
        "sensitivity_peak_db": 6.0,
        "complementary_peak_db": 6.0,
        "control_peak_db": 30.0,
        "control_high_frequency_db": 0.0,
        "control_high_frequency_from_hz": 30.0,
        "bandwidth_hz": 1.0,
    }
    return ls.Requirements(**(given | changes))  # type: ignore[arg-type]


def frfs() -> list[ls.FRF]:
    return [frf(*point) for point in POINTS]


def fits() -> list[ls.Fit]:
    return [fit(*point) for point in POINTS]


def loops() -> list[Loop]:
    one = controller()
    return [Loop(plant, one, integrators=1, unstable_poles=0) for plant in frfs()]


def margins(k: int = 0, stable: str = "stable") -> ls.Margins:
    """Margins as `check` would give them; the numbers are made up."""
    values = {
        "gain_margin_db": 8.0 + 4.0 * np.sin(k),
        "gain_reduction_margin_db": float("inf"),
        "phase_margin_deg": 40.0 + 9.0 * np.cos(1.7 * k),
        "modulus_margin": 0.55,
        "delay_margin_s": 0.05,
        "sensitivity_peak_db": 5.0 + 1.5 * np.sin(2.0 * k),
        "complementary_peak_db": 3.0,
        "control_peak_db": 26.0,
        "control_high_frequency_db": -3.0,
        "bandwidth_hz": 1.1 + 0.08 * k,
    }
    return ls.Margins.of(values, stable, crossings_hz=(1.1 + 0.08 * k,), phase_crossings_hz=(9.0,))


def verdict() -> ls.Verdict:
    found = {f"r{k + 1:02d}": margins(k, "undecided" if k == 7 else "stable") for k in range(24)}
    lines = tuple(
        RequirementResult(name, unit, required, 0.0, 0.0, "passed", "r01", None)
        for name, unit, required in (
            ("gain_margin_db", "dB", 6.0),
            ("gain_reduction_margin_db", "dB", 6.0),
            ("phase_margin_deg", "deg", 35.0),
            ("sensitivity_peak_db", "dB", 6.0),
            ("bandwidth_hz", "Hz", 1.2),
        )
    )
    return ls.Verdict("theta2", lines, found)


def loop_setups() -> Sequence[LoopSetup]:
    return (
        LoopSetup("theta2", "r_theta2_rad", "n_theta2_rad", "z_theta2_v", "theta2_rad", controller()),
        LoopSetup("p", "r_p_ab_bar", "n_p_ab_bar", "z_p_v", "p_a_bar + p_b_bar", None),
    )


def recording(seconds: float = 20.0, rate_hz: float = 1000.0) -> ls.Recording:
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    rng = np.random.default_rng(3)
    setpoint = rad(15.0) * np.sign(np.sin(TWO_PI * t / 10.0))
    y = setpoint * (1.0 - np.exp(-(t % 5.0) / 0.25) * (1.0 + np.cos(TWO_PI * 2.0 * t)))
    y = y + rad(0.02) * rng.standard_normal(t.size)
    p_ab = np.where(t > 12.0, 1.2, 1.0)
    split = 0.2 * y / rad(15.0)
    noise = 1e-3 * rng.standard_normal((2, t.size))
    columns = {
        "t_s": t,
        "r_theta2_rad": setpoint,
        "n_theta2_rad": np.zeros(t.size),
        "z_theta2_v": np.clip(11.0 * (setpoint - y), -2.0, 2.0),
        "theta2_rad": y,
        "r_p_ab_bar": p_ab,
        "n_p_ab_bar": np.zeros(t.size),
        "z_p_v": 0.3 * (p_ab - 1.0) + 0.01 * rng.standard_normal(t.size),
        "p_a_bar": 0.5 * p_ab + split + noise[0],
        "p_b_bar": 0.5 * p_ab - split + noise[1],
        "u_a_v": np.zeros(t.size),
        "u_b_v": np.zeros(t.size),
        "p_capacity_bar": 3.0 + 0.05 * np.cos(t),
    }
    info = RecordingInfo("r03.parquet", "profile", "reference", operating_point={"theta2_deg": 0.0, "p_ab_bar": 1.0})
    return ls.Recording(info, rate_hz, columns)
