import re
import shutil
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from dataclasses import replace

import pyarrow.parquet as pq
import pytest

from firmware_model.errors import ConfigError
from gustproof.errors import FlightError
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.store import ROW_GROUP, Shard, Store, parts_folder
from gustproof.studies.campaign.worker import ChunkResult, failed_rows


class Here:
    """A pool without workers: what is submitted is done at once, and a task that names a poisonous run dies."""

    death_errors = (BrokenExecutor,)
    max_pending = 3

    def __init__(self, poison=()):
        self.poison, self.deadly, self.stretches, self.died = set(poison), True, [], []

    def submit(self, function, *arguments):
        future = Future()
        stretch = arguments[-1]
        if isinstance(stretch, tuple) and self.deadly and self.poison & runs_of(stretch):
            future.set_exception(BrokenExecutor("a worker died"))
            self.died.append(stretch)
        else:
            future.set_result(function(*arguments))
            self.stretches.append(stretch)
        return future


class Dead(Here):
    """A pool whose workers never come up."""

    def submit(self, function, *arguments):
        future = Future()
        future.set_exception(BrokenExecutor("no worker"))
        return future


def runs_of(stretch):
    return set(range(stretch.first, stretch.first + stretch.runs))


def rows_of(campaign):
    """Return a task that gives rows without flying."""
    return lambda _, stretch: ChunkResult(failed_rows(campaign, stretch, "not flown"), 1e-3 * stretch.runs)


def written(campaign, path, pool=None, **options):
    fly_campaign(campaign, path, pool or Here(), task=rows_of(campaign), **options)
    return path.read_bytes()


@pytest.mark.parametrize("count", [1, 3, 7])
def test_shards_put_together_are_one_run_to_the_byte(planned, tmp_path, count):
    campaign, whole, output = planned(), written(planned(), tmp_path / "whole.parquet"), tmp_path / "a" / "mc.parquet"
    for number in range(1, count + 1):  # each on a machine of its own, from which its parts are copied
        there = tmp_path / str(number) / "mc.parquet"
        for path in (there, output):
            path.parent.mkdir(exist_ok=True)
        fly_campaign(campaign, there, Here(), task=rows_of(campaign), shard=Shard(number, count), chunk_runs=5)
        assert not there.exists()
        shutil.copytree(parts_folder(there), parts_folder(output), dirs_exist_ok=True)
    pool = Here()
    assert written(campaign, output, pool) == whole
    assert pool.stretches == []


def test_shards_run_beside_each_other_but_not_beside_the_whole(planned, tmp_path):
    campaign, output = planned(), tmp_path / "mc.parquet"
    with Store(output, campaign, Shard(1, 2)), Store(output, campaign, Shard(2, 2)):
        for shard in (None, Shard(1, 2)):
            with pytest.raises(ConfigError, match="another process is flying"):
                Store(output, campaign, shard)
    with Store(output, campaign), pytest.raises(ConfigError, match="another process is flying shard 2/2"):
        Store(output, campaign, Shard(2, 2))
    with pytest.raises(ConfigError, match="holds parts of another campaign: seed was"):
        Store(output, replace(campaign, seed=campaign.seed + 1), Shard(2, 2)).__enter__()


def test_the_file_does_not_depend_on_how_the_runs_are_cut(planned, tmp_path):
    campaign = planned()
    files = [written(campaign, tmp_path / f"{size}.parquet", chunk_runs=size) for size in (None, 1, 7, 80, 1000)]
    assert len(set(files)) == 1
    rows = pq.read_table(tmp_path / "7.parquet").to_pylist()
    assert [row["run"] for row in rows] == list(range(80))
    assert [row["law"] for row in rows] == ["hinf-d1"] * 40 + ["pid-fair"] * 40
    assert [row["seed"] for row in rows[:40]] == [row["seed"] for row in rows[40:]]
    assert not list(tmp_path.glob("*.parts"))


