"""May this machine run this experiment: what was measured against its limit, with the limit's reason. Pure.

In the spirit of BCI2000's certification (Wilson et al., 10.1109/TBME.2010.2047259), which measures a system's timing on
the very machine, in the very experiment, instead of trusting figures of another.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stimulus.pace import Flips

Array = NDArray[np.float64]

ONSET_SD_MS = 10.0
"""Standard deviation of what is left between an onset's stamp and its light, at most: a third of a feature's window,
and what BciPy's photodiode test tolerates (decided)."""
FLIP_SD_MS = 2.0
"""Standard deviation of the flip interval of a paced screen, at most (decided)."""
LATE_SHARE = 0.01
"""Share of flips that may come a frame or more late (decided): a jump of a hundred."""
MARKER_MS = 100.0
"""From flip to marker in another program, at most: a sixth of the time until the epoch's last sample (decided)."""
VERDICT_MS = 100.0
"""From a move's last sample to its verdict, at most: a tenth of the time the policy has (decided)."""
ACTION_MS = 200.0
"""From verdict to action, and from there to the stimulus, at most (decided)."""
LEFT_MS = 300.0
"""What must be left until the next jump when its action is there, at least (decided)."""
LIGHT_MS = (-1.0, 150.0)
"""Earliest and latest light after a flip that can be believed (decided): later, something else was measured."""
BEFORE_S, AFTER_S = 0.1, 0.3
"""Seconds around a flip in which its light is looked for."""
STEP_S = 0.012
"""Seconds on both sides of a change of light over which the levels are averaged: longer than a screen takes to change
(decided)."""
SEEN_IN = 0.9
"""Share of jumps whose light must be seen for the offset to be believed (decided)."""
CONTRAST = 5.0
"""Height of a change of light, in standard deviations of the channel without one, from which it is seen (decided)."""


@dataclass(frozen=True)
class Finding:
    """One line of the page.

    Attributes
    ----------
    what, found, limit, why : in words.
    ok : None where it couldn't be measured.
    figures : the numbers, in ms or as counts.
    """

    what: str
    found: str
    limit: str
    why: str
    ok: bool | None
    figures: Mapping[str, float] = field(default_factory=dict)


def may_run(findings: Sequence[Finding]) -> bool:
    """Whether nothing that was measured is beyond its limit."""
    return all(finding.ok is not False for finding in findings)


def screen(flips: Flips, refresh_hz: float | None) -> Finding:
    """How evenly the screen shows its pictures."""
    told = f"the system says {1e3 / refresh_hz:.2f} ms" if refresh_hz else "the system doesn't say what it should be"
    pacing = "the screen paces them" if flips.paced else "nothing paces them"
    found = (
        f"flips every {flips.interval_ms:.2f} ms, SD {flips.sd_ms:.2f} ms, {pacing} ({told}); {flips.n_late} of "
        f"{flips.n} late, the longest {flips.longest_ms:.1f} ms"
    )
    few_late = flips.n_late <= LATE_SHARE * flips.n
    return Finding(
        "flip interval",
        found,
        f"SD {FLIP_SD_MS:g} ms where the screen paces; {LATE_SHARE:.0%} late",
        "the jump is due at a certain flip, and that must come when it is due",
        few_late and (flips.sd_ms <= FLIP_SD_MS or not flips.paced),
        {
            "interval_ms": flips.interval_ms,
            "sd_ms": flips.sd_ms,
            "longest_ms": flips.longest_ms,
            "n": flips.n,
            "n_late": flips.n_late,
            "paced": float(flips.paced),
        },
    )


def late_jumps(n_late: int, n_moves: int) -> Finding:
    """Whether jumps were late in the run itself: their flips, not their light."""
    return Finding(
        "late jumps in a run",
        f"{n_late} of {n_moves}",
        f"{LATE_SHARE:.0%}, but one may always be",
        "a late jump is stamped rightly, but surprises the eye",
        n_late <= max(1.0, LATE_SHARE * n_moves),
        {"n_late": n_late, "n": n_moves},
    )


def onsets(flips: Flips, light_ms: Array | None) -> Finding:
    """How well it is known when a jump was seen."""
    if light_ms is not None:
        sd, how = float(np.std(light_ms)), "measured by the photodiode"
    elif flips.paced:
        sd, how = flips.sd_ms, "as even as the flips; a photodiode would also tell how late the screen is"
    else:
        # Without a beat the light comes at the screen's next refresh, evenly likely within its period of 1/60 s.
        sd, how = 1e3 / 60 / np.sqrt(12), "for a screen of 60 Hz that doesn't pace; a photodiode would tell"
    return Finding(
        "onsets are known",
        f"to {sd:.1f} ms (SD), {how}",
        f"{ONSET_SD_MS:g} ms",
        "features are means of 30 ms; onsets known worse smear the response",
        bool(sd <= ONSET_SD_MS),
        {"sd_ms": float(sd)},
    )


def light_delays(samples: Array, times: Array, at: Array) -> Array:
    """When the light changed after each flip, in ms; NaN where no change was seen.

    Parameters
    ----------
    samples, times : the photodiode's channel and its stamps, (n_times,).
    at : the flips, on the same clock, (n_flips,).

    Notes
    -----
    A change is where the means of `STEP_S` before and after differ most; its time is where the line between the samples
    crosses the middle of these two levels. Slow drifts, and a channel without direct current, don't matter to it.
    """
    found = [_change(samples, times, float(flip)) for flip in at]
    heights = np.array([height for height, _ in found])
    delays = np.array([(when - flip) * 1e3 for (_, when), flip in zip(found, at, strict=True)])
    if not len(heights):
        return delays
    noise = float(np.median(np.abs(np.diff(samples)))) / 0.6745 / np.sqrt(2)
    is_seen = (heights > CONTRAST * noise) & (heights > np.median(heights) / 2)
    return np.where(is_seen, delays, np.nan)


