"""The table of materials: documented, sourced, within range, and physically sane."""

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import C0
from ullage.radar.penetration import coherent, fresnel, reflection_tables, slab, stack
from ullage.world.materials import MATERIALS, Material, material


def test_every_material_names_its_source():
    assert [name for name, one in MATERIALS.items() if not one.source] == []


@pytest.mark.parametrize(
    ("name", "ghz", "eps"),
    [
        ("concrete", 1.0, 5.24 - 0.8304j),  # P.2040-3: 0.0462 S/m at 1 GHz
        ("water", 10.0, 61.5 - 31.5j),  # well-known value at 20 C, within a few per cent
        ("skin", 10.0, 31.29 - 14.41j),
        ("muscle", 10.0, 42.8 - 19.1j),
    ],
)
def test_published_permittivities(name, ghz, eps):
    ours = material(name).permittivity(ghz * 1e9)
    assert abs(ours - eps) < 0.05 * abs(eps)


def test_out_of_range_is_refused():
    with pytest.raises(ul.InputError, match=r"floorboard has no data at 7.29 GHz \(allowed: 50 to 100 GHz\)"):
        reflection_tables([material("floorboard")], ul.RadarSpec.preset("x4m05"))
    with pytest.raises(ul.InputError, match="perfect conductor"):
        material("pec").permittivity(7e9)
    with pytest.raises(ul.InputError, match="no material 'unobtainium'"):
        material("unobtainium")


def transfer(eps, thickness, frequency, cosine, tm):
    """R and T of a slab by the transfer matrix of tangential fields, a formula of its own."""
    k = 2 * np.pi * frequency / C0
    kz = k * np.sqrt(eps - (1 - cosine**2) + 0j)
    z0, z1 = (cosine, kz / k / eps) if tm else (1 / cosine, k / kz)
    c, s = np.cos(kz * thickness), 1j * np.sin(kz * thickness)
    a, b, g, d = c, s * z1, s / z1, c
    bottom = a + b / z0 + g * z0 + d
    return (a + b / z0 - g * z0 - d) / bottom, 2 / bottom * np.exp(1j * k * thickness * cosine)


@pytest.mark.parametrize("cosine", [1.0, 0.8, 0.5, 0.2])
@pytest.mark.parametrize(("name", "thickness"), [("wood", 0.02), ("glass", 0.006), ("plasterboard", 0.0125)])
def test_slab_against_transfer_matrix(name, thickness, cosine):
    eps = material(name).permittivity(7.29e9)
    te, tm, through_te, through_tm = slab(eps, thickness, 7.29e9, cosine)
    for ours, want in ((te, transfer(eps, thickness, 7.29e9, cosine, False)[0]),
                       (tm, transfer(eps, thickness, 7.29e9, cosine, True)[0]),
                       (through_te, transfer(eps, thickness, 7.29e9, cosine, False)[1]),
                       (through_tm, transfer(eps, thickness, 7.29e9, cosine, True)[1])):  # fmt: skip
        assert abs(ours - want) < 1e-6


def test_brewster_and_normal_incidence():
    te, tm = fresnel(4.0 + 0j, [1.0, 1 / np.sqrt(5)])
    assert te[0] == pytest.approx(tm[0])
    assert te[0] == pytest.approx(-1 / 3)
    assert abs(tm[1]) < 1e-12


@pytest.mark.filterwarnings("error")
def test_air_reflects_nothing_even_at_grazing():
    cosine = np.linspace(0, 1, 5)
    assert not np.any(fresnel(1.0, cosine))
    te, tm, through_te, through_tm = slab(1.0, 0.1, 7.29e9, cosine)
    assert not np.any([te, tm])
    np.testing.assert_allclose([through_te, through_tm], 1)


def test_lossless_slab_keeps_energy():
    te, tm, through_te, through_tm = slab(3.0 + 0j, 0.013, 7.29e9, np.linspace(0.05, 1, 40))
    assert abs(te) ** 2 + abs(through_te) ** 2 == pytest.approx(np.ones(40))
    assert abs(tm) ** 2 + abs(through_tm) ** 2 == pytest.approx(np.ones(40))


def test_coherent_loss_is_the_mean_phase():
    heights = np.random.default_rng(1).standard_normal(200_000) * 0.004
    k = 2 * np.pi / 0.0411
    for cosine in (1.0, 0.6):
        mean = abs(np.mean(np.exp(2j * k * heights * cosine)))
        assert coherent(k * 0.004, cosine) == pytest.approx(mean, abs=5e-3)


