"""The engine beside other people's code and theory: image sources of a room, and the point response of an aperture."""

import numpy as np
import pytest

import ullage as ul
from studies.validation.rows import radar
from studies.validation.validate import image_lengths
from ullage.geometry import C0
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.planar import accumulate_planar
from ullage.radar.pulse import envelope

SIZE, AT = np.array([6.0, 4.0, 3.0]), np.array([0.31, -0.42, 0.17])


@pytest.fixture(scope="module")
def images():
    """Distances and orders of the image sources of pyroomacoustics, source and receiver at one place."""
    pra = pytest.importorskip("pyroomacoustics")
    room = pra.ShoeBox(SIZE, materials=pra.Material(0.0), max_order=5)
    room.add_source(AT + SIZE / 2)
    room.add_microphone(AT + SIZE / 2 + [1e-7, 0, 0])
    room.image_source_model()
    source = room.sources[0]
    far = np.linalg.norm(source.images - (AT + SIZE / 2)[:, None], axis=0)
    return far, source.orders, source.damping[0]


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_rooms_delays_are_those_of_its_image_sources(images, order):
    far, orders, _ = images
    ready = radar_context(ul.scenes.room(tuple(SIZE), material="pec"), radar())
    ours = np.unique(np.round(image_lengths(ready, antenna_pair(radar(), AT, np.eye(3)), order), 4))
    want = np.unique(np.round(far[orders == order], 4))
    ours, want = ours[ours <= 18.0], want[(want <= 18.0) & (want > 1e-3)]
    assert len(ours) == len(want)
    assert abs(ours - want).max() <= 1.1e-4


def test_a_rooms_walls_weigh_as_their_image_sources(images):
    """Mirror echoes fall as the distance of the image, as pressure does."""
    far, orders, damping = images
    ready = radar_context(ul.scenes.room(tuple(SIZE), material="pec"), radar())
    frame = radar_frame(ready, antenna_pair(radar(), AT, np.eye(3)))
    (laid,) = accumulate_planar(frame, frame.parts[0])
    first = np.flatnonzero(orders == 1)
    first = first[np.argsort(far[first])]
    delays, echoes = laid.delay_s[-len(first) :], laid.echo[-len(first) :]  # mirror points come last
    rank = np.argsort(delays)
    assert delays[rank] * C0 == pytest.approx(far[first], abs=1e-4)
    gain = abs(echoes[rank])
    assert gain / gain[0] == pytest.approx(damping[first] / far[first] * far[first[0]] / damping[first[0]], rel=1e-3)


def width(values, step):
    """Width of a peak at half its power."""
    power = abs(values) ** 2 / abs(values).max() ** 2
    above = np.flatnonzero(power >= 0.5)
    a, b = above[0], above[-1]
    low = a - (power[a] - 0.5) / (power[a] - power[a - 1])
    high = b + (power[b] - 0.5) / (power[b] - power[b + 1])
    return (high - low) * step


def test_point_response_of_an_aperture_has_the_widths_of_theory():
    spec, length, distance = radar(), 1.0, 3.0
    track = ul.Trajectory.line((0, -length / 2, 0), (0, length / 2, 0), 0.25, 40)
    frames = ul.simulate(ul.scenes.plate(0.004, 0.004, distance), track, spec)
    step = 0.004
    grid = ul.Grid.covering(np.array([[2.8, -0.2, 0], [3.2, 0.2, 0]]), step_m=step)
    values = np.asarray(ul.focus(frames, grid).values)
    i, j = np.unravel_index(abs(values).argmax(), values.shape)
    along_x, along_y = values[i], values[:, j]
    across = 0.886 * spec.wavelength_m / (4 * np.sin(np.arctan(length / 2 / distance)))
    t = np.linspace(-2e-9, 2e-9, 4001)
    deep = width(envelope(spec, t), (t[1] - t[0]) * C0 / 2)
    assert width(along_y, step) == pytest.approx(across, rel=0.05)
    assert width(along_x, step) == pytest.approx(deep, rel=0.05)
