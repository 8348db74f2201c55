"""EMG as a signal: read it, turn it into an envelope, normalise it, bring it to the frames of a motion.

Raw EMG goes through :func:`envelope` and one of the `normalize_` functions; data that already are an envelope
as a fraction of the maximum (many public sets) only need :func:`resample`. Which muscles a channel stands
for is in :mod:`scso_nlp.emg.map`.
"""

from __future__ import annotations

import csv
import io
import logging
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scso_nlp.arguments import checked
from scso_nlp.exceptions import DataError, FileFormatError
from scso_nlp.files import read_text
from scso_nlp.io.storage import read_storage
from scso_nlp.text import number, shown
from scso_nlp.validation import FloatArray, positions, read_only, unique_names

logger = logging.getLogger("scso_nlp")

#: Lower edge of the band [Hz]. De Luca et al. (2010), J Biomech 43:1573-1579, for movement artifact.
BAND_LOW = 20.0
#: Lower edge of the band for trunk muscles [Hz], against the heart's beat. Drake and Callaghan (2006),
#: J Electromyogr Kinesiol 16:175-187.
TRUNK_BAND_LOW = 30.0
#: Upper edge of the band [Hz]. SENIAM: the surface signal's content lies below about 450 Hz.
BAND_HIGH = 450.0
#: Cut-off of the envelope [Hz]: the 6 Hz zero-lag filter that the field uses for motion and EMG alike.
ENVELOPE_CUTOFF = 6.0
#: Order of each one-way filter [-]; run forwards and backwards it acts as one of twice this order.
FILTER_ORDER = 2
#: Share of the target's Nyquist frequency that is kept when resampling to fewer frames [-].
ANTI_ALIAS_SHARE = 0.8
#: Longest gap between samples that is bridged [median steps]. Longer ones are refused.
MAX_GAP = 10.0


@dataclass(frozen=True, kw_only=True)
@checked
class Emg:
    """EMG channels over time.

    Attributes
    ----------
    channels : tuple of str
    time : ndarray, shape (n_samples,) [s]
        Strictly increasing.
    values : ndarray, shape (n_samples, n_channels) [-]
        Raw signal, envelope or fraction of the maximum, in the unit of the file.
    source : str
        The file it was read from, for messages.
    """

    channels: tuple[str, ...]
    time: FloatArray
    values: FloatArray
    source: str = "EMG"

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "channels", unique_names("EMG channel", self.channels))
        time = read_only(f"{self.source}: time", self.time, (-1,), "n_samples")
        set_field(self, "time", time)
        if len(time) == 0:
            raise DataError(f"{self.source} has no sample, expected at least one")
        back = np.flatnonzero(np.diff(time) <= 0)
        if len(back):
            k = int(back[0])
            raise DataError(f"{self.source}: time must increase, found {time[k + 1]} s after {time[k]} s")
        shape = (len(time), len(self.channels))
        values = read_only(
            f"{self.source}: values", self.values, shape, "n_samples, n_channels", finite=False
        )
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            k, c = (int(i) for i in bad[0])
            raise DataError(
                f"{self.source}: channel {self.channels[c]!r} is {values[k, c]} at t = {time[k]:g} s, "
                "expected a finite number; cut that part off or drop the channel with select()"
            )
        set_field(self, "values", values)

    def select(self, channels: Iterable[str]) -> Emg:
        """Keep the channels named, in that order.

        Raises
        ------
        NameMismatchError
            A channel is not there; the closest names are suggested.
        """
        chosen = tuple(channels)
        return replace(
            self,
            channels=chosen,
            values=self.values[:, positions(f"EMG channel of {self.source}", chosen, self.channels)],
        )