def test_thick_slab_echoes_apart():
    thick = Material(name="x", a=4.0, thickness_m=0.3, valid_ghz=(1, 20))
    gamma, lag, _ = reflection_tables([thick], ul.RadarSpec.preset("x4m05"))
    assert lag[0, 1, -1] == pytest.approx(2 * 0.3 * 2 / C0)
    assert abs(gamma[0, 1, 0, -1]) == pytest.approx((1 - 1 / 9) / 3)


def matrices(layers, load, frequency, cosine, tm):
    """R and T of layers before a load by the product of their transfer matrices; None: a perfect conductor."""
    k, whole = 2 * np.pi * frequency / C0, np.eye(2, dtype=complex)
    for eps, thickness in layers:
        q = np.sqrt(eps - (1 - cosine**2) + 0j)
        z, turn = (q / eps if tm else 1 / q), k * q * thickness
        whole = whole @ [[np.cos(turn), 1j * z * np.sin(turn)], [1j * np.sin(turn) / z, np.cos(turn)]]
    z0 = cosine if tm else 1 / cosine
    if load is None:
        impedance = whole[0, 1] / whole[1, 1]
        return (impedance - z0) / (impedance + z0), 0.0
    q = np.sqrt(load - (1 - cosine**2) + 0j)
    field, current = whole @ [1.0, load / q if tm else q]
    free = np.exp(1j * k * cosine * sum(thickness for _, thickness in layers))
    return (field - z0 * current) / (field + z0 * current), 2 * free / (field + z0 * current)


@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.3])
@pytest.mark.parametrize("behind", [None, 1.0, 5.3 - 0.4j])
def test_layers_against_the_product_of_their_transfer_matrices(behind, cosine):
    layers = [(2.9 - 0.02j, 0.0011), (1.3 - 0.001j, 0.047), (6.2 - 0.3j, 0.004)]
    reflected, through = stack(layers, behind, 7.29e9, cosine)
    for ours, beyond, tm in zip(reflected, through, (False, True), strict=True):
        assert abs(ours - matrices(layers, behind, 7.29e9, cosine, tm)[0]) < 1e-9
        assert abs(beyond - matrices(layers, behind, 7.29e9, cosine, tm)[1]) < 1e-9


@pytest.mark.parametrize(
    ("base", "layers"),
    [
        ("steel", [("oil", 0.004)]),
        ("steel", [("plastic", 0.001), ("ceiling-board", 0.06)]),
        ("concrete", [("plastic", 0.002), ("plasterboard", 0.0125)]),
    ],
)
def test_a_coated_surface_reflects_each_frequency_of_the_pulse_as_its_layers_do(base, layers):
    spec = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)

    def received(one):
        wall = ul.scenes.plate(width_m=12, height_m=12, distance_m=2.0, material=one)
        return np.asarray(ul.simulate(wall, ul.Trajectory.stationary(n=1), spec).samples[0])

    mirror, echo = received("pec"), received(material(base).but(layers=layers, thickness_m=None))
    offset_hz = np.fft.fftfreq(4096, 2 * spec.bin_m / C0)
    media = [(material(name).permittivity(spec.center_hz), thick) for name, thick in layers]
    behind = None if base == "steel" else material(base).permittivity(spec.center_hz)
    reflection = np.array([stack(media, behind, spec.center_hz + f, 1.0)[0][0] for f in offset_hz])
    expected = np.fft.ifft(np.fft.fft(mirror, 4096) * -reflection)[: len(mirror)]
    assert abs(echo - expected).max() < 10 ** (-26 / 20) * abs(expected).max()


def klein_swift(ghz, t, s):
    """Permittivity of sea water by a single Debye term, a fit of its own to other measurements (Klein, Swift 1977)."""
    static = 87.134 - 1.949e-1 * t - 1.276e-2 * t**2 + 2.491e-4 * t**3
    static *= 1 + 1.613e-5 * s * t - 3.656e-3 * s + 3.21e-5 * s**2 - 4.232e-7 * s**3
    tau = 1.768e-11 - 6.086e-13 * t + 1.104e-14 * t**2 - 8.111e-17 * t**3
    tau *= 1 + 2.282e-5 * s * t - 7.638e-4 * s - 7.760e-6 * s**2 + 1.105e-8 * s**3
    less = 25 - t
    sigma = s * (0.182521 - 1.46192e-3 * s + 2.09324e-5 * s**2 - 1.28205e-7 * s**3)
    beta = 2.033e-2 + 1.266e-4 * less + 2.464e-6 * less**2 - s * (1.849e-5 - 2.551e-7 * less + 2.551e-8 * less**2)
    omega = 2e9 * np.pi * ghz
    return 4.9 + (static - 4.9) / (1 + 1j * omega * tau) - 1j * sigma * np.exp(-beta * less) / (omega * 8.854e-12)


