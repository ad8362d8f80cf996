"""Gust filters as others copy them: alone, in batches, with the bits that fly here."""

import ast
import sys
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from firmware_model.config.waveforms import Dryden
from firmware_model.numerics.elementary import normals
from firmware_model.numerics.random import GUST_STREAM
from firmware_model.physics import gust_filters
from firmware_model.physics.gust_filters import (
    DrydenState,
    dryden_gust,
    dryden_step,
    low_altitude_spectrum,
    make_filters,
    stationary_state,
)
from gustproof.flight.routes.direct import fly_direct
from gustproof.guide.examples import gusts
from gustproof.law.form import load_law

SEEDS = (1, 2, 3)
KINDS = [kind for kind in ("numpy", "torch", "jax") if find_spec(kind)]


def draw(sample: int, block: int) -> np.ndarray:
    each = [
        [*normals(seed, GUST_STREAM, sample, block), *normals(seed, GUST_STREAM, sample, block + 1)] for seed in SEEDS
    ]
    return np.array(each).T


def test_the_file_stands_alone_and_is_short() -> None:
    text = Path(gust_filters.__file__).read_text()
    modules = {node.module for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)}
    modules |= {name.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import) for name in node.names}
    assert {module.split(".")[0] for module in modules} <= sys.stdlib_module_names
    assert text.startswith("# SPDX-License-Identifier: BSD-3-Clause")
    assert len(text.splitlines()) <= 250


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "jax"])
@pytest.mark.parametrize(("altitude", "handbook"), [(10.0, False), (1.0, True)])
def test_a_batch_gives_the_bits_of_flights(kind, altitude, handbook) -> None:
    as_array = import_module(kind).asarray
    air = Dryden(kind="dryden", wind_speed_20ft_mps=9.0, specification="MIL-HDBK-1797" if handbook else "MIL-F-8785C")
    paper, vehicle = load_scenario("paper-turbulence"), load_vehicle("paper")
    scenario = replace(paper, wind=(air,), altitude_m=altitude, duration_s=0.4)
    law = load_law("flagship")
    flown = [fly_direct(scenario, law, vehicle=vehicle, seed=seed) for seed in SEEDS]
    spectrum = low_altitude_spectrum(9.0, altitude, vehicle.span, handbook=handbook)
    filters, factor = make_filters(spectrum, vehicle.span, 0.004)
    state = stationary_state(factor, as_array(draw(0, 2)))
    for sample in range(scenario.samples):
        found = np.array([[np.asarray(each) for each in part] for part in dryden_gust(filters, state)])
        flights = [[flight[name][sample] for name in ("gust_B", "gust_omega_B")] for flight in flown]
        assert np.array_equal(np.moveaxis(found, -1, 0), flights)
        state = dryden_step(filters, state, as_array(draw(sample, 0)))


@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_vehicles_fly_at_once(kind, capsys) -> None:
    assert gusts.main(kind, steps=250) == pytest.approx(2.1, rel=0.05)
    assert "10000 vehicles" in capsys.readouterr().out


def test_each_vehicle_of_a_fleet_is_in_its_own_wind() -> None:
    random, winds = np.random.default_rng(2), [2.0] * 5000 + [12.0] * 5000
    filters, fleet = gusts.start_fleet(winds, random.standard_normal((8, 10_000)), 0.004, np.asarray)
    for _ in range(20):
        fleet = gusts.step_all(filters, fleet, random.standard_normal((8, 10_000)), 0.9, 0.004)
    (_, _, w), _ = dryden_gust(filters, fleet.air)
    calm, windy = w[:5000].std(), w[5000:].std()
    assert (calm, windy) == pytest.approx((0.2, 1.2), rel=4.0 / np.sqrt(2 * 5000))  # .1 of the wind at 20 ft


@pytest.mark.parametrize("wrong", [{"altitude": 305.0}, {"airspeed": 0.0}, {"span": 0.0}, {"altitude": float("nan")}])
def test_air_that_the_model_does_not_have_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match="must be positive, and altitude at most"):
        low_altitude_spectrum(**{"wind_speed_20ft": 5.0, "altitude": 10.0, "span": 0.5, **wrong})
    assert low_altitude_spectrum(5.0, 0.0, 0.5).L_w == pytest.approx(3.048)  # below 10 ft it counts as 10 ft
    assert low_altitude_spectrum(5.0, 1000.0 * gust_filters.FOOT, 0.5).L_w == pytest.approx(304.8)
    assert isinstance(stationary_state(((0.0,) * 8,) * 8, (1.0,) * 8), DrydenState)
