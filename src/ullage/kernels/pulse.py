"""The loop from delay grids to range bins."""

from __future__ import annotations

from ullage.kernels.loops import loop


@loop(fastmath=True, nogil=True, error_model="numpy")
def convolve(grids, taps, every, shift, out):  # type: ignore[no-untyped-def]
    """Bins from delay grids: out[m] = sum over kinds and places of taps * grid, `every` places per bin.

    Args:
        grids: (3, g) complex.
        taps: (3, h) complex pulse of each kind, centred on index (h - 1) / 2.
        every: grid places per bin.
        shift: grid place of bin 0.
        out: (b) complex, added to.
    """
    half = (taps.shape[1] - 1) // 2
    size = grids.shape[1]
    for kind in range(3):
        low, high = 0, size
        while low < size and grids[kind, low] == 0:
            low += 1
        while high > low and grids[kind, high - 1] == 0:
            high -= 1
        if low == high:
            continue
        for m in range(len(out)):
            first = m * every + shift - half
            real, imag = 0.0, 0.0
            for g in range(max(low, first), min(high, first + 2 * half + 1)):
                value, tap = grids[kind, g], taps[kind, 2 * half - (g - first)]
                real += value.real * tap.real - value.imag * tap.imag
                imag += value.real * tap.imag + value.imag * tap.real
            out[m] += complex(real, imag)
