import re

import numpy as np
import pytest

from firmware_model.errors import ConfigError
from gustproof.flight.recording.bag import write_bag
from gustproof.law.form import load_law
from gustproof.show.report.html.runs import MAX_RUNS, read_runs


def test_a_run_is_what_its_bag_holds(recorded):
    rates = np.random.default_rng(1).standard_normal((500, 3))
    (run,) = read_runs([recorded("run", seed=7, omega_B=rates)])
    assert np.array_equal(run.records["omega_B"], rates)
    assert (run.label, run.seed, run.outcome.name, run.scenario.duration_s) == ("hinf-d1", 7, "DONE", 2.0)
    assert run.law.to_dict() == load_law("hinf-d1").to_dict()
    assert run.metrics.rho_in_bounds == bool(np.all(np.abs(rates) <= 1.5))


def test_a_bag_itself_does_as_well_as_the_folder_around_it(recorded):
    folder = recorded("run", n=2)
    (bag,) = folder.iterdir()
    assert [run.bag for run in read_runs([folder])] == [bag] == [run.bag for run in read_runs([bag])]


def test_labels_say_what_tells_flights_apart_and_no_more(recorded):
    one, other = recorded("a", n=2), recorded("b", law="pid-fair", n=2)
    assert [run.label for run in read_runs([one, other])] == ["hinf-d1", "pid-fair"]
    seeds = [recorded("c", seed=2, n=2), recorded("d", seed=3, scenario="calm", n=2)]
    assert [run.label for run in read_runs(seeds)] == ["hinf-d1, coning, seed 2", "hinf-d1, calm, seed 3"]
    assert [run.label for run in read_runs([one, one])] == ["hinf-d1", "hinf-d1 (2)"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path, _: [path / "nowhere"], "nowhere: no such file or folder"),
        (lambda path, _: [path], "no bag in it"),
        (
            lambda _, recorded: [recorded("many", n=2)] * (MAX_RUNS + 1),
            f"{MAX_RUNS + 1} flights, a report shows at most {MAX_RUNS}",
        ),
    ],
)
def test_what_is_no_flight_is_refused_in_one_line(tmp_path, recorded, make, message):
    with pytest.raises(ConfigError, match=message) as refused:
        read_runs(make(tmp_path, recorded))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("about", [{}, {"law": 1, "scenario": 2, "vehicle": 3, "seed": 4}])
def test_a_bag_that_does_not_say_what_was_flown_is_named(tmp_path, recorded, about):
    (run,) = read_runs([recorded("run", n=2)])
    write_bag(tmp_path / "other", run.records, about)
    with pytest.raises(ConfigError, match=re.escape(f"{tmp_path / 'other'}: does not say what was flown")):
        read_runs([tmp_path / "other"])
