"""EMG processing against signals whose envelope is known."""

import logging
import math

import numpy as np
import pytest

from scso_nlp.emg import (
    Emg,
    EnvelopeFilter,
    envelope,
    normalize_to_mvc,
    normalize_to_peak,
    read_emg,
    resample,
)
from scso_nlp.exceptions import DataError, FileFormatError, NameMismatchError

RATE = 2000.0


def make_emg(values, rate=RATE, start=0.0, channels=None):
    values = np.asarray(values, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    names = channels or tuple(f"channel_{c}" for c in range(values.shape[1]))
    return Emg(channels=names, time=start + np.arange(len(values)) / rate, values=values)


def amplitude(series):
    """Half of the range in the middle third, away from the ends."""
    middle = series[len(series) // 3 : 2 * len(series) // 3]
    return np.ptp(middle) / 2


def test_envelope_of_a_steady_carrier_is_its_mean_rectified_value():
    time = np.arange(8000) / RATE
    found = envelope(make_emg(0.7 * np.sin(2 * np.pi * 97 * time)))
    # the mean of |sin| is 2 / pi; the band passes 97 Hz within 0.3 %
    assert found.values[3000:5000, 0] == pytest.approx(0.7 * 2 / math.pi, rel=5e-3)


def test_envelope_is_three_decibels_down_at_its_cutoff_and_has_no_lag():
    time = np.arange(16000) / RATE
    modulation = 1 + 0.5 * np.sin(2 * np.pi * 6 * time)
    found = envelope(make_emg(modulation * np.sin(2 * np.pi * 150 * time))).values[:, 0]
    # modulation of a rectified carrier: (2 / pi) 0.5 sin, times the filter's 1 / sqrt 2 at 6 Hz
    assert amplitude(found) == pytest.approx(0.5 * 2 / math.pi / math.sqrt(2), rel=0.01)
    middle = slice(5000, 11000)
    assert np.corrcoef(found[middle], modulation[middle])[0, 1] > 0.9999


def test_band_takes_out_offset_and_slow_movement_artifact():
    time = np.arange(8000) / RATE
    found = envelope(make_emg(5.0 + np.sin(2 * np.pi * 1.0 * time)))
    assert found.values[2000:6000].max() < 0.01  # 1 Hz is 26 dB per octave-pair below 20 Hz


def test_envelope_does_not_depend_on_the_offset_and_follows_the_gain(rng):
    raw = rng.standard_normal(6000)
    base = envelope(make_emg(raw)).values
    assert envelope(make_emg(raw + 3)).values == pytest.approx(base, abs=1e-9)
    assert envelope(make_emg(raw * 2)).values == pytest.approx(2 * base, abs=1e-9)
    assert (base >= 0).all()


def test_time_reversal_gives_the_reversed_envelope(rng):
    raw = rng.standard_normal(6000)
    forward, backward = envelope(make_emg(raw)).values, envelope(make_emg(raw[::-1])).values
    # the two directions differ only in how the ends are padded
    assert backward[::-1][1000:-1000] == pytest.approx(forward[1000:-1000], abs=1e-3)


def test_an_envelope_is_not_taken_for_raw_emg():
    with pytest.raises(
        DataError, match="sampled at 30 Hz, too slowly for a band from 20 Hz; if it already is"
    ):
        envelope(make_emg(np.ones(100), rate=30.0))


def test_a_gap_and_a_recording_too_short_are_refused():
    time = np.arange(200) / RATE
    time[100:] += 0.5
    with pytest.raises(DataError, match=r"gap of 0.5005 s after t = .*0.0495"):
        envelope(Emg(channels=("a",), time=time, values=np.ones((200, 1))))
    with pytest.raises(DataError, match="4 samples, too few"):
        envelope(make_emg(np.ones(4)))


@pytest.mark.parametrize(
    "options", [{"cutoff": 0.0}, {"cutoff": 30.0}, {"band_high": 10.0}, {"band_low": math.nan}, {"order": 0}]
)
def test_filter_options_out_of_order_are_refused(options):
    with pytest.raises(DataError, match="of the EMG filter"):
        EnvelopeFilter(**options)


def test_normalizing_to_the_peak_makes_the_peak_one():
    found = normalize_to_peak(make_emg(np.array([[0.2, 3.0], [0.4, 1.0]])))
    assert found.values == pytest.approx(np.array([[0.5, 1.0], [1.0, 1 / 3]]))


def test_values_above_one_and_below_zero_are_kept_with_a_warning(caplog):
    emg = make_emg(np.array([0.5, -0.1, 1.0]), channels=("soleus",))
    with caplog.at_level(logging.WARNING, "scso_nlp"):
        found = normalize_to_mvc(emg, {"soleus": 0.5})
    assert found.values[:, 0] == pytest.approx([1.0, -0.2, 2.0])
    assert "channel 'soleus' is above 1 in 1 of 3 samples, up to 2" in caplog.text
    assert "channel 'soleus' is below 0 in 1 of 3 samples" in caplog.text


def test_a_silent_channel_cannot_be_normalized_and_an_unknown_one_is_named():
    with pytest.raises(DataError, match="reference of channel 'channel_0' is 0"):
        normalize_to_peak(make_emg(np.zeros(3)))
    with pytest.raises(NameMismatchError, match=r"'solius' \(closest: soleus\)"):
        normalize_to_mvc(make_emg(np.ones(3), channels=("soleus",)), {"solius": 1.0})


def test_resampling_keeps_slow_content_exactly_and_takes_out_what_would_alias():
    time = np.arange(4000) / 1000.0
    frames = np.arange(0.5, 3.5, 1 / 15)  # Nyquist 7.5 Hz
    slow, fast = 0.5 + 0.3 * np.sin(2 * np.pi * 1.0 * time), np.sin(2 * np.pi * 14 * time)
    # 14 Hz at 15 frames per second would look like 1 Hz
    aliased = np.interp(frames, time, fast)
    assert amplitude(aliased) > 0.9
    found = resample(make_emg(slow + 0.2 * fast, rate=1000.0), frames)
    expected = 0.5 + 0.3 * np.sin(2 * np.pi * frames)
    # both runs of the second-order filter at 6 Hz leave 7.5 % of 14 Hz: 0.015 of 0.2; 1 Hz loses 0.03 %
    assert found.values[:, 0] == pytest.approx(expected, abs=0.016)


def test_resampling_to_more_frames_only_interpolates():
    found = resample(make_emg([0.0, 1.0, 0.0], rate=10.0), np.array([0.05, 0.1, 0.125]))
    assert found.values[:, 0] == pytest.approx([0.5, 1.0, 0.75])


def test_frames_outside_the_emg_are_refused_and_other_clocks_are_explained():
    emg = make_emg(np.ones(100), rate=100.0, start=1.0)
    with pytest.raises(
        DataError, match=r"covers .*1\.0.* to .*1\.99.* the motion needs .*0\.5.*; cut the motion"
    ):
        resample(emg, np.array([0.5, 1.5]))
    with pytest.raises(DataError, match="clocks differ: give start_offset"):
        resample(emg, np.array([1.6e9, 1.6e9 + 0.5]))
    moved = resample(emg, np.array([11.0, 11.5]), start_offset=10.0)
    assert moved.values == pytest.approx(1.0)


def test_epoch_time_stamps_with_jitter_lose_nothing(rng):
    start = 1667315995.5
    time = start + np.arange(3000) / 1000 + rng.uniform(-2e-4, 2e-4, 3000)
    slow = 0.4 + 0.2 * np.sin(2 * np.pi * (time - start))
    frames = start + np.arange(0.3, 2.7, 0.067)
    found = resample(Emg(channels=("a",), time=time, values=slow[:, None]), frames)
    assert found.values[:, 0] == pytest.approx(0.4 + 0.2 * np.sin(2 * np.pi * (frames - start)), abs=2e-3)


def test_a_nan_in_a_channel_is_named_with_its_time():
    values = np.ones((5, 2))
    values[3, 1] = np.nan
    with pytest.raises(
        DataError,
        match=r"channel 'channel_1' is nan at t = 0.0015 s, expected a finite number; cut that part off",
    ):
        make_emg(values)


def test_tables_with_commas_are_read_and_their_faults_named(tmp_path):
    path = tmp_path / "emg.csv"
    path.write_text("time,soleus,tibialis anterior\n0,0.1,0.2\n\n0.5,0.3,0.4\n", encoding="utf-8-sig")
    found = read_emg(path)
    assert found.channels == ("soleus", "tibialis anterior")
    assert found.values.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    for text, message in (
        ("soleus,time\n0,1\n", "first column is 'soleus', expected 'time'"),
        ("time,soleus\n", "no rows"),
        ("time,soleus\n0,0.1,0.2\n", "row 2: expected 2 numbers, found 3"),
        ("time,soleus\n0,much\n", "row 2: 'much' is not a number"),
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=message):
            read_emg(path)
    with pytest.raises(DataError, match="does not exist"):
        read_emg(tmp_path / "nothing.csv")


def test_storage_files_are_read(tmp_path):
    path = tmp_path / "emg.sto"
    path.write_text("emg\nversion=1\nendheader\ntime\tsoleus\n0\t0.1\n1\t0.2\n")
    assert read_emg(path).values.tolist() == [[0.1], [0.2]]


def test_back_lifting_emg_reaches_the_frames_of_its_motion(shared_data):
    from scso_nlp.io.storage import read_storage

    folder = shared_data / "back_lifting" / "stoop15kg"
    emg = read_emg(folder / "emgFilt.sto")
    time = read_storage(folder / "id.sto").time
    found = resample(emg, time)
    assert found.values.shape == (405, 9)
    # stated with the data: rectus abdominis 0.04 on average and 0.17 at its peak
    rectus = found.values[:, found.channels.index("rectabd_r")]
    assert rectus.mean() == pytest.approx(0.04, abs=0.005)
    assert rectus.max() == pytest.approx(0.17, abs=0.01)
