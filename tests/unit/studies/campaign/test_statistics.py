import csv
import json
import math
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from firmware_model.errors import ConfigError
from gustproof.show.report.campaign import (
    _drawn_in_words,
    format_comparisons,
    format_estimate,
    format_share,
    render_campaign,
)
from gustproof.show.report.html.campaign_page import render_campaign_page
from gustproof.show.report.summary_files import save_csv, save_latex
from gustproof.show.report.terminal import save_text
from gustproof.studies.campaign.intervals import IntervalEstimate
from gustproof.studies.campaign.plan import DispersionKind
from gustproof.studies.campaign.reader import open_table, read_campaign, read_campaign_metadata, read_column, read_run
from gustproof.studies.campaign.runner import fly_campaign
from gustproof.studies.campaign.statistics import _compare_laws, compute_statistics
from gustproof.studies.campaign.worker import FIGURES, ChunkResult, failed_rows

CASES = 400
FAILED = 17


@pytest.fixture
def table(planned, tmp_path, here):
    """Return the file of a campaign with made-up figures: RMSE rises with the gusts, and is lower for the second law.

    All other figures are the RMSE, but for the slew, which no law and no dispersion changes; run 17 is lost.
    """
    campaign = planned([DispersionKind.GUST, DispersionKind.VEHICLE], cases=CASES)

    def fly(_, stretch):
        rows = failed_rows(campaign, stretch, "lost")
        rmse = (1.0 if stretch.first < CASES else 0.5) * (2.0 + rows["delta_gust_scale"].to_numpy())
        runs = rows["run"].to_numpy()
        for name in rows.column_names:
            if name in FIGURES or name.startswith("require"):
                values = {"torque_slew_rms": np.ones(len(rmse)), "require_0_rho_share": rmse}.get(name, rmse)
                rows = put(rows, name, values <= 1.4 if name.endswith("_held") else values)
        rows = put(rows, "held", rmse <= 1.4)
        reasons = pa.array([None if run != FAILED else "lost" for run in runs], pa.string())
        rows = rows.set_column(rows.column_names.index("failure"), "failure", reasons)
        return ChunkResult(holes(rows, runs == FAILED), 1.0)

    path = tmp_path / "mc.parquet"
    fly_campaign(campaign, path, here, task=fly)
    return path


def put(rows, name, values):
    at = rows.column_names.index(name)
    return rows.set_column(at, rows.schema.field(at), pa.array(values, rows.schema.field(at).type))


def holes(rows, where):
    """Return rows whose figures are missing where a run was lost."""
    for name in rows.column_names:
        if name in FIGURES:
            values = np.where(where, math.nan, rows[name].to_numpy())
            rows = rows.set_column(
                rows.column_names.index(name), rows.schema.field(name), pa.array(values, from_pandas=True)
            )
    return rows


def test_figures_are_those_of_the_runs_that_left_some(table):
    found = compute_statistics(table).laws
    rows = pq.read_table(table).to_pylist()
    rmse = found[0].figures["rmse_deg"]
    assert (rmse.flown, found[1].figures["rmse_deg"].flown) == (CASES - 1, CASES)
    assert rmse.mean.low < rmse.mean.value < rmse.mean.high
    assert rmse.quantiles["median"].low < 2.0 < rmse.quantiles["median"].high
    assert rmse.quantiles["p95"].value > rmse.quantiles["median"].value
    assert rmse.worst[0].value >= max(row["rmse_deg"] or 0.0 for row in rows)
    assert read_run(table, rmse.worst[0].run)["rmse_deg"] == rmse.worst[0].value
    assert all(worst.run >= CASES for worst in found[1].figures["rmse_deg"].worst)


def test_of_runs_that_are_equally_bad_the_first_are_told(table):
    assert [worst.run for worst in compute_statistics(table).laws[1].figures["torque_slew_rms"].worst] == list(
        range(CASES, CASES + 5)
    )
    first = compute_statistics(table).laws[0].figures["rmse_deg"].worst
    assert [worst.value for worst in first] == sorted((worst.value for worst in first), reverse=True)


def test_a_run_that_left_nothing_passes_nothing(table):
    law = compute_statistics(table).laws[0]
    assert law.failed == 1
    assert law.failures[0] == (FAILED, "lost")
    held = sum(
        row["rmse_deg"] is not None and row["rmse_deg"] <= 1.4 for row in pq.read_table(table).to_pylist()[:CASES]
    )
    assert law.passed[0].rate.value == law.all_held.value == held / CASES


def test_what_matters_is_found_and_what_does_not_is_not(table):
    figures = compute_statistics(table).laws[1].figures
    importance = figures["rmse_deg"].importance
    assert importance["gust_scale"].first_order > 0.95
    assert importance["gust_scale"].rank_correlation == pytest.approx(1.0)
    assert importance["actuator_lag"].first_order < 0.1
    assert figures["torque_slew_rms"].importance["gust_scale"] is None


