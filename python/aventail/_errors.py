"""What can go wrong, by cause. Every message names the file or thing, the value found, and what to do about it."""

from __future__ import annotations


class Error(Exception):
    """An error of aventail; its subclasses are its causes.

    ``str(error)`` is what the program prints.
    """

    exit_code: int = 1
    """Exit code of the program for this cause."""

    def __init__(self, message: str, what: str | None, cause: str, remedy: str, code: str = "") -> None:
        super().__init__(message, what, cause, remedy, code)
        self.message = message
        self.what = what
        """The file or thing at fault, where one is."""
        self.cause = cause
        """What is wrong, with the value found."""
        self.remedy = remedy
        """What to do about it."""
        self.code = code
        """Stable name of the finding, as in docs/refusals.md; empty where it has none."""

    def __str__(self) -> str:
        return self.message


class InternalError(Error):
    """A defect of aventail."""


class UsageError(Error):
    """An argument or a setting asks for something that does not exist or cannot be."""

    exit_code = 2


class ReadError(Error):
    """A file is missing, truncated, or not in a format that can be read."""

    exit_code = 3


class InputError(Error):
    """Inputs do not fit the task or each other."""

    exit_code = 4


class WriteError(Error):
    """A result cannot be written."""

    exit_code = 5


class RegistrationError(Error):
    """The registration has no trustworthy answer."""

    exit_code = 6


_KINDS: dict[int, type[Error]] = {
    kind.exit_code: kind
    for kind in (InternalError, UsageError, ReadError, InputError, WriteError, RegistrationError)
}


def made(message: str, what: str | None, cause: str, remedy: str, code: str, exit_code: int) -> Error:
    """The exception of an error of the compiled module."""
    return _KINDS.get(exit_code, Error)(message, what, cause, remedy, code)


def usage(cause: str, remedy: str) -> UsageError:
    """An argument that cannot be."""
    return UsageError(f"{cause}\n  remedy: {remedy}", None, cause, remedy)


def unsuitable(what: str, cause: str, remedy: str) -> InputError:
    """An input that does not fit."""
    return InputError(f"{what}: {cause}\n  remedy: {remedy}", what, cause, remedy)
