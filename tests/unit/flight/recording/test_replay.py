import pytest
from typer.testing import CliRunner

from firmware_model.config.scenario import load_scenario
from firmware_model.config.vehicle import load_vehicle
from gustproof.cli.app import app
from gustproof.flight.recording.bag import write_bag
from gustproof.flight.routes.direct import fly_direct
from gustproof.law.form import load_law

HEAD = 'description = "a gust"\nduration_s = 4.0\n[gyro]\nnoise = false\n'
GUST = '[[wind]]\nkind = "one_minus_cosine"\namplitude_mps = [1.0, 6.0, 2.0]\nstart_s = 0.5\nlength_s = 2.0\n'


def fly(path, text):
    path.write_text(HEAD + text)
    return fly_direct(load_scenario(path), load_law("pid-fair"), vehicle=load_vehicle("paper"))


@pytest.mark.parametrize(("kind", "options"), [("wind", ()), ("moment", ("--moment",))])
def test_a_recorded_gust_replayed_turns_the_vehicle_the_same_way_to_the_bit(kind, options, tmp_path):
    first = fly(tmp_path / "gust.toml", GUST)
    write_bag(tmp_path / "run" / "bag", first, {})
    arguments = ["scenario", "extract", str(tmp_path / "run"), "-o", str(tmp_path / "air.csv"), *options]
    done = CliRunner().invoke(app, arguments)
    assert (done.exit_code, done.stdout) == (0, f"1000 samples in {tmp_path / 'air.csv'}\n")
    again = fly(tmp_path / "again.toml", f'[[{kind}]]\nkind = "replay"\nfile = "air.csv"\n')
    assert again["q_NB"].tobytes() == first["q_NB"].tobytes()
    assert abs(first["q_NB"][:, 1]).max() > 1e-3


def test_a_file_that_is_there_is_not_overwritten(tmp_path):
    write_bag(tmp_path / "run" / "bag", fly(tmp_path / "gust.toml", GUST), {})
    (tmp_path / "air.csv").write_text("mine")
    done = CliRunner().invoke(app, ["scenario", "extract", str(tmp_path / "run"), "-o", str(tmp_path / "air.csv")])
    assert done.exit_code == 2
    assert (tmp_path / "air.csv").read_text() == "mine"
