"""Results as JUnit's XML, which build servers read: a test each, with its reason if it fails."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple
from xml.etree import ElementTree

from firmware_model.config.validation import sanitize_line
from gustproof.flight.routes.flight import Flight
from gustproof.flight.scoring.requirements import RequirementResult, requirement_label, requirement_limits
from gustproof.studies.campaign.statistics import CampaignStatistics, PassRate


class JunitTest(NamedTuple):
    """One test of a suite."""

    name: str
    """Name, which repeats from run to run."""
    told: str
    """Result in words."""
    failed: bool
    """True if what was asked does not hold."""
    group: str
    """Law, vehicle or scenario that it is of."""
    broken: bool = False
    """True if it could not be asked: the flight broke off."""


def render_suites(suites: Mapping[str, Sequence[JunitTest]]) -> str:
    """Return tests by suite as XML."""
    root = ElementTree.Element("testsuites")
    for title, tests in suites.items():
        failures, errors = sum(test.failed for test in tests), sum(test.broken for test in tests)
        counts = {"tests": str(len(tests)), "failures": str(failures), "errors": str(errors)}
        suite = ElementTree.SubElement(root, "testsuite", {"name": title, **counts})
        for test in tests:
            told = sanitize_line(test.told)  # XML has no control characters
            case = ElementTree.SubElement(suite, "testcase", classname=test.group, name=test.name)
            if test.failed or test.broken:
                ElementTree.SubElement(case, "failure" if test.failed else "error", message=told)
            ElementTree.SubElement(case, "system-out").text = told
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def flight_tests(flight: Flight) -> Iterator[JunitTest]:
    """Yield whether a flight came to its expected end, and each of its requirements."""
    ended = flight.has_expected_outcome
    yield JunitTest("flown", flight.message, failed=False, group=flight.pilot_name, broken=not ended)
    for result in flight.requirements:
        yield JunitTest(_name(result), f"is {result.value:.4g}", failed=not result.is_met, group=flight.pilot_name)


def campaign_tests(found: CampaignStatistics) -> Iterator[JunitTest]:
    """Yield whether all runs of a law were flown, and each requirement: it fails if a run did not meet it."""
    cases = found.campaign.cases
    for law in found.laws:
        told = "; ".join(f"run {failure.run}: {failure.reason}" for failure in law.failures)
        yield JunitTest("flown", told or f"{cases} runs", failed=False, group=law.law, broken=bool(law.failed))
        for each in law.passed:
            rate, worst = each.rate, each.worst[0] if each.worst else None
            share, low, high = (100.0 * end for end in rate)
            told = f"met in {share:.4g} % ({low:.4g} to {high:.4g}) of {cases} runs"
            told += f", worst {worst.value:.4g} in run {worst.run}" if worst else ""
            yield JunitTest(_name(each), told, failed=rate.value < 1.0, group=law.law)


def _name(asked: RequirementResult | PassRate) -> str:
    return f"{requirement_label(asked.requirement)} {requirement_limits(asked.requirement)}"
