"""Times of beats of known shape, at several frame rates and noise levels: the table "Waveforms" of docs/benchmarks.md.

    python benchmarks/waveforms.py [TRACES]

Three shapes, a raised cosine of 0.5 s, a bell, and a beat that rises in 0.2 s and falls in 0.4 s, beat 6 times a trace
at 1 Hz, with a random phase, on a slowly falling baseline; noise is white, given as a share of the amplitude. Every
trace is cut and measured as `microbundle trace` does. The error is that of nine times of each whole beat (`TIMES`); the
last column is the share of 95 % intervals (value +/- 2.04 standard errors) that hold the truth.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from microbundle.data import Floats
from microbundle.errors import CannotMeasure
from microbundle.trace import cut_trace, trace_values

BEATS, PERIOD_S, T_95 = 6, 1.0, 2.04
RATES, NOISES = (20, 30, 60, 200), (0.0, 0.005, 0.01, 0.03)
TIMES = ("time_to_peak", "cd10", "cd50", "cd90", "relax50", "relax90", "t_up_20_80", "t_down_80_20", "half_rise_time")


def cosine(t: Floats) -> Floats:
    """As fast up as down, from -0.25 to 0.25 s."""
    return np.where(np.abs(t) < 0.25, 0.5 + 0.5 * np.cos(np.pi * t / 0.25), 0.0)


def bell(t: Floats) -> Floats:
    """A Gaussian of 0.09 s."""
    return np.asarray(np.exp(-0.5 * (t / 0.09) ** 2))


def skewed(t: Floats) -> Floats:
    """Up in 0.2 s, down in 0.4 s."""
    x = np.clip((t + 0.2) / 0.6, 0, 1)
    return np.asarray((3 * x) ** 2 * (1.5 * (1 - x)) ** 4)


def truth(shape: Callable[[Floats], Floats]) -> dict[str, float]:
    """The times of a shape in seconds, from 200,000 points of it; half_rise_time from its peak."""
    t = np.linspace(-0.5, 0.5, 200_001)
    y = shape(t)
    top = int(np.argmax(y))

    def rise(x: float) -> float:
        return float(np.interp(x, y[:top + 1], t[:top + 1]))

    def fall(x: float) -> float:
        return float(np.interp(-x, -y[top:], t[top:]))

    width = {f"cd{x}": fall(1 - x / 100) - rise(1 - x / 100) for x in (10, 50, 90)}
    return width | {"time_to_peak": t[top] - rise(0.1), "relax50": fall(0.5) - t[top], "relax90": fall(0.1) - t[top],
                    "t_up_20_80": rise(0.8) - rise(0.2), "t_down_80_20": fall(0.2) - fall(0.8),
                    "half_rise_time": rise(0.5) - t[top]}


def errors(fps: float, noise: float, traces: int) -> tuple[Floats, Floats, int]:
    """Errors in frames, the same over their standard errors, and the number of beats that were not found."""
    rng = np.random.default_rng(round(fps) + round(1e4 * noise))
    wrong, ratio, missed = [], [], 0
    for shape in (cosine, bell, skewed):
        exact = truth(shape)
        for _ in range(traces):
            first = rng.uniform(0.45, 0.7)
            t = np.arange(round(BEATS * PERIOD_S * fps)) / fps
            y = sum(shape(t - first - i * PERIOD_S) for i in range(-1, BEATS + 1))
            y = 100 * (1 + y) * (1 - 0.01 * t) + 100 * noise * rng.standard_normal(len(t))
            try:
                trace = cut_trace("known", t, y)
            except CannotMeasure:
                missed += BEATS - 1
                continue
            values, error = trace_values(trace)
            whole = trace.beats.complete
            missed += max(0, BEATS - 1 - int(whole.sum()))
            for name in TIMES:
                found = values[f"trace_{name}"][whole]
                if name == "half_rise_time":
                    true = (first + exact[name]) * fps
                    away = (found - true + 0.5 * PERIOD_S * fps) % (PERIOD_S * fps) - 0.5 * PERIOD_S * fps
                else:
                    away = found - exact[name] * fps
                wrong.append(away)
                ratio.append(np.divide(away, error[f"trace_{name}"][whole], out=np.full(len(away), np.nan),
                                       where=error[f"trace_{name}"][whole] > 0))
    return np.concatenate(wrong), np.concatenate(ratio), missed


def main() -> None:
    traces = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    print("| frames/s | noise, % of amplitude | error, frames (RMS) | 99 % below | beats missed | in the 95 % "
          "interval |\n|---|---|---|---|---|---|")
    for fps in RATES:
        for noise in NOISES:
            wrong, ratio, missed = errors(fps, noise, traces if noise else max(4, traces // 4))
            size = np.abs(wrong[np.isfinite(wrong)])
            held = "" if noise == 0 else f"{100 * np.mean(np.abs(ratio[np.isfinite(ratio)]) < T_95):.0f} %"
            print(f"| {fps} | {100 * noise:g} | {np.sqrt(np.mean(size**2)):.3f} | {np.quantile(size, 0.99):.3f} | "
                  f"{missed} | {held} |", flush=True)


if __name__ == "__main__":
    main()