def _change(samples: Array, times: Array, flip: float) -> tuple[float, float]:
    """Height and time of the largest change around a flip; height 0 where there are too few samples."""
    first, last = np.searchsorted(times, (flip - BEFORE_S, flip + AFTER_S))
    part, when = samples[first:last].astype(np.float64), times[first:last]
    if len(part) < 4:
        return 0.0, float("nan")
    width = max(1, round(STEP_S * (len(when) - 1) / (when[-1] - when[0])))
    if len(part) <= 2 * width:
        return 0.0, float("nan")
    means = np.convolve(part, np.full(width, 1 / width), mode="valid")
    steps = means[width:] - means[:-width]  # at sample k + width: what follows less what was before
    place = int(np.argmax(np.abs(steps))) + width
    before, after = means[place - width], means[place]
    middle = (before + after) / 2
    above = (part > middle) == (after > before)  # on the side of the new level
    crossing = place
    while crossing > 1 and above[crossing - 1]:
        crossing -= 1
    while crossing < len(part) - 1 and not above[crossing]:
        crossing += 1
    a, b = part[crossing - 1], part[crossing]
    share = (middle - a) / (b - a) if b != a else 0.5
    return abs(float(after - before)), float(when[crossing - 1] + share * (when[crossing] - when[crossing - 1]))


def light(delays_ms: Array, key_ms: float | None) -> Finding:
    """How long after its flip a jump's light came."""
    seen = delays_ms[np.isfinite(delays_ms)]
    limit = (
        f"seen at {SEEN_IN:.0%} of jumps, SD {ONSET_SD_MS:g} ms, {LIGHT_MS[0]:g} to {LIGHT_MS[1]:g} ms after the flip"
    )
    why = "the photodiode tells when the eye could see it; onsets are stamped later by the mean"
    if len(seen) < max(1, SEEN_IN * len(delays_ms)):
        found = f"light seen at only {len(seen)} of {len(delays_ms)} jumps: is the photodiode on the patch?"
        return Finding("flip to light", found, limit, why, False, {"n": len(delays_ms), "n_seen": len(seen)})
    mean, sd = float(seen.mean()), float(seen.std())
    found = f"{mean:.1f} ms, SD {sd:.1f} ms, at {len(seen)} of {len(delays_ms)} jumps"
    figures = {"mean_ms": mean, "sd_ms": sd, "n": len(delays_ms), "n_seen": len(seen)}
    if key_ms is not None:
        found += f"; so a key shows after {key_ms + mean:.1f} ms, without what the keyboard itself takes"
        figures["key_ms"] = key_ms + mean
    ok = LIGHT_MS[0] <= mean <= LIGHT_MS[1] and sd <= ONSET_SD_MS
    if mean < LIGHT_MS[0]:
        found += ". Light before its flip: the amplifier's stamps are early; look at its LSL connector"
    return Finding("flip to light", found, limit, why, ok, figures)


UNSEEN = Finding(
    "flip to light",
    "not measured: no channel for a photodiode in the EEG stream",
    f"SD {ONSET_SD_MS:g} ms",
    "only light tells when the screen really changed; by how much it is late no program can know",
    None,
)
NO_SCREEN = Finding(
    "flip interval", "not measured: without a screen (--headless)", "", "nobody looks at this machine's screen", None
)


def markers(delays_ms: Array) -> Finding:
    """From the flip to the marker in another program's hands."""
    n_early = int((delays_ms < 0).sum())
    return _stage(
        "flip to marker, in another program",
        delays_ms,
        MARKER_MS,
        "the decoder must know of a move before its epoch is whole, and of none that wasn't shown",
        also_ok=n_early == 0,
        also=f"; {n_early} before their flip",
        limit="none before its flip; ",
    )


def stages(ledger: Mapping[str, Array]) -> list[Finding]:
    """What the loop adds, stage by stage; in ms of each move."""
    verdicts, actions, ways, left = (ledger[name] for name in ("verdict", "action", "way", "left"))
    return [
        _stage("last sample to verdict", verdicts, VERDICT_MS, "the policy waits for it"),
        _stage("verdict to action", actions, ACTION_MS, "the stimulus waits for it"),
        _stage("action to stimulus", ways, ACTION_MS, "the stimulus waits for it"),
        Finding(
            "time left before the next jump",
            f"{_low(left):.0f} ms at least" if len(left) else "no move with a next",
            f"{LEFT_MS:g} ms",
            "an action that comes after its jump is due holds the countdown, and the participant notices",
            bool(_low(left) >= LEFT_MS) if len(left) else None,
            {"least_ms": _low(left)} if len(left) else {},
        ),
    ]


def _low(values: Array) -> float:
    return float(values.min())


def _stage(
    what: str, delays_ms: Array, limit_ms: float, why: str, also_ok: bool = True, also: str = "", limit: str = ""
) -> Finding:
    if not len(delays_ms):
        return Finding(what, "nothing came", f"{limit}99% within {limit_ms:g} ms", why, False)
    p50, p99, longest = (float(value) for value in np.percentile(delays_ms, (50, 99, 100)))
    return Finding(
        what,
        f"{p50:.1f} ms, 99% within {p99:.1f}, the longest {longest:.1f}{also}",
        f"{limit}99% within {limit_ms:g} ms",
        why,
        also_ok and p99 <= limit_ms,
        {"p50_ms": p50, "p99_ms": p99, "longest_ms": longest, "n": len(delays_ms)},
    )