def test_laws_are_compared_case_by_case(table):
    duels = {duel.figure: duel.lower.value for duel in compute_statistics(table).duels}
    assert duels["rmse_deg"] == 0.0  # never below, in any case: 2 + d against (2 + d) / 2
    assert duels["torque_slew_rms"] == 0.0  # equal is not below
    line = next(line for line in format_comparisons(compute_statistics(table)) if "RMSE" in line)
    assert line.startswith("RMSE: hinf-d1 is higher than pid-fair by ")
    assert " on average, lower in 0 % (0 .. " in line


def test_differences_case_by_case_have_intervals_and_an_effect_size(table):
    duel = next(duel for duel in compute_statistics(table).duels if duel.figure == "rmse_deg")
    one, other = np.array(pq.read_table(table)["rmse_deg"].to_pylist(), dtype=float).reshape(2, -1)
    differences = (one - other)[np.isfinite(one - other)]
    assert duel.difference.value == pytest.approx(np.mean(differences))
    assert duel.effect == pytest.approx(np.mean(differences) / np.std(differences, ddof=1))
    assert duel.difference.low < duel.difference.value < duel.difference.high
    line = next(line for line in format_comparisons(compute_statistics(table)) if "RMSE" in line)
    assert f" by {duel.difference.value:.3g} deg ({duel.difference.low:.3g} .. " in line


def test_one_case_has_a_difference_and_no_effect_size():
    two = SimpleNamespace(laws=[SimpleNamespace(name="a"), SimpleNamespace(name="b")])
    (duel,) = _compare_laws("rmse_deg", np.array([[3.0], [1.0]]), two)
    assert duel.difference.value == 2.0
    assert math.isnan(duel.effect)
    (line,) = format_comparisons(SimpleNamespace(duels=[duel]))
    assert line == "RMSE: a is not lower than b in the one case: that is no average"


