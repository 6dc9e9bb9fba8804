"""Perfusion laws and units."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.refusals import refusals
from validation.heat.checks import reference_model

from pinav.errors import InputError
from pinav.thermal.design import Run, free_scale, log_d90
from pinav.thermal.grids import RadialGrid
from pinav.thermal.learning import learn
from pinav.thermal.optimise import optimise
from pinav.thermal.perfusion import (
    LANG,
    AbstractPerfusion,
    ConstantPerfusion,
    RegionalPerfusion,
    TabulatedPerfusion,
    lang,
    mass_perfusion,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.readings import Readings
from pinav.thermal.sources import eddy_power
from pinav.thermal.steppers import refuse_jumps
from pinav.thermal.tissues import PRESETS, Blood, Tissue, mix, preset

BLOOD, TISSUE = Blood(), Tissue(0.49, 1090.0, 3421.0)
TABLE = {
    "muscle": (0.467139, 0.626744, 0.892026, 1.385770, 2.126901, 2.993686, 3.716158, 4),
    "fat": (0.361738, 0.377923, 0.404825, 0.454895, 0.530052, 0.617951, 0.691216, 0.72),
    "tumour": (0.833, 0.827877, 0.797129, 0.690292, 0.416498, 0.416, 0.416, 0.416),
}


@pytest.mark.parametrize("tissue", TABLE)
def test_the_laws_at_their_printed_values(tissue):
    temperatures = jnp.array([37.0, 39, 40, 41, 42, 43, 44, 45])
    found = lang(tissue)(temperatures)
    assert np.asarray(found) == pytest.approx(TABLE[tissue], abs=1e-6)


@pytest.mark.parametrize("tissue", LANG)
def test_the_laws_have_finite_slopes_everywhere(tissue):
    """Trap: a power of 4.8 of zero or of a negative number is NaN in reverse mode."""
    celsius = jnp.array([20.0, 37.0, 37.5, 42.0, 43.0, 45.0, 60.0])
    slopes = jax.grad(lambda t: lang(tissue)(t).sum())(celsius)
    assert np.isfinite(slopes).all()


@pytest.mark.parametrize(
    ("value", "unit", "mass"),
    [
        (37.0, "ml/min/kg", 1050 * 6.721667e-4),
        (3.7, "ml/min/100g", 1050 * 6.721667e-4),
        (4.761905e-4, "1/s", 0.5),
        (0.5, "kg/m3/s", 0.5),
    ],
)
def test_four_units_of_one_quantity(value, unit, mass):
    found = mass_perfusion(value, unit=unit, blood=BLOOD, tissue=TISSUE)
    assert found == pytest.approx(mass, rel=1e-6)


def test_a_mask_mixes_laws_by_volume():
    share = jnp.array([0.0, 0.25, 1.0])
    law = RegionalPerfusion(
        (share, 1 - share), (ConstantPerfusion(2.0), ConstantPerfusion(1.0))
    )
    assert law(jnp.full(3, 40.0)).tolist() == pytest.approx([1.0, 1.25, 2.0])


@pytest.mark.slow
def test_a_localised_mixture_is_the_mixture():
    """With its derivatives, where the mask is and where it is not."""
    share = jnp.zeros((6, 5)).at[2:4, 1:3].set(0.7).at[3, 2].set(1.0)
    parts = (share, 1 - share), (lang("tumour"), lang("muscle"))
    whole, local = RegionalPerfusion(*parts), RegionalPerfusion.on_masks(*parts)
    assert local.boxes == (((2, 4), (1, 3)), ((0, 6), (0, 5)))
    at = jnp.linspace(36.0, 46.0, 30).reshape(6, 5)
    assert np.asarray(local(at)) == pytest.approx(np.asarray(whole(at)), rel=1e-14)
    slopes = [
        jax.grad(lambda t, law=law: jnp.sum(law(t) * t))(at) for law in (local, whole)
    ]
    assert np.asarray(slopes[0]) == pytest.approx(np.asarray(slopes[1]), rel=1e-12)
    nowhere = RegionalPerfusion.on_masks((0 * share,), (lang("tumour"),))
    assert not nowhere(at).any()
    traced = jax.jit(lambda s: RegionalPerfusion.on_masks((s,), (lang("fat"),))(at))
    assert traced(share).shape == (6, 5)


def test_mixed_tissue_conducts_in_series_and_stores_in_sum():
    first, second = Tissue(0.8, 1000.0, 4000.0, 10.0), Tissue(0.2, 2000.0, 1000.0, 30.0)
    both = mix((jnp.array([0.5]), jnp.array([0.5])), (first, second))
    assert float(both.conductivity[0]) == pytest.approx(0.32)
    assert float(both.capacity[0]) == pytest.approx(3e6)
    assert float(both.density[0]) == pytest.approx(1500.0)
    assert float(both.metabolic[0]) == pytest.approx(20.0)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_names_its_source(name):
    assert len(preset(name).source) > 20
    found = mass_perfusion(
        preset(name).perfusion, unit="1/s", blood=BLOOD, tissue=preset(name).tissue
    )
    assert 0.1 < found < 20


def test_eddy_heat_at_its_printed_values():
    assert float(eddy_power(0.15, 0.4, 4.85e8)) == pytest.approx(1.649740e4, rel=1e-6)
    for radius, product in ((0.15, 4.85e8), (0.15 * 4.85e8 / 5e9, 5e9)):
        found = float(eddy_power(radius, 0.6, product))
        assert found == pytest.approx(2.474610e4, rel=1e-6)


def test_protocols_are_put_together():
    bursts = Piecewise.on_off(1e4, 1e5, on=50.0, off=100.0, duration=260.0)
    assert bursts.edges == (0.0, 50.0, 150.0, 200.0, 260.0)
    assert bursts.starts.tolist() == [1e4, 0.0, 1e4, 0.0]
    starts, ends = jnp.array([0.0, 0.0]), jnp.array([2e4, 0.0])
    ramp = Piecewise((0.0, 100.0, 160.0), starts, ends, 1e5)
    half = ramp.amplitude(jnp.asarray(50.0), jnp.asarray(0))
    assert float(half) == pytest.approx(1e4)
    jump = [float(ramp.amplitude(jnp.asarray(100.0), jnp.asarray(i))) for i in (0, 1)]
    assert jump == pytest.approx([2e4, 0.0])
    assert ramp.largest == 2e4


test_bad_input_is_refused = refusals(
    (
        lambda: mass_perfusion(0.5, unit="1/s", blood=BLOOD, tissue=TISSUE),
        r"perfusion 0.5 1/s: expected within 0.001 and 150 kg/\(m³ s\).*check the",
    ),
    (
        lambda: mass_perfusion(6e-4, unit="kg/m3/s", blood=BLOOD, tissue=TISSUE),
        r"perfusion 0.0006 kg/m3/s: expected within .* check the unit",
    ),
    (
        lambda: mass_perfusion(1.0, unit="ml/s", blood=BLOOD, tissue=TISSUE),
        r"perfusion unit 'ml/s' is unknown; choose one of: 1/s, kg/m3/s",
    ),
    (lambda: ConstantPerfusion(-0.1), r"ConstantPerfusion: expected >= 0"),
    (lambda: lang("bone"), r"no perfusion law for 'bone'; choose one of: muscle"),
    (lambda: preset("bone"), r"tissue preset 'bone' is unknown; choose one of"),
    (
        lambda: Piecewise.constant((0.0, 10.0, 5.0), [1.0, 2.0], 1e5),
        r"expected edges that increase from 0 s, got \[0.0, 10.0, 5.0\]",
    ),
    (
        lambda: Piecewise.constant((0.0, 10.0), [1.0, 2.0], 1e5),
        r"expected 1 amplitudes for 2 edges, got 2",
    ),
    (
        lambda: Piecewise.on_off(1e4, 1e5, on=0.0, off=1.0, duration=5.0),
        r"on_off: expected times > 0 s, got on 0.0",
    ),
)


def test_a_law_of_ones_own_is_linear_between_its_values():
    law = TabulatedPerfusion((37.0, 42.0, 42.1), jnp.array([1.0, 2.0, 4.0]))
    at = jnp.array([30.0, 39.5, 42.05, 50.0])
    assert law(at).tolist() == pytest.approx([1.0, 1.5, 3.0, 4.0])
    with pytest.raises(InputError, match="a law that jumps has no derivative"):
        TabulatedPerfusion((37.0, 42.0, 42.0), jnp.array([1.0, 2.0, 4.0]))


class OwnLaw(AbstractPerfusion):
    """Perfusion of one's own, from 1 to 3 kg/(m³ s) about 42.3 °C."""

    width: float
    """Over which it rises [K]."""

    def __call__(self, temperature):
        above = (temperature - 42.3) / max(self.width, 1e-12)
        return 1.0 + 2.0 * jnp.clip(above, 0.0, 1.0)


def with_law(law):
    return reference_model(RadialGrid.slab(0.02, 4), 1e5, None, law, TISSUE)


@pytest.mark.parametrize("law", [OwnLaw(0.0), OwnLaw(0.005)])
def test_a_law_that_jumps_is_refused_where_it_is_differentiated(law):
    model, field = with_law(law), Piecewise.constant((0.0, 60.0), [1e4], 1e5)
    one, dose = np.ones((1, 1)), log_d90(jnp.ones(4))
    for act in (
        lambda: refuse_jumps(model),
        lambda: learn(model, field, Readings(one[0], one, one)),
        lambda: optimise(
            Run(model, field), [free_scale(1.0, 0.5)], maximise=dose, subject_to=[]
        ),
    ):
        with pytest.raises(InputError, match=r"changes by .* at 42.30 °C; no derivat"):
            act()


@pytest.mark.parametrize(
    "law", [*LANG.values(), OwnLaw(0.1), OwnLaw(1.0), ConstantPerfusion(1.0)]
)
def test_steep_laws_and_kinks_are_no_jumps(law):
    refuse_jumps(with_law(law))
