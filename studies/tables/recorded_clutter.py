"""Where the clutter of recordings comes from: what stays with the radar when it moves, and what breathes.

    python -m studies.tables.recorded_clutter FOLDER

FOLDER holds `x4/` with the two recordings of [X4Recordings] and `pulson440/rail_a`.
In the long one the radar is carried from frame 5000 to 7500: what belongs to the receiver (its direct path, a tail of
its antennas) stays as it is then, and what belongs to the room turns. In the other one the radar stands, somebody sits
before it and later moves.
"""

import sys
from pathlib import Path

import numpy as np

import ullage as ul

LONG, SHORT = "xethru_datafloat_20190614_141837.dat", "xethru_baseband_iq_20170913_150437.dat"
NOISE = 0.3455 * 1.16e-3 / 64
"""Of one bin at N = 4096, in normalised units."""
BIN_M = 0.05144


def db(level):
    return 20 * np.log10(np.maximum(np.abs(level), 1e-12))


def rms(values):
    return np.sqrt((np.abs(values) ** 2).mean())


def carried(frames):
    """Per piece of the range axis: level before, what of it stays while the radar is carried, what moves, and after."""
    before, during, after = frames[200:4900].mean(0), frames[5200:7300], frames[7600:9100].mean(0)
    print("long recording, dB over the noise of N = 4096: rms of bins, and coherence of before with after")
    for first, last in ((0, 5), (5, 9), (9, 12), (12, 17), (17, 29), (29, 60), (60, 100), (100, 180)):
        part = slice(first, last)
        alike = abs(np.vdot(before[part], after[part])) / np.linalg.norm(before[part]) / np.linalg.norm(after[part])
        levels = rms(before[part]), rms(during[:, part].mean(0)), rms(during[:, part].std(0)), rms(after[part])
        told = "  ".join(f"{db(x / NOISE):5.1f}" for x in levels)
        print(f"  bins {first:3d}-{last - 1:3d}, {first * BIN_M:4.2f} m on: before, stays, moves, after {told};"
              f" {alike:.2f}")  # fmt: skip


BANDS = ((0.5, 1), (1, 1.5), (1.5, 2), (2, 3), (3, 4.5), (4.5, 6), (6, 8))


def parted(name, frames, zero_m=0.0):
    """Rms over the noise of one frame, by range: all at rest, the instrument's own response, and what moves."""
    found = ul.Receiver.fit(frames)
    samples = np.asarray(frames.samples, np.float64 if np.isrealobj(frames.samples) else complex)
    noise = np.diff(samples[found.still], axis=0)[:, -samples.shape[1] // 4 :].std() / np.sqrt(2)
    moving = samples[found.moving]
    pieces = np.array([piece.mean(0) for piece in np.array_split(moving, max(2, len(moving) // 16))])
    chance = pieces.var(0) / len(pieces)  # of the mean over the moving part
    print(f"{name}: dB over the noise of one frame: at rest, own response, chance of that, what moves")
    for low, high in BANDS:
        part = (frames.range_m - zero_m >= low) & (frames.range_m - zero_m < high)
        own = np.maximum((np.abs(moving.mean(0)) ** 2 - chance)[part].mean(), 0) ** 0.5
        levels = rms(samples[found.still].mean(0)[part]), own, chance[part].mean() ** 0.5, moving[:, part].std(0).mean()
        print(f"  {low:3.1f} to {high:3.1f} m: " + " ".join(f"{db(level / noise):6.1f}" for level in levels))


def breathing(frames, range_m, rate_hz=17.0):
    """Per bin of the still second recording: how much of its change is slower than 0.6 Hz, and its rhythm."""
    still = frames[:150]
    print("second recording, still: static level, change [dB over the noise of N = 4096], share below 0.6 Hz, rhythm")
    for k in (0, 2, 4, 6, 8, 12, 20, 30, 40, 50):
        change = still[:, k] - still[:, k].mean()
        power = abs(np.fft.fft(change * np.hanning(len(change)), 2048)) ** 2
        rate = np.fft.fftfreq(2048, 1 / rate_hz)
        slow = power[abs(rate) < 0.6].sum() / power.sum()
        top = abs(rate[power.argmax()])
        print(f"  {range_m[k]:4.2f} m: {db(still[:, k].mean() / NOISE):5.1f} {db(change.std() / NOISE):5.1f}"
              f"  {slow:4.2f}  {top:4.2f} Hz")  # fmt: skip


def main(folder):
    long, short = (ul.open(str(Path(folder) / "x4" / name)).frames() for name in (LONG, SHORT))
    rail = ul.open(str(Path(folder) / "pulson440" / "rail_a")).frames()
    carried(np.asarray(long.samples, complex))
    breathing(np.asarray(short.samples, complex), short.range_m)
    parted("X4 of 2019", long)
    parted("PulsON 440 on a rail", rail, zero_m=0.45)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[3] / "shared" / "data")