@checked
def read_emg(path: str | os.PathLike[str]) -> Emg:
    """Read EMG from a Storage file (``.sto``, ``.mot``) or a table with commas (``.csv``).

    A ``.csv`` file has one line of labels whose first is ``time`` and numbers with decimal points below it.

    Parameters
    ----------
    path : str or path-like

    Returns
    -------
    Emg

    Raises
    ------
    DataError
        No such file, time that does not increase, or a value that is not finite.
    FileFormatError
        Not such a file.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        return _read_csv(path)
    storage = read_storage(path)
    keep = [i for i, label in enumerate(storage.labels) if label]
    return Emg(
        channels=tuple(storage.labels[i] for i in keep),
        time=storage.time,
        values=storage.values[:, keep],
        source=str(path),
    )


@dataclass(frozen=True, kw_only=True)
@checked
class EnvelopeFilter:
    """How raw EMG becomes an envelope.

    All filters are Butterworth, run forwards and backwards (no lag), with the cut-off corrected so that the
    pair of runs, not each of them, is 3 dB down at the frequency named.

    Attributes
    ----------
    band_low, band_high : float [Hz]
        Edges of the band that is kept before rectifying. `band_high` may exceed what the sampling rate
        holds; then only the lower edge is used.
    cutoff : float [Hz]
        Low-pass after rectifying.
    order : int [-]
        Of each one-way run; the pair acts as one filter of twice this order.

    References
    ----------
    Winter (2009), Biomechanics and Motor Control of Human Movement, 4th ed., section 3.4.4.2 (correction of
    the cut-off); sources of the default frequencies stand beside their names in this module.
    """

    band_low: float = BAND_LOW
    band_high: float = BAND_HIGH
    cutoff: float = ENVELOPE_CUTOFF
    order: int = FILTER_ORDER

    def __post_init__(self) -> None:
        if not 0 < self.cutoff < self.band_low < self.band_high < math.inf:
            raise DataError(
                f"frequencies of the EMG filter are cutoff {self.cutoff:g}, band {self.band_low:g} to "
                f"{self.band_high:g} Hz, expected 0 < cutoff < band_low < band_high"
            )
        if not (isinstance(self.order, int) and 1 <= self.order <= 8):
            raise DataError(f"order of the EMG filter is {self.order!r}, expected 1 to 8")


@checked
def envelope(emg: Emg, options: EnvelopeFilter | None = None) -> Emg:
    """Band-pass, rectify and smooth raw EMG.

    Parameters
    ----------
    emg : Emg
        Raw signal, sampled at more than twice `band_low`. Small irregularities of the time stamps are taken
        out by linear interpolation on the median step.
    options : EnvelopeFilter, optional

    Returns
    -------
    Emg
        On a uniform time, not negative: the little that the smoothing filter undershoots is set to zero.

    Raises
    ------
    DataError
        Sampled too slowly, too short for the filters, or a gap in time.
    """
    options = options or EnvelopeFilter()
    time, values, step = _on_uniform_time(emg)
    nyquist = 0.5 / step
    if options.band_low >= nyquist:
        raise DataError(
            f"{emg.source} is sampled at {1 / step:.4g} Hz, too slowly for a band from "
            f"{options.band_low:g} Hz; if it already is an envelope, do not filter it again"
        )
    values = values - values.mean(axis=0)
    values = _zero_lag(values, step, options.band_low, options.order, "highpass", emg.source)
    if options.band_high < nyquist:
        values = _zero_lag(values, step, options.band_high, options.order, "lowpass", emg.source)
    else:
        logger.info("%s: sampled at %.4g Hz, no upper edge of the band applied", emg.source, 1 / step)
    values = _zero_lag(np.abs(values), step, options.cutoff, options.order, "lowpass", emg.source)
    return replace(emg, time=time, values=np.maximum(values, 0.0))


@checked
def normalize_to_peak(emg: Emg) -> Emg:
    """Divide every channel by its own largest value.

    Activations of a model are fractions of the maximum, which the peak of a trial rarely is: only shapes may
    be compared afterwards, not levels.

    Parameters
    ----------
    emg : Emg
        Envelope.

    Returns
    -------
    Emg
        Largest value 1 in every channel.

    Raises
    ------
    DataError
        A channel that is never positive.
    """
    return normalize_to_mvc(emg, dict(zip(emg.channels, emg.values.max(axis=0).tolist(), strict=True)))


@checked
def normalize_to_mvc(emg: Emg, mvc: Mapping[str, float]) -> Emg:
    """Divide channels by their value at maximum voluntary contraction.

    Parameters
    ----------
    emg : Emg
        Envelope.
    mvc : mapping of str to float [unit of the channel]
        Envelope's value at maximum voluntary contraction. Channels without one stay as they are.

    Returns
    -------
    Emg
        Values above 1 or below 0 are kept, with a warning in the log.

    Raises
    ------
    NameMismatchError
        A channel that is not there.
    DataError
        A reference that is not positive.
    """
    values = emg.values.copy()
    for channel, reference in mvc.items():
        column = int(positions("EMG channel", (channel,), emg.channels)[0])
        if not (math.isfinite(reference) and reference > 0):
            raise DataError(
                f"{emg.source}: reference of channel {channel!r} is {reference}, expected above 0"
            )
        values[:, column] /= reference
    normalized = replace(emg, values=values)
    warn_outside_unit_range(normalized)
    return normalized


@checked
def scaled(emg: Emg, factors: Mapping[str, float]) -> Emg:
    """Multiply channels by numbers; those that are not named stay as they are.

    Parameters
    ----------
    emg : Emg
    factors : mapping of str to float [-]

    Returns
    -------
    Emg

    Raises
    ------
    NameMismatchError
        A channel that is not there.
    """
    values = emg.values.copy()
    for channel, factor in factors.items():
        values[:, positions("EMG channel", (channel,), emg.channels)] *= factor
    return replace(emg, values=values)


@checked
def delayed(emg: Emg, seconds: Mapping[str, float]) -> Emg:
    """Move channels to later times; those that are not named stay where they are.

    Parameters
    ----------
    emg : Emg
        Envelope.
    seconds : mapping of str to float [s]
        By channel, negative for earlier.

    Returns
    -------
    Emg
        At times that all its channels cover. Channels that move by the same amount keep their samples,
        others are interpolated linearly.

    Raises
    ------
    NameMismatchError
        A channel that is not there.
    DataError
        Channels that have no time in common then.
    """
    late = np.zeros(len(emg.channels))
    for channel, amount in seconds.items():
        late[positions("EMG channel", (channel,), emg.channels)] = amount
    if not late.any():
        return emg
    time, further = emg.time + late[0], late - late[0]
    common = (time >= time[0] + further.max()) & (time <= time[-1] + further.min())
    if not common.any():
        raise DataError(f"{emg.source}: channels delayed by {shown(dict(seconds))} have no time in common")
    values = [
        column[common] if shift == 0 else np.interp(time[common] - shift, time, column)
        for column, shift in zip(emg.values.T, further, strict=True)
    ]
    return replace(emg, time=time[common], values=np.column_stack(values))


def warn_outside_unit_range(emg: Emg) -> None:
    """Log a warning for every channel with values above 1 or below 0.

    Parameters
    ----------
    emg : Emg
        Fraction of the maximum.
    """
    for channel, series in zip(emg.channels, emg.values.T, strict=True):
        above, below = int((series > 1).sum()), int((series < 0).sum())
        if above:
            logger.warning(
                "%s: channel %r is above 1 in %d of %d samples, up to %.3g: is its reference a maximum?",
                emg.source, channel, above, len(series), series.max(),
            )  # fmt: skip
        if below:
            logger.warning(
                "%s: channel %r is below 0 in %d of %d samples, down to %.3g: is it an envelope?",
                emg.source, channel, below, len(series), series.min(),
            )  # fmt: skip


@checked
def resample(emg: Emg, time: FloatArray, *, start_offset: float = 0.0) -> Emg:
    """Bring an envelope to the frames of a motion.

    Where the motion has fewer frames per second than the EMG, a zero-lag Butterworth low-pass at 0.8 of the
    motion's Nyquist frequency comes first, so that what the frames cannot show does not appear as something
    slower; then linear interpolation.

    Parameters
    ----------
    emg : Emg
        Envelope.
    time : ndarray, shape (n_frames,) [s]
        Times of the motion, strictly increasing.
    start_offset : float [s]
        Added to the EMG's time: where the two clocks differ.

    Returns
    -------
    Emg
        At `time`. Small undershoot of the filter is set to zero where the signal itself is never negative.

    Raises
    ------
    DataError
        A frame lies outside the EMG, or a gap in the EMG.
    """
    time = read_only("time", time, (-1,), "n_frames")
    if len(time) == 0 or (np.diff(time) <= 0).any():
        raise DataError("time of the motion must hold at least one frame and increase")
    shifted = replace(emg, time=emg.time + start_offset)
    first, last = shifted.time[0], shifted.time[-1]
    step = float(np.median(np.diff(shifted.time))) if len(shifted.time) > 1 else 0.0
    # a time stamp may be rounded: half a sample outside is not outside
    slack = 0.5 * step
    if time[0] < first - slack or time[-1] > last + slack:
        hint = (
            "; the clocks differ: give start_offset"
            if abs(time[0] - first) > 1e6 or time[0] > last or time[-1] < first
            else "; cut the motion"
        )
        raise DataError(
            f"{emg.source} covers {float(first)} to {float(last)} s, the motion needs {float(time[0])} to "
            f"{float(time[-1])} s{hint}"
        )
    source_time, values = shifted.time, shifted.values
    if len(time) > 1:
        nyquist = 0.5 / float(np.median(np.diff(time)))
        cutoff = ANTI_ALIAS_SHARE * nyquist
        if step and cutoff < 0.5 / step * ANTI_ALIAS_SHARE:
            source_time, values, step = _on_uniform_time(shifted)
            lowest = values.min(axis=0)
            values = _zero_lag(values, step, cutoff, FILTER_ORDER, "lowpass", emg.source)
            values = np.where(lowest >= 0, np.maximum(values, 0.0), values)
    frames = np.column_stack([np.interp(time, source_time, column) for column in values.T])
    return replace(emg, time=time, values=frames.reshape(len(time), len(emg.channels)))


def _read_csv(path: Path) -> Emg:
    text = io.StringIO(read_text(path), newline="")
    try:
        rows = [row for row in csv.reader(text) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise FileFormatError(f"{path} is not a table with commas: {error}") from None
    if len(rows) < 2:
        raise FileFormatError(f"{path} has no rows below its labels")
    labels = [cell.strip() for cell in rows[0]]
    if labels[0].lower() != "time":
        raise FileFormatError(f"{path}: the first column is {shown(labels[0])}, expected 'time'")
    numbers = []
    for position, row in enumerate(rows[1:], start=2):
        if len(row) != len(labels):
            raise FileFormatError(
                f"{path}, row {position}: expected {len(labels)} numbers, found {len(row)} "
                "(columns are separated by commas, decimals by points)"
            )
        try:
            numbers.append([number(cell) for cell in row])
        except ValueError as error:
            raise FileFormatError(f"{path}, row {position}: {error}, expected numbers alone") from None
    table = np.array(numbers)
    return Emg(channels=tuple(labels[1:]), time=table[:, 0], values=table[:, 1:], source=str(path))


def _on_uniform_time(emg: Emg) -> tuple[FloatArray, FloatArray, float]:
    """Return time, values and step on the median step; refuse gaps."""
    if len(emg.time) < 2:
        raise DataError(f"{emg.source} has one sample, expected at least two")
    steps = np.diff(emg.time)
    median = float(np.median(steps))
    gaps = np.flatnonzero(steps > MAX_GAP * median)
    if len(gaps):
        k = int(gaps[0])
        raise DataError(
            f"{emg.source} has a gap of {steps[k]:g} s after t = {float(emg.time[k])} s where its step is "
            f"{median:g} s; cut the recording there"
        )
    n = max(2, round((emg.time[-1] - emg.time[0]) / median) + 1)
    time = np.linspace(emg.time[0], emg.time[-1], n)
    step = float((emg.time[-1] - emg.time[0]) / (n - 1))
    if np.abs(steps - median).max() <= 1e-6 * median:
        return emg.time, emg.values, step
    return time, np.column_stack([np.interp(time, emg.time, column) for column in emg.values.T]), step


def _zero_lag(
    values: FloatArray, step: float, frequency: float, order: int, kind: str, source: str
) -> FloatArray:
    """Filter forwards and backwards, 3 dB down at `frequency` after both runs."""
    # takes as long to import as matplotlib, and figures without EMG come by here
    from scipy import signal

    # |H|^4 = 1/2 at the frequency: the one-way cut-off is moved by (sqrt 2 - 1)^(1 / 2 order), on the
    # frequency axis that the bilinear transform warps
    shift = (math.sqrt(2) - 1) ** (1 / (2 * order))
    warped = math.tan(math.pi * frequency * step)
    one_way = math.atan(warped / shift if kind == "lowpass" else warped * shift) / (math.pi * step)
    sections = signal.butter(order, one_way, kind, fs=1 / step, output="sos")
    # padding of one period of the cut-off, as far as the signal goes
    padding = min(len(values) - 1, max(3 * (2 * len(sections) + 1), round(1 / (one_way * step))))
    if padding < 3 * (2 * len(sections) + 1):
        raise DataError(f"{source} has {len(values)} samples, too few to filter at {frequency:g} Hz")
    return np.asarray(signal.sosfiltfilt(sections, values, axis=0, padlen=padding))
