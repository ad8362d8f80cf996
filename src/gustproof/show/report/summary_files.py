"""Statistics of a campaign as files for a spreadsheet (CSV), a paper (LaTeX) and a build server (JUnit)."""

import csv
import math
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

from firmware_model.config.files import write_text
from gustproof.flight.scoring.requirements import requirement_label, requirement_limits
from gustproof.show.report.campaign import TERMINAL_FIGURES, describe_campaign, format_value
from gustproof.show.report.junit import campaign_tests, render_suites
from gustproof.show.report.spreadsheet import quote_text
from gustproof.show.report.terminal import FIGURES
from gustproof.studies.campaign.intervals import CONFIDENCE, IntervalEstimate
from gustproof.studies.campaign.statistics import QUANTILES, CampaignStatistics, LawStatistics
from gustproof.studies.campaign.worker import FIGURES as FLOWN

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "≤": r"$\le$",
    "≥": r"$\ge$",
    "∞": r"$\infty$",
    "–": "--",
}


def save_csv(found: CampaignStatistics, path: Path) -> None:
    """Write a row for each law and figure, requirement, and difference to another law; empty where unknown."""
    names = ("mean", *QUANTILES)
    ends = [column for name in names for column in (name, f"{name}_low", f"{name}_high")]
    blank = [""] * (len(ends) - 3 + 2)  # after a mean with its interval: no quantiles, no worst run
    with StringIO(newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["law", "figure", "unit", "runs", *ends, "worst", "worst_run", "effect_size"])
        for law in found.laws:
            law_name = quote_text(law.law)
            for name in FLOWN:
                figure = law.figures[name]
                estimates = [number for each in (figure.mean, *figure.quantiles.values()) for number in each]
                worst = (figure.worst[0].value, figure.worst[0].run) if figure.worst else ("", "")
                writer.writerow([law_name, name, FIGURES[name][1], figure.flown, *map(_number, estimates), *worst, ""])
            for label, rate in _pass_rates(law):
                writer.writerow([law_name, label, "-", found.campaign.cases, *map(_number, rate), *blank, ""])
        for duel in found.duels:
            name, unit = f"{duel.figure} less that of {duel.other}", FIGURES[duel.figure][1]
            difference, effect = map(_number, duel.difference), _number(duel.effect)
            writer.writerow([quote_text(duel.law), name, unit, found.campaign.cases, *difference, *blank, effect])
        write_text(path, file.getvalue())


def _pass_rates(law: LawStatistics) -> Iterator[tuple[str, IntervalEstimate]]:
    for each in law.passed:
        yield f"met: {requirement_label(each.requirement)} {requirement_limits(each.requirement)}", each.rate
    yield "met: all requirements", law.all_held


def _number(value: float) -> float | str:
    return value if math.isfinite(value) else ""


def save_junit(found: CampaignStatistics, path: Path) -> None:
    """Write a test for each law and requirement, which fails if a run did not meet it, as JUnit's XML."""
    title = f"{found.campaign.scenario.name} on {found.campaign.vehicles.nominal.name}"
    write_text(path, render_suites({title: [*campaign_tests(found)]}))


def save_latex(found: CampaignStatistics, path: Path) -> None:
    """Write a `tabular` that needs no package: median and 95th percentile of each law, with their intervals."""
    lines = [
        f"% {describe_campaign(found.campaign)}",
        f"% in brackets: {100.0 * CONFIDENCE:g} % confidence intervals",
        r"\begin{tabular}{llrrr}",
        r"\hline",
        r"law & figure & median & 95th percentile & worst \\",
        *_latex_rows(found),
        r"\hline",
        r"\end{tabular}",
    ]
    write_text(path, "\n".join(lines) + "\n")


def _latex_rows(found: CampaignStatistics) -> Iterator[str]:
    for law in found.laws:
        yield r"\hline"
        for first, name in enumerate(TERMINAL_FIGURES):
            (label, unit), figure = FIGURES[name], law.figures[name]
            quantiles = [_format_latex(figure.quantiles[each]) for each in ("median", "p95")]
            worst = format_value(figure.worst[0].value) if figure.worst else "–"
            cells = ("" if first else law.law, f"{label} [{unit}]", *quantiles, worst)
            yield " & ".join(map(_escape, cells)) + r" \\"


def _format_latex(estimate: IntervalEstimate) -> str:
    value, low, high = map(format_value, estimate)
    return f"{value} [{low}, {high}]"


def _escape(text: str) -> str:
    return "".join(_SPECIAL.get(letter, letter) for letter in text)
