"""A real autopilot in control of a flight, as it is named on the command line and in files."""

import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from firmware_model.config.validation import none_of
from firmware_model.errors import ConfigError
from firmware_model.external.interface import SAMPLE_RATES_HZ, WITHOUT_LOCKSTEP
from gustproof.flight.controllers.user_controller import Controller, refuse_named

AUTOPILOTS = tuple(SAMPLE_RATES_HZ)
"""Autopilots that can be flown, by the names of `--autopilot`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExternalAutopilot:
    """A build of a real autopilot with its parameters and, if one is built into it, a law inside.

    Examples
    --------
    >>> from gustproof import ExternalAutopilot
    >>> ExternalAutopilot(kind="px4", parameters="tuned").name
    'px4-tuned'
    """

    kind: str
    """One of `AUTOPILOTS`."""
    build: str = ""
    """Folder of its build; empty for the usual places."""
    parameters: str = ""
    """Shipped set or file of parameters, on top of those that the vehicle file gives; empty for none."""
    law: str = ""
    """Law that was built into it and flies in place of its own loops; empty for its own."""
    instance: int | None = None
    """Number of its instance, which sets its ports; `None` for a free one."""
    given: bool = field(default=True, compare=False)
    """True if its user named it. One that a bag or a table names is never started, see `confirm_autopilot`."""

    def __post_init__(self) -> None:
        """Check the kind."""
        if self.kind not in AUTOPILOTS:
            raise ConfigError(f"--autopilot: {none_of(self.kind, AUTOPILOTS)}")

    @property
    def name(self) -> str:
        """Name in texts and files."""
        return "-".join(filter(None, (self.kind, Path(self.parameters).stem, self.law)))

    @property
    def has_lockstep(self) -> bool:
        """True if its clock is ours; otherwise it flies at the pace of the machine's, and no two flights are equal."""
        return self.kind not in WITHOUT_LOCKSTEP

    def check_given(self, where: object = "") -> None:
        """Refuse to start an autopilot that its user did not name; the text begins with `where`.

        Raises
        ------
        ConfigError
            If only a file names it. The text says what to type.
        """
        if not self.given:
            words = {"--autopilot": self.kind, "--build": self.build, "--params": self.parameters}
            line = shlex.join([word for option, value in words.items() if value for word in (option, value)])
            raise refuse_named(where, "an autopilot, which is a program", line)

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON values, input of `parse_autopilot`."""
        return {
            "autopilot": self.kind,
            "name": self.name,
            "build": self.build,
            "parameters": self.parameters,
            "law": self.law,
            "instance": self.instance,
        }


AnyController = Controller | ExternalAutopilot
"""Whatever flies."""


def parse_autopilot(document: Any, source: object) -> ExternalAutopilot:
    """Return the autopilot that `ExternalAutopilot.to_dict` has written.

    It tells what flew and can't be started: the document may come from anywhere, see `confirm_autopilot`.

    Raises
    ------
    ConfigError
        If a field is missing or wrong.
    """
    try:
        kind, instance = str(document["autopilot"]), document.get("instance")
        texts = {key: str(document[key]) for key in ("build", "parameters", "law")}
        number = None if instance is None else int(instance)
        return ExternalAutopilot(kind=kind, instance=number, given=False, **texts)
    except (AttributeError, KeyError, TypeError, ValueError):
        raise ConfigError(f"{source}: does not say which autopilot flew") from None


def confirm_autopilot(flown: ExternalAutopilot, given: ExternalAutopilot | None, where: object) -> ExternalAutopilot:
    """Return `flown` with the build and the parameters that a user gives to fly it again.

    Raises
    ------
    ConfigError
        If none is given, or it is another one; the text begins with `where`.
    """
    if given is None:
        flown.check_given(where)
        return flown
    if given.kind != flown.kind or Path(given.parameters).name != Path(flown.parameters).name:
        raise ConfigError(f"{where}: flown by '{flown.name}', not '{given.name}'")
    if flown.build and not given.build:
        raise ConfigError(f"{where}: flown by the build {flown.build}; give that, or a copy: --build FOLDER")
    return replace(flown, build=given.build, parameters=given.parameters, given=True)