def test_figures_are_written_for_a_spreadsheet_and_for_a_paper(table, tmp_path):
    found = compute_statistics(table)
    save_csv(found, tmp_path / "mc.csv")
    with (tmp_path / "mc.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    figure = found.laws[1].figures["rmse_deg"]
    row = next(row for row in rows if (row["law"], row["figure"]) == ("pid-fair", "rmse_deg"))
    assert (row["unit"], float(row["p95"]), int(row["worst_run"])) == (
        "deg", figure.quantiles["p95"].value, figure.worst[0].run,
    )  # fmt: skip
    duel = next(row for row in rows if row["figure"] == "rmse_deg less that of pid-fair")
    assert float(duel["effect_size"]) > 0.0
    assert all(None not in row and None not in row.values() for row in rows)  # each row has all columns
    assert sum(row["figure"] == "met: all requirements" for row in rows) == 2
    save_latex(found, tmp_path / "mc.tex")
    text = (tmp_path / "mc.tex").read_text()
    body = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 1
    assert {line.count(" & ") for line in body} == {4}
    assert "∞" not in text


def test_the_document_is_json_without_what_json_has_not(table):
    told = json.loads(json.dumps(compute_statistics(table).to_dict(), allow_nan=False))
    assert told["runs"] == 2 * CASES
    assert told["laws"]["hinf-d1"]["figures"]["rmse_deg"]["flown"] == CASES - 1
    assert told["laws"]["hinf-d1"]["failures"] == [{"run": FAILED, "reason": "lost"}]


def test_text_and_page_tell_the_same(table, tmp_path):
    found, text = compute_statistics(table), tmp_path / "mc.txt"
    save_text(render_campaign(found), text)
    page = render_campaign_page(table)
    worst = found.laws[0].figures["rmse_deg"].worst[0].run
    for shown in (text.read_text(encoding="utf-8").replace("\n", ""), page):
        assert f"gustproof campaign rerun {table}:{worst}".replace("\n", "") in shown.replace("\n", "")
        assert "95 %" in shown
    assert page == render_campaign_page(table)
    assert "http" not in page.replace("http-equiv", "")
    drawn = 2 * (len(FIGURES) - 1) + 2 * len(found.campaign.spreads)  # the slew is 1 in every run
    assert page.count("<svg") == drawn
    assert page.count('class="dots"') == len(found.laws) * len(found.campaign.spreads)
    assert "torque slew rms [N m/s]: 1 in every run" in page


def test_a_campaign_without_requirements_or_dispersions_is_told_too(planned, tmp_path, here):
    scenario = replace(planned().scenario, require=())
    campaign = planned([], laws=("hinf-d1",), cases=3, scenario=scenario)
    path = tmp_path / "mc.parquet"
    fly_campaign(campaign, path, here, task=lambda _, stretch: ChunkResult(failed_rows(campaign, stretch, "lost"), 1.0))
    found = compute_statistics(path)
    save_text(render_campaign(found), tmp_path / "mc.txt")
    assert "3 runs without figures" in (tmp_path / "mc.txt").read_text(encoding="utf-8")
    assert "Only gusts and noise varied" in render_campaign_page(path)


def test_a_changed_byte_of_a_page_is_told(table, tmp_path):
    """Another number passed without a word, and a page that does not unpack was a traceback."""
    content, file, told = table.read_bytes(), tmp_path / "damaged.parquet", []
    sound = open_table(table).read()
    column = pq.read_metadata(table).row_group(0).column(sound.column_names.index("rmse_deg"))
    begin = column.data_page_offset
    for place in range(begin, begin + column.total_compressed_size, 7):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        try:
            assert open_table(file).read().equals(sound)
        except ConfigError as error:
            told.append(str(error))
    assert len(told) > 10
    assert set(told) == {f"{file}: it is damaged"}
    with pytest.raises(ConfigError, match="it is damaged"):
        read_column(open_table(table), "no_column", read_campaign(table))


def test_what_is_no_campaign_is_told_in_a_line(tmp_path):
    path = tmp_path / "mc.parquet"
    with pytest.raises(ConfigError, match="no such file"):
        read_campaign_metadata(path)
    path.write_bytes(b"")
    with pytest.raises(ConfigError, match="is empty"):
        read_campaign_metadata(path)
    path.write_bytes(b"no PAR1 at all")
    with pytest.raises(ConfigError, match=r"no table of a campaign$"):
        read_campaign_metadata(path)
    path.write_bytes(b"PAR1 not at all")
    with pytest.raises(ConfigError, match="no table of a campaign, or one that is cut short"):
        read_campaign_metadata(path)
    pq.write_table(pa.table({"run": [1]}), path)
    with pytest.raises(ConfigError, match="no table of a campaign"):
        read_campaign_metadata(path)


def test_names_of_laws_and_figures_are_whole_in_a_narrow_terminal(table):
    found, screen = compute_statistics(table), StringIO()
    Console(file=screen, width=80, color_system=None).print(render_campaign(found))
    words = " ".join(line.replace("│", " ") for line in screen.getvalue().splitlines())
    assert max(map(len, screen.getvalue().splitlines())) <= 80
    assert "…" not in words
    assert all(law.name in words.split() for law in found.campaign.laws)
    assert {"RMSE", "peak", "torque", "slew"} <= set(words.split())


def test_runs_that_tilt_past_the_horizon_are_counted_and_warned_of(planned, tmp_path, here):
    campaign = planned([], cases=40)

    def fly(_, stretch):
        rows = failed_rows(campaign, stretch, "lost")
        runs = rows["run"].to_numpy()
        for name in FIGURES:
            rows = put(rows, name, np.ones(len(runs)))
        rows = put(rows, "peak_roll_deg", np.where(runs % 10 == 3, 90.1, 90.0))
        return ChunkResult(put(rows, "peak_pitch_deg", np.full(len(runs), 89.0)), 1.0)

    path = tmp_path / "mc.parquet"
    fly_campaign(campaign, path, here, task=fly)
    found = compute_statistics(path)
    assert [law.tilted for law in found.laws] == [4, 4]
    line = "'hinf-d1' tilted past 90 deg in 4 of 40 runs"
    assert found.warnings[-2:] == (line, line.replace("hinf-d1", "pid-fair"))
    assert "tilted past 90 deg in 4 of 40 runs" in render_campaign_page(path)


@pytest.mark.parametrize(
    ("share", "told"),
    [
        ((53 / 60, 0.7743, 0.9518), ("88 %", "77 .. 95.2")),
        ((99_998 / 100_000, 0.999928, 1.0), ("99.9980 %", "99.9928 .. 100")),
        ((1.0, 0.94, 1.0), ("100 %", "94.0 .. 100")),
        ((0.0, 0.0, 3.7e-5), ("0 %", "0 .. 0.0037")),
    ],
)
def test_a_share_is_rounded_to_all_or_none_only_if_it_is(share, told):
    assert format_share(IntervalEstimate(*share)) == told


def test_a_quantile_without_an_upper_end_is_told_as_a_bound():
    assert format_estimate(IntervalEstimate(0.07, 0.06362, math.inf)) == ("0.07", "≥ 0.0636")


def test_what_is_drawn_is_told_in_words():
    names = ("inertia_B.x", "inertia_B.y", "inertia_B.z", "actuator_lag", "gyro.snr_db", "gust_scale")
    assert [*_drawn_in_words(names)] == ["inertia (3 axes)", "actuator lag", "gyro snr db", "gust scale"]