def test_a_stretch_is_of_one_law_and_about_a_second_of_work(planned, tmp_path):
    pool = Here()
    written(planned(cases=3000), tmp_path / "mc.parquet", pool)
    assert all(stretch.first // 3000 == (stretch.first + stretch.runs - 1) // 3000 for stretch in pool.stretches)
    sizes = {stretch.runs for stretch in pool.stretches}
    assert {32, 512} < sizes  # 16 times as many
    assert max(sizes) == 992  # a thousand would be a second, 32 fly at once


def test_no_more_is_submitted_than_may_be_pending(planned, tmp_path):
    waiting, pending = set(), []
    with ThreadPoolExecutor(1) as executor:

        class OneByOne(Here):
            def submit(self, function, *arguments):
                future = executor.submit(function, *arguments)
                waiting.add(future)
                pending.append(len(waiting))
                future.add_done_callback(waiting.discard)
                return future

        written(planned(), tmp_path / "mc.parquet", OneByOne(), chunk_runs=1)
    assert max(pending) <= Here.max_pending


def test_rows_are_written_in_groups_that_bound_the_memory(planned, tmp_path, monkeypatch):
    monkeypatch.setattr("gustproof.studies.campaign.store.ROW_GROUP", 16)
    written(planned(), tmp_path / "mc.parquet", chunk_runs=7)
    metadata = pq.read_metadata(tmp_path / "mc.parquet")
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [16] * 5
    assert ROW_GROUP * 60 * 8 < 2**24  # 60 columns of 8 bytes


@pytest.mark.parametrize("poison", [{13}, {0, 1, 79}])
def test_a_run_that_kills_its_workers_is_found_and_the_others_are_flown(planned, tmp_path, poison):
    campaign = planned()
    pool = Here(poison)
    written(campaign, tmp_path / "mc.parquet", pool, chunk_runs=16)
    assert [pool.died.count((run, 1)) for run in poison] == [2] * len(poison)
    rows = pq.read_table(tmp_path / "mc.parquet").to_pylist()
    assert [row["run"] for row in rows] == list(range(80))
    assert {row["run"] for row in rows if "died" in row["failure"]} == poison


def test_workers_that_never_come_up_are_not_blamed_on_the_runs(planned, tmp_path):
    with pytest.raises(FlightError, match="workers die before they fly"):
        written(planned(), tmp_path / "mc.parquet", Dead())


def test_a_worker_that_dies_once_costs_a_retry(planned, tmp_path):
    campaign, pool = planned(), Here({13})

    def mended(flown, of):
        pool.deadly = False

    pool.deadly = True
    expected = written(campaign, tmp_path / "sound.parquet")
    assert written(campaign, tmp_path / "mc.parquet", pool, progress=mended) == expected


def test_what_was_flown_before_an_interruption_is_not_flown_again(planned, tmp_path):
    campaign, first, second = planned(), Here(), Here()

    def interrupt(flown, of):
        if flown >= 30:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        written(campaign, tmp_path / "mc.parquet", first, chunk_runs=7, progress=interrupt)
    kept = {run for part in (tmp_path / "mc.parquet.parts").glob("*.arrow") for run in stretch_of(part)}
    assert len(kept) >= 30
    told = []
    again = written(campaign, tmp_path / "mc.parquet", second, chunk_runs=9, progress=lambda *n: told.append(n))
    assert set().union(*map(runs_of, second.stretches)) == set(range(80)) - kept
    assert told[0] == (0, 80 - len(kept))
    assert told[-1] == (80 - len(kept), 80 - len(kept))
    assert again == written(campaign, tmp_path / "whole.parquet")


def stretch_of(part):
    first, count = map(int, re.fullmatch(r"(\d+)-(\d+)\.arrow", part.name).groups())
    return range(first, first + count)


def interrupted(campaign, path):
    """Leave the parts of a campaign."""

    def interrupt(flown, of):
        if flown:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        written(campaign, path, chunk_runs=7, progress=interrupt)
    return next(path.with_name(f"{path.name}.parts").glob("0*.arrow"))


def test_a_part_that_is_not_whole_is_flown_again(planned, tmp_path):
    campaign = planned()
    part = interrupted(campaign, tmp_path / "mc.parquet")
    part.write_bytes(part.read_bytes()[:-10])
    (part.parent / "000000000070-9.parquet.tmp").write_bytes(b"half")
    assert written(campaign, tmp_path / "mc.parquet") == written(campaign, tmp_path / "whole.parquet")


def test_parts_of_another_campaign_are_refused(planned, tmp_path):
    interrupted(planned(), tmp_path / "mc.parquet")
    with pytest.raises(
        ConfigError, match=r"mc\.parquet\.parts: holds parts of another campaign: runs was 40, seed was 1;"
    ):
        written(planned(cases=50, seed=2), tmp_path / "mc.parquet")


def test_a_campaign_without_a_finished_run_is_begun_anew(planned, tmp_path):
    with Store(tmp_path / "mc.parquet", planned(cases=50)):
        pass
    assert written(planned(), tmp_path / "mc.parquet") == written(planned(), tmp_path / "whole.parquet")


def test_two_processes_do_not_fly_one_campaign(planned, tmp_path):
    campaign = planned()
    with Store(tmp_path / "mc.parquet", campaign), pytest.raises(ConfigError, match="another process is flying this"):
        written(campaign, tmp_path / "mc.parquet")


def test_a_full_disk_is_told_and_keeps_what_was_flown(planned, tmp_path, monkeypatch):
    campaign = planned()
    part = interrupted(campaign, tmp_path / "mc.parquet")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(FlightError, match="No space left on device; finished runs stay"):
        written(campaign, tmp_path / "mc.parquet")
    assert part.exists()