@pytest.mark.parametrize(("celsius", "salinity"), [(2.0, 35.0), (20.0, 35.0), (20.0, 12.0), (30.0, 0.0)])
def test_sea_water_is_that_of_another_fit(celsius, salinity):
    water = material("sea-water").but(celsius=celsius, salinity=salinity)
    for ghz in (1.4, 4.3, 7.3):
        assert water.permittivity(ghz * 1e9) == pytest.approx(klein_swift(ghz, celsius, salinity), rel=0.03)


def test_layers_that_cannot_be_are_refused():
    for layers in ([("steel", 0.01)], [("oil", 0.0)], [("gold", 0.01)]):
        with pytest.raises(ul.InputError):
            material("steel").but(layers=layers)


@pytest.mark.parametrize("thickness_m", [0.0115, 0.0125, 0.0135, 0.04])
def test_a_board_reflects_each_frequency_of_the_pulse_as_the_slab_does(thickness_m: float) -> None:
    """Plasterboard of 12.5 mm has a null within the band; at the carrier alone its echo was wrong by its own size."""
    spec = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
    board = material("plasterboard").but(thickness_m=thickness_m)

    def received(one: Material | str) -> np.ndarray:
        wall = ul.scenes.plate(width_m=12, height_m=12, distance_m=2.0, material=one)
        return np.asarray(ul.simulate(wall, ul.Trajectory.stationary(n=1), spec).samples[0])

    mirror, echo = received("pec"), received(board)
    offset_hz = np.fft.fftfreq(4096, 2 * spec.bin_m / C0)
    eps = board.permittivity(spec.center_hz)
    reflection = np.array([slab(eps, thickness_m, spec.center_hz + f, 1.0)[0] for f in offset_hz])
    expected = np.fft.ifft(np.fft.fft(mirror, 4096) * -reflection)[: len(mirror)]
    assert abs(echo - expected).max() < 10 ** (-35 / 20) * abs(expected).max()


def test_echoes_of_a_slab_add_up_to_its_reflection_at_the_carrier() -> None:
    spec = ul.RadarSpec.preset("x4m05")
    board = material("plasterboard")
    gamma, lag, bounce = reflection_tables([board], spec)
    turned = gamma[0] * np.exp(-2j * np.pi * spec.center_hz * np.maximum(lag[0], 0))[:, None]
    te, tm, *_ = slab(board.permittivity(spec.center_hz), 0.0125, spec.center_hz, np.linspace(0, 1, gamma.shape[3]))
    assert abs(turned.sum(0) - [te, tm]).max() < 1e-12
    assert abs(bounce[0, 0] - [te, tm]).max() < 1e-12


def test_sludge_is_oil_that_takes_up_water():
    """Small steps by the law of few drops lead to the mixing law that was solved at once [Bruggeman1935]."""
    oil, water, eps = (material(name).permittivity(7.29e9) for name in ("oil", "water", "oil"))
    steps, share = 20_000, 0.4
    for i in range(steps):
        eps += share / steps / (1 - share * (i + 0.5) / steps) * 3 * eps * (water - eps) / (water + 2 * eps)
    assert material("sludge").permittivity(7.29e9) == pytest.approx(eps, rel=1e-3)
    few = material("oil").but(water_share=1e-4).permittivity(7.29e9)
    assert few - oil == pytest.approx(1e-4 * 3 * oil * (water - oil) / (water + 2 * oil), rel=1e-3)


def test_wetter_sludge_reflects_more_and_loses_more():
    eps = [material("sludge").but(water_share=share).permittivity(7.29e9) for share in np.linspace(0, 0.7, 8)]
    assert (np.diff(np.real(eps)) > 0).all()
    assert (np.diff(np.imag(eps)) < 0).all()
    salty = material("sludge").but(salinity=35.0).permittivity(7.29e9)
    assert salty.imag < material("sludge").permittivity(7.29e9).imag
