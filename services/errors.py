"""The services' errors, one tree. Every message says what was expected, what was found, and what to do."""

from __future__ import annotations


class HalmaError(Exception):
    """Base of everything the services raise on purpose. The command line prints it and exits with `exit_code`."""

    exit_code = 1


class BadInput(HalmaError):
    """The person has to change something: exit code 2, nothing half-done left behind."""

    exit_code = 2


class SpecError(BadInput):
    """A study file is wrong: file, line, field, what was expected, what was found."""


class UnknownStudy(BadInput):
    """No study of that name."""


class UnknownTrial(BadInput):
    """No trial of that number."""


class NameTaken(BadInput):
    """A study of that name exists."""


class StudyDriven(BadInput):
    """Another process drives the study: which, where, since when."""


class WrongState(BadInput):
    """What was asked does not go with the state the study is in."""


class DatabaseUnavailable(BadInput):
    """The trial database can't be opened, reached or written, or is of another schema."""


class ArtifactsMoved(BadInput):
    """The artifacts are not where the record knows them: where they were, where they are looked for, what to do."""


class ArtifactDamaged(HalmaError):
    """An artifact is missing or doesn't match its hash."""


class StorageUnavailable(HalmaError, OSError):
    """The artifacts can't be written or read now (disk full, read-only, server away). Whoever can wait, waits."""


class Refused(HalmaError):
    """A transition was refused by its guard (state or fencing token). Nothing was written."""


class NotInstalled(HalmaError):
    """A package is missing that not everybody needs; the message says how to get it."""


class InterruptedByUser(HalmaError):
    """Ctrl-C or SIGTERM: the study is resumable."""

    exit_code = 130
