"""What a registration found, as arrays and numbers alone: its pickle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias, Union

from . import _aventail, _errors

if TYPE_CHECKING:
    from ._aventail import _Names, _Raster, _Rows

Results: TypeAlias = Union[_aventail.Registration, "Kept"]
"""What answers for a registration."""

_IMAGES = ("planning_on_fraction", "jacobian", "uncertainty")
_LABELS = ("bones_on_fraction", "regions")
_MASKS = ("body", "computed", "inside_planning")


class Kept:
    """Results without what made them; it answers as the compiled module's registration does."""

    def __init__(self, state: dict[str, Any]) -> None:
        self._state = state

    @classmethod
    def of(cls, found: Results) -> Kept:
        """Everything that a registration tells."""
        if isinstance(found, Kept):
            return found
        return cls(
            {
                "report": found.report(),
                "fields": {to_fraction: found.field(to_fraction) for to_fraction in (True, False)},
                "images": {name: found.image(name) for name in _IMAGES},
                "labels": {name: found.labels(name) for name in _LABELS},
                "masks": {name: found.mask(name) for name in _MASKS},
                "bones": found.bones(),
                "warnings": found.warnings(),
            }
        )

    def report(self) -> str:
        return self._state["report"]  # type: ignore[no-any-return]

    def field(self, to_fraction: bool) -> _Raster:
        return self._state["fields"][to_fraction]  # type: ignore[no-any-return]

    def image(self, name: str) -> _Raster | None:
        return self._state["images"][name]  # type: ignore[no-any-return]

    def labels(self, name: str) -> tuple[_Raster, _Names] | None:
        return self._state["labels"][name]  # type: ignore[no-any-return]

    def mask(self, name: str) -> _Raster | None:
        return self._state["masks"][name]  # type: ignore[no-any-return]

    def bones(self) -> list[tuple[str, _Rows]]:
        return self._state["bones"]  # type: ignore[no-any-return]

    def warnings(self) -> list[tuple[str, str]]:
        return self._state["warnings"]  # type: ignore[no-any-return]

    def save(self, *_: object) -> NoReturn:
        _refuse("save", "call registration.save(folder) in the process that registered")

    def samples(self, *_: object) -> NoReturn:
        _refuse("samples", "draw them in the process that registered, or with aventail samples of the saved run")

    def warp_points(self, *_: object) -> NoReturn:
        _refuse("warp")

    def warp_image(self, *_: object) -> NoReturn:
        _refuse("warp")

    def warp_labels(self, *_: object) -> NoReturn:
        _refuse("warp")

    def warp_contours(self, *_: object) -> NoReturn:
        _refuse("warp")


def _refuse(
    what: str,
    remedy: str = "warp in the process that registered, save its fields for `aventail warp`, or resample with "
    "field.to_sitk(); aventail.dose.map and aventail.evaluate take this registration",
) -> NoReturn:
    raise _errors.usage(f"{what}: this registration comes from a pickle, which holds results only", remedy)
