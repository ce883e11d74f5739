"""Elfes' cell update for one range reading, over plain arrays."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import inner, loop


@loop(fastmath=True)
def insert_reading(
    empty: np.ndarray,
    occupied: np.ndarray,
    column0: float,
    row0: float,
    step: float,
    x: float,
    y: float,
    yaw: float,
    near: float,
    reach: float,
    spread: float,
    echo: bool,
    half: float,
    box: np.ndarray,
) -> None:
    """Blend one reading into both layers; `box` takes the rows and columns looked at.

    Without an echo only emptiness up to `reach` is added. `column0`, `row0` are the lower corner of cell (0, 0).
    """
    far = reach + spread if echo else reach
    low_x, high_x, low_y, high_y = _lobe_square(x, y, yaw, half, far)
    rows, columns = empty.shape
    first_row = max(0, math.floor((low_y - row0) / step))
    last_row = min(rows - 1, math.floor((high_y - row0) / step))
    first_column = max(0, math.floor((low_x - column0) / step))
    last_column = min(columns - 1, math.floor((high_x - column0) / step))
    box[0], box[1], box[2], box[3] = first_row, last_row + 1, first_column, last_column + 1
    cos_yaw, sin_yaw, cos_half = math.cos(yaw), math.sin(yaw), math.cos(half)
    clear = max(reach - spread, near) if echo else reach
    total = 0.0
    for row in range(first_row, last_row + 1):
        dy = row0 + (row + 0.5) * step - y
        for column in range(first_column, last_column + 1):
            dx = column0 + (column + 0.5) * step - x
            distance = math.sqrt(dx * dx + dy * dy)
            along = dx * cos_yaw + dy * sin_yaw
            if distance > far or along < cos_half * distance:
                continue
            angle = math.atan2(dy * cos_yaw - dx * sin_yaw, along) / half
            across = 1.0 - angle * angle
            if near <= distance < clear:
                part = (distance - near) / (clear - near)
                weight = (1.0 - part * part) * across
                empty[row, column] += weight - empty[row, column] * weight
            elif echo and distance >= clear:
                part = (distance - reach) / spread
                if abs(part) < 1.0:
                    total += (1.0 - part * part) * across * (1.0 - empty[row, column])
    if not echo or total <= 0.0:
        return
    for row in range(first_row, last_row + 1):
        dy = row0 + (row + 0.5) * step - y
        for column in range(first_column, last_column + 1):
            dx = column0 + (column + 0.5) * step - x
            distance = math.sqrt(dx * dx + dy * dy)
            part = (distance - reach) / spread
            along = dx * cos_yaw + dy * sin_yaw
            if abs(part) >= 1.0 or distance < clear or along < cos_half * distance:
                continue
            angle = math.atan2(dy * cos_yaw - dx * sin_yaw, along) / half
            weight = (1.0 - part * part) * (1.0 - angle * angle) * (1.0 - empty[row, column]) / total
            occupied[row, column] += weight - occupied[row, column] * weight


@inner()
def _lobe_square(x: float, y: float, yaw: float, half: float, far: float) -> tuple[float, float, float, float]:
    low_x, high_x, low_y, high_y = x, x, y, y
    for k in range(6):
        angle = yaw - half if k == 4 else yaw + half if k == 5 else k * math.pi / 2
        if k < 4 and math.cos(angle - yaw) < math.cos(half):
            continue
        px, py = x + far * math.cos(angle), y + far * math.sin(angle)
        low_x, high_x = min(low_x, px), max(high_x, px)
        low_y, high_y = min(low_y, py), max(high_y, py)
    return low_x, high_x, low_y, high_y
