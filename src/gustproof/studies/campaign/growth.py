"""Make a campaign larger, by cases or by laws, and keep the runs that are flown.

A case is a pure function of seed and number, whatever the number of cases; only a Latin hypercube divides its ranges by
that number. So the larger table equals, to the bit, the one flown at once.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa

from firmware_model.errors import ConfigError
from gustproof.studies.campaign.plan import Campaign, check_given, confirm, is_given
from gustproof.studies.campaign.reader import open_table, read_campaign, read_campaign_metadata
from gustproof.studies.campaign.sampling import Sampling
from gustproof.studies.campaign.store import Store, check_same_campaign
from gustproof.studies.campaign.worker import Chunk, schema


def resume_campaign(table: Path, asked: Campaign) -> tuple[Campaign, int]:
    """Return the campaign to fly into a table, see `grow_campaign`, and the number of runs that the table has.

    Without a table that is what is asked for, and 0.
    """
    return (grow_campaign(table, asked), read_campaign(table).runs) if table.exists() else (asked, 0)


def grow_campaign(table: Path, asked: Campaign) -> Campaign:
    """Return the campaign of a table with more laws, and as many cases as are asked for if those are more.

    Its laws come first, then those of `asked` that it does not have. An entry or an autopilot of the table that is not
    given in `asked` stays one that can't fly.

    Raises
    ------
    ConfigError
        If they differ in anything else, or the cases of a Latin hypercube would be more. If an entry or an autopilot
        that is not given would fly more of them.
    """
    flown, metadata = read_campaign(table), read_campaign_metadata(table)
    given = {law.name: law for law in asked.laws if is_given(law)}
    laws = [confirm(law, tuple(given.values()), table) if law.name in given else law for law in flown.laws]
    theirs = {law.name: law.to_dict() for law in laws}
    same = {name: law.to_dict() for name, law in given.items() if name in theirs}
    ours = {**asked.metadata(), "laws": same, "runs": 0}
    check_same_campaign(
        {
            **flown.metadata(),  # as this version writes it
            "versions": metadata["versions"],
            "laws": {name: theirs[name] for name in same},
            "runs": 0,
        },
        ours,
        f"{table}: holds another campaign",
    )
    cases = max(flown.cases, asked.cases)
    if cases > flown.cases and flown.sampling is Sampling.LATIN:
        raise ConfigError(f"{table}: a Latin hypercube of {flown.cases:,} cases cannot grow; give another -o")
    if cases > flown.cases:
        check_given(laws, table)
    added = (law for name, law in given.items() if name not in theirs)
    return replace(asked, laws=(*laws, *added), cases=cases)


def take_runs(table: Path, campaign: Campaign, store: Store) -> None:
    """Store the runs of a table as runs of the campaign that `grow_campaign` returned for it."""
    flown, file, begin = read_campaign(table), open_table(table), 0
    columns = schema(campaign)
    for group in range(file.num_row_groups):
        rows = file.read_row_group(group)
        at = begin
        while at < begin + rows.num_rows:
            end = min(begin + rows.num_rows, (at // flown.cases + 1) * flown.cases)
            first = at // flown.cases * campaign.cases + at % flown.cases
            if not store.holds(first):
                store.add(Chunk(first, end - at), _renumber(rows.slice(at - begin, end - at), first, columns))
            at = end
        begin += rows.num_rows


def _renumber(rows: Any, first: int, columns: Any) -> Any:
    """Return rows with the numbers of runs from `first` on, and the metadata of `columns`."""
    numbers = pa.array(range(first, first + rows.num_rows), pa.int64())
    arrays = [numbers, *(rows.column(name) for name in columns.names[1:])]
    return pa.Table.from_arrays([each if each is numbers else each.combine_chunks() for each in arrays], schema=columns)
