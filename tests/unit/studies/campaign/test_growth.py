"""A table that grows is the one flown at once, and flies nothing twice."""

import json
import shutil

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from firmware_model.errors import ConfigError
from gustproof.studies.campaign.growth import grow_campaign
from gustproof.studies.campaign.plan import parse_campaign
from gustproof.studies.campaign.reader import read_campaign
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.sampling import Sampling
from gustproof.studies.campaign.store import METADATA_KEY
from gustproof.studies.campaign.worker import ChunkResult, failed_rows


@pytest.fixture
def fly(here, tmp_path):
    """Return a function that flies a campaign without flights into a file, and returns the chunks flown."""

    def run(plan, name, known=None):
        chunks = []

        def task(metadata, chunk):
            chunks.append(chunk)
            rows = failed_rows(parse_campaign(json.loads(metadata), "test"), chunk, "not flown")
            return ChunkResult(rows, 1.0)

        fly_campaign(plan, tmp_path / name, here, chunk_runs=16, task=task, known=known)
        return chunks

    return run


def test_more_cases_and_laws_give_the_table_flown_at_once(planned, fly, tmp_path):
    grown, whole = tmp_path / "grown.parquet", tmp_path / "whole.parquet"
    fly(planned(laws=("hinf-d1",), cases=20), grown.name)
    larger = grow_campaign(grown, planned(laws=("pid-fair",), cases=50))
    assert [law.name for law in larger.laws] == ["hinf-d1", "pid-fair"]
    flown = fly(larger, grown.name, known=grown)
    assert sum(chunk.runs for chunk in flown) == 80
    assert min(chunk.first for chunk in flown) == 20
    fly(planned(laws=("hinf-d1", "pid-fair"), cases=50), whole.name)
    assert grown.read_bytes() == whole.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["grown.parquet", "whole.parquet"]


def test_several_laws_grow_together_and_nothing_shrinks(planned, fly, tmp_path, monkeypatch):
    monkeypatch.setattr("gustproof.studies.campaign.store.ROW_GROUP", 16)  # a border of laws within a group
    path = tmp_path / "mc.parquet"
    fly(planned(cases=20), path.name)
    asked = grow_campaign(path, planned(laws=("pid-fair",), cases=10))
    assert (asked.cases, len(asked.laws)) == (20, 2)
    larger = grow_campaign(path, planned(cases=30))
    shutil.copy(path, tmp_path / "before.parquet")
    flown = fly(larger, path.name, known=tmp_path / "before.parquet")
    assert {run for chunk in flown for run in range(chunk.first, chunk.first + chunk.runs)} == {
        *range(20, 30),
        *range(50, 60),
    }
    assert pq.read_table(path).column("run").to_pylist() == list(range(60))


def test_another_campaign_does_not_grow(planned, fly, tmp_path):
    path = tmp_path / "mc.parquet"
    fly(planned(laws=("hinf-d1",), sampling=Sampling.LATIN, cases=8), path.name)
    with pytest.raises(ConfigError, match="holds another campaign: seed was 1"):
        grow_campaign(path, planned(laws=("hinf-d1",), sampling=Sampling.LATIN, cases=8, seed=2))
    with pytest.raises(ConfigError, match="a Latin hypercube of 8 cases cannot grow"):
        grow_campaign(path, planned(laws=("hinf-d1",), sampling=Sampling.LATIN, cases=9))
    assert len(grow_campaign(path, planned(laws=("pid-fair",), sampling=Sampling.LATIN, cases=8)).laws) == 2


def test_a_table_is_as_large_as_its_numbers_and_no_larger(planned, fly, tmp_path, monkeypatch):
    """Its rows by its columns bound it, so that a small file does not fill the memory."""
    fly(planned(laws=("hinf-d1",), cases=200), "mc.parquet")
    monkeypatch.setattr("gustproof.studies.campaign.reader.TEXT", 0)
    assert read_campaign(tmp_path / "mc.parquet").cases == 200
    monkeypatch.setattr("gustproof.studies.campaign.reader._VALUE", 1)
    with pytest.raises(ConfigError, match="do not match the campaign"):
        read_campaign(tmp_path / "mc.parquet")


def test_columns_have_units_and_tables_without_them_grow_too(planned, fly, tmp_path):
    path, whole = tmp_path / "mc.parquet", tmp_path / "whole.parquet"
    fly(planned(laws=("hinf-d1",), cases=20), path.name)
    units = {field.name: (field.metadata or {}).get(b"unit", b"").decode() for field in pq.read_schema(path)}
    assert (units["peak_deg"], units["torque_slew_rms"], units["saturated_s"]) == ("deg", "N m/s", "s")
    assert (units["delta_gust_scale"], units["require_0_rho_share"], units["held"]) == ("-", "-", "")
    rows = pq.read_table(path)
    note = {METADATA_KEY: rows.schema.metadata[METADATA_KEY.encode()]}
    old = pa.schema([pa.field(field.name, field.type) for field in rows.schema], metadata=note)
    pq.write_table(rows.cast(old), path)
    fly(grow_campaign(path, planned(laws=("hinf-d1",), cases=30)), path.name, known=path)
    fly(planned(laws=("hinf-d1",), cases=30), whole.name)
    assert path.read_bytes() == whole.read_bytes()
